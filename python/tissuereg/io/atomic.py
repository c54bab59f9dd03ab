"""Write files and folders whole or not at all.

A writer works in a draft, a temporary folder (`tissuereg.io.drafts`). Only when it has finished is the draft's content
flushed to disk and renamed to the name that the user gave. An error before that leaves the old content untouched; the
draft of a killed process is removed by the next writer to the same folder.
"""

import contextlib
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

from tissuereg._base.arguments import place
from tissuereg.errors import TissueRegError
from tissuereg.io.drafts import draft, remove_stale_drafts


class OutputError(TissueRegError, OSError):
    """An output file or folder cannot be written at the requested place."""


@contextlib.contextmanager
def atomic_file(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the path of a temporary file to write; it is renamed to `path` if the block ends without an error.

    `path`: the final name; missing folders are made, an older file is replaced. Yields the path of an empty temporary
    file with the same name in another folder. Raises `OutputError` if the operating system refuses: a folder of that
    name exists, permission is denied, or space is lacking.

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
    with _as_output_error(target), _draft_in(target.parent) as made:
        temporary = made / target.name
        temporary.touch()
        yield temporary
        _make_durable(temporary)
        temporary.chmod(0o666 & ~_umask())
        temporary.replace(target)


@contextlib.contextmanager
def atomic_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield the path of a temporary folder to fill; its content is moved to `path` if the block ends without an error.

    A new folder appears in one step. In a folder that exists already each file is replaced whole, and files of other
    names stay. `path`: the final name of the folder; missing parents are made. Raises `OutputError` if `path` is a
    file, or the operating system refuses.
    """
    target = place("path", path, error=OutputError)
    check_folder_target(target)
    # An existing folder may be the only writable one there, or a mount point: it is filled, not replaced.
    with _as_output_error(target), _draft_in(target if target.is_dir() else target.parent) as made:
        remove_stale_drafts(target.parent)
        yield made
        for file in sorted(made.rglob("*")):
            if file.is_file():
                _make_durable(file)
        _move_content(made, target)


def check_file_target(path: str | os.PathLike[str]) -> None:
    """Check, before a long run, that a file of this name can be written at its end.

    Raises `OutputError` if it is a folder, or lies where nothing may be written.
    """
    target = place("path", path, error=OutputError)
    if target.is_dir():
        message = f"the output file must not be a folder, got {target}"
        raise OutputError(message, where=str(target))
    _check_writable(target)


def check_folder_target(path: str | os.PathLike[str]) -> None:
    """Check, before a long run, that a folder of this name can be written at its end; what it holds does not matter.

    Raises `OutputError` if it is a file, or lies where nothing may be written.
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
    """Return the nearest existing ancestor of a path: a draft made there can be renamed on one file system."""
    return next(folder for folder in target.absolute().parents if folder.exists())


@contextlib.contextmanager
def _draft_in(folder: Path) -> Iterator[Path]:
    """Yield an empty temporary folder below `folder`, which is made if absent and removed again if it stays empty."""
    absent = [folder, *folder.parents]
    absent = [one for one in absent if not one.exists()]
    folder.mkdir(parents=True, exist_ok=True)
    try:
        with draft(folder) as made:
            yield made
    finally:
        for one in absent:
            with contextlib.suppress(OSError):
                one.rmdir()


def _move_content(made: Path, target: Path) -> None:
    if not target.exists():
        made.chmod(0o777 & ~_umask())
        try:
            made.rename(target)
        except OSError:
            if not target.is_dir():  # another process has just made it
                raise
        else:
            return
    moves = [(one, target / one.relative_to(made)) for one in sorted(made.rglob("*"))]
    for one, final in moves:  # all are checked before any is moved
        if final.exists() and final.is_dir() != one.is_dir():
            message = f"{final} must be a {'folder' if one.is_dir() else 'file'}, or absent, for results to replace it"
            raise OutputError(message, where=str(final))
    for one, final in moves:
        if one.is_dir():
            final.mkdir(exist_ok=True)
        else:
            one.replace(final)


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
