"""python -m blind.generator: solve what is not solved; ``ONE=name`` remakes one result and compares."""

import argparse
import os

from blind.generator import jobs

argparse.ArgumentParser(prog="python -m blind.generator", description=__doc__).parse_args()
if os.environ.get("ONE"):
    print(jobs.compare(os.environ["ONE"]))
else:
    jobs.make_all()
