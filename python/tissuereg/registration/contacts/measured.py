"""The data of a registration, in the form that the fit uses: markers, points of the surface, or both.

Either has one method, `read`: it returns, at a deformed body, the sensitivity rows of the observations, their residuals
and their standard deviations. The fit uses nothing else.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.markers import Markers
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.contacts.settings import MATCHING
from tissuereg.registration.contacts.state import BodyState, RigidMotion
from tissuereg.registration.contacts.unexplained import Rows


@dataclass(frozen=True, eq=False)
class Observations:
    """Observations at one deformed body, each a weighted sum of nodal displacements measured along one direction.

    `make`: function without arguments that returns `rows`; `places` (n_obs, 3): predicted position of the observed
    point, in the body's frame, mm; `directions` (n_obs, 3): unit vector along which it is measured, in the body's
    frame; `residual` (n_obs,): measured minus predicted, mm; `std` (n_obs,): standard deviation, enlarged by a heavy
    tail for large residuals, mm; `cost` (n_obs,): minus twice the logarithm of each observation's likelihood, up to a
    constant: 1 for residuals of pure noise; `groups`: for each marker the observations that may be wrong together;
    empty if outliers get a small weight instead.
    """

    make: Callable[[], Rows]
    places: FloatArray
    directions: FloatArray
    residual: FloatArray
    std: FloatArray
    cost: FloatArray
    groups: list[list[int]]

    @cached_property
    def rows(self) -> Rows:
        """Nodes int64 (k,) of each observation, and the dimensionless weights (k, 3) of their displacement."""
        return self.make()

    def followed_by(self, other: "Observations") -> "Observations":
        """Return these observations followed by those of `other`, at the same body."""

        def joined(mine: FloatArray, theirs: FloatArray) -> FloatArray:
            return np.concatenate([mine, theirs])

        return Observations(
            lambda: [*self.rows, *other.rows],
            joined(self.places, other.places),
            joined(self.directions, other.directions),
            joined(self.residual, other.residual),
            joined(self.std, other.std),
            joined(self.cost, other.cost),
            [*self.groups, *([i + len(self.residual) for i in group] for group in other.groups)],
        )


class DataPart(Protocol):
    """Interface of a part of the data, which is either the markers or the unlabelled points of the surface."""

    @property
    def n_obs(self) -> int:
        """Number of observations: measured coordinates of markers, or points of the surface."""

    def read(self, state: BodyState, *, weighed: bool, moved: FloatArray | None = None) -> Observations:
        """Return the observations at a deformed body, with residuals and standard deviations in mm.

        `state`: the body; `weighed`: whether outliers get a small weight, instead of a group of observations that the
        sampler may take for wrong; `moved` (n_nodes, 3): displacement at which they are linearised, mm; by default that
        of the body.
        """

    def coarser(self, width: float) -> "DataPart":
        """Return the same data with fewer observations, for the first passes (rounds of the fit).

        `width`: distance within which errors of matching points to the surface are correlated, as a share of the
        extent.
        """

    def outliers(self, state: BodyState) -> float:
        """Return the share of surface points, 0 to 1, too far from the body `state` to belong to it; 0 for markers."""


def _turned(rows: Rows, rotation: FloatArray) -> Rows:
    """Return rows for displacements along the tracker's axes, given those for displacements along the body's.

    `rows`: nodes (k,) and weights (k, 3) of x, y and z of each marker in turn; `rotation` (3, 3): from the body's frame
    to the tracker's.
    """
    if np.array_equal(rotation, np.eye(3)):
        return rows
    found = []
    for first in range(0, len(rows), 3):
        nodes, weights = rows[first][0], np.stack([weights for _, weights in rows[first : first + 3]])
        found += [(nodes, np.tensordot(axis, weights, 1)) for axis in rotation]
    return found


@dataclass(frozen=True, eq=False)
class MarkerData:
    """The markers as data of a registration.

    `observation`: map from the displacement of nodes to that of the markers; `markers`: reference and measured places,
    mm; `model_error`: standard deviation of the model's error at a marker, over the marker's motion; `rough`: whether
    unlabelled points are still far from the surface: markers then have no heavy tail, and lead.
    """

    observation: MarkerObservation
    markers: Markers
    model_error: float
    rough: bool = False

    @property
    def n_obs(self) -> int:
        """Number of measured coordinates of markers."""
        return len(self.rows)

    @cached_property
    def mask(self) -> BoolArray:
        """Whether each coordinate of each marker was measured, bool, shape (n_markers, 3)."""
        return np.asarray(np.isfinite(self.markers.measured))

    @cached_property
    def rows(self) -> IntArray:
        """Numbers of the measured coordinates, int64 (n_obs,): 3 m + i for axis i of marker m."""
        return np.flatnonzero(self.mask.ravel())

    @cached_property
    def groups(self) -> list[list[int]]:
        """For each marker that was seen, in order, the positions in `rows` of its measured coordinates."""
        owner = self.rows // 3
        return [np.flatnonzero(owner == marker).tolist() for marker in np.unique(owner)]

    def moved(self, frame: RigidMotion) -> FloatArray:
        """Return the length of each marker's motion in addition to a rigid one, (n_markers,), in mm.

        `frame`: the rigid motion. Coordinates that were not measured count as not moved.
        """
        places = frame.apply(self.markers.reference)
        return np.asarray(np.linalg.norm(np.where(self.mask, self.markers.measured - places, 0.0), axis=1))

    def motion(self, frame: RigidMotion) -> FloatArray:
        """Return the motion of each marker that was seen beside the rigid motion `frame`, at least its noise, in mm."""
        return np.asarray(np.maximum(self.moved(frame), self.markers.std)[self.mask.any(axis=1)])

    def std(self, frame: RigidMotion) -> FloatArray:
        """Return the standard deviation of each measured coordinate, (n_obs,), mm: tracker and model together.

        `frame`: rigid motion of the body; the model's error is in proportion to the motion beside it.
        """
        both = np.hypot(self.markers.axis_std, self.model_error * self.moved(frame)[:, None])
        return np.asarray(both.ravel()[self.rows])

    def read(self, state: BodyState, *, weighed: bool, moved: FloatArray | None = None) -> Observations:
        """Return the measured coordinates of markers as observations, mm, at a deformed body `state`.

        `weighed`: whether an outlier gets a small weight, by heavy-tailed noise, or may be taken for wrong by the
        sampler; `moved`: as in `DataPart.read`.
        """
        observation, reference = self.observation, self.markers.reference
        here = state.moved[observation.nodes]
        places = reference + observation.predict(here)
        residual = (self.markers.measured - state.frame.apply(places)).ravel()[self.rows]
        std = self.std(state.frame)
        scaled = (residual / std) ** 2
        cost = scaled
        if weighed and not self.rough:
            std, cost = std.copy(), cost.copy()
            for group in self.groups:
                std[group] *= np.sqrt(tail_variance(scaled[group].sum(), len(group)))
                cost[group] = tail_cost(scaled[group].sum(), len(group)) / len(group)

        def rows() -> Rows:
            own = observation.rows(here) if moved is None else observation.rows_of(moved)
            every = _turned(own, state.frame.rotation)
            return [every[row] for row in self.rows]

        return Observations(
            rows,
            np.repeat(places, 3, axis=0)[self.rows],
            np.tile(state.frame.rotation, (len(reference), 1))[self.rows],
            residual,
            std,
            cost,
            [] if weighed else self.groups,
        )

    def wrong(self, state: BodyState, log_odds: float, wrong_std: float) -> FloatArray:
        """Return the probability of each marker that was seen to be wrong, given a body, shape (n_seen,).

        `state`: the deformed body; `log_odds`: logarithm of the prior odds that a marker is wrong; `wrong_std`:
        additional standard deviation of a wrong marker, mm.
        """
        residual = self.read(state, weighed=False).residual
        narrow = self.std(state.frame)
        wide = np.hypot(narrow, wrong_std)
        gain = 0.5 * residual**2 * (1.0 / narrow**2 - 1.0 / wide**2) - np.log(wide / narrow)
        logs = log_odds + np.array([gain[group].sum() for group in self.groups])
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(logs, -700.0, 700.0))))

    def outliers(self, state: BodyState) -> float:
        """Return zero: a wrong marker is found by its own probability to be wrong, and is not counted as an outlier."""
        del state
        return 0.0

    def coarser(self, width: float) -> "MarkerData":
        """Return the markers for the first rounds of the fit: all of them, since labels bring the body close."""
        del width
        return replace(self, rough=True)


@dataclass(frozen=True, eq=False)
class ObservedData:
    """All data of one registration: the markers, and points of the surface if there are any.

    `parts`: markers first; `weighed`: whether wrong markers get a small weight instead of an indicator that the sampler
    sets; many observations are then projected onto few; `rough`: whether these are the reduced data of first passes
    (rounds of the fit); `n_markers`: number of the markers given, also where none was measured.
    """

    parts: tuple[DataPart, ...]
    weighed: bool
    rough: bool = False
    n_markers: int = 0

    @classmethod
    def of(cls, *parts: DataPart | None) -> "ObservedData":
        """Return the data made of those parts that are not None and have observations.

        They are weighed, and projected onto few, if there are more than `MATCHING.most_plain` of them.
        """
        kept = tuple(part for part in parts if part is not None and part.n_obs)
        n_markers = sum(len(part.markers) for part in parts if isinstance(part, MarkerData))
        return cls(kept, sum(part.n_obs for part in kept) > MATCHING.most_plain, n_markers=n_markers)

    @property
    def markers(self) -> MarkerData | None:
        """The markers as data; None if no marker was measured."""
        return next((part for part in self.parts if isinstance(part, MarkerData)), None)

    @property
    def n_obs(self) -> int:
        """Number of observations: measured coordinates of markers, plus points of the surface."""
        return sum(part.n_obs for part in self.parts)

    @property
    def rematches(self) -> bool:
        """Whether there are points without labels, which are matched to the surface anew in every round of the fit."""
        return any(not isinstance(part, MarkerData) for part in self.parts)

    def read(self, state: BodyState, moved: FloatArray | None = None) -> Observations:
        """Return all observations at a deformed body, those of the markers first, in mm; `moved` as in `DataPart`."""
        first, *others = (part.read(state, weighed=self.weighed, moved=moved) for part in self.parts)
        for other in others:
            first = first.followed_by(other)
        return first

    def outliers(self, state: BodyState) -> float:
        """Return the share of surface points, 0 to 1, too far from the body `state` to belong to it; 0 for markers."""
        return max(part.outliers(state) for part in self.parts)

    def coarser(self, width: float) -> "ObservedData":
        """Return the same data with fewer points of the surface and equal noise, for first rounds of the fit.

        `width`: distance within which errors of matching points to the surface are correlated, as a share of the
        extent.
        """
        return replace(self, parts=tuple(part.coarser(width) for part in self.parts), rough=True)


def tail_variance(squares: FloatArray | float, count: int) -> FloatArray:
    """Return the factor by which heavy-tailed noise (a Student law) enlarges the variance of `count` observations.

    `squares`: squared length of their residuals in standard deviations, a number or an array. Result: dimensionless, of
    the same shape; below one for small residuals.
    """
    return np.asarray((MATCHING.tail + squares) / (MATCHING.tail + count), np.float64)


def tail_cost(squares: FloatArray | float, count: int) -> FloatArray:
    """Return minus twice the logarithm of Student's density of `count` residuals, up to a constant.

    `squares`: their squared length in standard deviations, a number or an array. Result: of the same shape, about
    `count` for noise alone.
    """
    return np.asarray((MATCHING.tail + count) * np.log1p(np.asarray(squares) / MATCHING.tail), np.float64)
