"""Registration with a trained model: Algorithm 1 of the paper.

A simulation of the moment is encoded, an ensemble is drawn around its code, and ES-MDA updates the ensemble until the
decoded fields agree with the markers; or Gauss-Newton finds the most probable code, and the ensemble is drawn about it.
"""

import os
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._arguments import found, place
from tissuereg._arrays import FloatArray, IntArray
from tissuereg._clock import Clock
from tissuereg.assimilate import Assimilation, assimilate, gauss_newton
from tissuereg.errors import ModelError
from tissuereg.inputs import RegisterInput, rms_length
from tissuereg.latent.model import Gaussian, LatentModel, error_covariance
from tissuereg.latent.network import NetworkModel
from tissuereg.markers import Markers
from tissuereg.mesh import Mesh, det_f
from tissuereg.observe import MarkerObservation
from tissuereg.posterior import Posterior
from tissuereg.result import MarkerFit, Registration, Target
from tissuereg.trust import judge
from tissuereg.widen import widened
from tissuereg.wrong_markers import drop_wrong, score_markers

#: Distance of neighbours for derivatives of the decoder, in standard deviations of the prior: wide enough for float32.
_DIFFERENCE = 1e-2

#: The search ends at a step of so many standard deviations, less than any region shows.
_TOLERANCE = 1e-2


def register_by_model(
    given: RegisterInput, model: "str | os.PathLike[str] | LatentModel", simulation: FloatArray | None, clock: Clock
) -> Registration:
    """Register with a trained model.

    Parameters
    ----------
    given : RegisterInput
        Checked input.
    model : path-like or LatentModel
        Folder of a trained model, or the model.
    simulation : ndarray of float64, shape (n_nodes, 3), or None
        Displacement of the moment by a simulation, mm.
    clock : Clock
        Records the times of the stages.

    Returns
    -------
    Registration
        The result.

    Raises
    ------
    ModelError
        If the model was trained for another mesh, or a file of it is corrupt.
    EnsembleError
        If too few ensemble members survive, or the decoder fails where the search for the most probable code begins.
    ConvergenceError
        If that search finds no minimum.
    """
    with clock.stage("prior"):
        latent = as_model(model, given.mesh, given.threads)
        if simulation is not None and isinstance(latent, NetworkModel):
            latent = latent.around(simulation)
    seen = np.flatnonzero(given.markers.seen)
    with clock.stage("assimilate"):
        fit, wrong = _without_wrong(latent, simulation, given, seen)
    used = np.setdiff1d(seen, list(wrong))
    with clock.stage("decode"):
        posterior = Posterior.of(latent, fit.ensemble, given.observed, given.targets)
    return _result(given, used, wrong, simulation, latent, fit, posterior, clock)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A posterior ensemble with its prior and noise; of a minimum also the predictions there, and their covariance."""

    prior: Gaussian
    widening: float
    noise: FloatArray
    ensemble: Assimilation
    predicted: FloatArray
    absorbed: FloatArray


def _without_wrong(
    latent: LatentModel, simulation: FloatArray | None, given: RegisterInput, seen: Any
) -> tuple[_Fit, dict[int, float]]:
    """Return the fit, and the markers that were dropped because they do not fit the others, with their p-values.

    Only where the fit is a minimum with its derivatives: the covariance of an ensemble is no exact share of the noise.
    """
    if given.settings.update != "gauss-newton":
        return _fit(latent, simulation, given, seen), {}

    def scored(kept: IntArray) -> tuple[_Fit, _core.GroupScores]:
        fit = _fit(latent, simulation, given, seen[kept])
        residual = given.markers.displacement[seen[kept]] - fit.predicted.reshape(-1, 3)
        return fit, score_markers(residual, fit.noise, fit.absorbed)

    fit, dropped = drop_wrong(scored, len(seen))
    return fit, {int(seen[index]): chance for index, chance in dropped}


def _fit(latent: LatentModel, simulation: FloatArray | None, given: RegisterInput, seen: Any) -> _Fit:
    """Return the posterior ensemble: fitted once to locate the state, and again with the model's error there."""
    observed, markers, settings = given.observed, given.markers, given.settings
    measured = markers.displacement[seen].ravel()
    predict = _predictor(latent, observed, seen)
    encoded = latent.prior(simulation)
    place: FloatArray | None = None
    predicted = absorbed = np.empty(0)
    for _ in range(2):
        noise = _noise(latent.errors(place), observed, markers, seen)
        rng = np.random.default_rng([given.seed, 2])
        prior, widening = widened(encoded, latent.prior(None), predict, measured, noise, rng)
        if settings.update == "gauss-newton":
            # The first pass has already come near.
            posterior = gauss_newton(
                predict, measured, noise, prior, start=place, tolerance=_TOLERANCE, difference=_DIFFERENCE
            )
            ensemble = posterior.ensemble(rng, settings.n_members)
            predicted, absorbed = posterior.predicted, posterior.absorbed
        else:
            ensemble = assimilate(
                predict,
                measured,
                noise,
                prior,
                rng=rng,
                n_members=settings.n_members,
                n_steps=settings.n_steps,
                decrease=settings.decrease,
                threads=given.threads,
            )
        place = ensemble.mean
    return _Fit(prior, widening, noise, ensemble, predicted, absorbed)


def _result(
    given: RegisterInput,
    seen: Any,
    wrong: dict[int, float],
    simulation: FloatArray | None,
    latent: LatentModel,
    fit: _Fit,
    posterior: Posterior,
    clock: Clock,
) -> Registration:
    """Assemble the result of the markers `seen` that were used; `wrong` has the chances of those that were dropped."""
    mesh, markers, inner = given.mesh, given.markers, given.targets
    before = np.zeros((mesh.n_nodes, 3)) if simulation is None else simulation
    observed = posterior.markers
    start = observed.predict(before[observed.nodes])
    residual = markers.displacement[seen] - posterior.marker_mean[seen]
    ratios = det_f(mesh, posterior.displacement)
    off = fit.ensemble.mean - fit.prior.mean
    rows = (3 * seen[:, None] + np.arange(3)).ravel()
    notes = list(given.suspicions)
    for i, chance in wrong.items():
        notes.append(f"wrong marker: {markers.names[i]} does not fit the others (p = {chance:.1g}) and was left out")
    if fit.widening > 9.0:
        times = np.sqrt(fit.widening)
        notes.append(f"simulation: it is farther off than usual; its prior had to be widened {times:.1f}-fold")
    trust = judge(
        tuple(markers.names[i] for i in seen),
        residual,
        fit.noise,
        posterior.marker_covariance[np.ix_(rows, rows)],
        float(off @ np.linalg.solve(fit.prior.covariance, off)),
        float(ratios.min()),
        notes,
    )
    target_start = inner.predict(before[inner.nodes])
    unseen = np.setdiff1d(np.arange(len(markers)), seen)
    return Registration(
        mesh=mesh,
        displacement=posterior.displacement,
        nodes=lambda: posterior.std,
        targets={
            name: Target(
                inner.reference[i],
                inner.reference[i] + posterior.target_mean[i],
                posterior.target_covariance[i],
                None if simulation is None else inner.reference[i] + target_start[i],
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
        seconds=clock.seconds,
        seed=given.seed,
        dropped_members=fit.ensemble.dropped,
    )


def as_model(model: Any, mesh: Mesh, threads: int) -> LatentModel:
    """Return a model, read from its folder if necessary; raise ModelError if it is none, or knows another mesh."""
    if isinstance(model, (str, os.PathLike)):
        if str(model) == "phantom":
            from tissuereg.phantom import shipped_model_folder

            return NetworkModel(shipped_model_folder(), mesh, threads=threads, source="shipped")
        return NetworkModel(place("model", model, error=ModelError), mesh, threads=threads)
    if not isinstance(getattr(model, "n_nodes", None), int):
        message = f"`model` must be a folder, 'phantom' or a model that knows a mesh, got {found(model)}"
        raise ModelError(message, where="model")
    if model.n_nodes != mesh.n_nodes:
        message = f"the model must know this mesh of {mesh.n_nodes} nodes, it knows {model.n_nodes}"
        raise ModelError(message, where="model")
    return model  # type: ignore[no-any-return]


def _predictor(latent: LatentModel, observed: MarkerObservation, seen: Any) -> Callable[[FloatArray], FloatArray]:
    def predict(latents: FloatArray) -> FloatArray:
        moved = observed.predict(latent.decode(latents, observed.nodes))[:, seen]
        return np.ascontiguousarray(moved.reshape(len(moved), -1).T)

    return predict


def _noise(own: FloatArray, observed: MarkerObservation, markers: Markers, seen: Any) -> FloatArray:
    """Return C_d: the tracker's noise and the model's own errors (fields) at the markers."""
    errors = observed.predict(own[:, observed.nodes])[:, seen]
    tracker = (markers.axis_std[seen] ** 2).ravel()
    return np.asarray(np.diag(tracker) + error_covariance(errors.reshape(len(errors), -1)))
