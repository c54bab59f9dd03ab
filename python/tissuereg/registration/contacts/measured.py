"""The data of a registration, in the form that the passes use: markers, points of the surface, or both.

Each kind of data has one method, `read`: it returns, at a deformed body, the sensitivity rows of the observations,
their residuals and their standard deviations. The passes use nothing else.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.markers import Markers
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.contacts.settings import MATCHING
from tissuereg.registration.contacts.state import BodyState, RigidMotion


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations at one deformed body.

    Attributes
    ----------
    rows : list of (ndarray of int64 (k,), ndarray of float64 (k, 3))
        Nodes and weights of each observation.
    places : ndarray of float64, shape (n_obs, 3)
        Position of each, in the body's frame, mm.
    directions : ndarray of float64, shape (n_obs, 3)
        Unit vector along which it is measured.
    residual : ndarray of float64, shape (n_obs,)
        Measured minus predicted, mm.
    std : ndarray of float64, shape (n_obs,)
        Standard deviation, enlarged by a heavy tail for large residuals, mm.
    cost : ndarray of float64, shape (n_obs,)
        Minus twice the logarithm of each observation's likelihood, up to a constant: 1 for residuals of pure noise.
    groups : list of list of int
        Observations that may be wrong together, one group per marker; empty if weights replace indicators.
    """

    rows: list[tuple[IntArray, FloatArray]]
    places: FloatArray
    directions: FloatArray
    residual: FloatArray
    std: FloatArray
    cost: FloatArray
    groups: list[list[int]]

    def followed_by(self, other: "Observations") -> "Observations":
        """Return these observations followed by others."""

        def joined(mine: FloatArray, theirs: FloatArray) -> FloatArray:
            return np.concatenate([mine, theirs])

        return Observations(
            [*self.rows, *other.rows],
            joined(self.places, other.places),
            joined(self.directions, other.directions),
            joined(self.residual, other.residual),
            joined(self.std, other.std),
            joined(self.cost, other.cost),
            [*self.groups, *([i + len(self.residual) for i in group] for group in other.groups)],
        )


class DataPart(Protocol):
    """One kind of data, markers or points of the surface: what every kind can be asked for."""

    @property
    def n_obs(self) -> int:
        """Number of observations."""

    def read(self, state: BodyState, *, weighed: bool) -> Observations:
        """Return the observations at a deformed body.

        `weighed`: whether outliers get a small weight, instead of a group that the sampler may take for wrong.
        """

    def coarser(self, width: float) -> "DataPart":
        """Return the same data with fewer observations, for first passes.

        `width`: distance within which errors of matching are correlated, over the extent.
        """

    def outliers(self, state: BodyState) -> float:
        """Return the share of the observations without labels that lie too far from a body to belong to it."""


def _turned(rows: list[tuple[IntArray, FloatArray]], rotation: FloatArray) -> list[tuple[IntArray, FloatArray]]:
    """Return rows of nodes and weights for displacements along the tracker's axes, given those of the body."""
    if np.array_equal(rotation, np.eye(3)):
        return rows
    found = []
    for first in range(0, len(rows), 3):
        nodes, weights = rows[first][0], np.stack([weights for _, weights in rows[first : first + 3]])
        found += [(nodes, np.tensordot(axis, weights, 1)) for axis in rotation]
    return found


@dataclass(frozen=True, eq=False)
class MarkerData:
    """The markers as data.

    `observation`: attachment of the markers to the mesh; `model_error`: standard deviation of the model's error at a
    marker, over the marker's motion; `rough`: whether unlabelled points are still far from the surface: markers then
    have no heavy tail, and lead.
    """

    observation: MarkerObservation
    markers: Markers
    model_error: float
    rough: bool = False

    @property
    def n_obs(self) -> int:
        """Number of components seen."""
        return len(self.rows)

    @cached_property
    def mask(self) -> BoolArray:
        """Components that were seen, shape (n_markers, 3)."""
        return np.asarray(np.isfinite(self.markers.measured))

    @cached_property
    def rows(self) -> IntArray:
        """Indices of the components seen among all, shape (n_obs,)."""
        return np.flatnonzero(self.mask.ravel())

    @property
    def groups(self) -> list[list[int]]:
        """Indices among `rows` of each marker that was seen."""
        owner = self.rows // 3
        return [np.flatnonzero(owner == marker).tolist() for marker in np.unique(owner)]

    def moved(self, frame: RigidMotion) -> FloatArray:
        """Return each marker's motion relative to a rigid motion, (n_markers,) in mm; unseen components are zero."""
        places = frame.apply(self.markers.reference)
        return np.asarray(np.linalg.norm(np.where(self.mask, self.markers.measured - places, 0.0), axis=1))

    def std(self, frame: RigidMotion) -> FloatArray:
        """Return the standard deviation (n_obs,), mm, of each component seen: tracker's and model's."""
        both = np.hypot(self.markers.axis_std, self.model_error * self.moved(frame)[:, None])
        return np.asarray(both.ravel()[self.rows])

    def read(self, state: BodyState, *, weighed: bool) -> Observations:
        """Return the components seen; `weighed` gives each marker a heavy tail instead of an indicator."""
        observation, reference = self.observation, self.markers.reference
        here = state.displacement[observation.nodes]
        places = reference + observation.predict(here)
        residual = (self.markers.measured - state.frame.apply(places)).ravel()[self.rows]
        all_rows = _turned(observation.rows(here), state.frame.rotation)
        std = self.std(state.frame)
        scaled = (residual / std) ** 2
        cost = scaled
        if weighed and not self.rough:
            std, cost = std.copy(), cost.copy()
            for group in self.groups:
                std[group] *= np.sqrt(tail_variance(scaled[group].sum(), len(group)))
                cost[group] = tail_cost(scaled[group].sum(), len(group)) / len(group)
        return Observations(
            [all_rows[row] for row in self.rows],
            np.repeat(places, 3, axis=0)[self.rows],
            np.tile(state.frame.rotation, (len(reference), 1))[self.rows],
            residual,
            std,
            cost,
            [] if weighed else self.groups,
        )

    def wrong(self, state: BodyState, log_odds: float, wrong_std: float) -> FloatArray:
        """Return the probability of each marker that was seen to be wrong, given a body, shape (n_seen,).

        `state`: the deformed body; `log_odds`: logarithm of the odds that a marker is wrong; `wrong_std`: additional
        standard deviation of a wrong marker, mm.
        """
        residual = self.read(state, weighed=False).residual
        narrow = self.std(state.frame)
        wide = np.hypot(narrow, wrong_std)
        gain = 0.5 * residual**2 * (1.0 / narrow**2 - 1.0 / wide**2) - np.log(wide / narrow)
        logs = log_odds + np.array([gain[group].sum() for group in self.groups])
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logs, -700.0, 700.0))))

    def outliers(self, state: BodyState) -> float:
        """Return zero: a wrong marker is found by its label, not counted among outliers."""
        del state
        return 0.0

    def coarser(self, width: float) -> "MarkerData":
        """Return the markers as data of first passes: all of them, because their labels bring the body close."""
        del width
        return replace(self, rough=True)


@dataclass(frozen=True, eq=False)
class ObservedData:
    """All data of one registration: the markers, and points of the surface if there are any.

    `parts`: markers first; `weighed`: whether wrong markers get a small weight instead of an indicator of the sampler;
    data are then projected; `rough`: whether these are the reduced data of first passes.
    """

    parts: tuple[DataPart, ...]
    weighed: bool
    rough: bool = False

    @classmethod
    def of(cls, *parts: DataPart | None) -> "ObservedData":
        """Return the data of the parts that have observations."""
        kept = tuple(part for part in parts if part is not None and part.n_obs)
        return cls(kept, sum(part.n_obs for part in kept) > MATCHING.most_plain)

    @property
    def markers(self) -> MarkerData | None:
        """The markers, if there are any."""
        return next((part for part in self.parts if isinstance(part, MarkerData)), None)

    @property
    def n_obs(self) -> int:
        """Number of observations."""
        return sum(part.n_obs for part in self.parts)

    @property
    def rematches(self) -> bool:
        """Whether some observations have no label, so that passes match them anew."""
        return any(not isinstance(part, MarkerData) for part in self.parts)

    def read(self, state: BodyState) -> Observations:
        """Return all observations at a deformed body."""
        first, *others = (part.read(state, weighed=self.weighed) for part in self.parts)
        for other in others:
            first = first.followed_by(other)
        return first

    def outliers(self, state: BodyState) -> float:
        """Return the largest share of observations without labels that a body does not explain."""
        return max(part.outliers(state) for part in self.parts)

    def coarser(self, width: float) -> "ObservedData":
        """Return the same data with fewer points, spaced by a share `width` of the extent, and equal noise."""
        return ObservedData(tuple(part.coarser(width) for part in self.parts), self.weighed, rough=True)


def tail_variance(squares: FloatArray | float, count: int) -> FloatArray:
    """Return the factor on the variance of `count` observations that a Student tail gives for residuals.

    `squares`: their squared length in standard deviations.
    """
    return np.asarray((MATCHING.tail + squares) / (MATCHING.tail + count), np.float64)


def tail_cost(squares: FloatArray | float, count: int) -> FloatArray:
    """Return minus twice the logarithm of Student's density of squared residuals, up to a constant.

    `squares`: squared length of the residuals of `count` observations, in standard deviations. About `count` for noise
    alone.
    """
    return np.asarray((MATCHING.tail + count) * np.log1p(np.asarray(squares) / MATCHING.tail), np.float64)
