"""Misread and good inputs: which are suspected, which are trusted -> results/misuse.json, docs/misuse.md.

    python benchmarks/misuse.py [--jobs N] [--page]

Forty misuses on five bodies, and 500 good events, all of them odd-numbered; `tissuereg.registration.readings` was
developed on the
even-numbered ones. Events without a suspicion are also registered. `--page` writes the page again from the archive.
The events are in `tests/misuse`, their data made by `misuse.generate`.
"""

import argparse
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from threadpoolctl import threadpool_limits

from misuse import run
from misuse.page import page

ROOT = Path(__file__).resolve().parents[1]
ARCHIVE, PAGE = ROOT / "benchmarks" / "results" / "misuse.json", ROOT / "docs" / "misuse.md"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true", help="write the page from the archive, run nothing")
    parser.add_argument("--jobs", type=int, default=2, help="registrations side by side")
    options = parser.parse_args()
    if not options.page:
        with threadpool_limits(limits=1):
            answers = {
                "schema": "tissuereg.misuse/1",
                "misuses": run.misuses(range(1, run.N_MISUSED, 2)),
                "good": run.good_events(range(1, run.N_GOOD, 2)),
                "one_marker_off": run.one_marker_off(range(1, run.N_OFF, 2)),
            }
            run.through_register(answers, options.jobs)
        rows = {name: value for name, value in answers.items() if isinstance(value, list)}
        listed = [f'"{name}": [\n' + ",\n".join(map(json.dumps, value)) + "\n]" for name, value in rows.items()]
        text = '{"schema": "tissuereg.misuse/1",\n' + ",\n".join(listed) + "}\n"
        kept = ARCHIVE.with_suffix(".part")
        kept.write_text(text, encoding="utf-8")
        kept.replace(ARCHIVE)
    PAGE.write_text(page(json.loads(ARCHIVE.read_text(encoding="utf-8"))), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
