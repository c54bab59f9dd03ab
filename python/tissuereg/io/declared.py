"""Keys of TOML tables, declared once: readers check files by the declarations, and docs/experiment.md lists them."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Final

from tissuereg.errors import FormatError
from tissuereg.io.node_rules import rule_for_file
from tissuereg.io.toml import Table


class _Needed:
    """Marks a key that has no default and must be given."""

    def __repr__(self) -> str:
        return "needed"


#: Default of a key that must be given.
NEEDED: Final = _Needed()

#: Endings of keys, and the units that they state. Longer ones come first.
UNITS = {
    "_g_per_cm3": "g/cm^3",
    "_mm_per_s2": "mm/s^2",
    "_kpa_per_mm": "kPa/mm",
    "_kpa_s": "kPa s",
    "_per_s": "1/s",
    "_mm": "mm",
    "_kpa": "kPa",
    "_kPa": "kPa",
    "_mN": "mN",
    "_deg": "deg",
    "_s": "s",
}


def unit_of(name: str) -> str:
    """Return the unit that the ending of a key's name states, empty for a number without one."""
    return next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "")


@dataclass(frozen=True)
class Key:
    """One key of a table.

    Attributes
    ----------
    name : str
        As it stands in the file.
    words : str
        What it must hold, in words for docs/experiment.md.
    meaning : str
        One sentence.
    default : object
        Value where the key is absent; None: nothing is stated; `NEEDED`: the key must be given.
    take : callable
        ``take(table)`` returns the checked value.
    unit : str
        Unit of its numbers; empty where they have none.
    otherwise : str
        What applies where the key is absent, in words, where `default` does not show it.
    """

    name: str
    words: str
    meaning: str
    default: Any
    take: Callable[[Table], Any]
    unit: str
    otherwise: str = ""


@dataclass(frozen=True)
class Declaration:
    """The keys of one table.

    Attributes
    ----------
    heading : str
        As in the file: ``[mesh]``, ``[[actuator]]``; empty for the top of the file.
    meaning : str
        One sentence.
    keys : tuple of Key
        In the order of docs/experiment.md.
    needed : bool
        Whether the table must be given.
    """

    heading: str
    meaning: str
    keys: tuple[Key, ...]
    needed: bool = False

    @property
    def name(self) -> str:
        """The heading without its brackets."""
        return self.heading.strip("[]")

    def values(self, table: Table) -> dict[str, Any]:
        """Take all declared keys of a table.

        Parameters
        ----------
        table : Table
            As read; keys that are not declared are left for `Table.finish` to refuse.

        Returns
        -------
        dict of str to object
            Checked value by key; the default where the key is absent.

        Raises
        ------
        ExperimentError
            If a key is missing or does not hold what it must.
        """
        return {key.name: key.take(table) for key in self.keys}

    def of(self, top: Table) -> dict[str, Any] | None:
        """Read this table of a file, and refuse keys that are not declared.

        Parameters
        ----------
        top : Table
            The file.

        Returns
        -------
        dict of str to object or None
            As `values`; None where a table that may be left out is absent.

        Raises
        ------
        ExperimentError
            If a table that must be there is absent, a key missing or unknown, or one does not hold what it must.
        """
        table = self.table(top)
        if table is None:
            return None
        values = self.values(table)
        table.finish()
        return values

    def table(self, top: Table) -> Table | None:
        """Return the table itself, for readers with further checks.

        Parameters
        ----------
        top : Table
            The file.

        Returns
        -------
        Table or None
            None where it is absent and may be.

        Raises
        ------
        ExperimentError
            If it must be there and is not.
        """
        table = top.table(self.name)
        if table is None and self.needed:
            top.refuse(f"a table {self.heading} must be given")
        return table


def a_text(
    name: str, meaning: str, default: Any = NEEDED, *, among: Iterable[str] = (), words: str = "", otherwise: str = ""
) -> Key:
    """Declare a key that holds a text, one of `among` where that is given."""
    allowed = tuple(among)

    def take(table: Table) -> Any:
        return table.text(name, _usual(default), among=allowed)

    words = words or _one_of(allowed)
    return Key(name, words, meaning, default, _may_miss(name, default, take), "", otherwise)


def a_number(
    name: str,
    meaning: str,
    default: Any = NEEDED,
    *,
    positive: bool = False,
    unit: str | None = None,
    otherwise: str = "",
) -> Key:
    """Declare a key that holds a finite number, greater than zero where it must be."""

    def take(table: Table) -> Any:
        return table.number(name, _usual(default), positive=positive)

    words = "number > 0" if positive else "number"
    unit = unit_of(name) if unit is None else unit
    return Key(name, words, meaning, default, _may_miss(name, default, take), unit, otherwise)


def a_belief(name: str, meaning: str) -> Key:
    """Declare a key that holds a number, or a list of mean and standard deviation."""
    words = "number, or [mean, standard deviation]"
    return Key(name, words, meaning, NEEDED, lambda table: table.belief(name), unit_of(name))


def a_vector(name: str, meaning: str, *, unit: str | None = None, directed: bool = False) -> Key:
    """Declare a key that holds three finite numbers; `directed`: not all of them zero."""

    def take(table: Table) -> Any:
        values = table.numbers(name, 3)
        if directed and not values.any():
            table.refuse(f"`{name}` must have a length", values.tolist())
        return values

    return Key(name, "[x, y, z]", meaning, NEEDED, take, unit_of(name) if unit is None else unit)


def a_flag(name: str, meaning: str) -> Key:
    """Declare a key that holds true or false."""
    return Key(name, "`true` or `false`", meaning, NEEDED, lambda table: table.flag(name), "")


def a_node_rule(name: str, meaning: str) -> Key:
    """Declare a key that chooses nodes: a set, a plane or a ball."""

    def take(table: Table) -> Any:
        rule = table.need(name)
        try:
            return rule_for_file(rule, name)
        except FormatError as error:
            table.refuse(str(error))

    return Key(name, "node set, plane or ball", meaning, NEEDED, take, "mm")


def _one_of(allowed: tuple[str, ...]) -> str:
    listed = [f"`{word}`" for word in allowed]
    if not listed:
        return "text"
    return " or ".join(listed) if len(listed) < 4 else f"one of {', '.join(listed)}"


def _usual(default: Any) -> Any:
    """Return a default as `Table` takes it: None where the key must be given."""
    return None if default is NEEDED else default


def _may_miss(name: str, default: Any, take: Callable[[Table], Any]) -> Callable[[Table], Any]:
    """Return a reader that gives None for a key that is absent and has None as its default."""
    return (lambda table: take(table) if name in table else table.get(name)) if default is None else take
