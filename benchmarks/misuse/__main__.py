"""Misread and good inputs: which are suspected, which are trusted -> archive/, RESULTS.md.

    python -m misuse [--jobs N] [--quick] [--page]

Forty misuses on five bodies, and 500 good events, all of them odd-numbered; `tissuereg.registration.readings` was
developed on the even-numbered ones. Events without a suspicion are also registered. `--page` writes the page again
from the archive. Their data are made by `misuse.generate`.
"""

import argparse
import sys
from pathlib import Path

from threadpoolctl import threadpool_limits

from common import read_archive, write_archive
from misuse import run
from misuse.page import page

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE = HERE / "archive", HERE / "RESULTS.md"
TABLES = ("misuses/#", "good/#", "one_marker_off/#")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--page", action="store_true", help="write the page from the archive, run nothing")
    parser.add_argument("--jobs", type=int, default=2, help="registrations side by side")
    parser.add_argument("--quick", action="store_true", help="one event of each kind, a smoke run: nothing is written")
    options = parser.parse_args()
    if not options.page:
        with threadpool_limits(limits=1):
            answers = {
                "schema": "tissuereg.misuse/1",
                "misuses": run.misuses(range(1, 2 if options.quick else run.N_MISUSED, 2)),
                "good": run.good_events(range(1, 2 if options.quick else run.N_GOOD, 2)),
                "one_marker_off": run.one_marker_off(range(1, 2 if options.quick else run.N_OFF, 2)),
            }
            run.through_register(answers, options.jobs)
        if options.quick:
            print(page(answers))
            return 0
        write_archive(ARCHIVE, answers, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
