"""What a prompt and a notebook show of an object: a `repr` that stays short, and HTML made by the room of pages."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np


class _Most(NamedTuple):
    """How much is shown: numbers of an array, entries of a list, characters of a number and of anything else."""

    numbers: int = 9
    entries: int = 4
    digits: int = 7
    letters: int = 100


_MOST = _Most()


def short(value: Any) -> str:
    """Return a short text for a value: small arrays rounded, large ones by their shape, long lists by their length.

    >>> short(np.array([1.23456, 2.0, np.nan])), short(np.zeros((40, 3))), short([1.0, 2.123456789])
    ('[1.235, 2, nan]', 'array(40 x 3)', '[1.0, 2.123]')
    """
    if isinstance(value, np.ndarray):
        if value.size > _MOST.numbers:
            return f"array({' x '.join(map(str, value.shape))})"
        text = np.array2string(value, separator=", ", formatter={"float_kind": lambda x: f"{x:.4g}"})
        return "".join(line.strip() + " " * line.endswith(",") for line in text.split("\n"))
    if isinstance(value, float | np.floating):
        return repr(float(value)) if len(repr(float(value))) <= _MOST.digits else f"{value:.4g}"
    if isinstance(value, Mapping):
        return _several([f"{key!r}: {short(one)}" for key, one in value.items()], "{}")
    if isinstance(value, tuple | list) and not hasattr(value, "_fields"):
        return _several([short(one) for one in value], "()" if isinstance(value, tuple) else "[]")
    if isinstance(value, Callable) and not hasattr(value, "__dataclass_fields__"):  # type: ignore[arg-type]
        return f"<{getattr(value, '__name__', type(value).__name__)}>"
    text = repr(value)
    return text if len(text) <= _MOST.letters else f"{text[: _MOST.letters]}..."


def _several(parts: list[str], ends: str) -> str:
    more = [f"... {len(parts)} in all"] if len(parts) > _MOST.entries else []
    return ends[0] + ", ".join(parts[: _MOST.entries] + more) + ends[1]


def short_repr(self: Any) -> str:
    """Return a `repr` of a dataclass, each field by `short`; to be used as its ``__repr__``."""
    shown = (f"{one.name}={short(getattr(self, one.name))}" for one in fields(self) if one.repr)
    return f"{type(self).__name__}({', '.join(shown)})"


def notebook(kind: str, *what: Any) -> str:
    """Return what a notebook shows of an object, HTML, by ``<kind>_html`` of `tissuereg.report.notebook`.

    Pages know results, bodies and markers; these know pages by this name alone, which is looked up when it is needed.
    """
    made: str = getattr(importlib.import_module("tissuereg.report.notebook"), f"{kind}_html")(*what)
    return made
