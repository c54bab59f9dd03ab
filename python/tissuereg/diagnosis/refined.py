"""Predictions on fine meshes: one that corrects, others that measure what error it leaves, and those of fitted causes.

Meshing and solving take long; predictions of the believed model are cached, named by a hash of all that they depend on.

The effect of a cause has a discretisation error of its own. Four-node elements lock by an amount that depends on
Poisson's ratio: on a body of 600 nodes a change of the ratio moves markers two to three times too far, and a law that
is stiffer in tension twice too far; without a correction the two cannot be distinguished. The boundary of an inclusion
cuts across elements: with a radius of 8 mm in elements of 5 mm a quarter of its effect is error. In data without noise
that displaced the fitted place by 1.9 mm, and by 0.6 mm after the correction; the fine mesh's own error is 6 %.

A fit is simulated on the fine mesh, the difference becomes part of the correction, and the model is fitted again. The
error is assumed proportional to the effect. Where the new fit is another effect rather than more or less of the same,
the correction is computed again: on 600 nodes friction slips ten times too far, and the slipping region depends on the
friction.
"""

import io
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg._base.provenance import warn
from tissuereg.diagnosis.bank import fingerprint
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import Fit, FitTarget, at_believed_modulus, fit
from tissuereg.diagnosis.predictor import NO_ANSWER, refuse_failures
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.errors import MeshError
from tissuereg.experiment.effects import Effect, extended
from tissuereg.experiment.experiment import Experiment
from tissuereg.io.cache import keep_entry, read_entry
from tissuereg.simulation.experiment import CaseSimulation
from tissuereg.simulation.fine import FineModel, third_meshes
from tissuereg.simulation.memory import remembers

#: To be increased when fine meshes give other results, so that older files are not read.
SCHEMA = 2

#: Number of cached entries, some 0.1 MB each; the oldest are deleted.
MOST_ENTRIES = 500


def flat_of(layout: SignalLayout, answers: dict[str, CaseSimulation]) -> FloatArray:
    """Return simulated cases as a flat vector (size,): marker displacements in mm and forces in mN.

    `layout`: order of the vector; `answers`: simulation of every case, by name. Frames without equilibrium are NaN.
    """
    return layout.flatten(
        {name: answer.markers for name, answer in answers.items()},
        {name: answer.forces for name, answer in answers.items()},
    )


def entry_of(experiment: Experiment) -> str:
    """Return the name of the cache entry that holds a believed model's predictions on fine meshes."""
    return f"fine_{fingerprint(experiment, f'tet10 {SCHEMA}')}"


def refined_predictions(bench: Bench, entry: str | None) -> tuple[FloatArray, FloatArray]:
    """Return the prediction of the believed model on the correcting fine mesh, and those on further fine meshes.

    `bench`: the believed model; `entry`: name of the cached entry (`entry_of`), None to use no cache. Result: (size,)
    and (thirds, size), mm and mN. Frames without equilibrium on one of them are left out of the layout, with a warning;
    the prediction on the mesh before stands there. Raises `ConvergenceError` if no frame of a case has one.
    """
    made = _simulated(bench, entry)
    _leave_out(bench.layout, np.asarray(np.isnan(made).any(axis=0)))
    fine = np.where(np.isnan(made[0]), bench.base, made[0])
    return fine, np.where(np.isnan(made[1:]), fine, made[1:])


def _simulated(bench: Bench, entry: str | None) -> FloatArray:
    """Return the predictions (1 + thirds, size) of `refined_predictions`, NaN in frames without equilibrium."""
    thirds = bench.settings.model.thirds
    kept = None if entry is None else _read(entry)
    if kept is not None and kept.shape == (1 + thirds, bench.layout.size):
        return kept
    found = []
    for number, model in enumerate(_models(bench, thirds)):
        bench.progress("fine mesh" if number == 0 else f"other mesh {number}")
        found.append(flat_of(bench.layout, model.simulate(threads=bench.predictor.threads)))
    made = np.array(found)
    if entry is not None:
        content = io.BytesIO()
        np.save(content, made)
        keep_entry(entry, content.getvalue(), MOST_ENTRIES)
    return made


def _leave_out(layout: SignalLayout, unsolved: BoolArray) -> None:
    """Count frames with entries (size,) that a fine mesh could not predict as not measured; tell which they are."""
    for part in layout.parts:
        frames = np.flatnonzero(part.markers(unsolved).any(axis=(1, 2)) | part.forces(unsolved).any(axis=(1, 2)))
        if len(frames):
            layout.leave_out(part.name, frames.tolist())
            times = f"{part.times[frames[0]]:.4g} to {part.times[frames[-1]]:.4g} s"
            warn(
                f"{len(frames)} of {part.n_frames} frames of case '{part.name}' ({times}) are left out: there the "
                "believed model has no equilibrium on a fine mesh, as where a pad presses too deep for its elements"
            )


def refined_effects(bench: Bench, effects: Sequence[Effect]) -> FloatArray | None:
    """Return the prediction (size,) of the believed model with further effects on the fine mesh, mm and mN.

    `bench`: the believed model; `effects`: in addition to those of the experiment. The result is None where the
    material has memory: such histories take minutes on a fine mesh, and the discretisation error of a memory effect is
    that of the load's own response, which the correction of the believed model contains. Frames that the layout has
    left out may be NaN. Raises `ConvergenceError` if another one has no equilibrium.
    """
    every = (*bench.experiment.effects, *effects)
    if remembers(extended(replace(bench.experiment, effects=every), bench.predictor.element)):
        return None
    answers = bench.fine.simulate(every, warm=True, threads=bench.predictor.threads)
    for name, answer in answers.items():
        left_out = bench.layout.left_out[name]
        refuse_failures(name, [failure for failure in answer.failed if failure[0] not in left_out])
    return flat_of(bench.layout, answers)


def _models(bench: Bench, thirds: int) -> Iterator[FineModel]:
    yield bench.fine
    yield from third_meshes(bench.experiment, thirds, seed=0)


def _read(entry: str) -> FloatArray | None:
    content = read_entry(entry)
    return None if content is None else np.asarray(np.load(io.BytesIO(content), allow_pickle=False))


def corrected_fit(target: FitTarget, found: Fit) -> tuple[FitTarget, Fit]:
    """Return a target whose correction covers a fitted model, and the fit to it: correct and refit until they agree.

    `target`: data, believed model and correction of the fit; `found`: fit with causes. The two given ones are
    returned where `recorrected` changes nothing.

    Notes
    -----
    Most effects need one round: in 12 fits of bodies of 600 nodes a second one at the new fit changed the log evidence
    by 1.3 at most, where the first one changed it by up to 18, and moved no parameter by more than 0.5 of its
    deviations. Friction needs six: of a test body whose friction has a size of 21 noise deviations the fit gains 51
    nats on the user's mesh, 35 after one round, 108 after six, and 103 with ten-node elements throughout.
    """
    corrected = target, found
    for _ in range(target.bench.settings.model.most_corrections):
        better = recorrected(target, corrected[1])
        start, choices = corrected[1].x, found.choices
        again = None if better is target else fit(better, found.parts, start=start, choices=choices)
        if again is None:
            break
        corrected = better, again
        if _uncorrected(better, again) < target.bench.settings.model.uncorrected:
            break
    return corrected


def _uncorrected(target: FitTarget, found: Fit) -> float:
    """Return the estimated discretisation error of a fit that its correction does not cover, in noise deviations.

    It is the error of the effect that was corrected last, times the relative size of that part of the new effect which
    is no multiple of it.
    """
    of_effect = target.correction.of_effect
    if of_effect is None:
        return 0.0
    try:
        other = of_effect.other(at_believed_modulus(target, found)[1])
    except NO_ANSWER:
        # The fit reached this model by steps from a neighbour; solved at once it has no equilibrium.
        return 0.0
    remainder, error, effect = (
        float(np.linalg.norm(target.null.reduced(target.white(np.where(target.bench.layout.seen, flat, 0.0)))))
        for flat in (other, of_effect.difference, of_effect.change)
    )
    return remainder * error / effect if effect > 0.0 else 0.0


def recorrected(target: FitTarget, found: Fit) -> FitTarget:
    """Return a target whose correction is exact for the believed model and for a fitted model with causes.

    `target`: data, believed model and correction of the fit; `found`: fit with causes. The given target is returned
    where the modulus does more than scale forces, where all causes are errors of the tracker or one is memory, where
    the fine mesh has no equilibrium, and for data that were simulated on the user's mesh.
    """
    bench = target.bench
    if not bench.settings.model.corrected or bench.is_exact or not target.scales_forces(found.ids):
        return target
    if all(CAUSES[name].closed_form for name in found.ids):
        return target
    bench.progress(f"fine mesh with {' + '.join(found.ids)}")
    try:
        effects, coarse = at_believed_modulus(target, found)
        fine = refined_effects(bench, effects)
    except (*NO_ANSWER, MeshError):
        return target
    if fine is None:
        return target
    std = np.full(bench.layout.size, target.noise.force_std)
    for case in bench.layout.parts:
        case.markers(std)[:] = target.noise.marker_std[:, None]
    # Where nothing counts as measured there may be nothing that was simulated.
    fine = np.where(np.isfinite(fine), fine, target.correction.corrected(coarse))
    return replace(target, correction=target.correction.with_effect(bench.base, coarse, fine, std))
