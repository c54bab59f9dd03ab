"""A registered displacement field, for points thought of later: places, spread, and whether to rely on them."""

import os
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arguments import flag, whole
from tissuereg._base.arrays import BoolArray, FloatArray, float_array
from tissuereg._base.shown import short_repr
from tissuereg.body.locate import held_by
from tissuereg.body.mesh import Mesh
from tissuereg.body.surroundings import SpaceMap
from tissuereg.errors import MarkerError
from tissuereg.imaging.transforms import Written, write_transform
from tissuereg.registration.deviations import Deviations
from tissuereg.registration.target import NO_MARKER, OUTSIDE, Region, region_of


@dataclass(frozen=True, eq=False)
class PointAnswer:
    """Registered places of points that were asked for.

    Attributes
    ----------
    reference, mean : ndarray of float64, shape (n, 3)
        Places in the undeformed body and registered places, mm.
    covariance : ndarray of float64, shape (n, 3, 3), or None
        Of the registered places, mm^2; of points outside the body that of the closest place of the skin; None if it was
        not wanted.
    inside : ndarray of bool, shape (n,)
        Whether each point is inside the undeformed body.
    flag : tuple of (str or None)
        ``"outside the body"``, ``"no marker tells"``, or None for a point on which to rely.
    tail : float or None
        Degrees of freedom of the t law of the true places; None for a Gaussian.
    """

    reference: FloatArray
    mean: FloatArray
    covariance: FloatArray | None
    inside: BoolArray
    flag: tuple[str | None, ...]
    tail: float | None = None

    __repr__ = short_repr

    def __len__(self) -> int:
        return len(self.mean)

    @property
    def std(self) -> FloatArray:
        """Root of the trace of every covariance, (n,), mm."""
        if self.covariance is None:
            message = "`std` needs the covariances: ask with covariance=True"
            raise MarkerError(message, where="covariance")
        return np.asarray(np.sqrt(np.trace(self.covariance, axis1=1, axis2=2)))

    def region(self, number: int, share: float = 0.90) -> Region:
        """Return the ellipsoid that contains the true place of a point with probability `share`.

        Raises
        ------
        MarkerError
            If there is no such point, the covariances were not wanted, or `share` is not in (0, 1).
        """
        point = whole("number", number, most=max(len(self) - 1, 0), error=MarkerError)
        if self.covariance is None:
            message = "`region` needs the covariances: ask with covariance=True"
            raise MarkerError(message, where="covariance")
        return region_of(self.mean[point], self.covariance[point], share, self.tail)


@dataclass(frozen=True, eq=False)
class RegisteredField:
    """A displacement field with its uncertainty.

    Attributes
    ----------
    mesh : Mesh
        The undeformed body.
    displacement : ndarray of float64, shape (n_nodes, 3)
        Of its nodes, mm.
    uncertainty : Deviations
        Of the displacement.
    """

    mesh: Mesh
    displacement: FloatArray
    uncertainty: Deviations

    __repr__ = short_repr

    @cached_property
    def space(self) -> SpaceMap:
        """The field in and around the body."""
        return SpaceMap(self.mesh, self.displacement)

    def at(self, points: Any, covariance: bool = True) -> PointAnswer:
        """Return where points of the undeformed body are now; see `Registration.at`."""
        places = float_array("points", points, (None, 3))
        if not np.isfinite(places).all():
            message = f"`points` must be finite, got row {int(np.argmin(np.isfinite(places).all(axis=1)))}"
            raise MarkerError(message, where="points")
        nodes, weights, inside = held = held_by(self.mesh, places)
        moved = self.space.of(places, held)[0]
        untold = self.uncertainty.untold(nodes, weights)
        flags = tuple(
            OUTSIDE if not within else NO_MARKER if no else None for within, no in zip(inside, untold, strict=True)
        )
        wanted = self.uncertainty.at(nodes, weights) if flag("covariance", covariance) else None
        return PointAnswer(places, places + moved, wanted, inside, flags, self.uncertainty.tail)

    def transform(
        self,
        path: str | os.PathLike[str],
        *,
        like: Any = None,
        spacing: Any = None,
        direction: Any = None,
        std: Any = None,
        threads: int = 0,
    ) -> Written:
        """Write the field as a grid transform; see `Registration.transform`."""
        spread = None if std is None else (std, self.uncertainty.std)
        grid = {"like": like, "spacing": spacing, "direction": direction}
        return write_transform(self.space, path, **grid, std=spread, threads=threads)


__all__ = ["PointAnswer", "RegisteredField"]
