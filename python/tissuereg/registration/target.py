"""A registered inner point, and the region in which its true place lies with a given probability."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arguments import real, text
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg._base.shown import short_repr
from tissuereg.errors import MarkerError
from tissuereg.registration.learned.spread_law import squared_radius

#: Flag of a target of which the markers say too little.
NO_MARKER = "no marker tells"

#: Flag of a point that is not in the body.
OUTSIDE = "outside the body"


@dataclass(frozen=True, eq=False)
class Region:
    """Ellipsoid that contains a point with a given probability.

    Attributes
    ----------
    centre : ndarray of float64, shape (3,)
        Centre of the ellipsoid, mm.
    axes : ndarray of float64, shape (3, 3)
        Unit half-axes, one per row, in the order of `radii`.
    radii : ndarray of float64, shape (3,)
        Half-axes in mm, largest last.
    share : float
        Probability that the point lies inside, 0 to 1.
    """

    centre: FloatArray
    axes: FloatArray
    radii: FloatArray
    share: float

    __repr__ = short_repr

    def contains(self, point: Any) -> bool:
        """Return whether a point (3,), in mm, lies inside the ellipsoid or on its border."""
        along = self.axes @ (float_array("point", point, (3,)) - self.centre)
        return bool(np.sum((along / np.maximum(self.radii, 1e-300)) ** 2) <= 1.0)


def region_of(mean: FloatArray, covariance: FloatArray, share: float, tail: float | None) -> Region:
    """Return the ellipsoid that holds a point with probability `share`, by its mean (3,), covariance (3, 3) and tail.

    Raises `MarkerError` unless `share` is in (0, 1).
    """
    if not 0.0 < real("share", share, error=MarkerError) < 1.0:
        message = f"`share` must lie in (0, 1), got {share}"
        raise MarkerError(message, where="share")
    values, vectors = np.linalg.eigh(covariance)
    radii = np.sqrt(np.maximum(values, 0.0) * squared_radius(share, tail))
    return Region(mean, vectors.T, radii, share)


@dataclass(frozen=True, eq=False)
class Target:
    """An inner point after registration.

    Attributes
    ----------
    reference : ndarray of float64, shape (3,)
        Place in the undeformed body, mm.
    mean : ndarray of float64, shape (3,)
        Registered place, mm.
    covariance : ndarray of float64, shape (3, 3)
        Covariance of the place, mm^2, from the posterior and the model's own error. Where `tail` is not None, it is
        that of the Gaussian that has the same 90 % region as the t law.
    simulation : ndarray of float64, shape (3,), or None
        Place by the simulation alone, mm; None if there was no simulation.
    constrained : float or None
        Share of the point's variance under unknown contacts that the markers remove, 0 to 1. With a trained model the
        share of the expected squared error of the simulation (or of the undeformed body) that is removed. None for a
        marker that was not used.
    flag : str or None
        ``"no marker tells"`` if that share is too small to rely on the region, or on the registered place being better
        than the simulated one; otherwise None.
    tail : float or None
        Degrees of freedom of the t law of the true place about the mean, of a calibrated model; None for a Gaussian.
    """

    reference: FloatArray
    mean: FloatArray
    covariance: FloatArray
    simulation: FloatArray | None
    constrained: float | None = None
    flag: str | None = None
    tail: float | None = None

    __repr__ = short_repr

    def region(self, share: float = 0.90) -> Region:
        """Return the ellipsoid that contains the true place with probability `share`.

        Parameters
        ----------
        share : float
            Probability that the true place lies inside, in (0, 1).

        Returns
        -------
        Region
            The ellipsoid, with its centre and half-axes in mm, the largest last.
        """
        return region_of(self.mean, self.covariance, share, self.tail)

    def to_json(self) -> dict[str, Any]:
        """Return the target's entry in ``registration.json``: plain numbers, lists and strings; mm, mm^2."""
        return {
            "reference_mm": self.reference.tolist(),
            "mean_mm": self.mean.tolist(),
            "covariance_mm2": self.covariance.tolist(),
            "region90_radii_mm": self.region(0.90).radii.tolist(),
            "simulation_mm": None if self.simulation is None else self.simulation.tolist(),
            "constrained": self.constrained,
            "flag": self.flag,
            "tail_degrees_of_freedom": self.tail,
        }


def target_named(targets: Mapping[str, Target], name: str) -> Target:
    """Return the registered inner point of this name; raise `MarkerError` if there is none."""
    if text("name", name, error=MarkerError) not in targets:
        message = f"no target named '{name}' was registered; there are: {', '.join(targets) or 'none'}"
        raise MarkerError(message, where=name)
    return targets[name]


__all__ = ["NO_MARKER", "OUTSIDE", "Region", "Target", "region_of", "target_named"]
