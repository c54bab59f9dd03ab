"""Measured bodies registered without a known load -> results/loadfree-real.json, docs/loadfree-real.md.

    python benchmarks/loadfree_real.py [--page] [--data ../shared/data]

`--page` writes the page again from the archive. Bodies: `tests/loadfree_real`.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from loadfree_real import beam, hydrogel
from loadfree_real.page import page

ROOT = Path(__file__).resolve().parents[1]
ARCHIVE, PAGE = ROOT / "benchmarks" / "results" / "loadfree-real.json", ROOT / "docs" / "loadfree-real.md"
N_DRAWS = 5


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true", help="write the page from the archive, register nothing")
    parser.add_argument("--data", type=Path, default=ROOT.parent / "shared" / "data")
    options = parser.parse_args()
    if not options.page:
        mesh = beam.example().beam_mesh(options.data / "beam" / "beam.stl")
        trials = [
            path for name in ("own_weight", "load_*g") for path in sorted((options.data / "beam").glob(f"{name}_*.csv"))
        ]
        answer = {
            "schema": "tissuereg.loadfree-real/1",
            "n_targets": hydrogel.N_TARGETS,
            "beam": [beam.run(mesh, path) for path in trials],
            "hydrogel": [_told(options.data / "hydrogel", n, seed) for n in (20, 60) for seed in range(N_DRAWS)],
        }
        kept = ARCHIVE.with_suffix(".part")
        kept.write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
        kept.replace(ARCHIVE)
    PAGE.write_text(page(json.loads(ARCHIVE.read_text(encoding="utf-8"))), encoding="utf-8")
    return 0


def _told(folder: Path, n_markers: int, seed: int) -> dict:
    row = hydrogel.run(folder, n_markers, seed)
    print(json.dumps(row), file=sys.stderr, flush=True)
    return row


if __name__ == "__main__":
    sys.exit(main())
