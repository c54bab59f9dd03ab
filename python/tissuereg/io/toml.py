"""Checked reading of TOML tables: the reader takes each key that it knows, and a key that was not taken is refused."""

import os
import re
import tomllib
from collections.abc import Callable, Iterable
from dataclasses import MISSING, dataclass
from pathlib import Path
from typing import Any, ClassVar, NoReturn, TypeVar

from tissuereg._base.arguments import place
from tissuereg._base.fields import CheckedRecord
from tissuereg.errors import ExperimentError, FormatError, TissueRegError
from tissuereg.io.bounds import FILES, existing_file, read_text

_Value = TypeVar("_Value")
_Keys = TypeVar("_Keys", bound="Keys")


class Table:
    """A TOML table of a file whose keys are taken one by one, so that unknown ones can be refused at the end.

    Parameters
    ----------
    file : Path
        The file that holds the table, for messages.
    place : str
        Name of the table in the file, such as ``[mesh]``; empty for the top of the file.
    content : dict
        Values of the table by key, as read by `tomllib`.
    """

    def __init__(self, file: Path, place: str, content: dict[str, Any]) -> None:
        self.file = file
        self.place = place
        self._content = content
        self._taken: set[str] = set()

    def __contains__(self, key: str) -> bool:
        return key in self._content

    def refuse(self, rule: str, found: object = None) -> NoReturn:
        """Raise an error that states what must hold in this table.

        Parameters
        ----------
        rule : str
            What must hold, in words.
        found : object, optional
            The value that was found; not stated if it is None.

        Raises
        ------
        ExperimentError
            Always; it names table and file.
        """
        got = "" if found is None else f", got {found!r}"
        place = f" in {self.place}" if self.place else ""
        message = f"{rule}{got}{place} of {self.file}"
        raise ExperimentError(message, where=f"{self.file}:{self.place}" if self.place else str(self.file))

    def get(self, key: str, default: Any = None) -> Any:
        """Take a value as it stands, or the default if the key is absent; the key counts as known from now on.

        Parameters
        ----------
        key : str
            Name of the value.
        default : object, optional
            Value to return if the key is absent.

        Returns
        -------
        object
            The value, of any TOML type.
        """
        self._taken.add(key)
        return self._content.get(key, default)

    def need(self, key: str) -> Any:
        """Take a value that must be there; the key counts as known from now on.

        Parameters
        ----------
        key : str
            Name of the value.

        Returns
        -------
        object
            The value, of any TOML type.

        Raises
        ------
        ExperimentError
            If the key is absent.
        """
        if key not in self._content:
            there = ", ".join(self._content) or "nothing"
            self.refuse(f"`{key}` must be given; the table holds {there}")
        return self.get(key)

    def take(self, key: str, check: Callable[..., _Value]) -> _Value:
        """Take a value that must be there, and check it by a function of `tissuereg._base.arguments`.

        Parameters
        ----------
        key : str
            Name of the value.
        check : callable
            Function that is called as ``check(key, value, error=...)`` and returns the value to use, or raises the
            error.

        Returns
        -------
        object
            The value that `check` returns.

        Raises
        ------
        ExperimentError
            If the key is absent, or the value does not hold what it must.
        """
        try:
            return check(key, self.need(key), error=ExperimentError)
        except ExperimentError as error:
            self.refuse(str(error))

    def table(self, key: str) -> "Table | None":
        """Take a table that is the value of a key in this table.

        Parameters
        ----------
        key : str
            Name of the table.

        Returns
        -------
        Table or None
            The table; None where it is absent.

        Raises
        ------
        ExperimentError
            If the value of this name is not a table.
        """
        value = self.get(key)
        if value is None:
            return None
        if not isinstance(value, dict):
            self.refuse(f"`{key}` must be a table", value)
        if self.place.startswith("[["):
            return Table(self.file, f"`{key}` of {self.place}", value)
        return Table(self.file, f"[{self.place[1:-1]}.{key}]" if self.place else f"[{key}]", value)

    def tables(self, key: str) -> list["Table"]:
        """Take a list of tables, written ``[[key]]`` in the file.

        Parameters
        ----------
        key : str
            Name of the list.

        Returns
        -------
        list of Table
            The tables in file order; empty where the key is absent.

        Raises
        ------
        ExperimentError
            If the value of this name is not a list of tables.
        """
        value = self.get(key, [])
        if not (isinstance(value, list) and all(isinstance(item, dict) for item in value)):
            self.refuse(f"`{key}` must be a list of tables, [[{key}]]", value)
        return [Table(self.file, f"[[{key}]] number {i + 1}", item) for i, item in enumerate(value)]

    def know(self, keys: Iterable[str]) -> None:
        """Count keys as taken, so that `finish` does not refuse them and names them among the known ones."""
        self._taken.update(keys)

    def rest(self) -> dict[str, Any]:
        """Take all values that have not been taken yet.

        Returns
        -------
        dict
            The values by key, of any TOML type.
        """
        left = {key: value for key, value in self._content.items() if key not in self._taken}
        self._taken.update(left)
        return left

    def finish(self) -> None:
        """Refuse the keys of the table that have not been taken.

        Raises
        ------
        ExperimentError
            If there is one; the message names it and the known keys.
        """
        unknown = sorted(set(self._content) - self._taken)
        if unknown:
            known = ", ".join(sorted(self._taken))
            self.refuse(f"only the keys {known} are known", ", ".join(unknown))


@dataclass(frozen=True, kw_only=True)
class Keys(CheckedRecord):
    """Base of the declarations of TOML tables: each field of a subclass is one key of the table.

    The docstring of a subclass says what the table holds, and appears in files and documentation. An instance holds the
    checked values of one table.

    Raises
    ------
    ExperimentError
        If a key does not hold what it must.
    """

    error: ClassVar[type[TissueRegError]] = ExperimentError
    #: As in the file: ``[mesh]``, ``[[actuator]]``; empty for the top of the file.
    heading: ClassVar[str] = ""
    #: Whether the table must be given.
    needed: ClassVar[bool] = False

    @classmethod
    def of(cls: type[_Keys], table: Table) -> _Keys:
        """Take all declared keys of a table; others are left for `Table.finish` to refuse.

        Parameters
        ----------
        table : Table
            The table as it was read from a file.

        Returns
        -------
        Keys
            An instance of this class with the checked values of the table, and defaults where keys are absent.

        Raises
        ------
        ExperimentError
            If a key is missing or does not hold what it must; table and file are named.
        """
        wanted = [key for key in cls.declared() if key.name in table or key.default is MISSING]
        given = {key.name: table.need(key.name) for key in wanted}
        table.know(key.name for key in cls.declared())
        try:
            return cls(**given)
        except ExperimentError as error:
            table.refuse(str(error))

    @classmethod
    def found(cls, top: Table) -> Table | None:
        """Return the table that this class declares from the top of a file; None if it is absent and need not be there.

        Raises
        ------
        ExperimentError
            If it must be there and is not.
        """
        table = top.table(cls.heading.strip("[]"))
        if table is None and cls.needed:
            top.refuse(f"a table {cls.heading} must be given")
        return table

    @classmethod
    def alone(cls: type[_Keys], top: Table) -> _Keys | None:
        """Return the checked values of this class's table of a file; None if the table is absent and need not be there.

        Keys that are not declared are refused. `top`: the top of the file.

        Raises
        ------
        ExperimentError
            If the table must be there and is not, a key is missing, unknown, or does not hold what it must.
        """
        table = cls.found(top)
        if table is None:
            return None
        values = cls.of(table)
        table.finish()
        return values


def experiment_file(path: str | os.PathLike[str]) -> Path:
    """Return the path of an experiment's file: the given file, or ``experiment.toml`` in the given folder.

    Raises `FormatError` if there is no such file.
    """
    given = place("path", path, error=FormatError)
    file = given / "experiment.toml" if given.is_dir() else given
    if not file.exists():
        message = f"an experiment must be a folder with an experiment.toml; no such file: {file}"
        raise FormatError(message, where=str(file))
    return file


def parsed_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML text as a dict of Python values by key.

    Raises `ValueError` if it is no TOML, is nested too deeply (`FILES.toml_depth`), or holds a key of more characters
    than `FILES.toml_word` or a number of thousands of digits.
    """
    _refuse_depth(text)
    content: dict[str, Any] = tomllib.loads(text)
    return content


#: Parts of a TOML text by which its nesting is counted; what stands in a text or a comment does not count.
_PARTS = re.compile(
    r"""
    "{3}(?:[^\\]|\\.)*?"{3} | '{3}.*?'{3}         # texts of several lines
    | "(?:[^"\\\n]|\\.)*" | '[^'\n]*' | \#[^\n]*  # texts, comments
    | [.\[\]{}=,\n] | [^"'\#.\[\]{}=,\n]+ | .
    """,
    re.DOTALL | re.VERBOSE,
)


def _refuse_depth(text: str) -> None:
    """Raise `ValueError` if a TOML text is nested more deeply than `FILES` allows, before any of it is parsed."""
    dots, depth, line, word = 0, 0, 1, 0
    for found in _PARTS.finditer(text):
        part = found[0]
        if part == ".":
            dots += 1
        elif part in ("[", "{"):
            dots, depth = 0, depth + 1
        elif part in ("]", "}"):
            dots, depth = 0, max(depth - 1, 0)
        elif part in ("=", ",", "\n"):
            dots = 0
        word = len(part.strip()) if part[0] not in "\"'#" else 0
        if dots >= FILES.toml_depth or depth > FILES.toml_depth or word > FILES.toml_word:
            message = (
                f"keys must have at most {FILES.toml_depth} parts of {FILES.toml_word} characters, and brackets be "
                f"nested {FILES.toml_depth} deep at most (line {line})"
            )
            raise ValueError(message)
        line += part.count("\n")


def read_toml(path: str | os.PathLike[str]) -> Table:
    """Read a TOML file and return its top as a `Table`, whose method `rest` gives all values as a dict.

    Raises `ExperimentError` if it is no TOML; the message has the line; `FormatError` if there is no such file, or it
    is too large.
    """
    file = existing_file(path, FILES.text_mb)
    try:
        return Table(file, "", parsed_toml(read_text(file)))
    except TissueRegError:
        raise
    except (ValueError, OSError, RecursionError) as error:  # no TOML, no UTF-8, or a number of thousands of digits
        message = f"{file} must be a TOML file; it cannot be read: {error}"
        raise ExperimentError(message, where=str(file)) from error
