"""Provenance: when an answer was made, by which call or command, from which files, and with which warnings.

`recorded` opens a record; until it is closed, readers add the files that they open (`note_file`) and `warn` the
warnings that are given. What a record holds stays with the object that was made meanwhile (`keep_with`), so that an
answer knows the files of a mesh that was read long before.
"""

import hashlib
import sys
import warnings
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial, wraps
from pathlib import Path
from types import FrameType
from typing import Any, ParamSpec, TypeVar

import numpy as np

from tissuereg._base.arguments import found
from tissuereg._version import __version__

#: What this software is for, in every answer and on every page.
RESEARCH = "For research use. Not a medical device; no patient data have been tried."


@dataclass(frozen=True)
class InputFile:
    """A file that was read: `path`, its name, and `sha256`, hexadecimal."""

    path: str
    sha256: str


@dataclass(frozen=True)
class Provenance:
    """How an answer came about.

    Attributes
    ----------
    date : str
        Date and time in UTC, as ISO 8601 writes it.
    version : str
        Version of this package.
    command : str
        Command line, without the options that change no answer (``--out``, ``--threads`` and the like), or the call in
        Python.
    inputs : tuple of InputFile
        Files that were read, in this order, with their hashes. Arrays that were not read from a file have none.
    warnings : tuple of str
        Warnings that were given, those of reading the input included.
    """

    date: str = ""
    version: str = __version__
    command: str = ""
    inputs: tuple[InputFile, ...] = ()
    warnings: tuple[str, ...] = ()

    def to_json(self, settings: Mapping[str, Any]) -> dict[str, Any]:
        """Return the entry ``provenance`` of an answer with these settings: plain lists, strings and None."""
        return {
            "use": RESEARCH,
            "date": self.date,
            "version": self.version,
            "command": self.command,
            "inputs": [{"path": one.path, "sha256": one.sha256} for one in self.inputs],
            "settings": dict(settings),
            "warnings": list(self.warnings),
        }

    def also_of(self, record: "Record") -> "Provenance":
        """Return the same with the files and warnings of a record before its own."""
        files = tuple(dict.fromkeys((*record.files.values(), *self.inputs)))
        warned = tuple(dict.fromkeys((*record.warnings, *self.warnings)))
        return replace(self, inputs=files, warnings=warned)


@dataclass
class Record:
    """What happened in a block: files read, by their whole path, and texts of warnings, in the order of a dict."""

    command: str = ""
    files: dict[str, InputFile] = field(default_factory=dict)
    warnings: dict[str, None] = field(default_factory=dict)

    def add(self, other: "Record") -> None:
        """Add the files and warnings of another record."""
        self.files |= other.files
        self.warnings |= other.warnings

    def provenance(self) -> Provenance:
        """Return the provenance of an answer that is made now."""
        date = datetime.now(UTC).isoformat(timespec="seconds")
        return Provenance(date, __version__, self.command, tuple(self.files.values()), tuple(self.warnings))


#: Arguments are shown in at most this many characters, or else by their type.
_SHOWN = 100

#: Records that are open, the outermost first.
_OPEN: ContextVar[tuple[Record, ...]] = ContextVar("_OPEN", default=())

#: Records of objects, by identity; an entry goes with its object.
_KEPT: dict[int, tuple["weakref.ref[Any]", Record]] = {}


_Given = ParamSpec("_Given")
_Made = TypeVar("_Made")


@contextmanager
def recorded(command: str = "") -> Iterator[Record]:
    """Open a record for the block and yield it; `command`: command line or call, for the answer made in the block."""
    record = Record(command)
    token = _OPEN.set((*_OPEN.get(), record))
    try:
        yield record
    finally:
        _OPEN.reset(token)


def provenance_now() -> Provenance:
    """Return the provenance of an answer that is made now: by the outermost record, that of the user's call."""
    records = _OPEN.get()
    return (records[0] if records else Record()).provenance()


def note_file(file: Path, sha256: str | None = None) -> None:
    """Add a file that is read now to all open records; `sha256`: its hash, where it is known already."""
    records = _OPEN.get()
    if not records:
        return
    key = str(file.absolute())
    known = next((record.files[key] for record in records if key in record.files), None)
    known = known or InputFile(file.name, sha256 or sha256_of(file))
    for record in records:
        record.files[key] = known


def note_warning(text: str) -> None:
    """Add a warning that the user is given now, in another way than by `warn`, to all open records."""
    for record in _OPEN.get():
        record.warnings[text] = None


def warn(text: str, category: type[Warning] = UserWarning) -> None:
    """Issue a warning at the innermost calling line outside this package; add it to all open records, shown or not."""
    note_warning(text)
    level = 1
    frame: FrameType | None = sys._getframe()
    while frame is not None and str(frame.f_globals.get("__name__")).split(".")[0] == "tissuereg":
        level, frame = level + 1, frame.f_back
    warnings.warn(text, category, stacklevel=level)


def note_record(other: Record) -> None:
    """Add the files and warnings of another record to all open records."""
    for record in _OPEN.get():
        record.add(other)


def note_origins(*objects: Any) -> None:
    """Add the files and warnings with which these objects were made to all open records."""
    for one in (part for whole in objects for part in _parts(whole)):
        ref, kept = _KEPT.get(id(one), (None, None))
        if ref is not None and kept is not None and ref() is one:
            note_record(kept)


def keep_with(made: Any, record: Record) -> None:
    """Keep a record with an object that was made from what it holds, as long as the object lives."""
    if record.files or record.warnings:
        for one in _parts(made):
            _KEPT[id(one)] = (weakref.ref(one, partial(_forget, id(one))), record)


def _parts(made: Any) -> Iterable[Any]:
    """Return the objects that records are kept with: of a dict or tuple its parts, which may go on to another one."""
    inner = made.values() if isinstance(made, Mapping) else made if isinstance(made, tuple) else None
    if inner is None:
        return () if isinstance(made, float | int | str) or made is None else (made,)
    return (part for one in inner for part in _parts(one))


def _forget(key: int, _: Any) -> None:
    _KEPT.pop(key, None)


def derived(made: _Made, *origins: Any) -> _Made:
    """Return `made`, which was made from `origins`: their files and warnings are now its own as well."""
    with recorded() as record:
        note_origins(*origins, made)
    keep_with(made, record)
    return made


def reads(reader: Callable[_Given, _Made]) -> Callable[_Given, _Made]:
    """Return a reader whose results know the files that were read and the warnings that were given."""

    @wraps(reader)
    def read(*args: _Given.args, **options: _Given.kwargs) -> _Made:
        with recorded() as record:
            made = reader(*args, **options)
        keep_with(made, record)
        return made

    return read


def call_text(name: str, **given: Any) -> str:
    """Return the call of a function as text for people: arguments that are None are left out, arrays by shape.

    >>> call_text("register", markers=(np.zeros((4, 3)),), model=None, seed=0)
    'register(markers=(array (4, 3),), seed=0)'
    """
    return f"{name}({', '.join(f'{key}={_shown(value)}' for key, value in given.items() if value is not None)})"


def _shown(value: Any) -> str:
    """Return an argument in a few words."""
    if isinstance(value, np.ndarray):
        return f"array {value.shape}"
    if isinstance(value, tuple):
        return f"({', '.join(map(_shown, value))}{',' if len(value) == 1 else ''})"
    if isinstance(value, Mapping):
        return f"{{{', '.join(map(str, value))}}}"
    if isinstance(value, Path):
        return found(str(value))
    said = repr(value) if type(value).__module__.startswith("tissuereg") else found(value)
    return said if len(said) <= _SHOWN and said[0] != "<" else type(value).__name__


def sha256_of(file: Path) -> str:
    """Return the SHA-256 of a file, in hexadecimal digits."""
    with file.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()
