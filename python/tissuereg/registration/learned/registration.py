"""Registration with a trained model: ES-MDA in the latents of its decoder, under the prior of its calibration."""

import contextlib
import os
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from tissuereg._base.arguments import found, place
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.clock import Clock
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError, EnsembleError, ModelError
from tissuereg.registration.inputs import RegisterInput, rms_length
from tissuereg.registration.learned.calibration_set import STATISTICS
from tissuereg.registration.learned.mixture_posterior import CalibratedPosterior
from tissuereg.registration.learned.model import LatentModel
from tissuereg.registration.learned.network import kept_network
from tissuereg.registration.learned.points import PointModel
from tissuereg.registration.learned.result import LearnedRegistration
from tissuereg.registration.learned.variants import Variants
from tissuereg.registration.result import MarkerFit
from tissuereg.registration.target import NO_MARKER, Target
from tissuereg.registration.trust import judge_by_rehearsal
from tissuereg.registration.wrong_markers import most_wrong

#: Standard deviations of the tracker's noise beyond which a sign is sure: chance of 1e-5.
_SURELY = 4.3

#: Number of the statistic of the marker that fits the others worst.
_WRONG = STATISTICS.index("wrong marker")

#: A marker is left out if fewer than this share of calibration events have one that fits the others as badly.
_DROPPED = 0.05


def register_by_model(
    given: RegisterInput,
    points: PointModel,
    simulation: FloatArray | None,
    clock: Clock,
    variants: Variants | None = None,
) -> LearnedRegistration:
    """Register one moment (one set of marker measurements) with a trained model.

    `given`: checked input; `points`: the model at the markers and targets of that input; `simulation` (n_nodes, 3) or
    None: displacement of the moment by a simulation, mm; `clock`: records the times of the stages ``encode``,
    ``assimilate`` and ``judge``; `variants`: variants of the simulation, on whose mean the prior is then
    centred. The answer is compared with the simulation, or with that mean if there is no simulation. Cost: the
    ensembles of a few pairs of component and scale are decoded at markers and targets once for each step and once at
    the end, and before that three times about 2 n_latent columns; again for every marker that is left out. One whole
    field is decoded. Raises `EnsembleError` if too few ensemble members survive; `ArgumentError` if variants are given
    and there are no pairs of simulation and truth behind what is known of the model.
    """
    if variants is not None and not points.knows_changes:
        message = "`variants` must be left out: the model was not calibrated with pairs of simulation and truth"
        raise ArgumentError(message, where="variants")
    anchor = simulation if variants is None else variants.mean
    with clock.stage("encode"):
        model = points.around(anchor)
    seen = np.flatnonzero(given.markers.seen)

    def smoothed(used: IntArray) -> CalibratedPosterior:
        return CalibratedPosterior.of(given, model, used, anchor, variants)

    with clock.stage("assimilate"), _suspected(given):
        posterior, wrong, surely = _without_unlikely(smoothed, seen)
    used = np.setdiff1d(seen, list(wrong))
    with clock.stage("judge"):
        before = anchor if simulation is None else simulation
        return _result(given, used, wrong, surely, before, points.model, posterior, clock)


@contextlib.contextmanager
def _suspected(given: RegisterInput) -> Iterator[None]:
    """Add what speaks against the input to the message of an `EnsembleError` that is raised in the block."""
    try:
        yield
    except EnsembleError as error:
        error.args = ("; ".join([str(error), *given.notes]),)
        raise


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
        share = compared.share(_WRONG, float(shown.row[_WRONG]))
        if share >= _DROPPED:
            return found, dropped, surely
        worst = int(np.argmax(shown.marker_rows))
        dropped[int(used[worst])] = share
        if compared.p_value(shown.row) < compared.level:
            surely[int(used[worst])] = share
        used = np.delete(used, worst)


def _result(
    given: RegisterInput,
    seen: IntArray,
    wrong: dict[int, float],
    surely: dict[int, float],
    simulation: FloatArray | None,
    latent: LatentModel,
    posterior: CalibratedPosterior,
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
    notes = given.notes
    for i, chance in surely.items():
        notes.append(f"wrong marker: {markers.names[i]} does not fit the others (p = {chance:.1g}) and was left out")
    if simulation is not None:
        notes += _against(markers.displacement[seen], start[seen], markers.axis_std[seen])
    names = tuple(markers.names[i] for i in seen)
    compared, shown = posterior.rehearsal.calibration_set, posterior.statistics
    trust = judge_by_rehearsal(names, residual, posterior.noise, compared, shown, float(ratios.min()), notes)
    target_start = inner.predict(before[inner.nodes])
    gains = posterior.gains(target_start)
    unseen = np.setdiff1d(np.arange(len(markers)), seen)
    return LearnedRegistration(
        body=given.body,
        displacement=posterior.displacement,
        deviations=lambda: posterior.deviations(before),
        targets={
            name: Target(
                inner.reference[i],
                inner.reference[i] + posterior.target_mean[i],
                posterior.target_covariance[i],
                None if simulation is None else inner.reference[i] + target_start[i],
                gains[i][0],
                NO_MARKER if gains[i][1] else None,
                posterior.tail,
            )
            for i, name in enumerate(inner.names)
        },
        unseen={
            markers.names[i]: Target(
                markers.reference[i],
                markers.reference[i] + posterior.marker_mean[i],
                # Predicted measurement: the body's spread and the tracker's noise.
                posterior.marker_covariance[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] + np.diag(markers.axis_std[i] ** 2),
                None if simulation is None else markers.reference[i] + start[i],
            )
            for i in unseen
        },
        markers=MarkerFit(
            used=tuple(markers.names[i] for i in seen),
            dropped=tuple((markers.names[i], "wrong" if i in wrong else given.why_unseen(int(i))) for i in unseen),
            before_rms_mm=rms_length(markers.displacement[seen] - start[seen]),
            after_rms_mm=rms_length(residual),
            residual_mm={markers.names[i]: row for i, row in zip(seen, residual, strict=True)},
            inner=tuple(markers.names[i] for i in np.flatnonzero(observed.inner)),
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
        dropped_members=posterior.found.dropped,
    )


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
    """Return a latent model for a mesh, read from its folder if `model` is a path, or a shipped one for its name.

    Raises `ModelError` if it is no model, or is one for another mesh. `threads` is the number of batches decoded at
    once, 0 for all cores.
    """
    from tissuereg.phantom import SHIPPED_MODELS, shipped_model_folder

    if isinstance(model, (str, os.PathLike)):
        if str(model) in SHIPPED_MODELS:
            return kept_network(shipped_model_folder(str(model)), mesh, threads, "shipped")
        return kept_network(place("model", model, error=ModelError), mesh, threads)
    if not isinstance(getattr(model, "n_nodes", None), int):
        message = (
            f"`model` must be a folder, {', '.join(SHIPPED_MODELS)} or a model that knows a mesh, got {found(model)}"
        )
        raise ModelError(message, where="model")
    if model.n_nodes != mesh.n_nodes:
        message = f"the model must know this mesh of {mesh.n_nodes} nodes, it knows {model.n_nodes}"
        raise ModelError(message, where="model")
    return model  # type: ignore[no-any-return]
