"""python -m loadfree.generator: solve the events that are not solved, then write the archive.

``--pack``: only write the archive from the events that are there; ``--limit N``: the first N events of each body;
``--bodies REFERENCE``: make the bodies' meshes anew, with the reference problems in that folder.
"""

import argparse
from pathlib import Path

from loadfree.generator import bodies, store

parser = argparse.ArgumentParser(prog="python -m loadfree.generator")
parser.add_argument("--pack", action="store_true")
parser.add_argument("--limit", type=int, default=store.N_EVENTS)
parser.add_argument("--bodies", type=Path)
told = parser.parse_args()
if told.bodies:
    for name in bodies.BODIES:
        bodies.write(name, told.bodies)
if not told.pack:
    store.make_events(told.limit, lambda line: print(line, flush=True))
for name in bodies.BODIES:
    print(f"{name}: {store.pack(name)} events")
