"""Large tables of a model's files in a byte or two a number: every row holds whole multiples of a power of two.

An array NAME of ``digits`` int8 (n_digits, n_rows, ...), to the base 256, the lowest first and each from -128 to 127,
with ``NAME.exponents`` int8 (n_rows,) stands for ``table[r] = 2**exponents[r] * sum_k 256**k digits[k, r]``. A table
without exponents is stored as it is.
"""

from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.fields import Archive

#: Largest number that two digits hold, and largest exponent: single precision holds all their products.
_MOST, _FARTHEST = 127 * 257, 100


def rounded(table: FloatArray, share: float) -> FloatArray:
    """Return a table (n_rows, ...) of finite numbers, its rows rounded to steps that digits can express.

    The step of a row is the power of two that is nearest to `share` times its root mean square, or a larger one where
    its largest number would need a third digit.
    """
    rows, least = table.reshape(len(table), -1), 2.0**-_FARTHEST
    step = np.maximum(share * np.sqrt((rows**2).mean(axis=1)), least)
    coarsest = np.maximum(np.abs(rows).max(axis=1) / _MOST, least)
    power = np.exp2(np.maximum(np.rint(np.log2(step)), np.ceil(np.log2(coarsest))))[:, None]
    return np.asarray((np.rint(rows / power) * power).reshape(table.shape))


def in_digits(name: str, table: FloatArray) -> dict[str, Any]:
    """Return the arrays that a file holds for a table (n_rows, ...): its digits, or half precision if two do not do."""
    half = {name: table.astype(np.float16)}
    if table.size == 0 or not np.isfinite(table).all():
        return half
    rows = table.reshape(len(table), -1)
    # A number is a whole multiple of 2**(exponent - 53), and of the powers of two below.
    mantissas, powers = np.frexp(rows)
    whole = np.ldexp(mantissas, 53).astype(np.int64)
    steps = np.where(whole == 0, np.inf, powers - 53 + np.log2(np.maximum(whole & -whole, 1)))
    exponents = steps.min(axis=1)
    exponents = np.where(np.isfinite(exponents), exponents, 0.0).astype(int)
    numbers = np.ldexp(rows, -exponents[:, None]).reshape(table.shape)
    if np.abs(numbers).max() > _MOST or np.abs(exponents).max() > _FARTHEST:
        return half
    low = (numbers.astype(np.int64) + 128) % 256 - 128
    high = (numbers.astype(np.int64) - low) // 256
    digits = np.stack([low, high] if high.any() else [low])
    return {name: digits.astype(np.int8), f"{name}.exponents": exponents.astype(np.int8)}


def table_in(archive: Archive, name: str, *shape: int | None) -> FloatArray:
    """Return the table of finite numbers `name`, of the given shape (None stands for any length), in an open archive.

    Raises `FormatError` if an array is missing, of another shape or type, or not finite.
    """
    if f"{name}.exponents" not in archive:
        return archive.floats(name, *shape)
    found, exponents = archive.raw(name), archive.indices(f"{name}.exponents", None)
    wanted = (len(exponents), *shape[1:])
    fits = found.ndim == 1 + len(shape) and all(n in (None, m) for n, m in zip(wanted, found.shape[1:], strict=True))
    if found.dtype != np.int8 or not fits or len(found) not in (1, 2) or shape[0] not in (None, len(exponents)):
        rows = ", ".join("any" if n is None else str(n) for n in shape)
        message = (
            f"array '{name}' in {archive.path} must hold one or two digits, int8, of a table of shape ({rows}) and as "
            f"many exponents as rows, got {found.dtype} of shape {found.shape} and {len(exponents)} exponents"
        )
        raise FormatError(message, where=f"{archive.path}:{name}")
    if ((exponents < -_FARTHEST) | (exponents > _FARTHEST)).any():
        message = f"array '{name}.exponents' in {archive.path} must lie within {_FARTHEST} of 0"
        raise FormatError(message, where=f"{archive.path}:{name}.exponents")
    table = np.zeros(found.shape[1:])
    for place, digit in enumerate(found):
        power = np.ldexp(256.0**place, exponents)
        table += power.reshape(-1, *(1,) * (digit.ndim - 1)) * digit
    return table
