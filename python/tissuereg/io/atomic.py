"""Write files and folders whole or not at all.

A writer gets a temporary sibling; only when it has finished is that made durable and renamed onto
the name the user gave. Whatever goes wrong before leaves the old content untouched.
"""

import contextlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tissuereg._arguments import place
from tissuereg.errors import TissueRegError


class OutputError(TissueRegError, OSError):
    """An output file or folder cannot be written where it was asked for."""


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary file to write; it becomes `path` when the block ends well.

    Parameters
    ----------
    path : path-like
        Where the file shall stand; missing folders are made, an older file is replaced.

    Yields
    ------
    Path
        The temporary file, same suffix.

    Raises
    ------
    OutputError
        If the operating system refuses: a folder of that name, no permission, no space.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     with atomic_file(Path(folder) / "note.txt") as temporary:
    ...         _ = temporary.write_text("all of it")
    ...     (Path(folder) / "note.txt").read_text()
    'all of it'
    """
    target = place("path", path, error=OutputError)
    check_file_target(target)
    with _as_output_error(target):
        handle, name = tempfile.mkstemp(prefix=".tissuereg-", suffix=target.suffix, dir=_standing_folder(target))
        os.close(handle)
        temporary = Path(name)
        try:
            yield temporary
            _make_durable(temporary)
            temporary.chmod(0o666 & ~_umask())
            target.parent.mkdir(parents=True, exist_ok=True)
            temporary.replace(target)
        finally:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary folder to fill; its content moves to `path` when the block ends well.

    A new folder appears in one step. In a folder that stands already each file is replaced whole,
    and files of other names stay.

    Parameters
    ----------
    path : path-like
        Where the folder shall stand; missing parents are made.

    Yields
    ------
    Path
        The temporary folder.

    Raises
    ------
    OutputError
        If `path` is a file, or the operating system refuses.
    """
    target = place("path", path, error=OutputError)
    check_folder_target(target)
    with _as_output_error(target):
        temporary = Path(tempfile.mkdtemp(prefix=".tissuereg-", dir=_standing_folder(target)))
        try:
            yield temporary
            for file in sorted(temporary.rglob("*")):
                if file.is_file():
                    _make_durable(file)
            _move_content(temporary, target)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)


def check_file_target(path: str | os.PathLike[str]) -> None:
    """Refuse early a file name that could not be written at the end of a long run.

    Parameters
    ----------
    path : path-like
        Name of a file to be written.

    Raises
    ------
    OutputError
        If it is a folder, or lies where nothing may be written.
    """
    target = place("path", path, error=OutputError)
    if target.is_dir():
        message = f"the output file must not be a folder, got {target}"
        raise OutputError(message, where=str(target))
    _check_writable(target)


def check_folder_target(path: str | os.PathLike[str]) -> None:
    """Refuse early a folder name that could not be written at the end of a long run; what it holds is no matter.

    Parameters
    ----------
    path : path-like
        Name of a folder to be written.

    Raises
    ------
    OutputError
        If it is a file, or lies where nothing may be written.
    """
    target = place("path", path, error=OutputError)
    if target.exists() and not target.is_dir():
        message = f"the output folder must not be a file, got {target}"
        raise OutputError(message, where=str(target))
    _check_writable(target)


def _check_writable(target: Path) -> None:
    folder = target if target.is_dir() else _standing_folder(target)
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        reason = error.strerror or str(error)
        message = f"the output {target} must lie where files can be written; in {folder} none can: {reason}"
        raise OutputError(message, where=str(target)) from error


def _standing_folder(target: Path) -> Path:
    """Return the nearest ancestor that exists, so that a rename stays on one file system."""
    return next(folder for folder in target.absolute().parents if folder.exists())


def _move_content(temporary: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    temporary.chmod(0o777 & ~_umask())
    if not target.exists():
        temporary.rename(target)
        return
    for file in sorted(temporary.rglob("*")):
        place = target / file.relative_to(temporary)
        if file.is_dir():
            place.mkdir(exist_ok=True)
        else:
            file.replace(place)


def _make_durable(file: Path) -> None:
    with file.open("rb") as handle:
        os.fsync(handle.fileno())


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask


@contextlib.contextmanager
def _as_output_error(target: Path) -> Iterator[None]:
    try:
        yield
    except TissueRegError:
        raise
    except OSError as error:
        message = f"{target} must be writable: {error.strerror or error}"
        raise OutputError(message, where=str(target)) from error
