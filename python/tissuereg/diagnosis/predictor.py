"""Predictions of all measured numbers by the believed model with any further effects, on the user's mesh.

Also what they depend on, as a hash by which results are cached.
"""

import hashlib
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from dataclasses import dataclass, replace
from functools import cached_property, partial
from threading import BoundedSemaphore

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg._base.machine import n_cores
from tissuereg._version import __version__
from tissuereg.body.observe import MarkerObservation
from tissuereg.diagnosis.settings import DEFAULT, ModelSettings
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.errors import ConvergenceError, ExperimentError, MaterialError, SupportError
from tissuereg.experiment.effects import ChainEffect, Effect, extended, seen_markers
from tissuereg.experiment.experiment import Case, Experiment
from tissuereg.io.json import dumps
from tissuereg.simulation.experiment import Simulators, solve_cases
from tissuereg.simulation.frames import FrameSettings, Rigs, Similar
from tissuereg.simulation.memory import SolvedCase, are_apart, goes_through_time

#: To be increased when fine meshes, or changes by the shape on them, give other results: older entries are not read.
FINE_SCHEMA = 4

#: Errors of a model without equilibrium, or whose effects do not apply, on the user's mesh.
NO_ANSWER = (ConvergenceError, ExperimentError, MaterialError, SupportError)


@dataclass(frozen=True, eq=False)
class Solved:
    """The equilibria of a model in all cases, as they are before the tracker's errors are applied.

    `effects`: effects in addition to those of the experiment; `young`: factor on the believed modulus, None for 1. The
    rest is by name of the case: `places` (n_frames, n_markers, 3): places of the markers, mm; `forces`: by pad,
    (n_frames, 3), mN; `times` (n_frames,): s; `fields` (n_frames, n, 3): displacements of all n element nodes, mm.
    """

    effects: tuple[Effect, ...]
    young: float | None
    places: dict[str, FloatArray]
    forces: dict[str, dict[str, FloatArray]]
    times: dict[str, FloatArray]
    fields: dict[str, FloatArray]


class Predictor:
    """The believed model of an experiment, solved with varying further effects.

    `element` {"tet4", "tet4-averaged", "tet10"}: elements to use; `threads`: 0 takes all cores. Attribute `workers`:
    how many bodies are solved at a time, however many predictions are asked for.
    """

    def __init__(
        self,
        experiment: Experiment,
        layout: SignalLayout,
        *,
        element: Element = "tet4",
        threads: int = 0,
        settings: ModelSettings = DEFAULT.model,
    ) -> None:
        self.settings = settings
        self.experiment = experiment
        self.layout = layout
        self.element = element
        self.threads = threads
        self.observation = MarkerObservation(experiment.mesh, experiment.marker_reference, experiment.marker_names)
        self.workers = threads or n_cores()
        # With more bodies at a time more memory would be held.
        self._slots = BoundedSemaphore(self.workers)
        self._simulators: Simulators = {}
        self._rigs: Rigs = {}
        # Each with the solution that it started from: another start changes its last digits.
        self._solved: list[tuple[Solved | None, Solved]] = []

    def predict(
        self,
        effects: Sequence[Effect] = (),
        *,
        young: float | None = None,
        threads: int | None = None,
        near: Solved | None = None,
    ) -> FloatArray:
        """Return the prediction (size,) of all measured numbers with further effects, in mm (markers) and mN (forces).

        `effects`: in addition to those of the experiment; `young`: factor on the believed modulus; `threads`: by
        default the predictor's own number; `near`: solution of a similar model, from which frames that are solved one
        after another start; by default that of the believed model. All entries are finite, and do not depend on what
        was predicted before, or is at the same time. Raises `ConvergenceError` if a frame has no equilibrium;
        `ExperimentError` if an effect does not apply to the experiment.
        """
        believed = replace(self.experiment, effects=(*self.experiment.effects, *effects))
        solved = self.solved(effects, young=young, threads=threads, near=near)
        seen = {name: seen_markers(believed, places, solved.times[name]) for name, places in solved.places.items()}
        return self.layout.flatten(seen, solved.forces)

    def solved(
        self,
        effects: Sequence[Effect] = (),
        *,
        young: float | None = None,
        threads: int | None = None,
        near: Solved | None = None,
    ) -> Solved:
        """Return the equilibria of the believed model with further effects; the last few solutions are kept.

        Errors of the tracker among the `effects` are left out; the arguments are those of `predict`.
        """
        bodily = _bodily(effects)
        worked = self._worked(bodily, young)
        if not goes_through_time(worked):
            near = None
        elif near is None and (bodily or young is not None):
            near = self._believed
        for start, solved in reversed(self._solved):
            if solved.young == young and solved.effects == bodily and start is near:
                return solved
        found = self._solve(worked, bodily, young, self.threads if threads is None else threads, near)
        self._solved = [*self._solved, (near, found)][-self.settings.most_solved :]
        return found

    def goes_through_time(self, effects: Sequence[Effect] = ()) -> bool:
        """Return whether the frames of a model with further effects are solved one after another."""
        return goes_through_time(self._worked(_bodily(effects), None))

    @cached_property
    def _believed(self) -> Solved:
        """The equilibria of the believed model without further effects."""
        return self.solved(())

    def _worked(self, effects: tuple[Effect, ...], young: float | None) -> Experiment:
        """Return the believed model with further effects applied; `young`: factor on the believed modulus."""
        believed = replace(self.experiment, effects=(*self.experiment.effects, *effects))
        if young is not None:
            believed = replace(believed, material=believed.material.scaled(young))
        return extended(believed, self.element)

    def _solve(
        self, worked: Experiment, effects: tuple[Effect, ...], young: float | None, threads: int, near: Solved | None
    ) -> Solved:
        cases = list(worked.cases.values())
        apart = threads == 1 and are_apart(worked)
        how = FrameSettings(self.element, self.settings.tolerance, threads)
        similar = Similar(None if near is None else near.fields, self._rigs, self._simulators)

        def together(some: Sequence[Case]) -> dict[str, SolvedCase]:
            with self._slots:
                return solve_cases(worked, some, settings=how, similar=similar)

        if apart and self.workers > 1 and len(cases) > 1:
            # In copies of this context, so that warnings come to the records that are open here.
            calls = [partial(copy_context().run, together, [case]) for case in cases]
            with ThreadPoolExecutor(min(self.workers, len(cases))) as pool:
                solved = {name: one for part in pool.map(lambda call: call(), calls) for name, one in part.items()}
        else:
            solved = together(cases)
        places, forces = {}, {}
        for case in cases:
            found = solved[case.name]
            refuse_failures(case.name, found.failed)
            moved = self.observation.predict(found.displacement[:, self.observation.nodes])
            places[case.name] = worked.marker_reference + moved
            forces[case.name] = found.forces
        times = {case.name: case.times for case in cases}
        fields = {name: found.all_displacement for name, found in solved.items()}
        return Solved(effects, young, places, forces, times, fields)


def _bodily(effects: Sequence[Effect]) -> tuple[Effect, ...]:
    """Return effects without the tracker's: it does not act on the body; models that differ in it have one solution."""
    return tuple(effect for effect in effects if not isinstance(effect, ChainEffect))


def refuse_failures(case: str, failed: Sequence[tuple[int, str]]) -> None:
    """Raise `ConvergenceError` that names the first of the frames of a case that `failed`, each with the reason."""
    if failed:
        frame, why = failed[0]
        message = f"every frame must find equilibrium; frame {frame} of case '{case}' does not: {why}"
        raise ConvergenceError(message, where=case)


def fingerprint(experiment: Experiment, of: str) -> str:
    """Return a hash, 32 hexadecimal digits, of all that a believed model's prediction depends on, and of a label."""
    digest = hashlib.sha256(f"{__version__} {of}".encode())
    mesh = experiment.mesh
    parts = [mesh.nodes, mesh.tets, mesh.fixed_nodes, experiment.marker_reference]
    parts += [*(boundary.nodes for boundary in experiment.boundaries), *(pad.nodes for pad in experiment.actuators)]
    for case in experiment.cases.values():
        digest.update(f"{case.name} {sorted(case.forces)}".encode())
        parts.append(case.times)
        for name, motion in (*sorted(case.displacements.items()), *sorted(case.applied_forces.items())):
            digest.update(name.encode())
            parts.append(motion)
    for part in parts:
        array = np.ascontiguousarray(part)
        digest.update(f"{array.shape} {array.dtype}".encode() + array.tobytes())
    weight = experiment.gravity
    gravity = "none" if weight is None else f"{list(weight.direction)} {weight.g_mm_per_s2} {weight.in_reference}"
    patches = [f"{pad.name} {pad.kind} {pad.rule}" for pad in experiment.actuators]
    patches += [boundary.name for boundary in experiment.boundaries]
    effects = [dumps(effect.table()) for effect in experiment.effects]
    lines = [experiment.material.digest(), f"{experiment.material.density}", gravity, *patches, *effects]
    digest.update("\n".join(lines).encode())
    return digest.hexdigest()[:32]
