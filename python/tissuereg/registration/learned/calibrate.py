"""Makes the calibration of a trained model from fields of its training set, fields not used in training, and pairs.

A pair is a simulated and a true field of the same event. The distribution of event sizes and the p-values of correct
measurements come from trial registrations (called rehearsals): events that were not used in training are registered
from random markers, as a user's events will be.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Protocol

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh, random_simplices
from tissuereg.registration.learned.calibration import (
    LEAST_SIZE_MM,
    UNRELATED,
    Calibration,
    Change,
    FieldErrors,
    Rehearsal,
    RowsOf,
)
from tissuereg.registration.learned.components import Components, probabilities
from tissuereg.registration.learned.digits import rounded
from tissuereg.registration.learned.mixture import Component, Evidence
from tissuereg.registration.learned.model import LatentModel, rms_displacement
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.smoother import Decode, Screening, normals, smooth
from tissuereg.registration.learned.spread_law import squared_radius
from tissuereg.registration.learned.statistics import statistics_of
from tissuereg.registration.settings import SmootherSettings

#: Scales of events of one kind: their standard deviations over those of the kind.
_SCALES = np.array([0.2, 0.4, 0.7, 1.2, 2.0, 3.5])

#: Scales of the difference between truth and simulation.
_CHANGE_SCALES = np.array([0.25, 0.5, 1.0, 2.0, 4.0])

#: Variances of the factor by which all moves more or less than simulated: from sure to a factor of two or so.
_FACTORS = np.array([0.0, 0.02, 0.1, 0.4])

#: Parts of the events, each rehearsed with what the others tell.
_FOLDS = 5

#: Least and most degrees of freedom of the law of targets; above the most it is a Gaussian.
_TAILS = (1.5, 100.0)

#: Errors by which those of a kind are mixed with those of all; steps of patterns as a share of their root mean square.
_BORROWED, _PATTERN_STEP = 20.0, 0.2

#: Fields coded at once.
_BATCH = 50

#: Work of a trial that is screened, and of one that is registered too.
_SCREENED, _SHOWN = 2, 3

#: Takes what is done and what there is in all.
Counter = Callable[[int, int], None]


class Codes(LatentModel, Protocol):
    """A latent model that also has an encoder, which gives the latents (the code) of a displacement field."""

    def codes(self, fields: FloatArray) -> FloatArray:
        """Return the encoder's means (n_fields, n_latent), dimensionless, for fields (n_fields, n_nodes, 3) in mm."""
        ...


@dataclass(frozen=True)
class RehearsalSettings:
    """Settings of the trial registrations (rehearsals) from which a model is calibrated.

    Parameters
    ----------
    n_markers, n_targets : int
        Number of markers, at random places on the free surface, and of targets, at random places inside the body.
    std : float
        Standard deviation of the tracker's noise in each coordinate, mm.
    n_events : int
        Number of fields not used in training that are registered, at most: the first ones.
    n_repeats : int
        Registrations of each pair, from other places and with other noise: pairs are few.
    n_varied : int
        Events at most that are registered once more, from other numbers of markers and with other noise; they only
        tell how test statistics are distributed. Each pair is, too.
    least_markers, most_markers : int
        Numbers of markers of these, drawn evenly on a logarithmic scale.
    least_std, most_std : float
        Noise of these, mm, drawn likewise.
    n_patterns : int
        Patterns at most by which the model's errors, and those of changes from a simulation, are described: they make
        most of the file.
    seed : int
        Seed of the places, of the noise, and of the fit of the kinds of events.
    """

    n_markers: int = 15
    n_targets: int = 20
    std: float = 0.1
    n_events: int = 1000
    n_repeats: int = 3
    n_varied: int = 400
    least_markers: int = 5
    most_markers: int = 40
    least_std: float = 0.03
    most_std: float = 1.0
    n_patterns: int = 80
    seed: int = 0


def calibrate(
    model: Codes,
    mesh: Mesh,
    codes: FloatArray,
    unseen: FloatArray,
    pairs: Sequence[tuple[FloatArray, FloatArray]] = (),
    *,
    n_kinds: int = 12,
    settings: RehearsalSettings | None = None,
    progress: Counter | None = None,
) -> Calibration:
    """Return the calibration of a model: kinds of events, the model's errors, and the outcome of trial registrations.

    `model` is the encoder and decoder, `mesh` its mesh; `codes` (n_codes, n_latent) are the encoder's means for fields
    of the training set; `unseen` (n_fields, n_nodes, 3) are fields that were not used in training, in mm; `pairs`
    holds, for each kind of change (one way in which truths differ from simulations, such as another stiffness),
    simulated and true fields of the same events, each (n_pairs, n_nodes, 3), in mm; `n_kinds` is the number of Gaussian
    components (kinds of events) from which the fit to `codes` starts; `settings` are those of the trial registrations.
    `progress` is called with the work done and all work, in units of half a screened trial. Cost of every trial, at its
    markers and targets: six decodes of about 2 n_latent columns, five of its ensembles.
    """
    how = settings or RehearsalSettings()
    n_pairs = sum(len(truths) for _, truths in pairs)
    rehearsal = _Rehearsing(model, mesh, how, progress)
    kinds = Components.fit(codes, n_kinds, how.seed)
    known = [unseen, *(truths for _, truths in pairs)]
    fields, group = np.concatenate(known), np.repeat(np.arange(len(known)), [len(one) for one in known])
    coded = model.codes(fields)
    missed = np.concatenate([fields[i : i + _BATCH] - model.decode(coded[i : i + _BATCH].T) for i in _parts(fields)])
    # Errors of events of another physics, where there are some, have covariances of their own.
    n_physics = min(len(known), 2)
    shares = np.einsum("fp,fk->fpk", np.eye(n_physics)[np.minimum(group, 1)], kinds.shares(coded))
    shares = shares.reshape(len(fields), -1)
    scales = Rehearsal(_SCALES, _equal(n_physics, len(_SCALES)))
    made = Calibration(kinds, field_errors(missed, shares, how.n_patterns), scales)
    trials, varied = _Trials([], []), _Trials([], [])
    for own, others in _folds(group):
        without = replace(made, errors=field_errors(missed[others], shares[others], how.n_patterns))
        for row in own:
            times = how.n_repeats if group[row] else int(row < how.n_events)
            for _ in range(times):
                trials.add(rehearsal.trial(without, None, fields[row]), group[row])
            if group[row] or row < how.n_varied:
                varied.add(rehearsal.trial(without, None, fields[row], varied=True), group[row])
    rehearsal.expect(len(trials.events) + n_pairs * how.n_repeats, len(varied.events) + n_pairs)
    made = replace(made, alone=rehearsal.beside(rehearsal.outcome(trials, scales), varied))
    if not pairs:
        return made
    simulations, truths, kind = np.concatenate([one for one, _ in pairs]), fields[group > 0], group[group > 0] - 1
    missed = missed[group == 0]
    differences = _Differences.of(model, simulations, truths, kind, missed)
    made = replace(made, change=differences.change(np.arange(len(truths)), how.n_patterns))
    n_forms = len(pairs) * len(_FACTORS)
    scales = Rehearsal(_CHANGE_SCALES, _equal(n_forms, len(_CHANGE_SCALES)))
    trials, varied = _Trials([], []), _Trials([], [])
    for own, others in _folds(kind):
        without = replace(made, anchored=scales, change=differences.change(others, how.n_patterns))
        for row in own:
            for _ in range(how.n_repeats):
                trials.add(rehearsal.trial(without, simulations[row], truths[row]), kind[row])
            varied.add(rehearsal.trial(without, simulations[row], truths[row], varied=True), kind[row])
    return replace(made, anchored=rehearsal.beside(rehearsal.outcome(trials, scales), varied))


def _equal(*shape: int) -> FloatArray:
    """Return an array of a shape whose entries are all the same and sum to one."""
    return np.full(shape, 1.0 / np.prod(shape))


def codes_of(model: Codes, fields: Any, rows: IntArray, progress: Counter | None = None) -> FloatArray:
    """Return the encoder's means (n_rows, n_latent) for some fields of a data set, which is read in parts.

    `fields` (n_fields, n_nodes, 3), in mm, is an array in memory or on disk; `rows` int64 (n_rows,) are their numbers;
    `progress` is called with the number of fields coded and of all.
    """
    parts = []
    for i in range(0, len(rows), _BATCH):
        parts.append(model.codes(np.asarray(fields[rows[i : i + _BATCH]])))
        if progress is not None:
            progress(min(i + _BATCH, len(rows)), len(rows))
    return np.concatenate(parts)


def field_errors(errors: FloatArray, shares: FloatArray, n_patterns: int) -> FieldErrors:
    """Return the covariances of a model's error fields, one for each kind of event, in terms of a few common patterns.

    `errors` (n_fields, n_nodes, 3) are true minus decoded fields, in mm; `shares` (n_fields, n_kinds) is the
    probability that a field belongs to each kind of event (component of a Gaussian mixture); `n_patterns` is the
    largest number of patterns (principal components of the errors) that are kept. The covariance of a kind with few
    fields is drawn towards that of all kinds.
    """
    rows = errors.reshape(len(errors), -1).astype(np.float64)
    values, vectors = np.linalg.eigh(rows @ rows.T)
    order = np.argsort(values)[::-1][:n_patterns]
    order = order[values[order] > 1e-9 * values.max()]
    basis = (vectors[:, order].T @ rows) / np.sqrt(values[order])[:, None]
    # As the file will hold them, so that rehearsals are of what registrations find there.
    basis = rounded(basis * np.sqrt(errors.shape[1]), _PATTERN_STEP)
    coefficients = np.linalg.solve(basis @ basis.T, basis @ rows.T).T
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


@dataclass(frozen=True, eq=False)
class _Differences:
    """How true fields differ from simulations of the same events, divided by the size of the simulated event.

    `kind` int64 (n_pairs,) is the kind of change of each pair (the group of pairs that it comes from). `codes`
    (n_pairs, n_latent) is the difference of the encoder's means, in 1/mm. `missed` (n_pairs, n_nodes, 3) is the part of
    the difference of the fields that the decoder cannot represent, in mm per mm. `others` (n_fields, n_nodes, 3) are
    errors of whole fields, scaled to the root mean square of `missed`, which contribute further patterns.
    """

    kind: IntArray
    codes: FloatArray
    missed: FloatArray
    others: FloatArray

    @classmethod
    def of(
        cls, model: Codes, simulations: FloatArray, truths: FloatArray, kind: IntArray, others: FloatArray
    ) -> "_Differences":
        """Return the differences of pairs of simulated and true fields, less what a factor on the whole field explains.

        `simulations` and `truths` (n_pairs, n_nodes, 3) are displacements in mm; `kind` int64 (n_pairs,) is the group
        of each pair (its kind of change); `others` (n_fields, n_nodes, 3) are true minus decoded whole fields, in mm.
        """
        squares = np.maximum((simulations**2).sum(axis=(1, 2)), 1e-300)
        factors = ((truths - simulations) * simulations).sum(axis=(1, 2)) / squares
        # Without what the factor explains.
        rest = truths - factors[:, None, None] * simulations
        before, after = model.codes(simulations), model.codes(rest)
        sizes = np.maximum(rms_displacement(simulations), LEAST_SIZE_MM)
        off = (after - before) / sizes[:, None]
        missed = (rest - simulations - model.decode(after.T) + model.decode(before.T)) / sizes[:, None, None]
        scale = np.sqrt(np.mean(missed**2) / np.maximum(np.mean(others**2), 1e-300))
        return cls(kind, off, missed, scale * others)

    def change(self, rows: IntArray, n_patterns: int) -> Change:
        """Return the covariances of the differences of truths from simulations, from the pairs with numbers `rows`.

        `n_patterns`: the largest number of patterns of what the decoder cannot represent.
        """
        n_kinds, n_latent = int(self.kind.max()) + 1, self.codes.shape[1]
        kind, every = self.kind[rows], self.codes[rows]
        pooled, covariances = every.T @ every / len(every), np.empty((n_kinds, n_latent, n_latent))
        for number in range(n_kinds):
            off = every[kind == number]
            # One pair of all kinds, for kinds of few or none.
            covariance = (off.T @ off + pooled) / (len(off) + 1.0)
            keep = len(off) / (len(off) + n_latent)
            covariances[number] = keep * covariance + np.diag((1.0 - keep) * np.diag(covariance) + 1e-9)
        # Errors of whole fields lend what errors look like; their size is that of the changes.
        both = np.concatenate([self.missed[rows], self.others])
        shares = np.eye(n_kinds + 1)[np.concatenate([kind, np.full(len(self.others), n_kinds)])]
        errors = field_errors(both, shares, n_patterns)
        rest = both[: len(rows)] - errors.project(both[: len(rows)])
        own = FieldErrors(errors.basis, errors.covariances[:n_kinds], np.sqrt((rest**2).mean(axis=0)))
        return Change(_FACTORS, covariances, own)


@dataclass(frozen=True, eq=False)
class _Places:
    """Random markers on the free surface and random targets inside the body, each a weighted sum of mesh nodes.

    `nodes` int64 (k,) holds the numbers of the mesh nodes that are needed. `where` int64 (n_places, 4) holds, for each
    place, the positions in `nodes` of its four nodes, and `weights` (n_places, 4) their weights, which sum to one. The
    markers come first.
    """

    nodes: IntArray
    where: IntArray
    weights: FloatArray

    @classmethod
    def drawn(cls, mesh: Mesh, n_markers: int, n_targets: int, rng: np.random.Generator) -> "_Places":
        triangles, tets = random_simplices(mesh, n_markers, n_targets, rng)
        members = np.concatenate([np.column_stack([triangles, triangles[:, :1]]), tets])
        weights = np.zeros((len(members), 4))
        weights[:n_markers, :3] = rng.dirichlet(np.ones(3), n_markers)
        weights[n_markers:] = rng.dirichlet(np.ones(4), n_targets)
        nodes, where = np.unique(members, return_inverse=True)
        return cls(nodes, where.reshape(members.shape), weights)

    def rows(self, fields: FloatArray) -> FloatArray:
        """Return the displacement components (n_fields, 3 n_places) of fields (n_fields, k, 3) at `nodes`, in mm."""
        return np.asarray(np.einsum("fpcx,pc->fpx", fields[:, self.where], self.weights).reshape(len(fields), -1))

    def rows_of(self) -> RowsOf:
        """Return a function from whole fields (n_fields, n_nodes, 3) to components (n_fields, 3 n_places), mm."""
        return lambda fields: self.rows(fields[:, self.nodes])

    def decoder(self, model: Codes) -> RowsOf:
        """Return a function from latents (n_latent, n_members) to displacement components (n_members, 3 n_places), mm.

        If the model is a network, its decoder is reduced to one that computes these places alone.
        """
        from scipy import sparse

        cut = None
        if isinstance(model, NetworkModel):
            number = np.repeat(np.arange(len(self.where)), self.where.shape[1])
            places = (self.weights.ravel(), (number, self.nodes[self.where].ravel()))
            cut = model.cut(sparse.csr_array(places, (len(self.where), model.n_nodes)))
        if cut is None:
            return lambda latents: self.rows(model.decode(latents, self.nodes))
        return lambda latents: cut(latents).reshape(latents.shape[1], -1)


@dataclass(frozen=True, eq=False)
class _RegisteredEvent:
    """A registered truth: its prior, of which the first `n_own` components are the event's own, and their evidence.

    `shares` (n_own,): probability of each of these among those of its form, whatever the scale; `decode`: the model at
    the markers and targets of the event; rows of `observed` are those of the markers, of `rows` the true ones of
    markers and targets, mm; `noise`: covariance of the tracker's noise, mm^2.
    """

    made: Calibration
    prior: list[Component]
    n_own: int
    shares: FloatArray
    decode: Decode
    screening: Screening
    observed: FloatArray
    noise: FloatArray
    rows: FloatArray


#: Registers one truth.
_Trial = Callable[[], _RegisteredEvent]


@dataclass(frozen=True, eq=False)
class _Trials:
    """What registers truths, each with the group of its event in the calibration set."""

    events: list[_Trial]
    groups: list[int]

    def add(self, event: _Trial, group: Any) -> None:
        """Add one."""
        self.events.append(event)
        self.groups.append(int(group))


class _Rehearsing:
    """Registers events of known displacement from random markers with random noise, to measure the errors.

    `model` is the encoder and decoder, `mesh` its mesh, and `how` gives the numbers of markers and targets, the noise
    and the seed.
    """

    def __init__(self, model: Codes, mesh: Mesh, how: RehearsalSettings, progress: Counter | None = None) -> None:
        self._model, self._mesh, self._how = model, mesh, how
        self._progress, self._done, self._in_all = progress, 0, 0
        self._n_trials = 0
        usual = SmootherSettings()
        self._alphas, self._draws = usual.alphas(), normals(how.seed, model.n_latent, usual.n_members)

    def trial(
        self, made: Calibration, simulation: FloatArray | None, truth: FloatArray, *, varied: bool = False
    ) -> _Trial:
        """Return what registers one truth, the same at every call: a registered event takes megabytes.

        `made`: calibration that is used; `simulation`, `truth` (n_nodes, 3): mm; `varied`: whether the number of
        markers and their noise are drawn, too.
        """
        self._n_trials += 1
        return partial(self._registered, made, simulation, truth, self._n_trials, varied)

    def _registered(
        self, made: Calibration, simulation: FloatArray | None, truth: FloatArray, number: int, varied: bool
    ) -> _RegisteredEvent:
        """Register one truth from places and noise that depend on the number of the trial."""
        how, model = self._how, self._model
        rng = np.random.default_rng([how.seed, 22, number])
        n_markers, std = self._layout(rng) if varied else (how.n_markers, how.std)
        n_obs = 3 * n_markers
        noise = std**2 * np.eye(n_obs)
        places = _Places.drawn(self._mesh, n_markers, how.n_targets, rng)
        rows = places.rows(truth[None, places.nodes].astype(np.float64))[0]
        observed = rows[:n_obs] + std * rng.standard_normal(n_obs)
        at, decoded = made.at(places.rows_of()), places.decoder(model)
        anchor, start, n_own = np.zeros(len(rows)), made.kinds.centre, len(made.errors.covariances)
        prior, shares = at.prior(), np.tile(made.kinds.weights, n_own // len(made.kinds.weights))
        if simulation is not None:
            simulation = simulation.astype(np.float64)
            start, simulated = model.codes(simulation[None])[0], places.rows(simulation[None, places.nodes])[0]
            prior, forms = at.prior_about(start, float(rms_displacement(simulation[None])[0]), simulated)
            n_own, shares = len(forms), np.full(len(forms), 1.0 - UNRELATED)
            anchor = simulated - decoded(start[:, None])[0]

        def decode(latents: FloatArray) -> FloatArray:
            return decoded(latents) + anchor

        spread, simulated = made.kinds.spread, n_own < len(prior)
        screening = Screening.of(decode, prior, observed, noise, start, spread, simulated=simulated)
        return _RegisteredEvent(made, prior, n_own, shares, decode, screening, observed, noise, rows)

    def expect(self, n_trials: int, n_varied: int) -> None:
        """State how many trials there are in all, and how many more that only tell how test statistics spread."""
        self._in_all = _SCREENED * n_trials + _SHOWN * (n_trials + n_varied)

    def _tell(self, work: int) -> None:
        self._done += work
        if self._progress is not None:
            self._progress(self._done, self._in_all)

    def _layout(self, rng: np.random.Generator) -> tuple[int, float]:
        """Return a number of markers and the standard deviation of their noise, mm."""
        how = self._how
        markers, std = (
            np.exp(rng.uniform(np.log(least), np.log(most)))
            for least, most in ((how.least_markers, how.most_markers), (how.least_std, how.most_std))
        )
        return round(float(markers)), float(std)

    def beside(self, law: Rehearsal, trials: _Trials) -> Rehearsal:
        """Return the outcome with further groups of events, which only tell how test statistics are distributed."""
        shown = [self.shown(event(), law.scale_weights)[0] for event in trials.events]
        return _with_groups(law, np.array(shown), trials.groups)

    def shown(self, event: _RegisteredEvent, scale_weights: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the test statistics of an event under probabilities of scales, and the misfits of its targets."""
        own = event.prior[: event.n_own]
        laws = np.repeat(scale_weights, len(own) // len(scale_weights), axis=0)
        own = [replace(one, weights=share * law) for one, share, law in zip(own, event.shares, laws, strict=True)]
        prior, n_obs = [*own, *event.prior[event.n_own :]], len(event.noise)
        again = event.screening.under(prior, event.observed, event.noise)
        shown = statistics_of(event.made, prior, again, event.observed, event.noise, event.n_own)
        found = smooth(event.decode, prior, again.kept(), event.observed, event.noise, self._draws, self._alphas)
        self._tell(_SHOWN)
        return shown.row, _misfits(event.rows - found.mean, found.covariance, n_obs)

    def outcome(self, trials: _Trials, law: Rehearsal) -> Rehearsal:
        """Return the likeliest scales, and what registrations with these give."""
        n_forms, n_scales = law.scale_weights.shape
        logs = np.array([self._log_evidence(event(), n_forms).ravel() for event in trials.events])
        scale_weights = _mixing(logs).reshape(n_forms, n_scales)
        statistics, misfits = zip(*(self.shown(event(), scale_weights) for event in trials.events), strict=True)
        widening, tail = _regions(np.concatenate(misfits))
        found = replace(law, scale_weights=scale_weights, widening=widening, tail=tail)
        return _with_groups(found, np.array(statistics), trials.groups)

    def _log_evidence(self, event: _RegisteredEvent, n_forms: int) -> FloatArray:
        """Return the log-evidence (n_forms, n_scales) of scales under the prior components of the registered event.

        A scale is a factor on a component's standard deviations. With `n_forms` above one each component has a row;
        with one form the components are summed, weighted by their probabilities.
        """
        prior = event.prior[: event.n_own]
        equal = [
            replace(one, weights=np.full(len(one.scales), share))
            for one, share in zip(prior, event.shares, strict=True)
        ]
        logs = Evidence.of(equal, event.screening.linear, event.observed, event.noise).logs
        self._tell(_SCREENED)
        return np.asarray(np.logaddexp.reduce(logs.reshape(n_forms, len(prior) // n_forms, -1), axis=1))


def _with_groups(law: Rehearsal, statistics: FloatArray, groups: Sequence[int]) -> Rehearsal:
    """Return an outcome with the test statistics of events (n_events, 5) of some groups (n_events,) added."""
    known = law.calibration_set
    for number in np.unique(groups):
        known = known.beside(statistics[np.asarray(groups) == number])
    return replace(law, calibration_set=known)


def _mixing(logs: FloatArray) -> FloatArray:
    """Return the probabilities (n_cases,) of cases that make evidences exp(logs), (n_events, n_cases), largest.

    They are found by expectation and maximisation, with one event added to each case, so that none becomes impossible.
    """
    weights = np.full(logs.shape[1], 1.0 / logs.shape[1])
    for _ in range(200):
        # One event for each, so that none becomes impossible.
        counts = probabilities(logs + np.log(weights)).sum(axis=0) + 1.0
        weights = counts / counts.sum()
    return weights


def _misfits(off: FloatArray, covariance: FloatArray, first: int) -> FloatArray:
    """Return the squared Mahalanobis distance (n_points,) of each point from its mean, in its own covariance.

    `off` (n_rows,) is true minus mean displacement, in mm, three components per point; `covariance` (n_rows, n_rows) is
    in mm^2; `first` is the row at which the points begin.
    """
    rows = range(first, len(off), 3)
    return np.array([off[i : i + 3] @ np.linalg.solve(covariance[i : i + 3, i : i + 3], off[i : i + 3]) for i in rows])


def _regions(misfits: FloatArray) -> tuple[float, float | None]:
    """Return the factor on covariances and the degrees of freedom with which 50 % and 90 % regions hold their share.

    `misfits` (n,) are squared Mahalanobis distances of targets from their means. The first result, `widening`, is the
    factor on covariances for which the 90 % region of a Gaussian holds 90 % of the targets. The second, `tail`, is the
    degrees of freedom of the t law that has the same 90 % region and holds half of the targets in its 50 % region; None
    if the tails are those of a Gaussian, or lighter.
    """
    from scipy.optimize import brentq
    from scipy.stats import chi2

    middle, wide = np.quantile(misfits, (0.5, 0.9))

    def excess(dof: float) -> float:
        return float(squared_radius(0.9, None) / squared_radius(0.5, dof) - wide / middle)

    low, high = _TAILS
    widening = float(wide / chi2.ppf(0.9, 3))
    if excess(high) >= 0.0:
        return widening, None
    return widening, low if excess(low) <= 0.0 else float(brentq(excess, low, high))


def _folds(kind: IntArray) -> list[tuple[IntArray, IntArray]]:
    """Divide events into parts for cross-validation; return for each part the numbers of its events and of the others.

    `kind` int64 (n_events,) is the group of each event; every part has an equal share of each group. Cross-validation
    is needed because a covariance fits the events from which it was estimated too well. A part is a run of consecutive
    events of a group, so that events of one body or one rig, which follow each other, are in one part unless they lie
    at its end.
    """
    part = np.empty(len(kind), np.int64)
    for number in np.unique(kind):
        own = np.flatnonzero(kind == number)
        part[own] = np.arange(len(own)) * _FOLDS // len(own)
    parts = [(np.flatnonzero(part == number), np.flatnonzero(part != number)) for number in range(_FOLDS)]
    # A single event has no others.
    return [(own, others if len(others) else own) for own, others in parts if len(own)]


def _parts(fields: FloatArray) -> range:
    return range(0, len(fields), _BATCH)
