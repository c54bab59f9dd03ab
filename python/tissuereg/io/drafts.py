"""Drafts: the temporary folder in which an output is written before it gets its name.

A draft is a folder ``.tissuereg-tmp-MACHINE-RANDOM`` next to the output, with a file ``lock`` that its writer keeps
locked. The system frees the lock when the process ends, however it ends: a draft whose lock is free was left by a
killed process, and the next writer to the same folder removes it. Locks may not reach other machines through a shared
folder, so a draft of another machine is removed only if nothing in it has changed for a day. Windows and file systems
without locks keep drafts until somebody deletes them.
"""

import contextlib
import hashlib
import os
import re
import secrets
import shutil
import socket
import sys
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tissuereg.io.bounds import FILES

if sys.platform != "win32":
    import fcntl

#: How the name of every draft begins.
DRAFT_PREFIX = ".tissuereg-tmp-"

#: Names that this module gives, and what a draft holds: nothing else is ever removed.
_NAME = re.compile(rf"{re.escape(DRAFT_PREFIX)}[A-Za-z0-9]+-[0-9a-f]{{8}}")
_LOCK, _CONTENT = "lock", "content"


@contextlib.contextmanager
def draft(folder: Path) -> Iterator[Path]:
    """Yield an empty temporary folder to write in, and remove temporary folders that killed processes left.

    `folder`: folder in which to make it: that of the output, so that a later rename stays on one file system. Whatever
    is still in the temporary folder when the block ends is removed. Raises `OSError` if it cannot be made.
    """
    remove_stale_drafts(folder)
    made, lock = _make(folder)
    try:
        yield made / _CONTENT
    finally:
        shutil.rmtree(made, ignore_errors=True)
        os.close(lock)
        if made.exists():  # some systems cannot delete an open file, such as the lock
            shutil.rmtree(made, ignore_errors=True)


def remove_stale_drafts(folder: Path) -> None:
    """Remove the drafts (temporary folders of writers) in a folder whose writers have ended.

    `folder`: folder in which outputs are written. Drafts that cannot be removed stay, without an error.
    """
    with contextlib.suppress(OSError):
        for entry in sorted(os.scandir(folder), key=lambda entry: entry.name):
            if _NAME.fullmatch(entry.name) and entry.is_dir(follow_symlinks=False):
                _remove_if_stale(Path(entry.path))


def _make(folder: Path) -> tuple[Path, int]:
    """Make a new draft (temporary folder of a writer) in a folder; return its path and the descriptor of its lock file.

    The process holds the lock until it closes the descriptor. Raises `OSError` if no draft can be made.
    """
    for _ in range(FILES.draft_tries):
        made = folder / f"{DRAFT_PREFIX}{_machine()}-{secrets.token_hex(4)}"
        try:
            made.mkdir(mode=0o700)
            lock = _opened(made)
        except (FileExistsError, FileNotFoundError):  # another writer's name, or removed by one before it was locked
            continue
        if _take(lock) is not False and _still_there(made, lock):
            (made / _CONTENT).mkdir(mode=0o700)
            return made, lock
        os.close(lock)
    message = "no draft could be made"
    raise FileExistsError(message)


def _remove_if_stale(found: Path) -> None:
    try:
        held = {entry.name for entry in os.scandir(found)}
        if not held <= {_LOCK, _CONTENT}:
            return
        if (
            not found.name.startswith(f"{DRAFT_PREFIX}{_machine()}-")
            and time.time() - _changed(found) < FILES.stale_draft_s
        ):
            return
        lock = _opened(found)
    except OSError:
        return
    try:
        if _take(lock):
            shutil.rmtree(found, ignore_errors=True)
    finally:
        os.close(lock)


@cache
def _machine() -> str:
    """Return a word of 12 hexadecimal digits for this machine or container; others have other words."""
    known = socket.gethostname()
    for file in ("/etc/machine-id", "/proc/sys/kernel/random/boot_id"):
        with contextlib.suppress(OSError):
            known += f"\n{Path(file).read_text(encoding='ascii').strip()}"
            break
    return hashlib.sha256(known.encode()).hexdigest()[:12]


def _changed(found: Path) -> float:
    """Return the time in s since the epoch at which anything in a folder was last changed."""
    times = [found.stat().st_mtime]
    for folder, folders, files in os.walk(found):
        for name in (*folders, *files):
            with contextlib.suppress(OSError):
                times.append((Path(folder) / name).stat(follow_symlinks=False).st_mtime)
    return max(times)


def _opened(made: Path) -> int:
    # Where anybody may write, another user's link must not lead anywhere.
    return os.open(made / _LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o600)


def _take(lock: int) -> bool | None:
    """Lock an open file, given by its descriptor, for this process, without waiting.

    Return True if this process now holds the lock, False if another one does, None if the system has no locks.
    """
    if sys.platform == "win32":
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


def _still_there(made: Path, lock: int) -> bool:
    try:
        return os.path.samestat((made / _LOCK).stat(), os.fstat(lock))
    except OSError:
        return False
