"""The main path: a mesh and a few measured markers in, the registered body with its spread out.

Algorithm 1 of the paper: a simulation of the moment is encoded, an ensemble drawn around its code, and ES-MDA
moves the ensemble until what it decodes to agrees with the markers. Without a trained model the latents are
principal components fitted on the spot (`tissuereg.latent.fitted`).
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from threadpoolctl import threadpool_limits

from tissuereg._arrays import FloatArray, float_array
from tissuereg._clock import Clock
from tissuereg.assimilate import Assimilation, assimilate
from tissuereg.errors import MarkerError, ModelError, ShapeError
from tissuereg.latent.fitted import FittedPriorSettings, Motion, fit_prior
from tissuereg.latent.model import Gaussian, LatentModel, error_covariance
from tissuereg.latent.network import NetworkModel
from tissuereg.load import Load
from tissuereg.markers import Markers
from tissuereg.material import Material
from tissuereg.mesh import Mesh, det_f
from tissuereg.observe import MarkerObservation, TargetObservation
from tissuereg.posterior import Posterior
from tissuereg.result import MarkerFit, Registration, Target
from tissuereg.simulate.solve import Simulator
from tissuereg.trust import judge
from tissuereg.widen import widened


@dataclass(frozen=True)
class RegisterSettings:
    """How a registration runs.

    Parameters
    ----------
    n_members, n_steps : int
        Ensemble size N_e and number of assimilations N_a.
    decrease : float
        Ratio of successive inflation coefficients.
    prior : FittedPriorSettings
        How a prior is fitted where no model is given.
    """

    n_members: int = 200
    n_steps: int = 5
    decrease: float = 2.0
    prior: FittedPriorSettings = field(default_factory=FittedPriorSettings)


def register(
    mesh: Mesh | tuple[Any, Any, Any],
    markers: Markers | tuple[Any, Any],
    *,
    model: "str | os.PathLike[str] | LatentModel | None" = None,
    simulation: Any = None,
    targets: Mapping[str, Any] | None = None,
    load: Load | None = None,
    material: Material | None = None,
    element: str = "tet4",
    held_nodes: Any = None,
    seed: int = 0,
    threads: int = 0,
    settings: RegisterSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Registration:
    """Register a deformed body to a few measured markers.

    Parameters
    ----------
    mesh : Mesh or (nodes, tets, fixed_nodes)
        Undeformed body in mm; its node set ``fixed`` is held.
    markers : Markers or (reference, measured)
        Where markers sit and where they were seen, mm; NaN = not seen.
    model : path-like or LatentModel, optional
        Folder of a trained model for this mesh, or ``"phantom"`` for the one that is shipped. Without it a prior is
        fitted to a few hundred simulations of this mesh, once; it is cached by content.
    simulation : array_like of float, shape (n_nodes, 3), optional
        What a simulation says of this moment, from any simulator, mm.
    targets : mapping of str to array_like of float, shape (3,), optional
        Inner points of the undeformed body, mm.
    load : Load, optional
        What is believed to act; gives the simulation where none is given, and the centre of a fitted prior.
    material : Material, optional
        What is believed of the material.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements of our own simulations.
    held_nodes : array_like of int, optional
        Nodes that the load prescribes, where they differ from the set ``fixed``.
    seed : int
        Of all chance: the same seed gives the same result at any thread count.
    threads : int
        Threads to use; 0 takes all cores.
    settings : RegisterSettings, optional
        Ensemble size, steps, prior.
    progress : callable of (int, int), optional
        Called with simulations finished and simulations in all while a prior is fitted.

    Returns
    -------
    Registration
        Displacement, spread, targets with regions, markers, trust, times.

    Raises
    ------
    MarkerError
        If no marker was seen, or one lies far off the body.
    ModelError
        If the model was trained for another mesh, or a file of it is spoilt.
    ShapeError
        If an array does not fit the mesh.
    ConvergenceError, EnsembleError
        If the load finds no equilibrium, or too few ensemble members survive.

    Notes
    -----
    Cost without a model: `settings.prior.n_members` solves, then milliseconds; from the second call on the prior
    comes from the cache.
    """
    settings = settings or RegisterSettings()
    clock = Clock()
    with threadpool_limits(limits=1, user_api="blas"), clock.stage("total"):
        body = _as_mesh(mesh)
        marks = _as_markers(markers)
        given = None if simulation is None else _finite_field(simulation, body)
        with clock.stage("attach"):
            observed = MarkerObservation.of(body, marks)
            inner = TargetObservation(body, targets or {})
            seen = np.flatnonzero(marks.seen)
            if not len(seen):
                message = f"at least one marker must have been seen; all {len(marks)} are missing"
                raise MarkerError(message, where="markers")
        simulator: Simulator | None = None
        if given is None and load is not None:
            with clock.stage("simulate"):
                simulator = Simulator(body, element=element, held_nodes=held_nodes)
                given = simulator.solve(load, material or Material(), threads=threads).displacement
        with clock.stage("prior"):
            if model is None:
                simulator = simulator or Simulator(body, element=element, held_nodes=held_nodes)
                motion = _motion(observed, marks, seen)
                latent: LatentModel = fit_prior(
                    simulator,
                    motion,
                    load=load,
                    material=material,
                    simulation=given,
                    settings=settings.prior,
                    seed=seed,
                    threads=threads,
                    progress=progress,
                )
            else:
                latent = _as_model(model, body, threads)
                if given is not None and isinstance(latent, NetworkModel):
                    latent = latent.around(given)
        with clock.stage("assimilate"):
            fit = _fit(latent, given, observed, marks, seen, settings, seed, threads)
        with clock.stage("decode"):
            posterior = Posterior.of(latent, fit.ensemble, observed, inner)
    return _result(body, marks, seen, given, latent, fit, posterior, inner, clock, seed)


@dataclass(frozen=True, eq=False)
class _Fit:
    """A posterior ensemble with the prior and the noise that gave it."""

    prior: Gaussian
    widening: float
    noise: FloatArray
    ensemble: Assimilation


def _fit(
    latent: LatentModel,
    simulation: FloatArray | None,
    observed: MarkerObservation,
    markers: Markers,
    seen: Any,
    settings: RegisterSettings,
    seed: int,
    threads: int,
) -> _Fit:
    """Return the posterior ensemble: once to find the place, once with the model's error of that place."""
    measured = markers.displacement[seen].ravel()
    predict = _predictor(latent, observed, seen)
    encoded = latent.prior(simulation)
    place: FloatArray | None = None
    for _ in range(2):
        noise = _noise(latent.errors(place), observed, markers, seen)
        rng = np.random.default_rng([seed, 2])
        prior, widening = widened(encoded, latent.prior(None), predict, measured, noise, rng)
        ensemble = assimilate(
            predict,
            measured,
            noise,
            prior,
            rng=rng,
            n_members=settings.n_members,
            n_steps=settings.n_steps,
            decrease=settings.decrease,
            threads=threads,
        )
        place = ensemble.mean
    return _Fit(prior, widening, noise, ensemble)


def _result(
    mesh: Mesh,
    markers: Markers,
    seen: Any,
    simulation: FloatArray | None,
    latent: LatentModel,
    fit: _Fit,
    posterior: Posterior,
    inner: TargetObservation,
    clock: Clock,
    seed: int,
) -> Registration:
    """Put everything that was found in its place."""
    before = np.zeros((mesh.n_nodes, 3)) if simulation is None else simulation
    observed = posterior.markers
    start = observed.predict(before[observed.nodes])
    residual = markers.displacement[seen] - posterior.marker_mean[seen]
    ratios = det_f(mesh, posterior.displacement)
    off = fit.ensemble.mean - fit.prior.mean
    rows = (3 * seen[:, None] + np.arange(3)).ravel()
    notes = []
    if fit.widening > 9.0:
        times = np.sqrt(fit.widening)
        notes.append(f"the simulation is farther off than it usually is: its prior had to be widened {times:.1f}-fold")
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
    unseen = np.flatnonzero(~markers.seen)
    return Registration(
        mesh=mesh,
        displacement=posterior.displacement,
        std=posterior.std,
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
                # What a tracker would see: the body's spread and the tracker's own.
                posterior.marker_covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
                + posterior.marker_error[i]
                + markers.std[i] ** 2 * np.eye(3),
                None if simulation is None else markers.reference[i] + start[i],
            )
            for i in unseen
        },
        markers=MarkerFit(
            used=tuple(markers.names[i] for i in seen),
            dropped=tuple((markers.names[i], "not seen") for i in unseen),
            before_rms_mm=_rms(markers.displacement[seen] - start[seen]),
            after_rms_mm=_rms(residual),
            residual_mm={markers.names[i]: row for i, row in zip(seen, residual, strict=True)},
        ),
        all_markers=markers,
        start_markers=markers.reference + start,
        min_det_f=float(ratios.min()),
        inverted_tets=int((ratios <= 0).sum()),
        trust=trust,
        model=dict(latent.card),
        seconds=dict(clock.seconds),
        seed=seed,
        dropped_members=fit.ensemble.dropped,
    )


def _rms(vectors: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))


def _as_mesh(mesh: Any) -> Mesh:
    if isinstance(mesh, Mesh):
        return mesh
    if not isinstance(mesh, tuple) or len(mesh) != 3:
        message = f"`mesh` must be a Mesh or (nodes, tets, fixed_nodes), got {type(mesh).__name__}"
        raise ShapeError(message, where="mesh")
    return Mesh(mesh[0], mesh[1], {"fixed": mesh[2]})


def _as_markers(markers: Any) -> Markers:
    if isinstance(markers, Markers):
        return markers
    if not isinstance(markers, tuple) or len(markers) != 2:
        message = f"`markers` must be Markers or (reference, measured), got {type(markers).__name__}"
        raise ShapeError(message, where="markers")
    return Markers(*markers)


def _finite_field(simulation: Any, mesh: Mesh) -> FloatArray:
    given = float_array("simulation", simulation, (mesh.n_nodes, 3))
    if not np.isfinite(given).all():
        node = int(np.argmin(np.isfinite(given).all(axis=1)))
        message = f"`simulation` must be finite, got {given[node].tolist()} at node {node}"
        raise ShapeError(message, where="simulation")
    return given


def _as_model(model: Any, mesh: Mesh, threads: int) -> LatentModel:
    if isinstance(model, (str, os.PathLike)):
        if str(model) == "phantom":
            from tissuereg.phantom import shipped_model_folder

            return NetworkModel(shipped_model_folder(), mesh, threads=threads, source="shipped")
        return NetworkModel(model, mesh, threads=threads)
    if model.n_nodes != mesh.n_nodes:
        message = f"the model must know this mesh of {mesh.n_nodes} nodes, it knows {model.n_nodes}"
        raise ModelError(message, where="model")
    return model  # type: ignore[no-any-return]


def _motion(observed: MarkerObservation, markers: Markers, seen: Any) -> Motion:
    return Motion(
        predict=lambda fields: observed.predict(fields[..., observed.nodes, :])[..., seen, :],
        measured=markers.displacement[seen],
        names=tuple(markers.names[i] for i in seen),
        std=float(np.median(markers.std[seen])),
    )


def _predictor(latent: LatentModel, observed: MarkerObservation, seen: Any) -> Callable[[FloatArray], FloatArray]:
    def predict(latents: FloatArray) -> FloatArray:
        moved = observed.predict(latent.decode(latents, observed.nodes))[:, seen]
        return np.ascontiguousarray(moved.reshape(len(moved), -1).T)

    return predict


def _noise(own: FloatArray, observed: MarkerObservation, markers: Markers, seen: Any) -> FloatArray:
    """Return C_d: the tracker's noise and the model's own errors (fields) at the markers."""
    errors = observed.predict(own[:, observed.nodes])[:, seen]
    tracker = np.repeat(markers.std[seen] ** 2, 3)
    return np.asarray(np.diag(tracker) + error_covariance(errors.reshape(len(errors), -1)))
