"""Cases whose frames depend on earlier ones, or whose body is not supported by held nodes alone.

Fading memory (relaxation, drainage, viscosity) starts anew with every case, which is one load history from rest: by
then the body has been at rest long enough without its actuators. Permanent memory (softening, set) is carried through
all cases on their common clock, together with fading memory, which decays over the time between two cases.
"""

import itertools
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.load import Load
from tissuereg.errors import ConvergenceError, ExperimentError
from tissuereg.experiment.effects import Drainage, Effect, Relaxation, Set, Sliding, Softening, Swelling
from tissuereg.experiment.effects.history import Memory
from tissuereg.experiment.experiment import Case, Experiment
from tissuereg.simulation import behaviour
from tissuereg.simulation.frames import Acting, FrameSettings, Pad, Similar, solve_frames
from tissuereg.simulation.loading import distinct_states, first_frames, hangs_already, pads_of, traction_of, weight_of
from tissuereg.simulation.settings import MEMORY

#: Memory that depends on the load path alone, not on time, so that it does not change under constant load. (A set acts
#: one frame later.)
_TIMELESS = (Softening,)


@dataclass(frozen=True, eq=False)
class SolvedCase:
    """Equilibria of the frames of one case (one load history).

    `displacement` (n_frames, n_nodes, 3): displacement of the mesh's nodes, mm; NaN in frames without equilibrium;
    `forces`: by the name of every displacement actuator that is present, its force on the body, (n_frames, 3), mN;
    `failed`: number of each frame without equilibrium, with the reason; `all_displacement` (n_frames, n_element_nodes,
    3): displacement of all nodes, mm: those of the mesh, then the mid-edge nodes of ten-node elements.
    """

    displacement: FloatArray
    forces: dict[str, FloatArray]
    failed: list[tuple[int, str]]
    all_displacement: FloatArray

    def at_every_frame(self, of_frame: IntArray) -> "SolvedCase":
        """Return a case of more frames, each a copy of one of these; `of_frame` (n,) holds the copied frame's index."""
        why = dict(self.failed)
        every = self.all_displacement[of_frame]
        return SolvedCase(
            every[:, : self.displacement.shape[1]],
            {name: force[of_frame] for name, force in self.forces.items()},
            [(frame, why[solved]) for frame, solved in enumerate(of_frame.tolist()) if solved in why],
            every,
        )


def goes_through_time(experiment: Experiment) -> bool:
    """Return whether the frames of a case must be solved one after another.

    `experiment`: experiment whose effects on body, supports and actuators are applied
    (`tissuereg.experiment.effects.extended`). Result: True with memory, swelling, sliding supports, or a mesh that was
    imaged under gravity.
    """
    return hangs_already(experiment) or any(isinstance(effect, Memory | Sliding) for effect in experiment.effects)


def are_apart(experiment: Experiment) -> bool:
    """Return whether each case is a history of its own, before which nothing is solved; effects are applied."""
    grows = any(isinstance(effect, Swelling) for effect in experiment.effects)
    return goes_through_time(experiment) and not is_carried(experiment) and not grows


def remembers(experiment: Experiment) -> bool:
    """Return True if the stress depends on earlier frames, by memory (such as relaxation) or by swelling."""
    return any(isinstance(effect, Memory) for effect in experiment.effects)


def is_carried(experiment: Experiment) -> bool:
    """Return True if a case depends on earlier cases, by softening, permanent set or friction of a support."""
    return any(
        isinstance(effect, Softening | Set) or (isinstance(effect, Sliding) and effect.friction is not None)
        for effect in experiment.effects
    )


def solve_through_time(
    experiment: Experiment,
    cases: Sequence[Case],
    *,
    settings: FrameSettings | None = None,
    similar: Similar | None = None,
    progress: Callable[[int], object] | None = None,
) -> dict[str, SolvedCase]:
    """Return the equilibria of cases (load histories), solved frame after frame.

    `experiment`: with the effects on body, supports and actuators applied; `cases`: the cases to solve: with softening,
    set or friction, every case from the first one on; `settings`: elements, tolerance, threads; `similar`: solutions of
    similar models to begin from, by case; `progress`: called with the number of frames done. Result: by case name, in
    the order given, displacements in mm and forces on pads in mN, one row per frame. Raises `ConvergenceError` if no
    frame of a case finds equilibrium; `ExperimentError` if cases that depend on each other overlap in time.
    """
    groups = [sorted(cases, key=lambda case: float(case.times[0]))] if is_carried(experiment) else [[c] for c in cases]
    settings, similar = settings or FrameSettings(), similar or Similar()
    growing = _growing(experiment, settings)
    solved: dict[str, SolvedCase] = {}
    done = 0
    for group in groups:
        _refuse_overlap(group)
        frames = [frames_of_own(experiment, case) for case in group]
        fewer = [_only(case, first) for case, (first, _) in zip(group, frames, strict=True)]
        guides = similar
        if similar.near is not None:
            near = {case.name: similar.near[case.name][first] for case, (first, _) in zip(group, frames, strict=True)}
            guides = replace(similar, near=near)
        report = None if progress is None else _counting(progress, done, frames)
        found = _solve_group(experiment, fewer, growing, settings, guides, report)
        for case, (_, of_frame) in zip(group, frames, strict=True):
            solved[case.name] = found[case.name].at_every_frame(of_frame)
        done += sum(len(case.times) for case in group)
    return {case.name: solved[case.name] for case in cases}


def frames_of_own(experiment: Experiment, case: Case) -> tuple[IntArray, IntArray]:
    """Return the frames of a case that must be solved, (n_solved,), and every frame's index among them, (n_frames,).

    A frame that is not solved equals the one that its index names. `experiment`: with effects applied; `case`: one of
    its cases. If memory depends on time, all frames are solved; if it depends on the load path alone, or with friction,
    the frames whose load differs from the previous one; otherwise one frame per distinct load.
    """
    if any(isinstance(effect, Memory) and not isinstance(effect, _TIMELESS) for effect in experiment.effects):
        every = np.arange(len(case.times))
        return every, every
    of_frame = distinct_states(case)[1]
    if is_carried(experiment):
        of_frame = np.cumsum(np.diff(of_frame, prepend=of_frame[0]) != 0)
    return first_frames(of_frame), of_frame


def _only(case: Case, frames: IntArray) -> Case:
    """Return a copy of a case with some frames of its loads alone; `frames` int64 (n,): numbers of these frames."""
    return replace(
        case,
        times=case.times[frames],
        displacements={name: motion[frames] for name, motion in case.displacements.items()},
        applied_forces={name: force[frames] for name, force in case.applied_forces.items()},
    )


def _counting(
    progress: Callable[[int], object], before: int, frames: Sequence[tuple[IntArray, IntArray]]
) -> Callable[[int], None]:
    """Return a callback that takes the number of solved frames and reports how many frames they stand for.

    `progress`: receives that number; `before`: frames done earlier; `frames`: for each case the frames that are solved
    and, for every frame, its index among them.
    """
    done = before + np.cumsum(np.concatenate([[0], *(np.bincount(of_frame) for _, of_frame in frames)]))

    def report(solved: int) -> None:
        progress(int(done[solved]))

    return report


def _solve_group(
    experiment: Experiment,
    group: Sequence[Case],
    growing: "_Growing | None",
    settings: FrameSettings,
    similar: Similar,
    progress: Callable[[int], object] | None,
) -> dict[str, SolvedCase]:
    """Return the equilibria of cases that share one load history, by name: displacement in mm, forces on pads in mN.

    `group`: the cases in order of time; between two of them all pads are released; `growing`: growth that pads follow,
    or None; `settings`: elements, tolerance, threads; `similar`: solutions to begin from, by case; `progress`: called
    with frames done. Raises `ConvergenceError` if no frame of a case finds equilibrium.
    """
    standing = _standing_times(experiment, float(group[0].times[0]))
    times, loads, rows = [standing], [Load()] * len(standing), {}
    done = [0] * (len(standing) + 1)
    for number, case in enumerate(group):
        if number > 0:
            # The actuators of the previous case are released.
            times.append(group[number - 1].times[-1:])
            loads.append(Load())
            done.append(done[-1])
        rows[case.name] = slice(len(loads), len(loads) + len(case.times))
        times.append(case.times)
        loads += [Load(traction=traction_of(experiment, case, i)) for i in range(len(case.times))]
        done += range(done[-1] + 1, done[-1] + 1 + len(case.times))
    report = None if progress is None else (lambda n: progress(done[n]))
    guides = None
    if similar.near is not None:
        guides = np.full((len(loads), *next(iter(similar.near.values())).shape[1:]), np.nan)
        for name, mine in rows.items():
            guides[mine] = similar.near[name]
    acting = Acting(
        loads,
        _pads(experiment, group, rows, len(loads), growing),
        _springs(experiment),
        weight=weight_of(experiment),
        in_reference=hangs_already(experiment),
        held_nodes=_held(experiment),
    )
    found = solve_frames(
        experiment.mesh,
        experiment.material,
        np.concatenate(times),
        acting,
        behaviour=behaviour_of(experiment.effects),
        settings=settings,
        similar=replace(similar, near=guides),
        progress=report,
    )
    answers = {}
    for case in group:
        mine = rows[case.name]
        failed = [(frame - mine.start, why) for frame, why in found.failed if mine.start <= frame < mine.stop]
        if len(failed) == len(case.times):
            message = f"case '{case.name}' must have a frame that finds equilibrium; none does: {failed[0][1]}"
            raise ConvergenceError(message, where=case.name)
        forces = {pad.name: found.pad_forces[pad.name][mine] for pad in pads_of(experiment, case)}
        answers[case.name] = SolvedCase(found.displacement[mine], forces, failed, found.all_displacement[mine])
    return answers


def behaviour_of(effects: Iterable[Effect]) -> behaviour.Behaviour | None:
    """Return the inelastic behaviour given by those of some effects that are of memory or swelling; None if none is."""
    given = {}
    for effect in effects:
        if isinstance(effect, Memory):
            kind = behaviour.LAWS[effect.id]
            given[effect.id] = kind(**{key.name: getattr(effect, key.name) for key in fields(kind)})
    return behaviour.Behaviour(**given) if given else None


def _standing_times(experiment: Experiment, begin: float) -> FloatArray:
    """Return the times in s, (5,) or (0,), at which a body comes to rest under weight or growth before its first case.

    `begin`: start of the first case in s. There are none if no stress relaxes, or if the body stands without load.
    """
    fading = [tau for effect in experiment.effects if isinstance(effect, Relaxation) for tau in effect.tau_s]
    fading += [effect.tau_s for effect in experiment.effects if isinstance(effect, Drainage)]
    swells = any(isinstance(effect, Swelling) for effect in experiment.effects)
    loaded = (experiment.gravity is not None and not hangs_already(experiment)) or swells
    return begin - MEMORY.rest * max(fading) * np.arange(4.0, -1.0, -1.0) if fading and loaded else np.empty(0)


@dataclass(frozen=True, eq=False)
class _Growing:
    """Growth (swelling) of a body with held boundaries on which no pad acts.

    `swelling`: the effect, with its strain and times; `field` (n_nodes, 3): displacement by the complete growth, mm.
    """

    swelling: Swelling
    field: FloatArray

    def moved(self, nodes: IntArray, times: FloatArray) -> FloatArray:
        """Return the mean displacement of a patch of nodes by growth since the first of `times` (n,), s: (n, 3), mm.

        `nodes` (k,): numbers of the nodes of the patch.
        """
        share = self.swelling.share(times)
        return np.asarray((share - share[0])[:, None] * self.field[nodes].mean(axis=0))


def _growing(experiment: Experiment, settings: FrameSettings) -> _Growing | None:
    """Return the growth of a body whose pads follow it; None if nothing grows or pads hold their patches in place."""
    swelling = next((effect for effect in experiment.effects if isinstance(effect, Swelling)), None)
    if swelling is None or swelling.pads == "hold":
        return None
    alone = replace(experiment, effects=(swelling,))
    found = solve_frames(
        experiment.mesh,
        experiment.material,
        np.array([swelling.from_time_s, swelling.to_time_s]),
        Acting([Load(), Load()], held_nodes=experiment.mesh.fixed_nodes),
        behaviour=behaviour_of(alone.effects),
        settings=settings,
    )
    return _Growing(swelling, found.displacement[1])


def _pads(
    experiment: Experiment, group: Sequence[Case], rows: dict[str, slice], n_frames: int, growing: _Growing | None
) -> list[Pad]:
    motions: dict[str, FloatArray] = {}
    for case in group:
        for pad in pads_of(experiment, case):
            motion = motions.setdefault(pad.name, np.full((n_frames, 3), np.nan))
            motion[rows[case.name]] = case.displacements[pad.name]
            if growing is not None:
                motion[rows[case.name]] += growing.moved(pad.nodes, case.times)
    return [Pad(name, experiment.actuator(name).nodes, motion) for name, motion in motions.items()]


def _held(experiment: Experiment) -> IntArray:
    """Return the numbers of the nodes of all boundaries that do not slide, shape (n_held,)."""
    sliding = {effect.boundary for effect in experiment.effects if isinstance(effect, Sliding)}
    if not sliding:
        return experiment.mesh.fixed_nodes
    held = [boundary.nodes for boundary in experiment.boundaries if boundary.name not in sliding]
    return np.unique(np.concatenate(held)) if held else np.empty(0, np.int64)


def _springs(experiment: Experiment) -> list[behaviour.Springs]:
    unit = float(experiment.material.young_array.max()) / experiment.mesh.extent
    found = []
    for effect in experiment.effects:
        if isinstance(effect, Sliding):
            along = MEMORY.sticks * unit if effect.spring_kpa_per_mm is None else effect.spring_kpa_per_mm
            cohesion = effect.cohesion_kpa or 0.0
            found.append(
                behaviour.Springs(effect.triangles(experiment), MEMORY.across * unit, along, effect.friction, cohesion)
            )
    return found


def _refuse_overlap(group: Sequence[Case]) -> None:
    for case, following in itertools.pairwise(group):
        if following.times[0] < case.times[-1]:
            message = (
                "cases must follow each other on one clock where softening, set or friction is carried from one to the "
                f"next: '{following.name}' begins at {following.times[0]:g} s, before '{case.name}' ends at "
                f"{case.times[-1]:g} s"
            )
            raise ExperimentError(message, where=following.name)
