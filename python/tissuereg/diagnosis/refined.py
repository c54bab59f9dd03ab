"""Predictions on fine meshes: one that corrects, others that measure what error it leaves, and those of fitted causes.

Meshing and solving take long; predictions of the believed model are cached, named by a hash of all that they depend on.

The effect of a cause has a discretisation error of its own. Four-node elements lock by an amount that depends on
Poisson's ratio: on a body of 600 nodes a change of the ratio moves markers two to three times too far, and a law that
is stiffer in tension twice too far; without a correction the two cannot be distinguished. An inclusion of 8 mm radius
in elements of 5 mm was displaced by 1.9 mm, and by 0.6 mm after the correction.

A fit is therefore simulated on the fine mesh, the difference becomes part of the correction, and the model is fitted
again. The error is assumed proportional to the effect; where the new fit is another effect, it is computed again.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.provenance import warn
from tissuereg.diagnosis.bench import Bench, OnFineMeshes, Targets
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import Fit, FitTarget, at_believed_modulus, fit
from tissuereg.diagnosis.predictor import FINE_SCHEMA, NO_ANSWER, fingerprint, refuse_failures
from tissuereg.diagnosis.signals import CasePart, SignalLayout
from tissuereg.errors import ConvergenceError, MeshError, TissueRegError
from tissuereg.experiment.effects import EFFECTS, ChainEffect, Effect, Stiffness
from tissuereg.experiment.effects.history import Memory
from tissuereg.experiment.experiment import Case, Experiment
from tissuereg.io.cache import keep_arrays, read_arrays
from tissuereg.io.json import dumps
from tissuereg.simulation.experiment import CaseSimulation, simulate_plain
from tissuereg.simulation.fine import FineModel, third_meshes
from tissuereg.simulation.memory import remembers

#: Number of cached entries, some 0.1 MB each; the oldest are deleted.
MOST_ENTRIES = 500


def flat_of(layout: SignalLayout, answers: Mapping[str, CaseSimulation]) -> FloatArray:
    """Return simulated cases, by name, as a flat vector (size,), mm and mN; frames without equilibrium are NaN."""
    return layout.flatten(
        {name: answer.markers for name, answer in answers.items()},
        {name: answer.forces for name, answer in answers.items()},
    )


def targets_of(answers: Mapping[str, CaseSimulation]) -> Targets:
    """Return the places of the inner targets in simulated cases, mm."""
    return {name: answer.targets for name, answer in answers.items()}


def entry_of(experiment: Experiment) -> str:
    """Return the name of the cache entry that holds a believed model's predictions on fine meshes."""
    targets = {name: place.tolist() for name, place in experiment.targets.items()}
    return f"fine_{fingerprint(experiment, f'tet10 {FINE_SCHEMA} {dumps(targets)}')}"


def refined_predictions(bench: Bench, entry: str | None) -> tuple[FloatArray, FloatArray]:
    """Return the prediction of the believed model on the correcting fine mesh, and those on further fine meshes.

    Result: (size,) and (thirds, size), mm and mN. `entry`: name of the cached entry (`entry_of`), None to use no cache.
    Raises `ConvergenceError` if a frame has no equilibrium (`solvable`).
    """
    made = _simulated(bench, entry).flat
    for part in bench.layout.parts:
        refuse_failures(part.name, [(int(frame), "no equilibrium on a fine mesh") for frame in _unsolved(part, made)])
    return made[0], made[1:]


def solvable(bench: Bench, *, keep: bool = True) -> Bench:
    """Return the believed model of an experiment whose cases end before frames that no fine mesh can predict.

    It is `bench` itself where there are none; else there is a warning. A prediction of later frames on the user's mesh
    would have gone through a state that is none of the body's, and with memory would keep it. `keep`: whether the cache
    is used. Raises `ConvergenceError` if no loaded frame has an equilibrium, or no frame of a case.
    """
    simulated = _simulated(bench, entry_of(bench.experiment) if keep else None)
    made, targets = simulated.flat, dict(simulated.targets)
    cases, kept = dict(bench.experiment.cases), np.ones(bench.layout.size, bool)
    for part in bench.layout.parts:
        frames = _unsolved(part, made)
        if not len(frames):
            continue
        # A case of one frame is at rest.
        first = int(frames[0])
        n_kept = first if first > 1 else 0
        part.put(kept, np.arange(part.n_frames) < n_kept)
        cases[part.name] = _until(cases[part.name], n_kept)
        targets[part.name] = _cut(targets[part.name], n_kept)
        if not n_kept:
            del cases[part.name]
        what = f"{part.n_frames - n_kept} of {part.n_frames} frames" if n_kept else f"all {part.n_frames} frames"
        warn(
            f"{what} of case '{part.name}' are left out: from {part.times[first]:.4g} s on the believed model has no "
            "equilibrium on a fine mesh, as where a pad presses too deep for its elements"
        )
    if kept.all():
        return bench
    given = (one for case in cases.values() for one in (case.displacements, case.applied_forces))
    if not any(np.any(motion) for motions in given for motion in motions.values()):
        message = f"experiment '{bench.experiment.name}' must have a loaded frame with an equilibrium on a fine mesh"
        raise ConvergenceError(message)
    shorter = bench.of(replace(bench.experiment, cases=cases))
    if bench.is_elastic:
        shorter.on_fine_meshes = OnFineMeshes(made[:, kept], targets)
    return shorter


def _until(case: Case, frame: int) -> Case:
    """Return a case up to a frame, without it."""
    named = ("displacements", "applied_forces", "forces", "targets")
    shorter: dict[str, Any] = {name: _cut(getattr(case, name), frame) for name in named}
    return replace(case, times=case.times[:frame], markers=case.markers[:frame], **shorter)


def _cut(of: Mapping[str, FloatArray], frame: int) -> dict[str, FloatArray]:
    return {name: rows[:frame] for name, rows in of.items()}


def _unsolved(part: CasePart, made: FloatArray) -> IntArray:
    """Return the frames of a case without equilibrium in one of several predictions (n, size)."""
    lost = np.asarray(np.isnan(made).any(axis=0))
    return np.flatnonzero(part.markers(lost).any(axis=(1, 2)) | part.forces(lost).any(axis=(1, 2)))


def _simulated(bench: Bench, entry: str | None) -> OnFineMeshes:
    """Return the predictions on all fine meshes, 1 + thirds of them."""
    if bench.on_fine_meshes is not None:
        return bench.on_fine_meshes
    thirds = bench.settings.model.thirds
    kept = None if entry is None else _read(bench, entry)
    if kept is not None and kept.flat.shape == (1 + thirds, bench.layout.size):
        bench.on_fine_meshes = kept
        return kept
    found: list[FloatArray] = []
    targets: Targets = {}
    for number, model in enumerate(_models(bench, thirds)):
        bench.progress("fine mesh" if number == 0 else f"other mesh {number}")
        answers = model.simulate(threads=bench.predictor.threads)
        found.append(flat_of(bench.layout, answers))
        targets = targets or targets_of(answers)
    made = bench.on_fine_meshes = OnFineMeshes(np.array(found), targets)
    if entry is not None:
        names = list(bench.experiment.targets)
        places = {f"targets of {case}": np.array([of[name] for name in names]) for case, of in targets.items()}
        keep_arrays(entry, {"flat": made.flat, **places}, MOST_ENTRIES)
    return made


def refined_effects(bench: Bench, effects: Sequence[Effect]) -> FloatArray:
    """Return the prediction (size,), mm and mN, on the fine mesh, with effects in addition to those of the experiment.

    Raises `ConvergenceError` if a frame has no equilibrium.
    """
    every = (*bench.experiment.effects, *effects)
    answers = bench.fine.simulate(every, warm=True, threads=bench.predictor.threads)
    for name, answer in answers.items():
        refuse_failures(name, answer.failed)
    return flat_of(bench.layout, answers)


def refined_targets(bench: Bench, effects: Sequence[Effect]) -> tuple[Targets, Targets | None]:
    """Return where believed model and model with further effects predict the inner targets, mm.

    Both are predictions on the fine mesh. Where memory comes with the effects, the second is that of the user's mesh,
    corrected by what the fine mesh changes under the other effects; it is None where there is no equilibrium.
    """
    plain = partial(simulate_plain, element=bench.predictor.element, threads=bench.predictor.threads)
    believed, all_effects = bench.experiment, (*bench.experiment.effects, *effects)
    exact = bench.is_exact or not bench.settings.model.corrected
    before = targets_of(plain(believed)) if exact else _simulated(bench, None).targets

    def moves(effect: Effect) -> bool:
        """Whether an effect moves targets: one of the tracker does not, nor a modulus that only scales forces."""
        return not isinstance(effect, ChainEffect) and not (isinstance(effect, Stiffness) and bench.scales_forces)

    if not any(moves(effect) for effect in effects):
        return before, before
    bench.progress("inner targets")
    try:
        if exact:
            return before, targets_of(plain(replace(believed, effects=all_effects)))
        others = [effect for effect in effects if not isinstance(effect, Memory)]
        if bench.is_elastic and len(others) < len(effects):
            lasting = (*believed.effects, *others)
            rough, slow = (targets_of(plain(replace(believed, effects=some))) for some in (lasting, all_effects))
            fine = _targets_with(bench, lasting) if any(moves(effect) for effect in others) else before
            return before, {
                case: {name: places + fine[case][name] - rough[case][name] for name, places in of.items()}
                for case, of in slow.items()
            }
        return before, _targets_with(bench, all_effects)
    except TissueRegError:  # no equilibrium, no prediction
        return before, None


def _targets_with(bench: Bench, effects: Sequence[Effect]) -> Targets:
    """Return the places of the targets on the fine mesh under effects, which replace those of the experiment."""
    return targets_of(bench.fine.simulate(effects, warm=True, threads=bench.predictor.threads))


def _models(bench: Bench, thirds: int) -> Iterator[FineModel]:
    yield bench.fine
    yield from third_meshes(bench.experiment, thirds, seed=0)


def _read(bench: Bench, entry: str) -> OnFineMeshes | None:
    kept, experiment = read_arrays(entry), bench.experiment
    if kept is None:
        return None
    places = {case: kept[f"targets of {case}"] for case in experiment.cases}
    targets = {case: dict(zip(experiment.targets, rows, strict=True)) for case, rows in places.items()}
    return OnFineMeshes(kept["flat"], targets)


def corrected_fit(target: FitTarget, found: Fit) -> tuple[FitTarget, Fit]:
    """Return a target whose correction covers a fitted model, and the fit to it: correct and refit until they agree.

    The two given ones are returned where `recorrected` changes nothing. Most effects need one round: in 12 fits of
    bodies of 600 nodes a second one changed the log evidence by 1.3 at most, where the first one changed it by up to
    18. Friction needs six: on such a mesh it slips ten times too far, and where it slips depends on the friction.
    """
    corrected = target, found
    for _ in range(target.bench.settings.model.most_corrections):
        better = recorrected(target, corrected[1])
        near = corrected[1].near
        again = None if better is target else fit(better, found.parts, choices=found.choices, near=near)
        if again is None:
            break
        corrected = better, again
        if _uncorrected(better, again) < target.bench.settings.model.uncorrected:
            break
    return corrected


def _uncorrected(target: FitTarget, found: Fit) -> float:
    """Return the estimated discretisation error of a fit that its correction does not cover, in noise deviations."""
    of_effect = target.correction.of_effect
    if of_effect is None:
        return 0.0
    try:
        other = of_effect.other(at_believed_modulus(target, found)[1])
    except NO_ANSWER:
        # The fit reached this model by steps from a neighbour; solved at once it has no equilibrium.
        return 0.0
    # The error of the effect corrected last, times the relative size of what in the new effect is no multiple of it.
    remainder, error, effect = (
        float(np.linalg.norm(target.null.reduced(target.white(np.where(target.bench.layout.seen, flat, 0.0)))))
        for flat in (other, of_effect.difference, of_effect.change)
    )
    return remainder * error / effect if effect > 0.0 else 0.0


def correctable(target: FitTarget, ids: Sequence[str]) -> bool:
    """Return whether the discretisation error of causes, given by their ids, can be corrected.

    It cannot where the modulus does more than scale forces, where all causes are errors of the tracker or there is
    none, for data that were simulated on the user's mesh, and where `settings.model.corrected` is off. With memory it
    is not: such histories take minutes on a fine mesh, and the error is that of the load's own response, which is
    corrected.
    """
    bench = target.bench
    if not bench.settings.model.corrected or bench.is_exact or not target.scales_forces(ids):
        return False
    if any(issubclass(EFFECTS[name], Memory) for name in ids) or remembers(bench.experiment):
        return False
    return not all(CAUSES[name].closed_form for name in ids)


def recorrected(target: FitTarget, found: Fit) -> FitTarget:
    """Return a target whose correction is exact for the believed model and for a fitted model with causes.

    It is the given one where there is nothing to correct (`correctable`) and where the fine mesh has no equilibrium.
    """
    bench = target.bench
    if not correctable(target, found.ids):
        return target
    bench.progress(f"fine mesh with {' + '.join(found.ids)}")
    try:
        effects, coarse = at_believed_modulus(target, found)
        fine = refined_effects(bench, effects)
    except (*NO_ANSWER, MeshError):
        return target
    std = np.full(bench.layout.size, target.noise.force_std)
    for case in bench.layout.parts:
        case.markers(std)[:] = target.noise.marker_std[:, None]
    # Where nothing counts as measured there may be nothing that was simulated.
    fine = np.where(np.isfinite(fine), fine, target.correction.corrected(coarse))
    return replace(target, correction=target.correction.with_effect(bench.base, coarse, fine, std))
