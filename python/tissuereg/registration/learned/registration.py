"""Registration with a trained model: Algorithm 1 of the paper.

A simulation of the moment is encoded, an ensemble of latents is drawn around its code, and ES-MDA updates the ensemble
until the decoded fields agree with the markers; or Gauss-Newton finds the most probable latents, and the ensemble is
drawn about them.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._base.arguments import found, place
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.clock import Clock
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError, ModelError
from tissuereg.registration.inputs import RegisterInput, rms_length
from tissuereg.registration.learned.assimilate import (
    Assimilation,
    AssimilationSettings,
    FirstEnsemble,
    SearchSettings,
    assimilate,
    gauss_newton,
)
from tissuereg.registration.learned.calibration_set import STATISTICS
from tissuereg.registration.learned.mixture_posterior import CalibratedPosterior
from tissuereg.registration.learned.model import Gaussian, LatentModel
from tissuereg.registration.learned.network import kept_network
from tissuereg.registration.learned.points import PointModel, PointsAround
from tissuereg.registration.learned.posterior import Posterior
from tissuereg.registration.learned.result import LearnedRegistration
from tissuereg.registration.learned.smoother import normals
from tissuereg.registration.learned.variants import Variants
from tissuereg.registration.learned.widen import stated
from tissuereg.registration.result import NO_MARKER, MarkerFit, Target
from tissuereg.registration.trust import LEVEL, Trust, judge, judge_by_rehearsal
from tissuereg.registration.wrong_markers import drop_wrong, most_wrong, score_markers

#: The search ends at a step of so many standard deviations, less than any region shows; neighbours for derivatives of
#: the decoder are far enough for float32.
_SEARCH = SearchSettings(tolerance=1e-2, difference=1e-2)

#: Standard deviations of the tracker's noise beyond which a sign is sure: chance of 1e-5.
_SURELY = 4.3

#: Number of the statistic of the marker that fits the others worst.
_WRONG = STATISTICS.index("wrong marker")

#: A marker is left out if fewer than this share of calibration events have one that fits the others as badly.
_DROPPED = 0.05

#: Draws from which predictions about the prior's mean are found where the ensemble is no search or has fewer than twice
#: as many members as there are latents.
_N_DRAWS = 100


def register_by_model(
    given: RegisterInput,
    points: PointModel,
    simulation: FloatArray | None,
    clock: Clock,
    variants: Variants | None = None,
) -> LearnedRegistration:
    """Register one moment (one set of marker measurements) with a trained model.

    `given`: checked input; `points`: the model at the markers and targets of that input; `simulation` (n_nodes, 3) or
    None: displacement of the moment by a simulation, mm; `clock`: records the times of the stages: ``encode``,
    ``assimilate``, ``decode``, ``judge``; `variants`: variants of the simulation, on whose mean the prior is then
    centred. The answer is compared with the simulation, or with that mean if there is no simulation. Result: the
    result. Cost: with ``update="esmda"`` the ensemble is decoded at markers and targets once for each step and once at
    the end. With a calibrated model, whose answer is found about the ensemble's mean, it is decoded before the first
    and the last step alone, and then 2 n_latent + 1 members are decoded two or three times. Once more where the prior
    had to be widened. Two whole fields are decoded. Raises `EnsembleError` if too few ensemble members survive, or the
    decoder fails where the search for the most probable latents begins; `ArgumentError` if variants are given and the
    model was not calibrated with pairs of simulation and truth; `ConvergenceError` if the search for the most probable
    latents finds no minimum.
    """
    if variants is not None and not points.knows_changes:
        message = "`variants` must be left out: the model was not calibrated with pairs of simulation and truth"
        raise ArgumentError(message, where="variants")
    anchor = simulation if variants is None else variants.mean
    with clock.stage("encode"):
        model = points.around(anchor)
    seen = np.flatnonzero(given.markers.seen)
    calibration, fit = points.calibration, None
    posterior: Posterior | CalibratedPosterior
    if calibration is None:
        with clock.stage("assimilate"):
            drawn = _Drawn.of(model, given)
            fit, wrong = _without_wrong(model, drawn, given, seen)
        with clock.stage("decode"):
            posterior, surely = Posterior.of(given.mesh, model, fit.ensemble), wrong
    else:

        def smoothed(used: IntArray) -> CalibratedPosterior:
            return CalibratedPosterior.of(given, model, calibration, used, anchor, variants)

        with clock.stage("assimilate"):
            posterior, wrong, surely = _without_unlikely(smoothed, seen)
    used = np.setdiff1d(seen, list(wrong))
    with clock.stage("judge"):
        before = anchor if simulation is None else simulation
        return _result(given, used, wrong, surely, before, points.model, fit, posterior, clock)


def _without_unlikely(
    smoothed: Callable[[IntArray], CalibratedPosterior], seen: IntArray
) -> tuple[CalibratedPosterior, dict[int, float], dict[int, float]]:
    """Return the posterior without the markers that fit the others worse than those of nearly all calibration events.

    `smoothed`: numbers of the markers that are used, to the posterior; `seen` int64 (n_seen,): all of them. Result:
    `dropped`: number of each marker that was left out, and the share of calibration events whose worst marker fits as
    badly; `surely`: those for which it is a reason against the answer, too. Leaving out a good marker costs little, so
    that it needs less evidence than an alarm.
    """
    used, dropped, surely = seen, dict[int, float](), dict[int, float]()
    while True:
        found = smoothed(used)
        compared, shown = found.rehearsal.calibration_set, found.statistics
        if not len(compared) or len(dropped) >= most_wrong(len(seen)):
            return found, dropped, surely
        share = float(compared.shares(shown.row)[_WRONG])
        if share >= _DROPPED:
            return found, dropped, surely
        worst = int(np.argmax(shown.marker_rows))
        dropped[int(used[worst])] = share
        if compared.p_value(shown.row) < LEVEL:
            surely[int(used[worst])] = share
        used = np.delete(used, worst)


@dataclass(frozen=True, eq=False)
class _Drawn:
    """Draws of latents from the prior, with the displacements that they predict for the markers.

    `prior` is the prior; `first` is the drawn ensemble; `markers` (n_members, n_markers, 3) are its predictions for all
    markers, and `centre` (n_markers, 3) those at the prior's mean, in mm.
    """

    prior: Gaussian
    first: FirstEnsemble
    markers: FloatArray
    centre: FloatArray

    @classmethod
    def of(cls, model: PointsAround, given: RegisterInput) -> "_Drawn":
        smoother = given.settings.smoother
        n_members = smoother.n_members
        if smoother.update == "gauss-newton" or n_members < 2 * len(model.prior.mean):
            n_members = _N_DRAWS
        first = FirstEnsemble.about(model.prior, *normals(given.seed, len(model.prior.mean), n_members))
        centre, moved = model.first(first.latents)
        return cls(model.prior, first, model.markers(moved), model.markers(centre))

    def predicted(self, seen: IntArray) -> FloatArray:
        """Return the predictions (3 n_seen, n_members), in mm, for the markers with numbers `seen` int64 (n_seen,)."""
        return _rows(self.markers[:, seen])

    def start(self, prior: Gaussian, widening: float, seen: IntArray) -> FirstEnsemble:
        """Return the ensemble as draws from a widened prior, with predictions for the markers `seen` if known.

        `prior` is the widened prior and `widening` the factor by which it was widened; predictions are known if it is
        one. `seen` int64 (n_seen,) are numbers of markers.
        """
        if widening == 1.0:
            return FirstEnsemble(self.first.latents, self.first.exact, self.predicted(seen))
        here, there = (np.linalg.cholesky(one.covariance) for one in (self.prior, prior))
        normals = np.linalg.solve(here, self.first.latents - self.prior.mean[:, None])
        return FirstEnsemble(prior.mean[:, None] + there @ normals, self.first.exact)


@dataclass(frozen=True, eq=False)
class _EnsembleFit:
    """A posterior ensemble, with the prior and the noise from which it was computed.

    `prior` is that of the latents, widened by the factor `widening` on its covariance; `noise` (n_obs, n_obs) is the
    covariance C_d of the tracker's noise and the model's errors, in mm^2; `ensemble` holds the posterior members. For
    Gauss-Newton, `predicted` (n_obs,) and `absorbed` (n_obs, n_obs) are the predictions at the minimum, in mm, and
    their posterior covariance, in mm^2; for ES-MDA they are empty.
    """

    prior: Gaussian
    widening: float
    noise: FloatArray
    ensemble: Assimilation
    predicted: FloatArray
    absorbed: FloatArray


def _without_wrong(
    model: PointsAround, drawn: _Drawn, given: RegisterInput, seen: IntArray
) -> tuple[_EnsembleFit, dict[int, float]]:
    """Return the fit without markers that do not fit the others, and the p-values of these markers by their numbers.

    `seen` int64 (n_seen,) are the numbers of the markers to start from. Markers are dropped only with Gauss-Newton,
    where the fit is a minimum with its derivatives: the covariance of an ensemble is no exact share of the noise.
    """
    if given.settings.smoother.update != "gauss-newton":
        return _fit(model, drawn, given, seen), {}

    def scored(kept: IntArray) -> tuple[_EnsembleFit, _core.GroupScores]:
        fit = _fit(model, drawn, given, seen[kept])
        residual = given.markers.displacement[seen[kept]] - fit.predicted.reshape(-1, 3)
        return fit, score_markers(residual, fit.noise, fit.absorbed)

    fit, dropped = drop_wrong(scored, len(seen))
    return fit, {int(seen[index]): chance for index, chance in dropped}


def _fit(model: PointsAround, drawn: _Drawn, given: RegisterInput, seen: IntArray) -> _EnsembleFit:
    """Return the posterior ensemble given the markers with numbers `seen` int64 (n_seen,).

    The model's own errors, which are part of the covariance C_d of the noise, are those at the most probable latents of
    a linear model, or of a typical event for a calibrated model with ES-MDA.
    """
    markers, settings = given.markers, given.settings.smoother
    measured = markers.displacement[seen].ravel()
    latents, predicted = drawn.first.latents, drawn.predicted(seen)
    believed = stated(model, markers, seen, latents, predicted, drawn.centre[seen].ravel())
    prior, noise, near, widening = believed.prior, believed.noise, believed.near, believed.factor

    def predict(latents: FloatArray) -> FloatArray:
        return _rows(model.markers(model.decode(latents))[:, seen])

    rng = np.random.default_rng([given.seed, 3])
    if settings.update == "gauss-newton":
        found = gauss_newton(predict, measured, noise, prior, start=near, settings=_SEARCH)
        ensemble = found.ensemble(rng, settings.n_members)
        return _EnsembleFit(prior, widening, noise, ensemble, found.predicted, found.absorbed)
    first = drawn.start(prior, widening, seen) if latents.shape[1] == settings.n_members else None
    how = AssimilationSettings(settings.n_members, settings.n_steps, decrease=settings.decrease, threads=1)
    ensemble = assimilate(predict, measured, noise, prior, rng=rng, settings=how, first=first)
    return _EnsembleFit(prior, widening, noise, ensemble, np.empty(0), np.empty(0))


def _rows(moved: FloatArray) -> FloatArray:
    """Return displacements (n_members, n_markers, 3) as predictions (3 n_markers, n_members), in the same unit."""
    return np.ascontiguousarray(moved.reshape(len(moved), -1).T)


def _result(
    given: RegisterInput,
    seen: Any,
    wrong: dict[int, float],
    surely: dict[int, float],
    simulation: FloatArray | None,
    latent: LatentModel,
    fit: _EnsembleFit | None,
    posterior: Posterior | CalibratedPosterior,
    clock: Clock,
) -> LearnedRegistration:
    """Assemble the result of the markers `seen` that were used.

    `wrong`: chances of those that were dropped; `surely`: of those for which that is a reason against the answer.
    """
    markers, inner = given.markers, given.targets
    before = np.zeros((given.mesh.n_nodes, 3)) if simulation is None else simulation
    observed = given.observed
    start = observed.predict(before[observed.nodes])
    residual = markers.displacement[seen] - posterior.marker_mean[seen]
    ratios = posterior.ratios
    notes = list(given.suspicions)
    for i, chance in surely.items():
        notes.append(f"wrong marker: {markers.names[i]} does not fit the others (p = {chance:.1g}) and was left out")
    if simulation is not None:
        notes += _against(markers.displacement[seen], start[seen], markers.axis_std[seen])
    names = tuple(markers.names[i] for i in seen)
    dropped_members = posterior.found.dropped if isinstance(posterior, CalibratedPosterior) else []
    if isinstance(posterior, CalibratedPosterior):
        trust = _calibrated_trust(names, residual, posterior, float(ratios.min()), notes)
    elif fit is not None:
        dropped_members = fit.ensemble.dropped
        trust = _trust(names, residual, seen, fit, posterior, float(ratios.min()), notes)
    target_start = inner.predict(before[inner.nodes])
    gains: list[tuple[float | None, bool]] = [(None, False)] * len(inner.names)
    tail = None
    if isinstance(posterior, CalibratedPosterior):
        gains, tail = list(posterior.gains(target_start)), posterior.tail
    unseen = np.setdiff1d(np.arange(len(markers)), seen)
    return LearnedRegistration(
        body=given.body,
        displacement=posterior.displacement,
        nodes=posterior.std,
        targets={
            name: Target(
                inner.reference[i],
                inner.reference[i] + posterior.target_mean[i],
                posterior.target_covariance[i],
                None if simulation is None else inner.reference[i] + target_start[i],
                gains[i][0],
                NO_MARKER if gains[i][1] else None,
                tail,
            )
            for i, name in enumerate(inner.names)
        },
        unseen={
            markers.names[i]: Target(
                markers.reference[i],
                markers.reference[i] + posterior.marker_mean[i],
                # Predicted measurement: the body's spread and the tracker's noise.
                posterior.marker_covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
                + posterior.marker_error[i]
                + np.diag(markers.axis_std[i] ** 2),
                None if simulation is None else markers.reference[i] + start[i],
            )
            for i in unseen
        },
        markers=MarkerFit(
            used=tuple(markers.names[i] for i in seen),
            dropped=tuple((markers.names[i], "wrong" if i in wrong else "not seen") for i in unseen),
            before_rms_mm=rms_length(markers.displacement[seen] - start[seen]),
            after_rms_mm=rms_length(residual),
            residual_mm={markers.names[i]: row for i, row in zip(seen, residual, strict=True)},
        ),
        all_markers=markers,
        start_markers=markers.reference + start,
        min_det_f=float(ratios.min()),
        inverted_tets=int((ratios <= 0).sum()),
        trust=trust,
        model=dict(latent.card),
        settings=given.settings,
        seconds=clock.seconds,
        seed=given.seed,
        dropped_members=dropped_members,
    )


def _trust(
    names: tuple[str, ...],
    residual: FloatArray,
    seen: IntArray,
    fit: _EnsembleFit,
    posterior: Posterior,
    min_det_f: float,
    notes: list[str],
) -> Trust:
    """Return whether the registration can be trusted, judged by the stated covariances of noise and prior.

    `names` are those of the used markers; `residual` (n_used, 3) is measured minus fitted displacement, in mm; `seen`
    int64 (n_used,) are the numbers of the used markers; `min_det_f` is the smallest volume ratio of a tetrahedron;
    `notes` are reasons for mistrust found earlier.
    """
    if fit.widening > 9.0:
        times = np.sqrt(fit.widening)
        notes.append(f"simulation: it is farther off than usual; its prior had to be widened {times:.1f}-fold")
    off = fit.ensemble.mean - fit.prior.mean
    rows = (3 * seen[:, None] + np.arange(3)).ravel()
    return judge(
        names,
        residual,
        fit.noise,
        posterior.marker_covariance[np.ix_(rows, rows)],
        float(off @ np.linalg.solve(fit.prior.covariance, off)),
        min_det_f,
        notes,
    )


def _calibrated_trust(
    names: tuple[str, ...],
    residual: FloatArray,
    posterior: CalibratedPosterior,
    min_det_f: float,
    notes: list[str],
) -> Trust:
    """Judge by comparison with calibration events that the model never saw."""
    compared, shown = posterior.rehearsal.calibration_set, posterior.statistics
    return judge_by_rehearsal(names, residual, posterior.noise, compared, shown, min_det_f, notes)


def _against(moved: FloatArray, simulated: FloatArray, std: FloatArray) -> list[str]:
    """Return a list with the sentence that markers moved against their simulation if they surely did, else empty.

    They did if the factor on the simulated displacements (n_used, 3) that fits the measured ones `moved` (n_used, 3)
    best is below zero beyond what the tracker's noise `std` (n_used, 3) explains, all in mm. In calibration events
    loads and stiffness are off by a factor, never by its sign.
    """
    weighted = simulated / std**2
    square = float((weighted * simulated).sum())
    if square <= 0.0:
        return []
    factor = float((weighted * moved).sum()) / square
    if factor + _SURELY / np.sqrt(square) >= 0.0:
        return []
    return [f"simulation: the markers moved against it, {factor:.2f} times as far as simulated"]


def as_model(model: Any, mesh: Mesh, threads: int) -> LatentModel:
    """Return a latent model for a mesh, read from its folder if `model` is a path, or the shipped one for "phantom".

    Raises `ModelError` if it is no model, or is one for another mesh. `threads` is the number of batches decoded at
    once, 0 for all cores.
    """
    if isinstance(model, (str, os.PathLike)):
        if str(model) == "phantom":
            from tissuereg.phantom import shipped_model_folder

            return kept_network(shipped_model_folder(), mesh, threads, "shipped")
        return kept_network(place("model", model, error=ModelError), mesh, threads)
    if not isinstance(getattr(model, "n_nodes", None), int):
        message = f"`model` must be a folder, 'phantom' or a model that knows a mesh, got {found(model)}"
        raise ModelError(message, where="model")
    if model.n_nodes != mesh.n_nodes:
        message = f"the model must know this mesh of {mesh.n_nodes} nodes, it knows {model.n_nodes}"
        raise ModelError(message, where="model")
    return model  # type: ignore[no-any-return]
