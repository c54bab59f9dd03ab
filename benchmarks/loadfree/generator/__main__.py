"""python -m loadfree.generator: solve the events that are not solved, then write the archive.

``--set NAME``: events of a further set (see ``store.py``), instead of the others; ``--pack``: only
write the archive from the events that are there; ``--limit N``: the first N events of each body;
``--bodies REFERENCE``: make the bodies' meshes anew, with the reference problems in that folder.
"""

import argparse
from functools import partial
from pathlib import Path

from loadfree.generator import bodies, store

parser = argparse.ArgumentParser(prog="python -m loadfree.generator")
parser.add_argument("--pack", action="store_true")
parser.add_argument("--limit", type=int, default=store.N_EVENTS)
parser.add_argument("--set", choices=[*store.SETS])
parser.add_argument("--bodies", type=Path)
options = parser.parse_args()
if options.bodies:
    for name in bodies.BODIES:
        bodies.write(name, options.bodies)
if not options.pack:
    report = partial(print, flush=True)
    store.make_set(options.set, report) if options.set else store.make_events(options.limit, report)
counts = store.pack_set(options.set) if options.set else {name: store.pack(name) for name in bodies.BODIES}
for name, count in counts.items():
    print(f"{name}: {count} events")
