"""What an experiment's believed model says: of one frame, of a case, of all of it.

The model is elastic, so a frame depends on its own load alone and all frames of a case are solved in parallel. Only a
mesh that hangs in gravity already is solved frame by frame, from its unloaded shape.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray, IntArray
from tissuereg.effects import extended, seen_markers
from tissuereg.errors import ConvergenceError
from tissuereg.experiment import Actuator, Case, Experiment
from tissuereg.load import Load
from tissuereg.observe import MarkerObservation, TargetObservation
from tissuereg.simulate.frames import Pad, solve_frames
from tissuereg.simulate.solve import Simulator


@dataclass(frozen=True, eq=False)
class Believed:
    """One case of an experiment, ready to be solved.

    Attributes
    ----------
    simulator : Simulator
        With fixed boundaries and bonded pads held.
    loads : list of Load
        One a frame.
    """

    simulator: Simulator
    loads: list[Load]


@dataclass(frozen=True, eq=False)
class CaseSimulation:
    """What the believed model says of one case.

    Attributes
    ----------
    times : ndarray of float64, shape (n_frames,)
        s.
    displacement : ndarray of float64, shape (n_frames, n_nodes, 3)
        mm; NaN in frames without equilibrium.
    markers : ndarray of float64, shape (n_frames, n_markers, 3)
        Places of the markers in mm, as the tracker sees them.
    forces : dict of str to ndarray of float64, shape (n_frames, 3)
        Force on the body at every displacement actuator that is present, mN.
    targets : dict of str to ndarray of float64, shape (n_frames, 3)
        Places of the targets in mm.
    failed : list of (int, str)
        Frames without equilibrium, with the reason.
    """

    times: FloatArray
    displacement: FloatArray
    markers: FloatArray
    forces: dict[str, FloatArray]
    targets: dict[str, FloatArray]
    failed: list[tuple[int, str]]


def believed_case(experiment: Experiment, case: Case, *, element: str = "tet4", threads: int = 0) -> Believed:
    """Return the solver's view of a case: who is held, what acts in every frame.

    Parameters
    ----------
    experiment : Experiment
        What is believed, effects worked in (`tissuereg.effects.extended`).
    case : Case
        One of its cases.
    element : {"tet4", "tet10"}
        Elements to use.
    threads : int
        Threads to use; 0 takes all cores.

    Returns
    -------
    Believed
        A pad is bonded to the shape that the body has when the case begins: with gravity acting, the sagged one.
        A weight that acts in the mesh as given already is left out: it is in balance there, and what it changes of
        the answer to other loads is not seen. `simulate_experiment` sees it.

    Raises
    ------
    ConvergenceError
        If the body's own weight finds no equilibrium.
    """
    mesh = experiment.mesh
    pads = _pads(experiment, case)
    fixed = mesh.fixed_nodes
    held = np.unique(np.concatenate([fixed, *(pad.nodes for pad in pads)]))
    weight, sag = _weight(experiment), np.zeros((mesh.n_nodes, 3))
    if weight is not None and pads:
        sag = (
            Simulator(mesh, element=element)
            .solve(Load(body_force=weight), experiment.material, threads=threads)
            .displacement
        )
    simulator = Simulator(mesh, element=element, held_nodes=held)
    return Believed(simulator, [_load(experiment, case, pads, held, sag, weight, i) for i in range(len(case.times))])


def simulate_experiment(
    experiment: Experiment,
    *,
    element: str = "tet4",
    threads: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> dict[str, CaseSimulation]:
    """Return what the believed model says of every case, its effects included.

    Parameters
    ----------
    experiment : Experiment
        What is believed.
    element : {"tet4", "tet10"}
        Elements to use.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    progress : callable of (int, int), optional
        Called with frames done and frames in all.

    Returns
    -------
    dict of str to CaseSimulation
        One a case, in the experiment's order.

    Raises
    ------
    ConvergenceError
        If no frame of a case finds equilibrium, or a mesh that hangs in gravity already has no unloaded shape.
    ExperimentError
        If an effect does not fit the experiment.
    """
    experiment = extended(experiment, element)
    markers = MarkerObservation(experiment.mesh, experiment.marker_reference, experiment.marker_names)
    targets = TargetObservation(experiment.mesh, experiment.targets)
    in_all = sum(len(case.times) for case in experiment.cases.values())
    done, answers = 0, {}
    for name, case in experiment.cases.items():
        report = None if progress is None else (lambda n, before=done: progress(before + n, in_all))
        answers[name] = _simulate_case(experiment, case, markers, targets, element, threads, report)
        done += len(case.times)
    return answers


def _simulate_case(
    experiment: Experiment,
    case: Case,
    markers: MarkerObservation,
    targets: TargetObservation,
    element: str,
    threads: int,
    progress: Callable[[int], None] | None,
) -> CaseSimulation:
    solve = _hanging if experiment.gravity is not None and experiment.gravity.in_reference else _standing
    field, forces, failed = solve(experiment, case, element, threads, progress)
    if len(failed) == len(case.times):
        message = f"case '{case.name}' must have a frame that finds equilibrium; none does: {failed[0][1]}"
        raise ConvergenceError(message, where=case.name)
    moved = targets.predict(field[:, targets.nodes])
    return CaseSimulation(
        case.times,
        field,
        seen_markers(experiment, experiment.marker_reference + markers.predict(field[:, markers.nodes]), case.times),
        forces,
        {name: targets.reference[i] + moved[:, i] for i, name in enumerate(targets.names)},
        failed,
    )


#: Displacement of all frames, force of every pad, frames that failed.
_Solved = tuple[FloatArray, dict[str, FloatArray], list[tuple[int, str]]]


def _standing(
    experiment: Experiment, case: Case, element: str, threads: int, progress: Callable[[int], None] | None
) -> _Solved:
    believed = believed_case(experiment, case, element=element, threads=threads)
    simulator = believed.simulator
    materials = [experiment.material] * len(believed.loads)
    found = simulator.solve_many(believed.loads, materials, threads=threads, progress=progress)
    forces = {
        pad.name: found.reactions[:, np.isin(simulator.held_nodes, pad.nodes)].sum(axis=1)
        for pad in _pads(experiment, case)
    }
    return found.displacement, forces, found.failed


def _hanging(
    experiment: Experiment, case: Case, element: str, threads: int, progress: Callable[[int], None] | None
) -> _Solved:
    found = solve_frames(
        experiment.mesh,
        experiment.material,
        case.times,
        loads=[Load(traction=_traction(experiment, case, i)) for i in range(len(case.times))],
        pads=[Pad(pad.name, pad.nodes, case.displacements[pad.name]) for pad in _pads(experiment, case)],
        weight=None
        if experiment.gravity is None
        else experiment.material.weight(experiment.gravity.direction, experiment.gravity.g_mm_per_s2),
        in_reference=True,
        element=element,
        threads=threads,
        progress=progress,
    )
    return found.displacement, found.pad_forces, found.failed


def _pads(experiment: Experiment, case: Case) -> list[Actuator]:
    return [a for a in experiment.actuators if a.kind == "displacement" and a.name in case.displacements]


def _weight(experiment: Experiment) -> FloatArray | None:
    gravity = experiment.gravity
    if gravity is None or gravity.in_reference:
        return None
    return experiment.material.weight(gravity.direction, gravity.g_mm_per_s2)


def _load(
    experiment: Experiment,
    case: Case,
    pads: list[Actuator],
    held: IntArray,
    sag: FloatArray,
    weight: FloatArray | None,
    frame: int,
) -> Load:
    prescribed = np.zeros((len(held), 3))
    for pad in pads:
        rows = np.flatnonzero(np.isin(held, pad.nodes))
        prescribed[rows] = sag[held[rows]] + case.displacements[pad.name][frame]
    prescribed[np.isin(held, experiment.mesh.fixed_nodes)] = 0.0
    return Load(body_force=weight, prescribed=prescribed, traction=_traction(experiment, case, frame))


def _traction(experiment: Experiment, case: Case, frame: int) -> tuple[IntArray, FloatArray] | None:
    triangles, tractions = [], []
    for pad in experiment.actuators:
        if pad.kind == "force" and pad.name in case.applied_forces:
            patch, area = _patch(experiment, pad)
            triangles.append(patch)
            tractions.append(np.broadcast_to(case.applied_forces[pad.name][frame] / area, (len(patch), 3)))
    return (np.concatenate(triangles), np.concatenate(tractions)) if triangles else None


def _patch(experiment: Experiment, pad: Actuator) -> tuple[IntArray, float]:
    """Return the boundary triangles of a force actuator's patch and their area in mm^2."""
    mesh = experiment.mesh
    inside = np.isin(mesh.surface, pad.nodes)
    # A patch smaller than a triangle still loads the triangles around its nodes.
    rows = inside.all(axis=1) if inside.all(axis=1).any() else inside.any(axis=1)
    triangles = mesh.surface[rows]
    corners = mesh.nodes[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return triangles, float(0.5 * np.linalg.norm(normal, axis=1).sum())
