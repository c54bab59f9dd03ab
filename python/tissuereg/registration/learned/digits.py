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

#: The base of the digits, and the largest number that two of them hold.
_BASE, _MOST = 256, 127 * 256 + 127

#: Largest exponent, and minus the least: eight bits, and single precision.
_FARTHEST = 100


def in_digits(name: str, table: FloatArray, share: float) -> dict[str, Any]:
    """Return the arrays that a file holds for a table (n_rows, ...), rounded to steps.

    The step of a row is the power of two that is nearest to `share` times its root mean square, or a larger one where
    its largest number would need a third digit.
    """
    if table.size == 0:
        return {name: table.astype(np.float16)}
    rows = table.reshape(len(table), -1)
    step = np.maximum(share * np.sqrt((rows**2).mean(axis=1)), 2.0**-_FARTHEST)
    least = np.maximum(np.abs(rows).max(axis=1) / _MOST, 2.0**-_FARTHEST)
    exponents = np.maximum(np.rint(np.log2(step)), np.ceil(np.log2(least))).astype(int)
    numbers = np.rint(np.ldexp(rows, -exponents[:, None])).astype(np.int64).reshape(table.shape)
    low = (numbers + _BASE // 2) % _BASE - _BASE // 2
    high = (numbers - low) // _BASE
    digits = np.stack([low, high] if high.any() else [low])
    return {name: digits.astype(np.int8), f"{name}.exponents": exponents.astype(np.int8)}


def table_in(archive: Archive, name: str, *shape: int | None) -> FloatArray:
    """Return the table of finite numbers `name`, of the given shape (None stands for any length), in an open archive.

    Raises `FormatError` if an array is missing, of another shape or not finite.
    """
    if f"{name}.exponents" not in archive:
        return archive.floats(name, *shape)
    found = archive.floats(name, None, *shape)
    if not 1 <= len(found) <= 2:
        message = f"array '{name}' in {archive.path} must hold one or two digits of a table, got shape {found.shape}"
        raise FormatError(message, where=f"{archive.path}:{name}")
    exponents = archive.indices(f"{name}.exponents", found.shape[1])
    if np.abs(exponents).max(initial=0) > _FARTHEST:
        message = f"array '{name}.exponents' in {archive.path} must lie within {_FARTHEST} of 0"
        raise FormatError(message, where=f"{archive.path}:{name}.exponents")
    table = np.zeros(found.shape[1:])
    for place, digit in enumerate(found):
        power = np.ldexp(float(_BASE**place), exponents)
        table += power.reshape(-1, *(1,) * (digit.ndim - 1)) * digit
    return table
