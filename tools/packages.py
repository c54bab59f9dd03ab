"""What the checks of crates and of wheels have in common."""

import sys
import tarfile
import time
from collections.abc import Callable


class CheckError(Exception):
    """A check of a package failed."""


def as_new(member: tarfile.TarInfo, folder: str) -> tarfile.TarInfo:
    """Give a file of an archive the present time: cargo takes a file older than its last build as built already."""
    return tarfile.data_filter(member, folder).replace(mtime=int(time.time()))


def exit_code(check: Callable[[], None]) -> int:
    """Run a check; return 0, or 1 with what failed on standard error."""
    try:
        check()
    except CheckError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    return 0
