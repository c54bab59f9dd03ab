"""Checked fields of dataclasses, each declared once for arguments, file tables, command-line options and their docs.

A field states what it must hold, its unit, its meaning and its default:

>>> @dataclass(frozen=True, kw_only=True)
... class Settings(CheckedRecord):
...     std_mm: float = number("noise of a marker coordinate", above=0.0, default=0.1)
...     tracker: str = choice(("fixed", "drifts"), "whether it may have moved", default="fixed")
>>> Settings(std_mm=0.0)
Traceback (most recent call last):
    ...
tissuereg.errors.ArgumentError: `std_mm` must be a finite number greater than 0, got 0.0
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import MISSING, dataclass, field, fields
from functools import partial
from typing import Any, ClassVar, NoReturn

from tissuereg._base import arguments
from tissuereg._base.arguments import MOST_COUNTED, bounds, check_choice, is_number
from tissuereg.errors import ArgumentError, TissueRegError

_Error = type[TissueRegError]

#: Endings of names, and the units that they state. Longer ones come first.
UNITS = {
    "_g_per_cm3": "g/cm^3",
    "_mm_per_s2": "mm/s^2",
    "_kpa_per_mm": "kPa/mm",
    "_per_mm": "1/mm",
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
    """Return the unit that the ending of a field's name states, such as ``mm`` for ``std_mm``; empty if none."""
    return next((unit for ending, unit in UNITS.items() if name.endswith(ending)), "")


@dataclass(frozen=True, kw_only=True, eq=False)
class Check:
    """The check and the description of one field of a record.

    Attributes
    ----------
    take : callable
        Function that is called as ``take(name, value, error=...)``, and returns the value to use or raises the error.
    words : str
        What the field must hold, in words, for the documentation.
    meaning : str
        Meaning of the field in one sentence; empty where the record's docstring describes the field.
    unit : str or None
        Unit of the field's numbers; None if the field's name ends in the unit.
    otherwise : str
        What applies where the field is absent, in words; empty where the default shows it.
    example : object
        Value to show in example files for a field that has no default; None if there is no example.
    choices : sequence of str
        Texts of which the field must hold one; empty for a field that is not such a choice.
    read : callable
        Function that makes the field's value from a word of the command line, and raises ValueError if it cannot.
    """

    take: Callable[..., Any]
    words: str
    meaning: str
    unit: str | None = None
    otherwise: str = ""
    example: Any = None
    choices: Sequence[str] = ()
    read: Callable[[str], Any] = str


@dataclass(frozen=True)
class DeclaredField:
    """A declared field of a record: its name, its check and description, and its default (`MISSING` if it has none)."""

    name: str
    check: Check
    default: Any

    @property
    def unit(self) -> str:
        """Unit of the field's numbers, such as ``mm``; empty where they have none."""
        return unit_of(self.name) if self.check.unit is None else self.check.unit


@dataclass(frozen=True)
class CheckedRecord:
    """A frozen dataclass whose fields are declared by the functions of this module, and checked when it is made.

    A field whose default is None may be None. Fields declared in another way are taken as they are.

    Raises
    ------
    TissueRegError
        Of the class that the class attribute `error` names, if a field does not hold what it must.
    """

    error: ClassVar[_Error] = ArgumentError

    def __post_init__(self) -> None:
        for each in self.declared():
            value = getattr(self, each.name)
            if value is not None or each.default is not None:
                object.__setattr__(self, each.name, each.check.take(each.name, value, error=self.error))
        self.check()

    def check(self) -> None:
        """Raise an error if fields contradict each other; subclasses define this, and it does nothing by default."""

    def refuse(self, rule: str, value: object = None) -> NoReturn:
        """Raise an error of the class `error` that states the rule to keep and, unless it is None, the value found."""
        message = rule if value is None else f"{rule}, got {value!r}"
        raise self.error(message)

    @classmethod
    def declared(cls) -> tuple[DeclaredField, ...]:
        """Return the fields of the class that functions of this module declare, in their order."""
        return tuple(DeclaredField(one.name, one.metadata["check"], one.default) for one in fields(cls) if one.metadata)


def checked(take: Callable[..., Any], words: str, meaning: str = "", *, default: Any = MISSING, **more: Any) -> Any:
    """Declare a dataclass field by a check of its own, called as ``take(name, value, error=...)``, and by words.

    The functions below declare the usual sorts of field. `words`: what the field must hold, for the documentation;
    `meaning`: its meaning in one sentence, for documentation and help; `default`: its default; if it is None, the field
    may be None; `more`: further attributes of `Check`.
    """
    return field(default=default, metadata={"check": Check(take=take, words=words, meaning=meaning, **more)})


def number(
    meaning: str = "",
    *,
    unit: str | None = None,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    most: float = math.inf,
    default: Any = MISSING,
    **more: Any,
) -> Any:
    """Declare a dataclass field that holds a finite number in a range.

    `meaning`: its meaning in one sentence; `unit`: its unit where the field's name does not end in it; `above`,
    `below`: bounds that the number must not reach; `least`, `most`: bounds that it may reach; `default`: its default,
    none if it is left out; `more`: further attributes of `Check`.
    """
    take = partial(arguments.real, unit=unit or "", above=above, least=least, below=below, most=most)
    return checked(
        take, f"number{bounds(above, least, below, most)}", meaning, default=default, unit=unit, read=float, **more
    )


def whole(
    meaning: str = "", *, least: int = 0, most: int = MOST_COUNTED, default: Any = MISSING, unit: str = "", **more: Any
) -> Any:
    """Declare a dataclass field that holds a whole number from `least` to `most`; `meaning` says what it is."""
    take = partial(arguments.whole, least=least, most=most)
    return checked(take, f"whole number at least {least}", meaning, default=default, unit=unit, read=int, **more)


def numbers(
    meaning: str = "",
    length: int | None = None,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    directed: bool = False,
    default: Any = MISSING,
    **more: Any,
) -> Any:
    """Declare a dataclass field that holds a tuple of `length` finite numbers in a range, of one or more for None.

    `meaning`: its meaning in one sentence; `above`, `below`: bounds that each number must not reach; `least`: bound
    that each may reach; `directed`: whether the numbers are a direction, so that at least one must differ from 0;
    `default`: its default, none if it is left out; `more`: further attributes of `Check`.
    """
    take = partial(arguments.reals, length=length, above=above, least=least, below=below, directed=directed)
    words = "[x, y, z]" if length == 3 else f"list of {'one or more' if length is None else length} numbers"
    within = bounds(above, least, below, math.inf)
    return checked(take, f"{words}, each{within}" if within else words, meaning, default=default, **more)


def span(
    meaning: str = "",
    *,
    above: float = -math.inf,
    below: float = math.inf,
    counted: int | None = None,
    default: Any = MISSING,
    **more: Any,
) -> Any:
    """Declare a dataclass field that holds a range [low, high] of numbers between `above` and `below`.

    `meaning`: its meaning in one sentence; `counted`: where it is given, both ends are whole numbers of at least this
    value instead; `default`: its default, none if it is left out; `more`: further attributes of `Check`.
    """
    one: Callable[..., Any] = partial(arguments.real, above=above, below=below)
    if counted is not None:
        one = partial(arguments.whole, least=counted)

    def take(name: str, value: Any, error: _Error = ArgumentError) -> tuple[Any, Any]:
        if isinstance(value, list | tuple) and len(value) == 2:
            low, high = (one(name, x, error=error) for x in value)
            if low <= high:
                return (low, high)
        message = f"`{name}` must be a range [low, high], got {value!r:.80}"
        raise error(message, where=name)

    within = bounds(above, -math.inf, below, math.inf)
    words = f"[low, high]{within}" if counted is None else f"[low, high], whole numbers at least {counted}"
    return checked(take, words, meaning, default=default, **more)


def belief(meaning: str = "", *, default: Any = MISSING, **more: Any) -> Any:
    """Declare a dataclass field that holds an uncertain number: the number alone, or [mean, standard deviation].

    The field's value is the pair (mean, standard deviation), with None for a standard deviation that is not given.
    `meaning`: its meaning in one sentence; `default`: its default, none if it is left out; `more`: further attributes
    of `Check`.
    """

    def take(name: str, value: Any, error: _Error = ArgumentError) -> tuple[float, float | None]:
        if is_number(value):
            return float(value), None
        pair = isinstance(value, list | tuple) and len(value) == 2 and is_number(value[0])
        if pair and value[1] is None:
            return float(value[0]), None
        if not pair or not is_number(value[1]) or value[1] <= 0:
            message = f"`{name}` must be a number or [mean, standard deviation > 0], got {value!r:.80}"
            raise error(message, where=name)
        return float(value[0]), float(value[1])

    return checked(take, "number, or [mean, standard deviation]", meaning, default=default, **more)


def text(meaning: str = "", *, longest: int | None = None, default: Any = MISSING, **more: Any) -> Any:
    """Declare a dataclass field that holds a text that is not blank, of at most `longest` characters (None: any)."""
    return checked(partial(arguments.text, longest=longest), "text", meaning, default=default, **more)


def texts(meaning: str = "", *, length: int, default: Any = MISSING) -> Any:
    """Declare a dataclass field that holds a tuple of `length` different texts, none of them blank."""
    return checked(partial(arguments.texts, length=length), f"list of {length} texts", meaning, default=default)


def choice(among: Sequence[str], meaning: str = "", *, default: Any = MISSING, **more: Any) -> Any:
    """Declare a dataclass field that holds one of the texts in `among`; `meaning` says in one sentence what it is."""

    def take(name: str, value: Any, error: _Error = ArgumentError) -> str:
        check_choice(name, value, among, error)
        return str(value)

    listed = [f"`{word}`" for word in among]
    words = " or ".join(listed) if len(listed) < 4 else f"one of {', '.join(listed)}"
    return checked(take, words, meaning, default=default, choices=tuple(among), **more)


def flag(meaning: str = "", *, default: Any = MISSING, **more: Any) -> Any:
    """Declare a dataclass field that holds true or false."""
    return checked(arguments.flag, "`true` or `false`", meaning, default=default, **more)


def path(meaning: str = "", *, default: Any = MISSING, **more: Any) -> Any:
    """Declare a dataclass field that holds a path to a file or folder, which need not exist."""
    return checked(arguments.place, "path", meaning, default=default, **more)


def table(meaning: str = "", *, words: str = "table", default: Any = MISSING, **more: Any) -> Any:
    """Declare a dataclass field that holds a mapping whose keys are texts; `words` says what the mapping holds."""

    def take(name: str, value: Any, error: _Error = ArgumentError) -> Mapping[str, Any]:
        if not isinstance(value, Mapping):
            message = f"`{name}` must be a table, got {value!r:.80}"
            raise error(message, where=name)
        return arguments.named(name, value, error=error)

    return checked(take, words, meaning, default=default, **more)


def nested(kind: type[Any], meaning: str = "") -> Any:
    """Declare a dataclass field that holds a record of the class `kind`; by default, that record with its defaults."""
    check = Check(take=partial(_of_kind, kind=kind), words=kind.__name__, meaning=meaning)
    return field(default_factory=kind, metadata={"check": check})


def _of_kind(name: str, value: Any, error: _Error = ArgumentError, *, kind: type[Any]) -> Any:
    return arguments.of_kind(name, value, kind, error=error)
