"""Checked reading of TOML tables: every key is read, and an unread one is refused."""

import os
import tomllib
from collections.abc import Iterable
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from tissuereg._base.arguments import is_number, place
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ExperimentError, FormatError, TissueRegError
from tissuereg.io.bounds import TEXT_MB, existing_file, read_text


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

    def text(self, key: str, default: str | None = None, *, among: Iterable[str] = ()) -> str:
        """Take a text.

        Parameters
        ----------
        key : str
            Name of the value.
        default : str, optional
            Where it is absent; without one it must be there.
        among : iterable of str
            What is allowed; empty = anything.

        Returns
        -------
        str
            Not empty.

        Raises
        ------
        ExperimentError
            If it is absent, no text, or not among what is allowed.
        """
        value = self.need(key) if default is None else self.get(key, default)
        if not isinstance(value, str) or not value.strip():
            self.refuse(f"`{key}` must be a text", value)
        allowed = tuple(among)
        if allowed and value not in allowed:
            self.refuse(f"`{key}` must be one of {', '.join(allowed)}", value)
        return value

    def flag(self, key: str) -> bool:
        """Take true or false.

        Parameters
        ----------
        key : str
            Name of the value; it must be there.

        Returns
        -------
        bool
            As it stands.

        Raises
        ------
        ExperimentError
            If it is absent or something else.
        """
        value = self.need(key)
        if not isinstance(value, bool):
            self.refuse(f"`{key}` must be true or false", value)
        return value

    def number(self, key: str, default: float | None = None, *, positive: bool = False) -> float:
        """Take a finite number.

        Parameters
        ----------
        key : str
            Name of the value.
        default : float, optional
            Where it is absent; without one it must be there.
        positive : bool
            Whether it must be greater than zero.

        Returns
        -------
        float
            Finite.

        Raises
        ------
        ExperimentError
            If it is absent, no number, not finite, or not positive where it must be.
        """
        value = self.need(key) if default is None else self.get(key, default)
        if not is_number(value) or (positive and value <= 0):
            self.refuse(f"`{key}` must be a {'positive' if positive else 'finite'} number", value)
        return float(value)

    def numbers(self, key: str, length: int) -> FloatArray:
        """Take a list of finite numbers that must be there.

        Parameters
        ----------
        key : str
            Name of the value.
        length : int
            How many.

        Returns
        -------
        ndarray of float64, shape (length,)
            In their order.

        Raises
        ------
        ExperimentError
            If it is absent or anything else.
        """
        value = self.need(key)
        if not (isinstance(value, list) and len(value) == length and all(is_number(x) for x in value)):
            self.refuse(f"`{key}` must be a list of {length} finite numbers", value)
        return np.array(value, dtype=np.float64)

    def belief(self, key: str, default: float | None = None) -> tuple[float, float | None]:
        """Take a number, or a list of mean and standard deviation.

        Parameters
        ----------
        key : str
            Name of the value.
        default : float, optional
            Mean where it is absent; without one it must be there.

        Returns
        -------
        mean : float
            Finite.
        std : float or None
            Positive, None where only one number is given.

        Raises
        ------
        ExperimentError
            If it is absent or anything else.
        """
        value = self.need(key) if default is None else self.get(key, default)
        if is_number(value):
            return float(value), None
        pair = isinstance(value, list) and len(value) == 2 and all(is_number(x) for x in value)
        if not pair or value[1] <= 0:
            self.refuse(f"`{key}` must be a number or [mean, standard deviation > 0]", value)
        return float(value[0]), float(value[1])

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


def experiment_file(path: str | os.PathLike[str]) -> Path:
    """Return the file of an experiment: the path itself, or ``experiment.toml`` in that folder.

    Parameters
    ----------
    path : path-like
        Folder or file.

    Returns
    -------
    Path
        A file that exists.

    Raises
    ------
    FormatError
        If there is none.
    """
    given = place("path", path, error=FormatError)
    file = given / "experiment.toml" if given.is_dir() else given
    if not file.exists():
        message = f"an experiment must be a folder with an experiment.toml; no such file: {file}"
        raise FormatError(message, where=str(file))
    return file


def parsed_toml(text: str) -> dict[str, Any]:
    """Return the content of a TOML text.

    Raises
    ------
    ValueError
        If it is no TOML, or holds a number of thousands of digits.
    """
    content: dict[str, Any] = tomllib.loads(text)
    return content


def read_toml(path: str | os.PathLike[str]) -> Table:
    """Read a TOML file.

    Parameters
    ----------
    path : path-like
        The file.

    Returns
    -------
    Table
        Its top; `Table.rest` gives it as a plain dict.

    Raises
    ------
    ExperimentError
        If it is no TOML; the message has the line.
    FormatError
        If there is no such file, or it is too large.
    """
    file = existing_file(path, TEXT_MB)
    try:
        return Table(file, "", parsed_toml(read_text(file)))
    except TissueRegError:
        raise
    except (ValueError, OSError, RecursionError) as error:  # no TOML, no UTF-8, or a number of thousands of digits
        message = f"{file} must be a TOML file; it cannot be read: {error}"
        raise ExperimentError(message, where=str(file)) from error
