"""Writes the tables from the archived verdicts: ``python -m blind.page [TIER ...] [--pack PREDICTIONS]``.

``archive/TIER.tar.xz`` holds the predictions of a tier, ``archive/TIER.md`` what a reader must know of how they were
made. ``--pack`` first stores a folder of predictions as the archive of the one tier that is named.
"""

import argparse
import tarfile
import tempfile
from pathlib import Path

from blind.score import scores

HERE = Path(__file__).resolve().parent
#: Page of each tier that is archived.
PAGES = {"full": "RESULTS.md", "fine": "RESULTS-fine.md", "sample": "RESULTS-sample.md"}


def page(tier: str) -> str:
    """Return the page of a tier from its archive."""
    with tempfile.TemporaryDirectory() as work:
        with tarfile.open(HERE / "archive" / f"{tier}.tar.xz") as kept:
            kept.extractall(work, filter="data")
        return scores(Path(work) / tier, (HERE / "archive" / f"{tier}.md").read_text(encoding="utf-8"))


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m blind.page", description=__doc__)
    parser.add_argument("tiers", nargs="*", metavar="TIER", help=f"one of {', '.join(PAGES)}; all by default")
    parser.add_argument("--pack", type=Path, help="folder of predictions that becomes the archive of the tier")
    options = parser.parse_args()
    tiers = options.tiers or [*PAGES]
    if not set(tiers) <= set(PAGES) or (options.pack and len(tiers) != 1):
        parser.error(f"tiers are {', '.join(PAGES)}; --pack takes one, found {', '.join(tiers)}")
    if options.pack:
        with tarfile.open(HERE / "archive" / f"{tiers[0]}.tar.xz", "w:xz") as kept:
            kept.add(options.pack, tiers[0])
    for tier in tiers:
        (HERE / PAGES[tier]).write_text(page(tier), encoding="utf-8")


if __name__ == "__main__":
    main()
