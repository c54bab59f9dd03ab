"""Checks of all arguments other than arrays: numbers, flags, texts, types, paths.

Every check takes the argument's name and value, returns the value to use, and raises an error of the given class that
names the argument, what must hold and what was found. Arrays are checked in `tissuereg._base.arrays`.
"""

import math
import operator
import os
import reprlib
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from tissuereg.errors import ArgumentError, TissueRegError

_Word = TypeVar("_Word", bound=str)


def check_choice(name: str, value: Any, choices: Collection[_Word], error: type[TissueRegError]) -> _Word:
    """Return a value; raise an error unless it is one of the allowed texts, and name all of them.

    `name`: name of the argument, for the message; `value`: the given value; `choices`: the allowed texts; `error`:
    class of the error.
    """
    if not isinstance(value, str) or value not in choices:
        message = f"`{name}` must be one of {', '.join(choices)}, got {found(value)}"
        raise error(message, where=name)
    return cast(_Word, value)


_T = TypeVar("_T")
_Error = type[TissueRegError]

#: A larger number of threads is taken for a typing error.
MOST_THREADS = 1024

#: So is a larger number of draws, members or steps.
MOST_COUNTED = 1_000_000

#: Largest length of a name.
LONGEST_NAME = 200

#: Largest length of a name in a file system.
_LONGEST_PART, _LONGEST_PATH = 255, 4000

#: Texts of found values are cut at about this many characters.
_SHOWN = 80
_short = reprlib.Repr()
_short.maxstring = _short.maxother = _short.maxlong = _SHOWN


def found(value: object) -> str:
    """Return a short text for a value in messages: numbers, texts and None as such, cut if long, else the type name."""
    if value is None or isinstance(value, bool | int | float | str | bytes):
        return _short.repr(value)[:_SHOWN]
    return type(value).__name__


def _listed(value: object) -> str:
    """Return a short text, for messages, of a value that should be a list: a list is shown cut, all else by `found`."""
    return _short.repr(value) if isinstance(value, list | tuple) else found(value)


def is_number(value: Any) -> bool:
    """Return whether a value is a finite real number that fits a float; true and false do not count as numbers."""
    if not isinstance(value, int | float | np.integer | np.floating) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def whole(name: str, value: Any, *, least: int = 0, most: int = MOST_COUNTED, error: _Error = ArgumentError) -> int:
    """Return the argument `name` as int after checking that it is a whole number, no bool, from `least` to `most`."""
    try:
        number = None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        number = None
    if number is None or not least <= number <= most:
        limit = f"of at least {least}" if number is None or number < least else f"of at most {most}"
        message = f"`{name}` must be a whole number {limit}, got {found(value)}"
        raise error(message, where=name)
    return number


def bounds(above: float, least: float, below: float, most: float) -> str:
    """Return the range of a number in words that follow a noun, such as " greater than 0 and at most 1".

    `above`, `below`: bounds that the number must not reach; `least`, `most`: bounds that it may reach. An infinite
    bound is left out; if all are infinite, the text is empty.
    """
    stated = [
        f"greater than {above:g}" if above > -math.inf else "",
        f"at least {least:g}" if least > -math.inf else "",
        f"less than {below:g}" if below < math.inf else "",
        f"at most {most:g}" if most < math.inf else "",
    ]
    return "".join(f" and {words}" for words in stated if words).removeprefix(" and").rstrip()


def real(
    name: str,
    value: Any,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    most: float = math.inf,
    unit: str = "",
    error: _Error = ArgumentError,
) -> float:
    """Return a number as float after checking that it is finite and in a range; texts, bools and arrays are refused.

    `name`: name of the argument, for the message; `above`, `below`: bounds that the number must not reach; `least`,
    `most`: bounds that it may reach; `unit`: unit to state in the message. Raises an error of the class `error`.
    """
    is_other = isinstance(value, bool | str | bytes) or bool(getattr(value, "shape", ()))
    try:
        number = math.nan if is_other else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not (math.isfinite(number) and above < number < below and least <= number <= most):
        wanted = f"{bounds(above, least, below, most)}{f', in {unit}' if unit else ''}"
        message = f"`{name}` must be a finite number{wanted}, got {found(value)}"
        raise error(message, where=name)
    return number


def reals(
    name: str,
    value: Any,
    *,
    length: int | None = None,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    directed: bool = False,
    error: _Error = ArgumentError,
) -> tuple[float, ...]:
    """Return a list or array of finite numbers as a tuple of floats, after checking their number and range.

    `name`: name of the argument, for the message; `length`: how many numbers there must be, at least one if it is None;
    `above`, `below`: bounds that each must not reach; `least`: bound that each may reach; `directed`: whether the
    numbers are a direction, so that at least one must differ from 0. Raises an error of the class `error`.
    """
    values = value.tolist() if isinstance(value, np.ndarray) else value
    listed = isinstance(values, list | tuple) and len(values) == (length or max(1, len(values)))
    if not (listed and all(is_number(x) and above < x < below and x >= least for x in values)):
        size = "one or more" if length is None else str(length)
        wanted = bounds(above, least, below, math.inf)
        message = f"`{name}` must be a list of {size} finite numbers{wanted}, got {_listed(values)}"
        raise error(message, where=name)
    if directed and not any(values):
        message = f"`{name}` must have a length, got {_listed(values)}"
        raise error(message, where=name)
    return tuple(float(x) for x in values)


def flag(name: str, value: Any, *, error: _Error = ArgumentError) -> bool:
    """Return a truth value, Python's or numpy's, as bool; raise an error of the class `error` for anything else."""
    if type(value).__name__ not in ("bool", "bool_"):
        message = f"`{name}` must be true or false, got {found(value)}"
        raise error(message, where=name)
    return bool(value)


def text(name: str, value: Any, *, longest: int | None = LONGEST_NAME, error: _Error = ArgumentError) -> str:
    """Return a text after checking that it is not blank and has at most `longest` characters, any number for None."""
    if not isinstance(value, str) or not value.strip() or len(value) > (longest or len(value)):
        limit = "" if longest is None else f" of at most {longest} characters"
        message = f"`{name}` must be a text{limit}, got {found(value)}"
        raise error(message, where=name)
    return value


def texts(name: str, value: Any, *, length: int, error: _Error = ArgumentError) -> tuple[str, ...]:
    """Return a list of texts as a tuple after checking that it holds `length` texts, none blank and all different."""
    listed = isinstance(value, list | tuple) and all(isinstance(x, str) and x.strip() for x in value)
    if not (listed and len(value) == length == len(set(value))):
        message = f"`{name}` must be a list of {length} different texts, got {_listed(value)}"
        raise error(message, where=name)
    return tuple(value)


def _kinds(kind: type[Any] | tuple[type[Any], ...]) -> str:
    return " or ".join(one.__name__ for one in (kind if isinstance(kind, tuple) else (kind,)))


def of_kind(name: str, value: Any, kind: type[_T] | tuple[type[_T], ...], *, error: _Error = ArgumentError) -> _T:
    """Return a value after checking that it is an instance of the class `kind`, or of one of several classes."""
    if not isinstance(value, kind):
        message = f"`{name}` must be of the kind {_kinds(kind)}, got {found(value)}"
        raise error(message, where=name)
    return value


def maybe(name: str, value: Any, kind: type[_T] | tuple[type[_T], ...], *, error: _Error = ArgumentError) -> _T | None:
    """Return None, or a value after checking that it is an instance of the class, or of one of the classes, `kind`."""
    return None if value is None else of_kind(name, value, kind, error=error)


def each(
    name: str, value: Any, kind: type[_T] | tuple[type[_T], ...], *, error: _Error = ArgumentError
) -> tuple[_T, ...]:
    """Return an iterable as a tuple after checking that each item is an instance of `kind`, or of a class in `kind`."""
    listed = isinstance(value, Iterable) and not isinstance(value, str | bytes)
    items = tuple(value) if listed else ()
    wrong = [item for item in items if not isinstance(item, kind)]
    if not listed or wrong:
        got = f"{found(wrong[0])} in it" if wrong else found(value)
        message = f"`{name}` must be a list of the kind {_kinds(kind)}, got {got}"
        raise error(message, where=name)
    return items


def called(name: str, value: Any) -> None:
    """Raise `ArgumentError` unless the argument called `name` is None or can be called like a function."""
    if value is not None and not callable(value):
        message = f"`{name}` must be a function or None, got {found(value)}"
        raise ArgumentError(message, where=name)


def named(name: str, value: Any, *, error: _Error = ArgumentError) -> Mapping[str, Any]:
    """Return a mapping after checking that all its keys are texts; return an empty mapping for None."""
    if value is None:
        return {}
    if not isinstance(value, Mapping) or not all(isinstance(key, str) for key in value):
        wrong = (key for key in value if not isinstance(key, str)) if isinstance(value, Mapping) else iter(())
        key = next(wrong, None)
        got = found(value) if key is None else f"the name {found(key)}"
        message = f"`{name}` must be a mapping with texts for names, got {got}"
        raise error(message, where=name)
    return value


def place(name: str, value: Any, *, error: _Error = ArgumentError) -> Path:
    """Return a text or path-like object as `Path` after checking that it can name a file, which need not exist."""
    given = os.fspath(value) if isinstance(value, os.PathLike) else value
    too_long = isinstance(given, str) and any(len(part) > _LONGEST_PART for part in Path(given).parts)
    if not isinstance(given, str) or not given or "\0" in given or too_long or len(given) > _LONGEST_PATH:
        message = f"`{name}` must be a path to a file or folder, got {found(given)}"
        raise error(message, where=name)
    return Path(given)


def check_running(*, seed: Any = 0, threads: Any = 0) -> None:
    """Raise `ArgumentError` unless `seed` lies from 0 to 2^64 - 1 and `threads` from 0 to 1024, both whole numbers."""
    whole("seed", seed, most=2**64 - 1)
    whole("threads", threads, most=MOST_THREADS)
