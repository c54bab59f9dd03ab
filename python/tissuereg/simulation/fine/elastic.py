"""Frames of an elastic case (load history) on a fine mesh: every distinct load is solved once, along the ramp."""

from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.errors import ConvergenceError, LoadError
from tissuereg.experiment.experiment import Case, Experiment
from tissuereg.simulation.experiment import believed_case
from tissuereg.simulation.loading import distinct_states, pads_of
from tissuereg.simulation.memory import SolvedCase
from tissuereg.simulation.settings import FINE
from tissuereg.simulation.solve import Simulator


def solve_states(
    experiment: Experiment,
    case: Case,
    *,
    element: Element = "tet10",
    tolerance: float = FINE.tolerance,
    threads: int = 0,
    near: FloatArray | None = None,
    progress: Callable[[int], object] | None = None,
) -> SolvedCase:
    """Return the equilibria of a case (load history) whose frames depend on their own load alone.

    `experiment`: experiment on a fine mesh, effects applied; `case`: one of its cases; `element` {"tet4",
    "tet4-averaged", "tet10"}: elements to use; `tolerance`: norm of the residual over the norm of the load; `threads`:
    threads to use; 0 takes all cores. The result does not depend on it; `near` (n_states, n_element_nodes, 3):
    displacement of a similar model in mm, one row per distinct load (state) of the case in the order of first
    appearance; NaN if unknown; `progress`: called with frames done. Result: displacement in mm and forces on pads in mN
    per frame; frames of equal load have equal rows. Raises `ConvergenceError` if no frame finds equilibrium.

    Notes
    -----
    The initial guess of a state is extrapolated from earlier states with collinear loads, with zero displacement at no
    load. This avoids load steps for a pad's sudden motion in the small elements at its rim. The field of a similar
    model is a better guess.
    """
    believed = believed_case(experiment, case, element=element, threads=threads)
    simulator = believed.simulator
    states, of_frame = distinct_states(case)
    pads = pads_of(experiment, case)
    n_nodes = simulator.body.n_nodes
    field = np.full((len(case.times), n_nodes, 3), np.nan)
    forces = {pad.name: np.full((len(case.times), 3), np.nan) for pad in pads}
    solved: list[tuple[FloatArray, FloatArray]] = []
    nothing = np.zeros((n_nodes, 3)), np.zeros((len(simulator.held_nodes), 3))
    if believed.loads[0].body_force is None:
        solved.append((np.zeros(states.shape[1]), nothing[0]))
    failed = []
    done = 0
    for number, state in enumerate(states):
        frames = np.flatnonzero(of_frame == number)
        known = bool(solved) and not state.any() and not solved[0][0].any()
        try:
            settings = {"tolerance": tolerance, "threads": threads}
            load = believed.loads[frames[0]]
            begin = near[number] if near is not None and len(near) == len(states) else None
            found = nothing if known else _solve(simulator, load, state, experiment.material, solved, begin, settings)
        except ConvergenceError as error:
            failed += [(int(frame), str(error)) for frame in frames]
        else:
            field[frames] = found[0]
            if not known:
                solved.append((state, found[0]))
            for pad in pads:
                forces[pad.name][frames] = found[1][np.isin(simulator.held_nodes, pad.nodes)].sum(axis=0)
        done += len(frames)
        if progress is not None:
            progress(done)
    if len(failed) == len(case.times):
        message = f"case '{case.name}' must have a frame that finds equilibrium; none does: {failed[0][1]}"
        raise ConvergenceError(message, where=case.name)
    return SolvedCase(field[:, : simulator.mesh.n_nodes], forces, sorted(failed), field)


def guess(state: FloatArray, solved: list[tuple[FloatArray, FloatArray]]) -> FloatArray | None:
    """Return an initial guess for the displacement (n_nodes, 3), mm, under a load, from loads that were solved before.

    `state` (n_parts,): the load, dimensionless; `solved`: load (n_parts,) and displacement (n_nodes, 3), mm, of each
    earlier one. The guess is extrapolated from the three nearest loads that are collinear with this one; if there are
    no two, it is the displacement under the nearest load, unless that is farther away than no load. None without a
    guess.
    """
    size = float(np.linalg.norm(state))
    if not solved or size == 0.0:
        return solved[0][1] if solved and not solved[0][0].any() else None
    on_line = sorted(_along(state, solved), key=lambda point: abs(point[0] - size))[: FINE.most_states]
    if len(on_line) < 2:
        nearest = min(solved, key=lambda one: float(np.linalg.norm(one[0] - state)))
        # The undeformed body is not used as a guess, a body that sags under its weight is.
        return nearest[1] if nearest[1].any() and np.linalg.norm(nearest[0] - state) <= size else None
    total = np.zeros_like(on_line[0][1])
    for i, (place, field) in enumerate(on_line):
        others = [p for j, (p, _) in enumerate(on_line) if j != i]
        total += np.prod([(size - p) / (place - p) for p in others]) * field
    return total


def _along(state: FloatArray, solved: list[tuple[FloatArray, FloatArray]]) -> list[tuple[float, FloatArray]]:
    """Return (position, displacement) of each solved load on the line from no load through `state`.

    `state` (n_parts,): a load, dimensionless; `solved`: load (n_parts,) and displacement (n_nodes, 3), mm, of each
    solved one. The position is the distance from no load along the line, negative on its other side.
    """
    size = max(float(np.linalg.norm(state)), 1e-300)
    line = state / size
    return [(float(s @ line), u) for s, u in solved if np.linalg.norm(s - (s @ line) * line) <= FINE.along * size]


def _solve(
    simulator: Simulator,
    load: Load,
    state: FloatArray,
    material: Material,
    solved: list[tuple[FloatArray, FloatArray]],
    near: FloatArray | None,
    settings: dict[str, Any],
) -> tuple[FloatArray, FloatArray]:
    """Return the displacement (n_nodes, 3), mm, and the reactions (n_held, 3), mN, under one load of a case.

    `state` (n_parts,): the load as dimensionless numbers, from which initial guesses are extrapolated; `solved`: such
    loads and displacements solved before; `near` (n_nodes, 3) or None: displacement of a similar model, mm, from which
    the solution starts if that converges; `settings`: tolerance and threads.
    """
    if near is not None and np.isfinite(near).all():
        with suppress(ConvergenceError, LoadError):
            found = simulator.solve(load, material, start=near, **settings)
            return found.all_displacement, found.reactions
    for steps in (1, 2):
        known = list(solved)
        try:
            for share in _shares(state, solved, steps if load.body_force is None else 1):
                part = load if share == 1.0 else _scaled(load, share)
                found = simulator.solve(part, material, start=guess(share * state, known), **settings)
                known.append((share * state, found.all_displacement))
        except (ConvergenceError, LoadError):  # the latter where a guess turns a tet inside out
            continue
        return found.all_displacement, found.reactions
    found = simulator.solve(load, material, **settings)
    return found.all_displacement, found.reactions


def _shares(state: FloatArray, solved: list[tuple[FloatArray, FloatArray]], steps: int) -> FloatArray:
    """Return the shares (steps,) of a load, in equal steps up to 1, from the largest smaller solved load on its line.

    `state` (n_parts,): the load, dimensionless; `solved`: load and displacement of each solved one.
    """
    size = max(float(np.linalg.norm(state)), 1e-300)
    along = [place / size for place, _ in _along(state, solved)]
    before = max((share for share in along if 0.0 < share < 1.0), default=0.0)
    return np.linspace(before, 1.0, steps + 1)[1:]


def _scaled(load: Load, share: float) -> Load:
    """Return a load with prescribed displacements and tractions multiplied by `share`; a body force is left out."""
    traction = None if load.traction is None else (load.traction[0], share * np.asarray(load.traction[1]))
    return Load(prescribed=share * np.asarray(load.prescribed), traction=traction)
