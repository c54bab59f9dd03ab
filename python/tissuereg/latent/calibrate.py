"""Makes the calibration of a trained model: from fields of its training set, fields it never saw, and pairs.

The scales of events and the chances of honest measurements come from rehearsals: events that the model never saw are registered from random
markers, as a user's will be.
"""

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from tissuereg._arrays import FloatArray, IntArray
from tissuereg.latent.calibration import (
    LEAST_SIZE_MM,
    Calibration,
    Change,
    FieldErrors,
    PointCalibration,
    Rehearsal,
    RowsOf,
)
from tissuereg.latent.kinds import Kinds, probabilities
from tissuereg.latent.mixture import Component, condition, log_evidence
from tissuereg.latent.model import LatentModel, rms_displacement
from tissuereg.latent.relinearise import conditioned, linearised, spread_of
from tissuereg.mesh import Mesh

#: Scales of events of one kind: their standard deviations over those of the kind.
_SCALES = np.array([0.2, 0.4, 0.7, 1.2, 2.0, 3.5])

#: Scales of the difference between truth and simulation.
_CHANGE_SCALES = np.array([0.25, 0.5, 1.0, 2.0, 4.0])

#: Patterns of errors kept, and of errors of changes.
_PATTERNS, _CHANGE_PATTERNS = 80, 40

#: Errors by which those of a kind are mixed with those of all.
_BORROWED = 20.0

#: Linearisations of a rehearsal, which starts from the mean of all codes.
_PASSES = 6

#: Fields coded at once.
_BATCH = 50


class Codes(LatentModel, Protocol):
    """A latent model with an encoder."""

    def codes(self, fields: FloatArray) -> FloatArray:
        """Return the encoder's means (n_fields, n_latent) of fields (n_fields, n_nodes, 3) in mm."""
        ...


@dataclass(frozen=True)
class RehearsalSettings:
    """How events are rehearsed.

    Parameters
    ----------
    n_markers, n_targets : int
        Random places on the free surface and inside.
    std : float
        Noise of the tracker, mm.
    n_events : int
        Events at most.
    seed : int
        Of places and noise.
    """

    n_markers: int = 15
    n_targets: int = 20
    std: float = 0.1
    n_events: int = 400
    seed: int = 0


def calibrate(
    model: Codes,
    mesh: Mesh,
    codes: FloatArray,
    unseen: FloatArray,
    pairs: tuple[FloatArray, FloatArray] | None = None,
    *,
    n_kinds: int = 10,
    settings: RehearsalSettings | None = None,
) -> Calibration:
    """Return the calibration of a model.

    Parameters
    ----------
    model : Codes
        Encoder and decoder.
    mesh : Mesh
        Its mesh.
    codes : ndarray of float64, shape (n_codes, n_latent)
        Encoder's means of fields of the training set.
    unseen : ndarray of float, shape (n_fields, n_nodes, 3)
        Fields that were not used in training, mm.
    pairs : (ndarray, ndarray), each of shape (n_pairs, n_nodes, 3), optional
        Simulations and truths of the same events, mm.
    n_kinds : int
        Kinds of events to start from.
    settings : RehearsalSettings, optional
        Of the rehearsals.

    Returns
    -------
    Calibration
        Cost: about six decodes of 2 n_latent + 1 columns at some nodes for every rehearsed event.
    """
    how = settings or RehearsalSettings()
    kinds = Kinds.fit(codes, n_kinds, how.seed)
    coded = model.codes(unseen)
    missed = np.concatenate([unseen[i : i + _BATCH] - model.decode(coded[i : i + _BATCH].T) for i in _parts(unseen)])
    errors = field_errors(missed, kinds.shares(coded), _PATTERNS)
    scales = Rehearsal(_SCALES, np.full(len(_SCALES), 1.0 / len(_SCALES)))
    made = Calibration(kinds, errors, scales)
    made = replace(made, alone=_rehearse(model, mesh, made, None, unseen[: how.n_events], how))
    if pairs is None or not len(pairs[0]):
        return made
    rest_code = model.codes(np.zeros((1, mesh.n_nodes, 3)))[0]
    change = _change(model, rest_code, *pairs)
    scales = Rehearsal(_CHANGE_SCALES, np.full(len(_CHANGE_SCALES), 1.0 / len(_CHANGE_SCALES)))
    made = replace(made, change=change, anchored=scales)
    return replace(made, anchored=_rehearse(model, mesh, made, pairs[0], pairs[1], how))


def field_errors(errors: FloatArray, shares: FloatArray, n_patterns: int) -> FieldErrors:
    """Return the covariances of errors by kind.

    Parameters
    ----------
    errors : ndarray of float, shape (n_fields, n_nodes, 3)
        mm.
    shares : ndarray of float64, shape (n_fields, n_kinds)
        Probability of each kind.
    n_patterns : int
        Patterns kept at most.

    Returns
    -------
    FieldErrors
        Those of a kind are mixed with those of all kinds in so far as there are few.
    """
    rows = errors.reshape(len(errors), -1).astype(np.float64)
    values, vectors = np.linalg.eigh(rows @ rows.T)
    order = np.argsort(values)[::-1][:n_patterns]
    order = order[values[order] > 1e-9 * values.max()]
    basis = (vectors[:, order].T @ rows) / np.sqrt(values[order])[:, None]
    # Patterns of root mean square one at a node, so that float16 holds them.
    basis *= np.sqrt(errors.shape[1])
    coefficients = rows @ basis.T / errors.shape[1]
    left = (rows - coefficients @ basis).reshape(errors.shape)
    rest = np.sqrt((left**2).mean(axis=0))
    pooled = coefficients.T @ coefficients / len(coefficients)
    covariances = np.empty((shares.shape[1], len(order), len(order)))
    for k, share in enumerate(shares.T):
        count = share.sum()
        own = (coefficients * share[:, None]).T @ coefficients
        # Few errors of a kind say how large they are sooner than what they look like.
        size = (np.trace(own) + np.trace(pooled)) / ((count + 1.0) * np.trace(pooled))
        covariances[k] = (own + _BORROWED * size * pooled) / (count + _BORROWED)
    return FieldErrors(basis.reshape(-1, *errors.shape[1:]), covariances, rest)


def _change(model: Codes, rest_code: FloatArray, simulations: FloatArray, truths: FloatArray) -> Change:
    """Return how truths differ from simulations."""
    before, after = model.codes(simulations), model.codes(truths)
    sizes = np.maximum(rms_displacement(simulations), LEAST_SIZE_MM)
    off, along = after - before, before - rest_code
    stretch = (off * along).sum(axis=1) / (along**2).sum(axis=1)
    left = (off - stretch[:, None] * along) / sizes[:, None]
    covariance = left.T @ left / len(left)
    keep = 1.0 / (1.0 + 0.3 * left.shape[1] / len(left))
    covariance = keep * covariance + np.diag((1.0 - keep) * np.diag(covariance) + 1e-9)
    missed = truths - simulations - model.decode(after.T) + model.decode(before.T)
    errors = field_errors(missed / sizes[:, None, None], np.ones((len(missed), 1)), _CHANGE_PATTERNS)
    return Change(float((stretch**2).mean()), covariance, errors)


@dataclass(frozen=True, eq=False)
class _Places:
    """Random markers on the free surface and targets inside, as sums over nodes."""

    nodes: IntArray
    where: IntArray
    weights: FloatArray

    @classmethod
    def drawn(cls, mesh: Mesh, how: RehearsalSettings, rng: np.random.Generator) -> "_Places":
        held = np.zeros(mesh.n_nodes, dtype=bool)
        held[mesh.fixed_nodes] = True
        free = mesh.surface[~held[mesh.surface].all(axis=1)]
        corners = mesh.nodes[free]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
        triangles = free[rng.choice(len(free), how.n_markers, p=areas / areas.sum())]
        tets = mesh.tets[rng.choice(mesh.n_tets, how.n_targets, p=mesh.volumes / mesh.volumes.sum())]
        members = np.concatenate([np.column_stack([triangles, triangles[:, :1]]), tets])
        weights = np.zeros((len(members), 4))
        weights[: how.n_markers, :3] = rng.dirichlet(np.ones(3), how.n_markers)
        weights[how.n_markers :] = rng.dirichlet(np.ones(4), how.n_targets)
        nodes, where = np.unique(members, return_inverse=True)
        return cls(nodes, where.reshape(members.shape), weights)

    def rows(self, fields: FloatArray) -> FloatArray:
        """Return components (n_fields, n_rows) of fields (n_fields, k, 3) at `nodes`."""
        return np.asarray(np.einsum("fpcx,pc->fpx", fields[:, self.where], self.weights).reshape(len(fields), -1))

    def rows_of(self) -> RowsOf:
        """Return the same for whole fields."""
        return lambda fields: self.rows(fields[:, self.nodes])


def _rehearse(
    model: Codes,
    mesh: Mesh,
    made: Calibration,
    simulations: FloatArray | None,
    truths: FloatArray,
    how: RehearsalSettings,
) -> Rehearsal:
    """Register truths from random markers; return fitted scales, chances, distances and widening."""
    rng = np.random.default_rng([how.seed, 22])
    law = made.alone if simulations is None else made.anchored
    assert law is not None  # noqa: S101
    spread, centre = spread_of(made.kinds), made.kinds.weights @ made.kinds.means
    noise = how.std**2 * np.eye(3 * how.n_markers)
    events, logs = [], []
    for i, truth in enumerate(truths):
        places = _Places.drawn(mesh, how, rng)
        rows = places.rows(truth[None, places.nodes].astype(np.float64))[0]
        observed = rows[: len(noise)] + how.std * rng.standard_normal(len(noise))
        at = made.at(places.rows_of())
        anchor = np.zeros(len(rows))
        start = centre
        if simulations is None:
            prior = at.prior()
        else:
            simulation = simulations[i].astype(np.float64)
            start = model.codes(simulation[None])[0]
            prior = prior_about(model, at, simulation, start)
            anchor = places.rows(
                simulation[None, places.nodes] - model.decode(start[:, None], places.nodes),
            )[0]

        def decode(latents: FloatArray, places: _Places = places, anchor: FloatArray = anchor) -> FloatArray:
            return places.rows(model.decode(latents, places.nodes)) + anchor

        found, linear = conditioned(decode, prior, observed, noise, start, spread, _PASSES)
        events.append((prior, linear, observed, rows))
        first = log_evidence(prior[:1] if simulations is not None else prior, linear, observed, noise)
        weight = made.kinds.weights[:, None] if simulations is None else 1.0
        logs.append(np.log((np.exp(first - first.max()) * weight).sum(axis=0)))
    scale_weights = _mixing(np.array(logs))
    law = replace(law, scale_weights=scale_weights)
    misfits, chances, distances = [], [], []
    for prior, linear, observed, rows in events:
        found = condition(_reweighted(prior, law, simulations is not None), linear, observed, noise)
        chances.append(found.p_value)
        distances.append(made.distance(found.mean_latents))
        misfits.append(_misfits(rows - found.mean, found.covariance, len(noise)))
    widening = float(np.quantile(np.concatenate(misfits), 0.9) / 6.2514)
    return replace(law, p_values=np.sort(chances), distances=np.sort(distances), widening=widening)


def prior_about(model: Codes, at: PointCalibration, simulation: FloatArray, code: FloatArray) -> list[Component]:
    """Return the prior of the truth of a simulated event; see `PointCalibration.prior_about`."""
    rest_code = model.codes(np.zeros((1, *simulation.shape)))[0]
    return at.prior_about(code, rest_code, float(rms_displacement(simulation[None])[0]))


def _reweighted(prior: list[Component], law: Rehearsal, anchored: bool) -> list[Component]:
    """Return the components with the scales' fitted probabilities; with a simulation those of the first alone."""
    changed = prior[:1] if anchored else prior
    return [
        *(replace(one, weights=one.weights.sum() * law.scale_weights) for one in changed),
        *prior[len(changed) :],
    ]


def _mixing(logs: FloatArray) -> FloatArray:
    """Return the probabilities of scales under which evidences exp(logs) (n_events, n_scales) are likeliest."""
    weights = np.full(logs.shape[1], 1.0 / logs.shape[1])
    for _ in range(200):
        # One event for each scale, so that none becomes impossible.
        counts = probabilities(logs + np.log(weights)).sum(axis=0) + 1.0
        weights = counts / counts.sum()
    return weights


def _misfits(off: FloatArray, covariance: FloatArray, first: int) -> FloatArray:
    """Return squared distances of points from row `first` on, in their own covariance."""
    rows = range(first, len(off), 3)
    return np.array([off[i : i + 3] @ np.linalg.solve(covariance[i : i + 3, i : i + 3], off[i : i + 3]) for i in rows])


def _parts(fields: FloatArray) -> range:
    return range(0, len(fields), _BATCH)
