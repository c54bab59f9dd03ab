r"""Choice of places for further markers: the surface points whose measurement most reduces the targets' variance.

An ensemble of displacement fields represents the prior. With the anomalies X of the targets and Y of the candidate
places (displacement minus the mean of the ensemble, over the square root of the number of members less one), and noise
of variance s^2 in each measured coordinate, measuring a set of candidates leaves the targets the posterior covariance

    X X' - X Y' (Y Y' + s^2 I)^-1 Y X',

which does not depend on the measured values, as far as the fields are Gaussian. The greedy choice takes, one after
another, the candidate that lowers the trace of this covariance most; the chosen marker's three coordinates are then
conditioned on, each by a rank-one downdate.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arguments import named, of_kind, real, whole
from tissuereg._base.arrays import FloatArray, IntArray, float_array, optional_array
from tissuereg._base.shown import short_repr
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.errors import ArgumentError, EnsembleError, MarkerError, ShapeError

#: More markers than this are not chosen.
_MOST = 1000

#: Noise is below this; `Markers` knows no larger one.
_MOST_STD_MM = 1e9


@dataclass(frozen=True, eq=False)
class MarkerAdvice:
    """Recommended places for markers, in the order of choice: the first one reduces the error at the targets most.

    Attributes
    ----------
    chosen : ndarray of int64, shape (n,)
        Row numbers of the chosen places in the array of candidates, in the order of choice.
    places_mm : ndarray of float64, shape (n, 3)
        The chosen places on or near the undeformed surface, in mm.
    targets : tuple of str
        Names of the targets (inner points of the body), in the order of the columns of `expected_mm`.
    expected_mm : ndarray of float64, shape (n + 1, n_targets)
        Expected error of every target in mm, the root of the trace of its covariance. Row k is after the first k chosen
        markers were measured; row 0 takes only the markers that were placed already.
    """

    chosen: IntArray
    places_mm: FloatArray
    targets: tuple[str, ...]
    expected_mm: FloatArray

    __repr__ = short_repr

    def to_json(self) -> dict[str, Any]:
        """Return the advice as a dict of plain numbers, strings and lists, for JSON; lengths are in mm.

        The keys are ``chosen``, ``places`` (coordinates of each place, and the root mean square over the targets of the
        expected errors after it) and ``expected_mm`` (expected errors by target).
        """
        rows = zip(self.targets, self.expected_mm.T, strict=True)
        left = np.sqrt((self.expected_mm[1:] ** 2).mean(axis=1))
        return {
            "chosen": self.chosen.tolist(),
            "places": [
                {**dict(zip(("x_mm", "y_mm", "z_mm"), map(float, place), strict=True)), "expected_std_mm": float(std)}
                for place, std in zip(self.places_mm, left, strict=True)
            ],
            "expected_mm": {name: errors.tolist() for name, errors in rows},
        }


def advise_markers(
    mesh: Mesh,
    fields_mm: Any,
    targets: Mapping[str, Any],
    n: int = 15,
    *,
    candidates_mm: Any = None,
    placed_mm: Any = None,
    std: float = 0.1,
    apart_mm: float = 0.0,
) -> MarkerAdvice:
    """Choose places for markers that shrink the expected error at inner targets most.

    Parameters
    ----------
    mesh : Mesh
        Undeformed body.
    fields_mm : array_like of float, shape (n_members, n_nodes, 3)
        Displacement fields in mm that represent the prior: members of a data set, draws of a model.
    targets : mapping of str to array_like of float, shape (3,)
        Inner points of the undeformed body, mm, by name; the sum of their variances is minimised.
    n : int
        Number of markers to choose.
    candidates_mm : array_like of float, shape (n_candidates, 3), optional
        Places where a marker may sit, on, near or inside the undeformed body, mm; by default every surface node outside
        the node set ``fixed``.
    placed_mm : array_like of float, shape (n_placed, 3), optional
        Places of markers that are attached already, mm; they are taken as measured.
    std : float
        Standard deviation of a measured coordinate, mm.
    apart_mm : float
        Least distance between markers, mm.

    Returns
    -------
    MarkerAdvice
        The chosen places, and the expected error of every target after each of them. Cost: a pick takes a multiply-add
        for each coordinate of a candidate, each member and each of three rank-one downdates; memory is that of the
        candidates' displacements.

    Raises
    ------
    ShapeError
        If an array has another shape, or a field is not finite.
    EnsembleError
        If the fields are not more than the coordinates to be measured plus one: any target would then seem to be known.
    MarkerError
        If there is no target, a place lies far from the body, or fewer than `n` candidates lie far enough apart.
    ArgumentError, MeshError
        If another argument is not usable.

    Notes
    -----
    Greedy placement by the posterior variance: A. Krause, A. Singh, C. Guestrin, "Near-optimal sensor placements in
    Gaussian processes", Journal of Machine Learning Research 9, 235-284, 2008, with the targets' variance as the aim.

    Examples
    --------
    >>> import numpy as np
    >>> import tissuereg as tr
    >>> mesh = tr.phantom.phantom_mesh("small")
    >>> height = mesh.nodes[:, 2:] / 50.0
    >>> fields = [height * push for push in np.random.default_rng(0).normal(size=(20, 3))]
    >>> advice = tr.advise_markers(mesh, fields, {"deep": (0.0, 0.0, 25.0)}, n=1)
    >>> bool(advice.expected_mm[1, 0] < 0.2 * advice.expected_mm[0, 0])
    True
    """
    of_kind("mesh", mesh, Mesh)
    fields = float_array("fields_mm", fields_mm, (None, mesh.n_nodes, 3))
    if not np.isfinite(fields).all():
        wrong = int(np.argmin(np.isfinite(fields).all(axis=(1, 2))))
        message = f"`fields_mm` must be finite; member {wrong} is not"
        raise ShapeError(message, where="fields_mm")
    inner = TargetObservation(mesh, named("targets", targets))
    if not inner.names:
        message = "`targets` must name at least one point, got none"
        raise MarkerError(message, where="targets")
    n = whole("n", n, least=1, most=_MOST)
    noise = real("std", std, above=0.0, below=_MOST_STD_MM, unit="mm")
    apart = real("apart_mm", apart_mm, least=0.0, unit="mm")
    candidates = _candidates(mesh, candidates_mm)
    placed = optional_array("placed_mm", placed_mm, (None, 3))
    placed = np.empty((0, 3)) if placed is None else placed
    _check_members(len(fields), n + len(placed))
    places = np.concatenate([candidates, placed])
    state = _ConditionedTargets(
        _anomalies(_at_markers(mesh, fields, places)), _anomalies(inner.predict(fields[:, inner.nodes])), noise**2
    )
    for marker in range(len(candidates), len(places)):
        state.measure(marker)
    allowed = np.ones(len(places), dtype=bool)
    allowed[len(candidates) :] = False
    for place in placed:
        allowed &= np.linalg.norm(places - place, axis=1) >= apart
    chosen, expected = [], [state.expected_mm]
    for count in range(n):
        if not allowed.any():
            message = f"{n} markers must find candidates {apart:g} mm apart, only {count} did"
            raise MarkerError(message, where="apart_mm")
        best = int(np.argmax(np.where(allowed, state.gains(), -np.inf)))
        state.measure(best)
        chosen.append(best)
        expected.append(state.expected_mm)
        allowed[best] = False
        allowed &= np.linalg.norm(places - places[best], axis=1) >= apart
    return MarkerAdvice(np.array(chosen), candidates[chosen], inner.names, np.array(expected))


class _ConditionedTargets:
    """Covariances of targets and candidate places, conditioned on one measured marker after another.

    `seen` (n_members, n_places, 3): anomalies of the displacement of the places, mm (deviation from the mean of the
    ensemble, over the square root of the number of members less one); `wanted` (n_members, n_targets, 3): those of the
    targets, mm; `variance`: of the noise in each measured coordinate, mm^2.
    """

    def __init__(self, seen: FloatArray, wanted: FloatArray, variance: float) -> None:
        self._n_places = seen.shape[1]
        self._rows = np.ascontiguousarray(seen.reshape(len(seen), -1).T)
        self._variance = variance
        targets = wanted.reshape(len(wanted), -1).T
        #: Variances of the targets' coordinates, their covariances with the places', and those within each place.
        self._wanted = (targets**2).sum(axis=1)
        self._cross = targets @ self._rows.T
        places = self._rows.reshape(self._n_places, 3, -1)
        self._own = np.einsum("pim,pjm->pij", places, places)
        self._downdates: list[FloatArray] = []

    @property
    def expected_mm(self) -> FloatArray:
        """Expected error of each target, (n_targets,), in mm: root of the trace of its present covariance."""
        return np.asarray(np.sqrt(np.maximum(self._wanted, 0.0).reshape(-1, 3).sum(axis=1)))

    def gains(self) -> FloatArray:
        """Return the decrease of the targets' summed variance by a marker at each place, (n_places,), in mm^2."""
        cross = self._cross.T.reshape(self._n_places, 3, -1)
        solved = np.linalg.solve(self._own + self._variance * np.eye(3), cross)
        return np.asarray((cross * solved).sum(axis=(1, 2)))

    def measure(self, place: int) -> None:
        """Update all covariances for a measurement of the three coordinates of a marker at the place number `place`."""
        for row in range(3 * place, 3 * place + 3):
            covariance = self._rows @ self._rows[row]
            for known in self._downdates:
                covariance -= known[row] * known
            scaled = covariance / np.sqrt(self._variance + covariance[row])
            towards = self._cross[:, row] / np.sqrt(self._variance + covariance[row])
            self._cross -= np.outer(towards, scaled)
            self._wanted -= towards**2
            by_place = scaled.reshape(-1, 3)
            self._own -= by_place[:, :, None] * by_place[:, None, :]
            self._downdates.append(scaled)


def _anomalies(moved: FloatArray) -> FloatArray:
    return np.asarray((moved - moved.mean(axis=0)) / np.sqrt(len(moved) - 1))


def _at_markers(mesh: Mesh, fields: FloatArray, places: FloatArray) -> FloatArray:
    observed = MarkerObservation(mesh, places, tuple(f"place {k}" for k in range(len(places))))
    return observed.predict(fields[:, observed.nodes])


def _candidates(mesh: Mesh, given: Any) -> FloatArray:
    if given is None:
        return mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.node_sets.get("fixed", np.empty(0, np.int64)))]
    candidates = float_array("candidates_mm", given, (None, 3))
    if not len(candidates):
        message = "`candidates_mm` must hold at least one place, got none"
        raise ArgumentError(message, where="candidates_mm")
    return candidates


def _check_members(n_members: int, n_markers: int) -> None:
    if n_members <= 3 * n_markers + 1:
        message = (
            f"`fields_mm` must have more than {3 * n_markers + 1} members for {n_markers} markers, got {n_members}: "
            "any target would seem to be known"
        )
        raise EnsembleError(message, where="fields_mm")
