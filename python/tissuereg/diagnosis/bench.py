"""The believed model with everything that hypotheses are computed from.

A `Bench` gives the model's prediction on the user's mesh, its sensitivities, and the change that any effect makes, all
as flat vectors in the order of a `SignalLayout`.

Sensitivities come from the tangent stiffness of the model's equilibria (`Tangents`). Frames under the same load are one
equilibrium, whose tangent is factored once. Derivatives by the modulus of every tetrahedron come from adjoint
solutions, so that an inclusion at any place is a weighted sum of them. For elastic models only; the causes of a model
with memory are simulated at one size (`Bench.change`).
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from scipy import sparse

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Element
from tissuereg.body.load import Load
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation
from tissuereg.diagnosis.predictor import NO_ANSWER, Predictor
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.diagnosis.signals import CasePart, SignalLayout
from tissuereg.experiment.effects import ChainEffect, Effect, extended, seen_markers
from tissuereg.experiment.experiment import Case, Experiment
from tissuereg.simulation.experiment import believed_case
from tissuereg.simulation.fine import FineModel
from tissuereg.simulation.loading import distinct_states, pads_of, traction_of
from tissuereg.simulation.memory import goes_through_time
from tissuereg.simulation.sensitivity import Adjoints, Cause, Linearised, Observation
from tissuereg.simulation.solve import Simulator

#: Places of inner targets by case and name, each (n_frames, 3) in mm.
Targets = Mapping[str, Mapping[str, FloatArray]]

_In = TypeVar("_In")
_Out = TypeVar("_Out")


@dataclass(frozen=True, eq=False)
class OnFineMeshes:
    """Predictions of the believed model on fine meshes.

    `flat` (n_meshes, size): of all measured numbers, mm and mN, the first on the mesh that corrects; NaN in frames
    without equilibrium; `targets`: of the inner targets, on that mesh.
    """

    flat: FloatArray
    targets: Targets


class Bench:
    """The believed model of an experiment: its prediction, its sensitivities, and its changes by effects.

    Predictions are flat vectors of all measured numbers, (size,): displacements of markers in mm, forces in mN.
    `element` {"tet4", "tet4-averaged", "tet10"}: elements to use; `threads`: 0 takes all cores; `progress`: called with
    the name of every step that begins. Attributes: `young`: mean of the believed modulus, kPa; `young_spread`: its
    prior standard deviation over that mean; `extent`: of the body, mm.
    """

    def __init__(
        self,
        experiment: Experiment,
        layout: SignalLayout,
        *,
        element: Element = "tet4",
        threads: int = 0,
        settings: DiagnoseSettings = DEFAULT,
        progress: Callable[[str], None] = lambda step: None,
    ) -> None:
        self.settings = settings
        self.progress = progress
        self.experiment = experiment
        self.layout = layout
        self.predictor = Predictor(experiment, layout, element=element, threads=threads, settings=settings.model)
        self.young = float(experiment.material.young_array.mean())
        self.young_spread = (experiment.young_std or settings.model.young_spread * self.young) / self.young
        self.extent = experiment.mesh.extent
        #: Predictions on fine meshes, once they were made (`refined`).
        self.on_fine_meshes: OnFineMeshes | None = None

    def of(self, experiment: Experiment) -> "Bench":
        """Return the same model of another experiment."""
        return Bench(
            experiment,
            SignalLayout(experiment),
            element=self.predictor.element,
            threads=self.predictor.threads,
            settings=self.settings,
            progress=self.progress,
        )

    @cached_property
    def base(self) -> FloatArray:
        """Prediction of the believed model on the user's mesh, (size,): marker displacements in mm, forces in mN."""
        return self.predictor.predict()

    @cached_property
    def fine(self) -> FineModel:
        """The believed model on a fine mesh of ten-node elements, made at the first use."""
        return FineModel(self.experiment)

    @property
    def is_exact(self) -> bool:
        """Whether the data were simulated on this mesh with these elements, and so have no discretisation error."""
        simulated = self.experiment.simulated
        return simulated is not None and simulated.model == "plain" and simulated.element == self.predictor.element

    @cached_property
    def is_elastic(self) -> bool:
        """Whether every frame of the believed model depends on its own load alone, not on the frames before it."""
        return not goes_through_time(extended(self.experiment, self.predictor.element))

    @cached_property
    def scales_forces(self) -> bool:
        """Whether a factor on the modulus scales forces and moves no marker, as displacements alone drive the body."""
        driven = any(case.applied_forces for case in self.experiment.cases.values())
        absolute = any(effect.absolute for effect in self.experiment.effects)
        return self.experiment.gravity is None and not driven and not absolute

    @cached_property
    def tangents(self) -> "Tangents":
        """The equilibria of the believed model with their tangent stiffnesses, for derivatives, where it is elastic."""
        return Tangents(self.predictor)

    def by(self, direction: "Callable[[State], Sequence[Cause]]", count: int) -> FloatArray:
        """Return the derivatives (count, size) of the prediction by `count` parameters, mm and mN per unit of each.

        `direction`: of an equilibrium, what one unit of each parameter moves (`Tangents.columns`).
        """
        return self.tangents.columns(direction, count)

    def by_fields(self, shares: "sparse.csr_array") -> FloatArray:
        """Return the derivatives (n_fields, size) of the prediction by the relative modulus in parts of the body.

        `shares` (n_tets, n_fields): of each tetrahedron in each part; mm and mN for a doubled modulus.
        """
        return self.tangents.by_fields(shares)

    @cached_property
    def by_young(self) -> FloatArray:
        """Derivative of the prediction by the relative change of the whole body's modulus, (1, size), mm and mN."""
        if self.scales_forces:
            return np.where(self.layout.of_markers(), 0.0, self.base)[None]
        # Not by tangents: a body that sags under its weight takes its pads with it.
        return np.asarray((self.predictor.predict(young=1.002) - self.base)[None] / 0.002)

    def change(self, *effects: Effect) -> FloatArray | None:
        """Return the change (size,), mm and mN, that effects make together; None as in `changes`."""
        return self.changes([effects])[0]

    def changes(self, tried: Sequence[Sequence[Effect]]) -> list[FloatArray | None]:
        """Return the change of the prediction that each of many sets of effects makes, each (size,), mm and mN.

        It is None where an effect of the set does not apply, or the body has no equilibrium with it. Several sets are
        simulated in parallel, the frames of each history one after another on one thread.
        """
        base = self.base  # solved once, not by every worker

        def one(effects: Sequence[Effect]) -> FloatArray | None:
            try:
                return self.predictor.predict(effects, threads=1) - base
            except NO_ANSWER:
                return None

        return self.side_by_side(one, tried)

    def side_by_side(self, work: Callable[[_In], _Out], tried: Sequence[_In]) -> list[_Out]:
        """Return `work(one)` for every entry of `tried`, in order; calls run in parallel and may call this too."""
        if self.predictor.workers == 1 or len(tried) <= 1:
            return [work(one) for one in tried]
        with ThreadPoolExecutor(self.predictor.workers) as pool:
            return list(pool.map(work, tried))

    @property
    def first_time(self) -> float:
        """Time of the first frame of all cases in s."""
        return min(float(part.times[0]) for part in self.layout.parts)

    @property
    def last_time(self) -> float:
        """Time of the last frame of all cases in s."""
        return max(float(part.times[-1]) for part in self.layout.parts)

    @property
    def frame_step(self) -> float:
        """Median time between successive frames of a case in s; 0 where every case has a single frame."""
        steps = np.concatenate([np.diff(part.times) for part in self.layout.parts])
        return float(np.median(steps)) if len(steps) else 0.0

    @property
    def longest_case(self) -> float:
        """Duration of the longest case in s."""
        return max(float(part.times[-1] - part.times[0]) for part in self.layout.parts)


@dataclass(frozen=True, eq=False)
class State:
    """One equilibrium of a load case, with the frames that have it.

    `frames` int64 (n,): of the case, with this equilibrium; `simulator`: solver of the body, with boundaries and pads
    as held nodes; `load`: displacements, mm, and forces, mN; `pad_rows`: by pad, its rows in the list of the held
    nodes.
    """

    case: Case
    frames: IntArray
    simulator: Simulator
    load: Load
    pad_rows: dict[str, IntArray]

    def moved(self, pad: str, motion: FloatArray) -> FloatArray:
        """Return the prescribed displacements (n_held, 3) that move one pad by `motion` (3,) or (n_pad, 3), mm."""
        prescribed = np.zeros((len(self.simulator.held_nodes), 3))
        prescribed[self.pad_rows[pad]] = motion
        return prescribed

    @property
    def frame(self) -> int:
        """Number of the first frame with this equilibrium."""
        return int(self.frames[0])


class Tangents:
    """All equilibria of an elastic model, each with its factored tangent stiffness.

    `predictor`: of a model without memory, without sliding supports, and with an unloaded mesh; `keep`: whether all
    tangents of a small enough body stay in memory, not just the last one. Raises `ConvergenceError` if a state has no
    equilibrium.
    """

    def __init__(self, predictor: Predictor, *, keep: bool = True) -> None:
        self.predictor = predictor
        self.layout = predictor.layout
        self.worked: Experiment = extended(predictor.experiment, predictor.element)
        self.states = [state for case in self.worked.cases.values() for state in self._of_case(case)]
        self._keep = keep and self.worked.mesh.n_nodes <= predictor.settings.kept_up_to_nodes
        self._kept: dict[int, tuple[Linearised, FloatArray, FloatArray]] = {}

    def columns(self, direction: Callable[[State], Sequence[Cause]], count: int) -> FloatArray:
        """Return the derivatives of the prediction by `count` parameters, (count, size), in mm and mN per unit of each.

        `direction`: returns, for an equilibrium, the derivatives of the load or the material by the parameters.
        """
        return self._seen(self._columns(lambda _, state: direction(state), count))

    def _columns(self, direction: Callable[[int, State], Sequence[Cause]], count: int) -> FloatArray:
        """Return derivatives (count, size) of the prediction, in mm and mN per unit, before the tracker's effects."""
        flat = np.zeros((count, self.layout.size))
        for number, state in enumerate(self.states):
            tangent, slopes, _ = self._at(number)
            found = tangent.derivatives(direction(number, state))
            nodes = self.predictor.observation.nodes
            markers = np.einsum("mxny,cny->cmx", slopes, found.displacement[:, nodes])
            part = self.layout[state.case.name]
            part.markers(flat)[:, state.frames] = markers[:, None]
            for i, pad in enumerate(part.pads):
                force = found.reactions[:, state.pad_rows[pad]].sum(axis=1)
                part.forces(flat)[:, state.frames, i] = force[:, None]
        return flat

    def by_fields(self, shares: "sparse.csr_array") -> FloatArray:
        """Return the derivatives of the prediction by the relative modulus in parts of the body, (n_fields, size).

        `shares` (n_tets, n_fields): share of every tet that changes. The result, in mm and mN, is the linear change for
        a modulus that is doubled where a share is 1.
        """
        return self.by_adjoints(lambda adjoints, _: shares.T @ self.by_modulus(adjoints).T, shares.shape[1])

    def by_adjoints(self, rates: Callable[[Adjoints, FloatArray], FloatArray], count: int) -> FloatArray:
        """Return the derivatives of the prediction by many parameters, (count, size), in mm and mN per unit of each.

        `rates`: takes the derivatives of n_obs measured numbers in an equilibrium by all inputs, and the displacement
        of its nodes (n_element_nodes, 3) in mm; returns those by the parameters, (count, n_obs). Costs one solution for
        each measured number and state.
        """
        flat = np.zeros((count, self.layout.size))
        n_markers = len(self.layout.marker_names)
        for number, state in enumerate(self.states):
            tangent, slopes, displacement = self._at(number)
            part = self.layout[state.case.name]
            found = tangent.adjoints(self._observations(state, part, slopes))
            each = rates(found, displacement).reshape(count, -1, 3)
            part.markers(flat)[:, state.frames] = each[:, None, :n_markers]
            part.forces(flat)[:, state.frames] = each[:, None, n_markers:]
        return self._seen(flat)

    def by_modulus(self, adjoints: Adjoints) -> FloatArray:
        """Return the derivatives of measured numbers by the relative modulus of every tet, (n_obs, n_tets)."""
        young = np.broadcast_to(per_tet(self.worked.material.young_array), (self.worked.mesh.n_tets,))
        return np.asarray(adjoints.young.mean(axis=2) * (young * adjoints.young.shape[2]))

    def by_shapes(self, motions: Sequence[FloatArray]) -> FloatArray:
        """Return the derivatives of the prediction by motions of the mesh's nodes (shape derivatives).

        `motions`: each (n_nodes, 3). Result: (n_motions, size), in mm and mN for a unit of each motion. Patches move
        with their nodes, reference places of markers do not. The weight of material that the motion adds is neglected.
        Costs one evaluation of the internal forces (forward difference) and one solution for each motion and state.
        """
        edges = self.worked.mesh.nodes[self.worked.mesh.edges]
        shortest = float(np.linalg.norm(edges[:, 0] - edges[:, 1], axis=1).min())
        step = self.predictor.settings.shape_step * shortest
        tiny = np.finfo(float).tiny
        steps = [step / max(float(np.abs(motion).max()), tiny) for motion in motions]
        moved = [_Moved(self.worked, self.predictor, *one) for one in zip(motions, steps, strict=True)]
        plain = _Moved(self.worked, self.predictor, np.zeros_like(self.worked.mesh.nodes), step)
        markers = np.zeros((len(motions), self.layout.size))

        def direction(number: int, state: State) -> list[Cause]:
            field = self._at(number)[2]
            balance, places = plain.out_of_balance(field, state), plain.seen(field)
            part = self.layout[state.case.name]
            for i, body in enumerate(moved):
                part.markers(markers)[i, state.frames] = (body.seen(field) - places) / body.step
            # The imbalance of the moved body is the load of the sensitivity problem.
            return [Load(forces=(body.out_of_balance(field, state) - balance) / body.step) for body in moved]

        return self._seen(self._columns(direction, len(motions)) + markers)

    def _of_case(self, case: Case) -> list[State]:
        believed = believed_case(self.worked, case, element=self.predictor.element, threads=self.predictor.threads)
        held = believed.simulator.held_nodes
        rows = {pad.name: np.flatnonzero(np.isin(held, pad.nodes)) for pad in pads_of(self.worked, case)}
        states, state_of = distinct_states(case)
        frames = [np.flatnonzero(state_of == number) for number in range(len(states))]
        return [State(case, mine, believed.simulator, believed.loads[mine[0]], rows) for mine in frames]

    def _at(self, number: int) -> tuple[Linearised, FloatArray, FloatArray]:
        """Return a state's tangent, markers' Jacobian (n_markers, 3, n_used, 3), displacement (n_nodes, 3) in mm."""
        if number in self._kept:
            return self._kept[number]
        if not self._keep:
            self._kept.clear()
        state = self.states[number]
        material, threads = self.worked.material, self.predictor.threads
        found = state.simulator.solve(state.load, material, threads=threads)
        tangent = Linearised(state.simulator, state.load, material, found.all_displacement, threads=threads)
        slopes = self.predictor.observation.jacobian(found.displacement[self.predictor.observation.nodes])
        self._kept[number] = (tangent, slopes, found.all_displacement)
        return self._kept[number]

    def _observations(self, state: State, part: CasePart, slopes: FloatArray) -> list[Observation]:
        nodes = self.predictor.observation.nodes
        observations = []
        for weights in slopes.reshape(-1, len(nodes), 3):
            used = np.flatnonzero(weights.any(axis=1))
            observations.append(Observation(nodes[used], weights[used]))
        for pad in part.pads:
            held = state.simulator.held_nodes[state.pad_rows[pad]]
            observations += [
                Observation(held_nodes=held, held_weights=np.tile(np.eye(3)[x], (len(held), 1))) for x in range(3)
            ]
        return observations

    def _seen(self, flat: FloatArray) -> FloatArray:
        """Return changes (n, size), mm and mN, as the tracker records them: its effects map places affinely."""
        chain = tuple(effect for effect in self.predictor.experiment.effects if isinstance(effect, ChainEffect))
        if not chain:
            return flat
        tracker = replace(self.predictor.experiment, effects=chain)
        for part in self.layout.parts:
            # The derivative of an affine map does not depend on the place.
            markers = part.markers(flat)
            places = np.broadcast_to(self.layout.reference, markers.shape[1:])
            here = seen_markers(tracker, places, part.times)
            for row in markers:
                row[:] = seen_markers(tracker, places + row, part.times) - here
        return flat


class _Moved:
    """The body of an experiment on a mesh whose nodes were moved, for derivatives by its shape."""

    def __init__(self, worked: Experiment, predictor: Predictor, motion: FloatArray, step: float) -> None:
        mesh = worked.mesh
        self.step = step
        self._experiment = replace(worked, mesh=Mesh(mesh.nodes + step * motion, mesh.tets, mesh.node_sets))
        self._simulator = Simulator(self._experiment.mesh, element=predictor.element)
        layout = predictor.layout
        self._observation = MarkerObservation(
            self._experiment.mesh, layout.reference, layout.marker_names, like=predictor.observation
        )

    def out_of_balance(self, field: FloatArray, state: State) -> FloatArray:
        """Return the pads' nodal forces minus the internal ones, (n_nodes, 3), mN, under displacements `field`, mm."""
        held = self._simulator.internal_forces(field, self._experiment.material)
        pulled = self._simulator.forces(Load(traction=traction_of(self._experiment, state.case, state.frame)))
        return -held if pulled is None else pulled - held

    def seen(self, field: FloatArray) -> FloatArray:
        """Return the displacements of the markers, (n_markers, 3) in mm, in a displacement field (n_nodes, 3) in mm."""
        return self._observation.predict(field[self._observation.nodes])


def per_tet(young: FloatArray) -> FloatArray:
    """Return a modulus of tets or of their quadrature points, (n_tets,) or (n_tets, n_points), as one of tets."""
    return young.mean(axis=1) if young.ndim == 2 else young
