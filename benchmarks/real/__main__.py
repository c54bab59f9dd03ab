"""Measured bodies registered without a known load, specimens with an event diagnosed -> archive/, RESULTS.md.

    python -m real [--page] [--events] [--quick] [--data ../shared/data]

`--page` writes the page again from the archive, `--events` diagnoses the specimens with events alone; `--quick`
registers one recording of the beam and one draw of each number of beads, and diagnoses one specimen.
"""

import argparse
import json
import sys
from pathlib import Path

from common import SHARED, read_archive, write_archive
from real import beam, events, hydrogel
from real.page import page

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE = HERE / "archive", HERE / "RESULTS.md"
TABLES = ("beam/#", "hydrogel/#", "events/#")
N_DRAWS = 5


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true", help="write the page from the archive, register nothing")
    parser.add_argument("--events", action="store_true", help="register nothing, diagnose the specimens")
    parser.add_argument("--quick", action="store_true", help="one recording, one draw")
    parser.add_argument("--data", type=Path, default=SHARED / "data")
    options = parser.parse_args()
    specimens = list(events.EVENTS)[: 1 if options.quick else None]
    if options.events:
        write_archive(
            ARCHIVE, read_archive(ARCHIVE) | {"events": [_said(events.run(name)) for name in specimens]}, TABLES
        )
    elif not options.page:
        mesh = beam.example().beam_mesh(options.data / "beam" / "beam.stl")
        trials = [
            path for name in ("own_weight", "load_*g") for path in sorted((options.data / "beam").glob(f"{name}_*.csv"))
        ]
        n_draws = 1 if options.quick else N_DRAWS
        answer = {
            "schema": "tissuereg.loadfree-real/1",
            "n_targets": hydrogel.N_TARGETS,
            "beam": [beam.run(mesh, path) for path in (trials[:1] if options.quick else trials)],
            "hydrogel": [
                _said(hydrogel.run(options.data / "hydrogel", n, seed)) for n in (20, 60) for seed in range(n_draws)
            ],
            "events": [_said(events.run(name)) for name in specimens],
        }
        write_archive(ARCHIVE, answer, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")
    return 0


def _said(row: dict) -> dict:
    print(json.dumps(row), file=sys.stderr, flush=True)
    return row


if __name__ == "__main__":
    sys.exit(main())
