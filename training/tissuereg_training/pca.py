"""Principal components of a training split, found part by part: the rival of every network, and a part of one."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from tissuereg_training.data import FieldArray
from tissuereg_training.errors import DivergenceError

Float64Array = npt.NDArray[np.float64]

#: Passes over the fields at most, and the relative gain of variance at which they end before that.
_PASSES = 30
_SMALLEST_GAIN = 1e-7


@dataclass(frozen=True, eq=False)
class Moments:
    """Mean and spread of a set of fields.

    Attributes
    ----------
    mean : ndarray of float64, shape (n_nodes, 3)
        Mean field, mm.
    scale : float
        Root mean square of a component about it, mm; positive.
    n_fields : int
        How many there were.
    """

    mean: Float64Array
    scale: float
    n_fields: int


def moments(parts: Iterable[FieldArray]) -> Moments:
    """Return mean field and scale.

    Parameters
    ----------
    parts : iterable of ndarray of float32, shape (n_part, n_nodes, 3)
        All fields in mm, in parts; walked through twice.

    Returns
    -------
    Moments
        Of all of them.

    Raises
    ------
    DivergenceError
        If all fields are the same, so that there is nothing to learn.
    """
    sums = [(part.sum(axis=0, dtype=np.float64), len(part)) for part in parts]
    n_fields = sum(n for _, n in sums)
    mean: Float64Array = sum(total for total, _ in sums) / n_fields
    square = sum(float(np.sum((part - mean) ** 2)) for part in parts)
    scale = float(np.sqrt(square / (n_fields * mean.size)))
    if not scale > 0:
        message = "the training fields must differ from each other; they are all the same"
        raise DivergenceError(message, where="displacement_mm")
    return Moments(mean, scale, n_fields)


def principal_components(
    parts: Iterable[FieldArray], about: Moments, n_components: int
) -> tuple[FieldArray, Float64Array]:
    """Return the leading principal components and the spread along them.

    Parameters
    ----------
    parts : iterable of ndarray of float32, shape (n_part, n_nodes, 3)
        All fields in mm, in parts; walked through some ten times, one part in memory at a time.
    about : Moments
        Theirs.
    n_components : int
        How many; fewer are returned where there are fewer fields or numbers a field.

    Returns
    -------
    components : ndarray of float32, shape (n_components, n_nodes, 3)
        Orthonormal, by falling variance; the entry of largest size is positive.
    std : ndarray of float64, shape (n_components,)
        Standard deviation of the fields' coefficients, mm.

    Notes
    -----
    Subspace iteration with a few more vectors than wanted. Cost a pass: 4 n_fields n_nodes 3 (1.25 n_components + 20)
    floating-point operations.
    """
    width = about.mean.size
    n_components = min(n_components, width, about.n_fields)
    block = min(n_components + n_components // 4 + 20, width, about.n_fields)
    mean = about.mean.astype(np.float32).ravel()
    basis = _orthonormal(np.random.default_rng(0).standard_normal((width, block), dtype=np.float32))
    captured = 0.0
    for _ in range(_PASSES):
        product = np.zeros_like(basis)
        for part in parts:
            rows = part.reshape(len(part), -1) - mean
            product += rows.T @ (rows @ basis)
        variances, turn = np.linalg.eigh((basis.T @ product).astype(np.float64))
        before, captured = captured, float(variances[-n_components:].sum())
        if captured - before <= _SMALLEST_GAIN * captured:
            break
        basis = _orthonormal(product)
    found = (basis @ turn[:, ::-1][:, :n_components].astype(np.float32)).T
    std = np.sqrt(np.maximum(variances[::-1][:n_components], 0.0) / about.n_fields)
    largest = np.take_along_axis(found, np.abs(found).argmax(axis=1)[:, None], axis=1)
    signed: FieldArray = np.ascontiguousarray(found * np.sign(largest)).reshape(-1, *about.mean.shape)
    return signed, std


def pca_error(components: FieldArray, mean: Float64Array, fields: FieldArray) -> float:
    """Return the mean Euclidean node error with which components reconstruct fields.

    Parameters
    ----------
    components : ndarray of float32, shape (n_components, n_nodes, 3)
        Orthonormal; none at all give the error of the constant mean shape.
    mean : ndarray of float64, shape (n_nodes, 3)
        Mean field that they stand about, mm.
    fields : ndarray of float32, shape (n_fields, n_nodes, 3)
        Fields in mm to reconstruct.

    Returns
    -------
    float
        mm.
    """
    basis = components.reshape(len(components), mean.size)
    rows = fields.reshape(len(fields), -1) - mean.astype(np.float32).ravel()
    missed = rows - (rows @ basis.T) @ basis
    return float(np.linalg.norm(missed.reshape(fields.shape), axis=2).mean(dtype=np.float64))


def _orthonormal(columns: FieldArray) -> FieldArray:
    basis: FieldArray = np.linalg.qr(columns)[0]
    return basis
