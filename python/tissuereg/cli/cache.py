"""The command ``tissuereg cache``: says what the cache on disk holds, and deletes it."""

import argparse
from pathlib import Path

from tissuereg.cli.common import Outcome, Stopwatch
from tissuereg.cli.options import Help, Parser, refuse

HELP = Help(
    "Some results are kept on disk, since they only save time: banks of causes and predictions on fine meshes, of "
    "'diagnose'. They lie in $TISSUEREG_CACHE, or in tissuereg in the user's cache folder. Deleting "
    "them changes no answer.",
    example="tissuereg cache\ntissuereg cache --clear",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg cache`` to its parser."""
    parser.add_argument("--clear", action="store_true", help="delete all entries, and nothing else in the folder")


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg cache``; JSON schema ``tissuereg.cache/1``, with what is left and what was deleted."""
    from tissuereg.io.cache import cache_folder, cached_entries, clear_cache

    clock = Stopwatch()
    try:
        folder = cache_folder()
    except RuntimeError:
        refuse("TISSUEREG_CACHE must name a folder where the user has no home; it is not set", "TISSUEREG_CACHE")
    deleted = clear_cache() if args.clear else {}
    left = cached_entries()
    clock.lap("clear" if args.clear else "count")
    content = {
        "schema": "tissuereg.cache/1",
        "folder": str(folder),
        "entries": len(left),
        "bytes": sum(left.values()),
        "deleted": {"entries": len(deleted), "bytes": sum(deleted.values())},
        "seconds": clock.seconds,
    }
    lines = [*([f"deleted: {_amount(deleted)}"] if args.clear else []), f"{folder}: {_amount(left)}"]
    return Outcome(content, "\n".join(lines), args.threads)


def _amount(entries: dict[Path, int]) -> str:
    return f"{len(entries)} {'entry' if len(entries) == 1 else 'entries'}, {sum(entries.values()) / 1e6:.1f} MB"
