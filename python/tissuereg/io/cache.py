"""A cache on disk of results that only save time, each under a name made from all that the result depends on.

Entries lie in ``$TISSUEREG_CACHE``, or the user's cache folder; deleting them costs time only. Each begins with the
SHA-256 of its name and content, so that a damaged, truncated or renamed entry counts as absent and is made anew. If the
folder cannot be written, a warning is given and nothing is kept; results are the same.
"""

import contextlib
import hashlib
import io
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.provenance import warn
from tissuereg.errors import TissueRegError
from tissuereg.io.atomic import OutputError, atomic_file

_SUFFIX = ".cached"
_MAGIC = b"tissuereg cache 1\n"
_DIGEST = 32

#: Folders that this process has warned of, since they cannot be written; None: the user has no home.
_WARNED: set[Path | None] = set()


def cache_folder() -> Path:
    """Return the path of the folder that holds the cached results of this user; it may not exist yet.

    Raises `RuntimeError` if neither ``$TISSUEREG_CACHE`` nor ``$XDG_CACHE_HOME`` is set and the user has no home.
    """
    chosen = os.environ.get("TISSUEREG_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tissuereg"


def read_entry(name: str) -> bytes | None:
    """Return the bytes that the cache on disk holds under a name; None if there is no such entry or it is damaged.

    `name`: name under which `keep_entry` stored the entry.
    """
    try:
        whole = (cache_folder() / f"{name}{_SUFFIX}").read_bytes()
    except (OSError, RuntimeError):
        return None
    head = len(_MAGIC) + _DIGEST
    content = whole[head:]
    return content if whole[:head] == _MAGIC + _digest(name, content) else None


def keep_entry(name: str, content: bytes, most: int) -> None:
    """Store bytes in the cache on disk under a name, and delete the oldest entries of the same sort beyond `most`.

    `name`: name of the entry; entries are of the same sort if their names agree up to the first underscore; `content`:
    bytes to store; `most`: number of entries of this sort that are kept. If the folder cannot be written, a warning is
    issued once per process and nothing is stored.
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
            warn(text)


def read_arrays(name: str) -> dict[str, Any] | None:
    """Return the arrays that `keep_arrays` stored under a name, by theirs; None if there are none."""
    content = read_entry(name)
    if content is None:
        return None
    with np.load(io.BytesIO(content), allow_pickle=False) as kept:
        return dict(kept)


def keep_arrays(name: str, arrays: Mapping[str, Any], most: int = 24) -> None:
    """Store numpy arrays, each under a name of its own, as one entry of `keep_entry`; no array may hold objects."""
    content = io.BytesIO()
    np.savez(content, allow_pickle=False, **arrays)
    keep_entry(name, content.getvalue(), most)


def _digest(name: str, content: bytes) -> bytes:
    return hashlib.sha256(name.encode() + b"\n" + content).digest()


def _age(path: Path) -> float:
    try:
        return path.stat().st_mtime
    except OSError:  # another process has deleted it
        return 0.0


def cached_entries() -> dict[Path, int]:
    """Return the files of all entries of the cache with their bytes; none if the folder does not exist.

    Raises `RuntimeError` as `cache_folder`, and `OutputError` if the folder cannot be read.
    """
    folder, found = cache_folder(), dict[Path, int]()
    try:
        for file in sorted(folder.glob(f"*{_SUFFIX}")) if folder.exists() else ():
            with contextlib.suppress(FileNotFoundError):  # another process has deleted it
                found[file] = file.stat().st_size
    except OSError as error:
        message = f"the cache must be a folder that can be read; {folder} is not: {error.strerror}"
        raise OutputError(message, where=str(folder)) from error
    return found


def clear_cache() -> dict[Path, int]:
    """Delete all entries of the cache and nothing else; return their files with their bytes.

    Raises `OutputError` if one cannot be deleted; those before it are gone then.
    """
    entries = cached_entries()
    for file in entries:
        try:
            file.unlink(missing_ok=True)
        except OSError as error:
            message = f"entries of the cache must be files that can be deleted; {file} is not: {error.strerror}"
            raise OutputError(message, where=str(file)) from error
    return entries
