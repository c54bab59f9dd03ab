"""Entries that only save time: kept between calls by the content of everything they depend on.

They lie in ``$TISSUEREG_CACHE``, or the user's cache folder; deleting them costs time only. An entry begins with the
SHA-256 of its name and content, so that one that is damaged, cut or another's is never read: it counts as absent, and
is made and written anew. A folder that cannot be written costs time, no answer, and a warning says so.
"""

import hashlib
import os
import warnings
from pathlib import Path

from tissuereg.errors import TissueRegError
from tissuereg.io.atomic import atomic_file

_SUFFIX = ".cached"
_MAGIC = b"tissuereg cache 1\n"
_DIGEST = 32

#: Folders of which this process has said that they cannot be written; None stands for no home.
_WARNED: set[Path | None] = set()


def cache_folder() -> Path:
    """Return the folder of cached entries; it may not exist yet.

    Raises
    ------
    RuntimeError
        If neither ``$TISSUEREG_CACHE`` nor ``$XDG_CACHE_HOME`` is set and the user has no home.
    """
    chosen = os.environ.get("TISSUEREG_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tissuereg"


def read_entry(name: str) -> bytes | None:
    """Return what was kept under a name.

    Parameters
    ----------
    name : str
        As it was given to `keep_entry`.

    Returns
    -------
    bytes or None
        None where there is none, or none that is whole.
    """
    try:
        whole = (cache_folder() / f"{name}{_SUFFIX}").read_bytes()
    except (OSError, RuntimeError):
        return None
    head = len(_MAGIC) + _DIGEST
    content = whole[head:]
    return content if whole[:head] == _MAGIC + _digest(name, content) else None


def keep_entry(name: str, content: bytes, most: int) -> None:
    """Keep an entry, and let the oldest of its kind go; where that cannot be done, warn, once a process.

    Parameters
    ----------
    name : str
        Its kind is what stands before the first underscore.
    content : bytes
        What `read_entry` shall return.
    most : int
        Entries of this kind that stay.
    """
    folder = None
    try:
        folder = cache_folder()
        with atomic_file(folder / f"{name}{_SUFFIX}") as temporary:
            temporary.write_bytes(_MAGIC + _digest(name, content) + content)
        alike = folder.glob(f"{name.partition('_')[0]}_*{_SUFFIX}")
        for old in sorted(alike, key=_age)[:-most]:
            old.unlink(missing_ok=True)
    except (OSError, RuntimeError, TissueRegError):
        if folder not in _WARNED:
            _WARNED.add(folder)
            place = "the user has no home" if folder is None else f"{folder} cannot be written"
            text = f"nothing is kept for the next run, {place}; TISSUEREG_CACHE may name another folder for the cache"
            warnings.warn(text, stacklevel=2)


def _digest(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + b"\n" + content).digest()


def _age(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # another process has let it go
        return 0.0
