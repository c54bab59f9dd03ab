"""Make the rigs that are missing: ``python -m twin`` (`make -C paper twin`).

``--development``: the rigs on which methods are tuned, none of which is reported; ``--only NAME``: one rig; ``--list``:
their names; ``--corners N``: another mesh, for a comparison, into another ``--out``. Each rig is one file, written
whole: a run that was stopped goes on.
"""

import argparse
import json
from dataclasses import asdict
from pathlib import Path

import numpy as np

from tissuereg.io.fields import write_npz
from twin.rig import DEVELOPMENT_SEEDS, FRAME_S, SCENARIOS, SEEDS, draw, pushes

FOLDER = Path(__file__).resolve().parent
RIGS, DEVELOPMENT = FOLDER / "rigs", FOLDER / "development"


def main():
    """Make what is missing."""
    parser = argparse.ArgumentParser(prog="python -m twin", description=__doc__)
    parser.add_argument("--only")
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--development", action="store_true")
    parser.add_argument("--out", type=Path)
    parser.add_argument("--corners", type=int)
    options = parser.parse_args()
    seeds = DEVELOPMENT_SEEDS if options.development else dict.fromkeys(SCENARIOS, SEEDS)
    out = options.out or (DEVELOPMENT if options.development else RIGS)
    rigs = [draw(scenario, seed) for scenario in SCENARIOS for seed in seeds[scenario]]
    names = [rig.name for rig in rigs]
    if options.list:
        print("\n".join(names))
        return
    if options.only and options.only not in names:
        parser.error(f"--only must be one of {', '.join(names)}, got {options.only}")
    out.mkdir(parents=True, exist_ok=True)
    for rig in rigs:
        path = out / f"{rig.name}.npz"
        if path.exists() or options.only not in (None, rig.name):
            continue
        make(rig, path, options.corners)


def make(rig, path, n_corners=None):
    """Solve a rig and write its file."""
    from twin.solve import N_CORNERS, solve

    found, facts = solve(rig, n_corners=n_corners or N_CORNERS)
    known = {
        "pad_centre_mm": [one.known_centre for one in rig.actuators],
        "pad_direction": [one.known_direction for one in rig.actuators],
        "pad_radius_mm": [one.radius for one in rig.actuators],
        "pad_stroke_mm": [one.stroke for one in rig.actuators],
        "motion": pushes(),
        "frame_s": FRAME_S,
    }
    stated = json.dumps(asdict(rig) | {"solved": facts}, default=lambda array: array.tolist())
    moved = {name: value for name, value in found.items() if name.endswith(("displacement_mm", "force_mN"))}
    rest = {name: value for name, value in found.items() if name not in moved}
    # Single precision is enough, and half of the size.
    write_npz(path, {**rest, **known, **{k: v.astype(np.float32) for k, v in moved.items()}, "truth": stated})
    print(f"{rig.name}: {facts}", flush=True)


if __name__ == "__main__":
    main()
