"""Checked reading of TOML tables: every key is read, and an unread one is refused."""

import os
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
    """A TOML table whose keys are taken one by one.

    Parameters
    ----------
    file : Path
        Where it stands, for messages.
    place : str
        Name of the table, such as ``[mesh]``; empty at the top.
    content : dict
        What was read.
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
            What must hold.
        found : object, optional
            What was found.

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
        """Take a value as it stands.

        Parameters
        ----------
        key : str
            Name of the value.
        default : object, optional
            Where it is absent.

        Returns
        -------
        object
            Of any TOML type.
        """
        self._taken.add(key)
        return self._content.get(key, default)

    def need(self, key: str) -> Any:
        """Take a value that must be there.

        Parameters
        ----------
        key : str
            Name of the value.

        Returns
        -------
        object
            Of any TOML type.

        Raises
        ------
        ExperimentError
            If it is absent.
        """
        if key not in self._content:
            there = ", ".join(self._content) or "nothing"
            self.refuse(f"`{key}` must be given; the table holds {there}")
        return self.get(key)

    def take(self, key: str, check: Callable[..., _Value]) -> _Value:
        """Take a value that must be there, by a check of `tissuereg._base.arguments`.

        Parameters
        ----------
        key : str
            Name of the value.
        check : callable
            ``check(key, value, error=...)`` returns the value to use.

        Returns
        -------
        object
            As checked.

        Raises
        ------
        ExperimentError
            If it is absent, or does not hold what it must.
        """
        try:
            return check(key, self.need(key), error=ExperimentError)
        except ExperimentError as error:
            self.refuse(str(error))

    def table(self, key: str) -> "Table | None":
        """Take a table.

        Parameters
        ----------
        key : str
            Name of the table.

        Returns
        -------
        Table or None
            None where it is absent.

        Raises
        ------
        ExperimentError
            If there is something else of that name.
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
        """Take a list of tables, ``[[key]]``.

        Parameters
        ----------
        key : str
            Name of the list.

        Returns
        -------
        list of Table
            Empty where it is absent.

        Raises
        ------
        ExperimentError
            If there is something else of that name.
        """
        value = self.get(key, [])
        if not (isinstance(value, list) and all(isinstance(item, dict) for item in value)):
            self.refuse(f"`{key}` must be a list of tables, [[{key}]]", value)
        return [Table(self.file, f"[[{key}]] number {i + 1}", item) for i, item in enumerate(value)]

    def know(self, keys: Iterable[str]) -> None:
        """Count keys as read, so that `finish` does not refuse them and names them among the known ones."""
        self._taken.update(keys)

    def rest(self) -> dict[str, Any]:
        """Take all values that have not been read yet.

        Returns
        -------
        dict
            By name, as read.
        """
        left = {key: value for key, value in self._content.items() if key not in self._taken}
        self._taken.update(left)
        return left

    def finish(self) -> None:
        """Refuse keys that have not been read.

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
    """The keys of one table, declared as fields; the docstring says what the table holds.

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
            As read.

        Returns
        -------
        Keys
            With defaults where keys are absent.

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
        """Return this table of a file, None where it is absent and may be.

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
        """Read this table of a file and refuse keys that are not declared; None where it is absent and may be.

        Raises
        ------
        ExperimentError
            As `of` and `found`, and if a key is unknown.
        """
        table = cls.found(top)
        if table is None:
            return None
        values = cls.of(table)
        table.finish()
        return values


def experiment_file(path: str | os.PathLike[str]) -> Path:
    """Return the file of an experiment: the path itself, or ``experiment.toml`` in that folder.

    `path`: folder or file. Result: a file that exists. Raises `FormatError` if there is none.
    """
    given = place("path", path, error=FormatError)
    file = given / "experiment.toml" if given.is_dir() else given
    if not file.exists():
        message = f"an experiment must be a folder with an experiment.toml; no such file: {file}"
        raise FormatError(message, where=str(file))
    return file


def parsed_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML text.

    Raises `ValueError` if it is no TOML, or holds a number of thousands of digits.
    """
    content: dict[str, Any] = tomllib.loads(text)
    return content


def read_toml(path: str | os.PathLike[str]) -> Table:
    """Read a TOML file.

    Result: its top; `Table.rest` gives it as a plain dict. Raises `ExperimentError` if it is no TOML; the message has
    the line; `FormatError` if there is no such file, or it is too large.
    """
    file = existing_file(path, FILES.text_mb)
    try:
        return Table(file, "", parsed_toml(read_text(file)))
    except TissueRegError:
        raise
    except (ValueError, OSError, RecursionError) as error:  # no TOML, no UTF-8, or a number of thousands of digits
        message = f"{file} must be a TOML file; it cannot be read: {error}"
        raise ExperimentError(message, where=str(file)) from error
