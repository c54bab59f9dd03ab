"""Checks and conversions of arrays that a user passes."""

from collections.abc import Sequence
from typing import Any, NoReturn, TypeVar

import numpy as np
import numpy.typing as npt

from tissuereg.errors import ShapeError

FloatArray = npt.NDArray[np.float64]
IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

#: Reasons are cut at so many characters.
_REASON = 200

_Array = TypeVar("_Array", bound=npt.NDArray[Any])


def _fits(shape: tuple[int, ...], wanted: tuple[int | None, ...]) -> bool:
    return len(shape) == len(wanted) and all(w is None or w == s for s, w in zip(shape, wanted, strict=True))


def _shown(wanted: tuple[int | None, ...]) -> str:
    return "(" + ", ".join("any" if w is None else str(w) for w in wanted) + ("," if len(wanted) == 1 else "") + ")"


def _refuse_kind(value: Any) -> NoReturn:
    message = "nothing" if value is None else "complex numbers"
    raise TypeError(message)


def float_array(name: str, value: Any, shape: tuple[int | None, ...]) -> FloatArray:
    """Return `value` as a C-ordered float64 array of the wanted shape.

    `name`: name of the argument, for the message; `value`: anything that numpy can turn into real numbers; `shape`:
    wanted shape, in which None stands for any length. Result: the same memory where it already fits, otherwise a copy.
    NaN and infinities are accepted. Raises `ShapeError` if `value` is not numeric or has another shape.
    """
    try:
        given = np.asarray(value)
        if value is None or given.dtype.kind == "c":
            _refuse_kind(value)
        array = np.ascontiguousarray(given, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        got = f"{type(value).__name__}: {str(error)[:_REASON]}"
        message = f"`{name}` must be an array of numbers of shape {_shown(shape)}, got {got}"
        raise ShapeError(message, where=name) from error
    array = array if np.ndim(value) else array.reshape(())
    if not _fits(array.shape, shape):
        message = f"`{name}` must have shape {_shown(shape)}, got {array.shape}"
        raise ShapeError(message, where=name)
    return array


def depth(name: str, value: Any) -> int:
    """Return the number of axes that a value has as a numpy array; raise `ShapeError` for lists of unequal lengths."""
    try:
        return np.ndim(value)
    except ValueError as error:
        message = f"`{name}` must be an array of numbers, got lists of unequal lengths"
        raise ShapeError(message, where=name) from error


def index_array(name: str, value: Any, shape: tuple[int | None, ...]) -> IntArray:
    """Return `value` as a C-ordered int64 array of the wanted shape.

    `name`: name of the argument, for the message; `value`: whole numbers; an array of floats is refused, not rounded,
    unless it is empty; `shape`: wanted shape, in which None stands for any length. Result: the same memory where it
    already fits, otherwise a copy. Raises `ShapeError` if `value` is not of an integer type or has another shape.
    """
    try:
        array = np.asarray(value)
    except (TypeError, ValueError, OverflowError) as error:
        message = (
            f"`{name}` must hold integers of shape {_shown(shape)}, got {type(value).__name__}: {str(error)[:_REASON]}"
        )
        raise ShapeError(message, where=name) from error
    if array.size == 0:
        array = array.astype(np.int64)
    if array.dtype.kind not in "iu":
        message = f"`{name}` must hold integers of shape {_shown(shape)}, got dtype {array.dtype}"
        raise ShapeError(message, where=name)
    if not _fits(array.shape, shape):
        message = f"`{name}` must have shape {_shown(shape)}, got {array.shape}"
        raise ShapeError(message, where=name)
    return np.ascontiguousarray(array, dtype=np.int64)


def optional_array(name: str, value: Any, shape: tuple[int | None, ...]) -> FloatArray | None:
    """Return None for None, else `value` as C-ordered float64 array of `shape`, where None stands for any length."""
    return None if value is None else float_array(name, value, shape)


def stacked(rows: Sequence[FloatArray | None]) -> FloatArray | None:
    """Stack n arrays (k, ...) into one (n, k, ...), with zeros for each row that is None; None if all rows are None."""
    some = next((row for row in rows if row is not None), None)
    if some is None:
        return None
    return np.stack([np.zeros_like(some) if row is None else row for row in rows])


def frozen(array: _Array) -> _Array:
    """Return a read-only view of an array, so that a record's array cannot be changed through its attribute."""
    view: _Array = array.view()
    view.flags.writeable = False
    return view
