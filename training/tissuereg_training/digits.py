"""Large tables in a byte or two a number: every row holds whole multiples of a power of two.

They are stored as ``digits`` int8 (n_digits, n_rows, ...), to the base 256, the lowest first and each from -128 to 127,
and ``exponents`` int8 (n_rows,): ``table[r] = 2**exponents[r] * sum_k 256**k digits[k, r]``.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from tissuereg_training.errors import ParityError

#: A table of fewer numbers is stored in half precision.
LARGE = 20_000

#: Steps of a layer's weights, and of error fields, as a share of their row's root mean square.
WEIGHT_STEP, ERROR_STEP = 0.03, 0.5

#: What rounding the components may add to the error of a decoded field, mm (root mean square over nodes).
COMPONENTS_MM = 0.0175

_BASE, _MOST = 256, 127 * 256 + 127


def rounded(table: torch.Tensor, step: torch.Tensor) -> torch.Tensor:
    """Return a table as `stored` keeps it: in half precision, or if it is large with rows in steps of a power of two.

    Parameters
    ----------
    table : Tensor of float, shape (n_rows, ...)
        Any numbers.
    step : Tensor of float, shape (n_rows,)
        Wanted distance of neighbouring values; the power next to it is taken, or a larger one where the row's largest
        number would need more than two digits.

    Returns
    -------
    Tensor
        Of the same shape.
    """
    if table.numel() < LARGE:
        return table.half().to(table.dtype)
    rows = table.flatten(1)
    least = rows.abs().amax(dim=1) / _MOST
    exponents = torch.maximum(step.log2().round(), least.log2().ceil()).clamp(-100.0, 100.0)
    power = torch.exp2(exponents)[:, None]
    return ((rows / power).round() * power).view_as(table)


def rounded_rows(table: torch.Tensor, share: float) -> torch.Tensor:
    """Return a table as `rounded` does, in steps of a share of each row's root mean square."""
    return rounded(table, share * table.flatten(1).square().mean(dim=1).sqrt())


def split(table: npt.NDArray[Any]) -> tuple[npt.NDArray[np.int8], npt.NDArray[np.int8]] | None:
    """Return the digits and exponents of a table, or None where two digits are not enough or the table is not large.

    Parameters
    ----------
    table : ndarray of float, shape (n_rows, ...)
        Such as `rounded` returns.

    Returns
    -------
    tuple of ndarray of int8, or None
        Digits (n_digits, n_rows, ...) and exponents (n_rows,).
    """
    if table.size < LARGE:
        return None
    rows = table.reshape(len(table), -1).astype(np.float64)
    # A number is a whole multiple of 2**(exponent - 24) in single precision, and of the powers below.
    mantissas, powers = np.frexp(rows)
    whole = np.ldexp(mantissas, 24).astype(np.int64)
    lowest = np.log2(np.maximum(whole & -whole, 1))
    steps = np.where(whole == 0, np.inf, powers - 24 + lowest).min(axis=1)
    steps = np.where(np.isfinite(steps), steps, 0.0)
    numbers = np.rint(np.ldexp(rows, -steps.astype(int)[:, None]))
    if np.abs(numbers).max() > _MOST or np.abs(steps).max() > 100:  # single precision ends at 2**-126
        return None
    numbers = numbers.astype(np.int64).reshape(table.shape)
    low = (numbers + 128) % _BASE - 128
    high = (numbers - low) // _BASE
    digits = np.stack([low, high] if high.any() else [low]).astype(np.int8)
    return digits, steps.astype(np.int8)


def halved(table: npt.NDArray[Any]) -> npt.NDArray[np.float16]:
    """Return a table in half precision; raise ParityError if that is not what it holds."""
    half = table.astype(np.float16)
    if not np.array_equal(half, table):
        message = f"a table of shape {table.shape} must be rounded before it is stored, and holds more digits"
        raise ParityError(message)
    return half


def stored(name: str, table: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
    """Return a table as ``decoder_weights.npz`` holds it: digits and ``NAME.exponents``, or half precision."""
    parts = split(table)
    return {name: halved(table)} if parts is None else {name: parts[0], f"{name}.exponents": parts[1]}
