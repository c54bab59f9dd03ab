"""Predictions of an experiment's believed model (as the user states it): for a frame, a case, or all cases.

A case is one load history and a frame one moment of it. If the model is elastic, a frame depends on its own load alone,
and all frames of a case are solved in parallel. With memory, sliding supports, or a mesh that was imaged under gravity
they are solved one after another (`memory`).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Element
from tissuereg.body.load import Load
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.errors import ConvergenceError
from tissuereg.experiment.effects import extended, seen_markers
from tissuereg.experiment.experiment import Actuator, Case, Experiment
from tissuereg.simulation.frames import FrameSettings, Similar
from tissuereg.simulation.loading import distinct_states, first_frames, hangs_already, pads_of, traction_of, weight_of
from tissuereg.simulation.memory import SolvedCase, goes_through_time, solve_through_time
from tissuereg.simulation.settings import SIZE
from tissuereg.simulation.solve import Simulator


@dataclass(frozen=True, eq=False)
class Believed:
    """One case of an experiment, ready to be solved: the analysed body and its loads.

    `simulator`: solver in which the nodes of fixed boundaries and bonded pads are held; `loads`: one per frame, with
    the displacement of the held nodes in mm.
    """

    simulator: Simulator
    loads: list[Load]


@dataclass(frozen=True, eq=False)
class CaseSimulation:
    """Prediction of the believed model (as the user states it) for one case (one load history) of an experiment.

    Attributes
    ----------
    times : ndarray of float64, shape (n_frames,)
        Time of every frame in s.
    displacement : ndarray of float64, shape (n_frames, n_nodes, 3)
        Displacement of the mesh's nodes in mm; NaN in frames without equilibrium.
    markers : ndarray of float64, shape (n_frames, n_markers, 3)
        Places of the markers in mm, as the tracker sees them, modelled errors of the tracker included.
    forces : dict of str to ndarray of float64, shape (n_frames, 3)
        Force on the body at every displacement actuator that is present, by its name, mN.
    targets : dict of str to ndarray of float64, shape (n_frames, 3)
        Places of the targets (inner points of the body) in mm, by name.
    failed : list of (int, str)
        Frames without equilibrium, with the reason.
    """

    times: FloatArray
    displacement: FloatArray
    markers: FloatArray
    forces: dict[str, FloatArray]
    targets: dict[str, FloatArray]
    failed: list[tuple[int, str]]


#: Analysed bodies of one mesh by elements and held nodes, cached by callers that need many solutions.
Simulators = dict[tuple[str, bytes], Simulator]


def believed_case(
    experiment: Experiment,
    case: Case,
    *,
    element: Element = "tet4",
    threads: int = 0,
    simulators: Simulators | None = None,
) -> Believed:
    """Return the solver's input for a case (load history): the analysed body, and the load of every frame.

    `experiment`: the model as the user states it, effects applied (`tissuereg.experiment.effects.extended`); `case`:
    one of its cases; `element` {"tet4", "tet4-averaged", "tet10"}: elements to use; `threads`: threads to use; 0 takes
    all cores; `simulators`: cache of simulators of the same mesh, by element and held nodes, to which new ones are
    added and from which the least recently used go. A pad is bonded to the shape that the body has when the case
    begins: with gravity acting, the sagged one. A weight under which the mesh was imaged is left out: it is in balance
    there, and its influence on the response to other loads is neglected. `simulate_plain` includes it. Raises
    `ConvergenceError` if the body's own weight finds no equilibrium.
    """
    mesh = experiment.mesh
    pads = pads_of(experiment, case)
    fixed = mesh.fixed_nodes
    held = np.unique(np.concatenate([fixed, *(pad.nodes for pad in pads)]))
    weight = None if hangs_already(experiment) else weight_of(experiment)
    sag = np.zeros((mesh.n_nodes, 3))
    if weight is not None and pads:
        sag = (
            Simulator(mesh, element=element)
            .solve(Load(body_force=weight), experiment.material, threads=threads)
            .displacement
        )
    key = (element, held.tobytes())
    simulator = None if simulators is None else simulators.get(key)
    if simulator is None or simulator.mesh is not mesh:
        simulator = Simulator(mesh, element=element, held_nodes=held)
    if simulators is not None:
        simulators.pop(key, None)
        simulators[key] = simulator
        for oldest in list(simulators)[: -SIZE.rigs_kept]:
            simulators.pop(oldest, None)
    return Believed(simulator, _loads(experiment, case, pads, held, sag, weight))


def simulate_plain(
    experiment: Experiment,
    *,
    element: Element = "tet4",
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, CaseSimulation]:
    """Return the prediction of an experiment's model for every case (load history), on the mesh as it is.

    `experiment`: the model as the user states it, with its effects; `element` {"tet4", "tet4-averaged", "tet10"}:
    elements to use; `threads`: threads to use; 0 takes all cores. The result does not depend on it; `progress`: called
    with frames done and frames in all. Result: one prediction per case, by name in the experiment's order:
    displacements and places in mm, forces in mN. Raises `ConvergenceError` if no frame of a case finds equilibrium, or
    a mesh that was imaged under gravity has no unloaded shape; `ExperimentError` if an effect does not fit the
    experiment, or cases that depend on each other overlap in time.
    """
    experiment = extended(experiment, element)
    markers = MarkerObservation(experiment.mesh, experiment.marker_reference, experiment.marker_names)
    targets = TargetObservation(experiment.mesh, experiment.targets)
    settings = FrameSettings(element, threads=threads)
    solved = solve_cases(experiment, list(experiment.cases.values()), settings=settings, progress=progress)
    answers = {}
    for name, case in experiment.cases.items():
        field = solved[name].displacement
        places = experiment.marker_reference + markers.predict(field[:, markers.nodes])
        inner = targets.reference + targets.predict(field[:, targets.nodes])
        answers[name] = CaseSimulation(
            case.times,
            field,
            seen_markers(experiment, places, case.times),
            solved[name].forces,
            {target: inner[:, i] for i, target in enumerate(targets.names)},
            solved[name].failed,
        )
    return answers


def solve_cases(
    experiment: Experiment,
    cases: Sequence[Case],
    *,
    settings: FrameSettings | None = None,
    similar: Similar | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, SolvedCase]:
    """Return the equilibria of cases (load histories): elastic frames in parallel, frames with memory in order.

    `experiment`: with effects applied (`tissuereg.experiment.effects.extended`); `cases`: some of its cases;
    `settings`: elements, tolerance, threads. The result does not depend on the threads; `similar`: solutions of similar
    models to save work: displacements by case if frames are solved in order, cached simulators if they are elastic;
    `progress`: called with frames done and frames in all. Result: by case name, displacements in mm and forces on pads
    in mN, one row per frame. Raises `ConvergenceError` if no frame of a case finds equilibrium, or a mesh that was
    imaged under gravity has no unloaded shape; `ExperimentError` if cases that depend on each other overlap in time.
    """
    in_all = sum(len(case.times) for case in cases)
    if goes_through_time(experiment):
        through = None if progress is None else (lambda n: progress(n, in_all))
        return solve_through_time(experiment, cases, settings=settings, similar=similar, progress=through)
    how, simulators = settings or FrameSettings(), None if similar is None else similar.simulators
    done, solved = 0, {}
    for case in cases:
        report = None if progress is None else (lambda n, before=done: progress(before + n, in_all))
        believed = believed_case(experiment, case, element=how.element, threads=how.threads, simulators=simulators)
        solved[case.name] = _solve_elastic(experiment, case, believed, how, report)
        done += len(case.times)
    return solved


def _solve_elastic(
    experiment: Experiment,
    case: Case,
    believed: Believed,
    how: FrameSettings,
    progress: Callable[[int], None] | None,
) -> SolvedCase:
    """Return the equilibria of a case's frames, solved independently and in parallel: displacement in mm, forces in mN.

    `believed`: the analysed body and the load of every frame; `how`: tolerance and threads; `progress`: called with
    frames done. Frames of equal load are solved once. Raises `ConvergenceError` if no frame finds equilibrium.
    """
    simulator = believed.simulator
    _, state_of = distinct_states(case)
    loads = [believed.loads[frame] for frame in first_frames(state_of)]
    report = None if progress is None else (lambda n: progress(n * len(state_of) // len(loads)))
    materials = [experiment.material] * len(loads)
    found = simulator.solve_many(loads, materials, tolerance=how.tolerance, threads=how.threads, progress=report)
    if len(found.failed) == len(loads):
        message = f"case '{case.name}' must have a frame that finds equilibrium; none does: {found.failed[0][1]}"
        raise ConvergenceError(message, where=case.name)
    forces = {
        pad.name: found.reactions[:, np.isin(simulator.held_nodes, pad.nodes)].sum(axis=1)
        for pad in pads_of(experiment, case)
    }
    solved = SolvedCase(found.displacement, forces, found.failed, found.all_displacement)
    return solved.at_every_frame(state_of)


def _loads(
    experiment: Experiment,
    case: Case,
    pads: list[Actuator],
    held: IntArray,
    sag: FloatArray,
    weight: FloatArray | None,
) -> list[Load]:
    """Return the load of every frame of a case: displacement of the held nodes (n_held, 3), weight and tractions.

    `pads`: displacement actuators of the case; `held` (n_held,): numbers of the held nodes; `sag` (n_nodes, 3):
    displacement in mm under the body's weight, from which pads move; `weight` (3,): body force in mN/mm^3, or None.
    """
    rows = [np.flatnonzero(np.isin(held, pad.nodes)) for pad in pads]
    fixed = np.isin(held, experiment.mesh.fixed_nodes)
    loads = []
    for frame in range(len(case.times)):
        prescribed = np.zeros((len(held), 3))
        for pad, mine in zip(pads, rows, strict=True):
            prescribed[mine] = sag[held[mine]] + case.displacements[pad.name][frame]
        prescribed[fixed] = 0.0
        loads.append(Load(body_force=weight, prescribed=prescribed, traction=traction_of(experiment, case, frame)))
    return loads


def with_noise(
    experiment: Experiment, answers: Mapping[str, CaseSimulation], *, seed: int = 0
) -> dict[str, CaseSimulation]:
    """Return simulated cases with measurement noise.

    `experiment`: experiment that states the standard deviations of markers (mm) and forces (mN); `answers`: predictions
    without noise, by case; `seed`: seed of all random numbers. Result: the same predictions with white normal noise on
    the markers, and on the forces if their standard deviation is stated; targets and displacements are unchanged.
    """
    generator = np.random.default_rng([seed, 6])
    std = experiment.force_std or 0.0
    noisy = {}
    for name, answer in answers.items():
        markers = answer.markers + experiment.marker_std * generator.standard_normal(answer.markers.shape)
        forces = {pad: force + std * generator.standard_normal(force.shape) for pad, force in answer.forces.items()}
        noisy[name] = replace(answer, markers=markers, forces=forces)
    return noisy
