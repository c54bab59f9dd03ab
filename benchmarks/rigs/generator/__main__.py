"""python -m rigs.generator [RIG ...]: solves what is missing, then writes all cases and answers."""

import argparse

from rigs.generator import make, store
from rigs.generator.rigs import names, third

parser = argparse.ArgumentParser(prog="python -m rigs.generator", description=__doc__)
parser.add_argument("rigs", nargs="*", metavar="RIG", help="names of rigs; all by default")
parser.add_argument("--kinds", nargs="+", default=["null", "single", "outside", "pair"])
parser.add_argument("--only-store", action="store_true", help="solve nothing")
options = parser.parse_args()
if not options.only_store:
    make.run(options.rigs or [*names(), *third()], lambda text: print(text, flush=True), tuple(options.kinds))
store.store(print)
