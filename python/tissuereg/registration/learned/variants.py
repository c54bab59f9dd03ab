"""Variants of a simulation: the same event simulated with other values of what is uncertain.

A registration starts from their mean, and their second moments are a part of its prior: how this body, supported and
loaded as it is, moves differently where moduli, supports or loads are others. As a few variants span few directions, a
share of the covariance of truths about simulations in general is added: a hybrid of an ensemble's and a static
covariance (T. M. Hamill and C. Snyder, "A hybrid ensemble Kalman filter-3D variational analysis scheme", Monthly
Weather Review 128, 2905-2919, 2000).
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, float_array
from tissuereg.errors import ShapeError
from tissuereg.registration.learned.calibration import FieldErrors

#: Variants that are needed at least: fewer say nothing of a covariance.
LEAST_VARIANTS = 4


def checked_variants(fields: Any, n_nodes: int | None = None) -> FloatArray:
    """Return variants of a simulation as float64, shape (n_variants, n_nodes, 3), in mm.

    Raises `ShapeError` unless `fields` are at least four finite displacement fields, of `n_nodes` nodes if that is
    given.
    """
    given = float_array("variants", fields, (None, n_nodes, 3))
    if len(given) < LEAST_VARIANTS:
        message = f"`variants` must be {LEAST_VARIANTS} or more simulations of one moment, got {len(given)}"
        raise ShapeError(message, where="variants")
    finite = np.isfinite(given).all(axis=(1, 2))
    if not finite.all():
        message = f"`variants` must be finite displacements in mm; variant {int(np.argmin(finite))} is not"
        raise ShapeError(message, where="variants")
    return given


@dataclass(frozen=True, eq=False)
class Variants:
    """Mean and covariance of the variants of a simulation (the same event with other moduli, supports or loads).

    `mean` (n_nodes, 3) is the mean displacement, in mm; `spread` is the covariance about it, with as many patterns as
    there are variants.
    """

    mean: FloatArray
    spread: FieldErrors

    @property
    def count(self) -> int:
        """Number of variants."""
        return len(self.spread.basis)

    @classmethod
    def of(cls, fields: Any, n_nodes: int) -> "Variants":
        """Return the mean and the covariance of the variants of a simulation.

        `fields` (n_variants, n_nodes, 3) are displacements, in mm. Raises `ShapeError` if the array has another shape,
        a field is not finite, or there are fewer than four.
        """
        given = checked_variants(fields, n_nodes)
        mean = given.mean(axis=0)
        patterns = (given - mean) / np.sqrt(len(given) - 1)
        return cls(mean, FieldErrors(patterns, np.eye(len(given))[None], np.zeros_like(mean)))
