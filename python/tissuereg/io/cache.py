"""Files that only save time: kept between calls by the content of everything they depend on.

They lie in ``$TISSUEREG_CACHE``, or the user's cache folder; deleting them costs time only. Who reads one treats a
damaged file as absent.
"""

import os
from collections.abc import Callable
from pathlib import Path
from typing import IO

from tissuereg.io.atomic import atomic_file


def cache_folder() -> Path:
    """Return the folder of cached files; it may not exist yet."""
    chosen = os.environ.get("TISSUEREG_CACHE")
    if chosen:
        return Path(chosen)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "tissuereg"


def keep_in_cache(path: Path, write: Callable[[IO[bytes]], None], most_files: int) -> None:
    """Keep a file, and let the oldest of its kind go; a cache that cannot be written is no error.

    Parameters
    ----------
    path : Path
        In the cache's folder. Its kind is what stands before the first underscore of its name.
    write : callable of binary stream
        Writes the content.
    most_files : int
        Files of this kind that stay.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as temporary, temporary.open("wb") as stream:
            write(stream)
        alike = path.parent.glob(f"{path.name.partition('_')[0]}_*{path.suffix}")
        for old in sorted(alike, key=lambda p: p.stat().st_mtime)[:-most_files]:
            old.unlink(missing_ok=True)
    except OSError:
        return
