"""python -m blind.generator: solve what is not solved; ``ONE=name`` remakes one result and compares."""

import os

from blind.generator import jobs

if os.environ.get("ONE"):
    print(jobs.compare(os.environ["ONE"]))
else:
    jobs.make_all()
