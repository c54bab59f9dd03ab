"""The believed model on the bench: its prediction, its derivatives, and what any effect changes."""

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import TypeVar

import numpy as np
from scipy import sparse

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.predictor import NO_ANSWER, Predictor
from tissuereg.diagnose.signals import Layout
from tissuereg.diagnose.tangents import State, Tangents
from tissuereg.effects import EFFECTS, Effect, extended
from tissuereg.experiment import Experiment
from tissuereg.simulate.fine import FineModel
from tissuereg.simulate.memory import goes_through_time
from tissuereg.simulate.sensitivity import Cause, Field

#: Deviation of the modulus over its mean, where the file states none.
YOUNG_SPREAD = 0.3

#: Effects with stresses in their tables, which do not grow with the modulus.
_ABSOLUTE = tuple(effect.id for effect in EFFECTS.values() if effect.absolute)

_In = TypeVar("_In")
_Out = TypeVar("_Out")


class Bench:
    """A believed model that can be asked how what was measured follows anything.

    Parameters
    ----------
    experiment : Experiment
        What is believed.
    layout : Layout
        Order of all columns.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements to use.
    threads : int
        Threads to use; 0 takes all cores.
    """

    def __init__(self, experiment: Experiment, layout: Layout, *, element: str = "tet4", threads: int = 0) -> None:
        self.experiment = experiment
        self.layout = layout
        self.predictor = Predictor(experiment, layout, element=element, threads=threads)
        self.young = float(experiment.material.young_array.mean())
        self.young_spread = (experiment.young_std or YOUNG_SPREAD * self.young) / self.young
        self.extent = experiment.mesh.extent

    @cached_property
    def base(self) -> FloatArray:
        """What the believed model says, shape (size,)."""
        return self.predictor.predict()

    @cached_property
    def fine(self) -> FineModel:
        """The believed model on a fine mesh."""
        return FineModel(self.experiment)

    @property
    def is_exact(self) -> bool:
        """Whether the data were simulated with this model, on this mesh as it is: nothing of it is uncertain."""
        said = self.experiment.simulated
        return said is not None and said.model == "plain" and said.element == self.predictor.element

    @cached_property
    def is_elastic(self) -> bool:
        """Whether the believed model's frames depend on their own load alone."""
        return not goes_through_time(extended(self.experiment, self.predictor.element))

    @cached_property
    def scales_forces(self) -> bool:
        """Whether the modulus scales forces and does nothing else: all that acts is displacement."""
        driven = any(case.applied_forces for case in self.experiment.cases.values())
        absolute = any(effect.id in _ABSOLUTE for effect in self.experiment.effects)
        return self.experiment.gravity is None and not driven and not absolute

    @cached_property
    def tangents(self) -> Tangents:
        """Derivatives of the believed model, where it is elastic."""
        return Tangents(self.predictor)

    def by(self, direction: Callable[[State], Sequence[Cause]], count: int) -> FloatArray:
        """Return how everything measured follows directions; see `Tangents.columns`."""
        return self.tangents.columns(direction, count)

    def by_fields(self, shares: "sparse.csr_array") -> FloatArray:
        """Return how everything measured follows relative changes of the modulus; see `Tangents.by_fields`."""
        return self.tangents.by_fields(shares)

    @cached_property
    def by_young(self) -> FloatArray:
        """How everything measured follows the modulus, over a relative change, shape (1, size)."""
        if not self.is_elastic:
            forces = np.where(self.layout.of_markers(), 0.0, self.base)
            if self.scales_forces:
                return np.asarray(forces[None])
            return np.asarray((self.predictor.predict(young=1.02) - self.base)[None] / 0.02)
        young = np.asarray(self.tangents.worked.material.young_array, np.float64)
        tets, points = self.experiment.mesh.n_tets, self.tangents.states[0].simulator.n_points
        rates = np.broadcast_to(young.reshape(-1, 1) if young.ndim == 1 else young, (tets, points))
        return self.by(lambda state: [Field("young", rates)], 1)

    def change(self, *effects: Effect) -> FloatArray | None:
        """Return what effects change, shape (size,); None where they fit nothing or leave no equilibrium."""
        return self.changes([effects])[0]

    def changes(self, tried: Sequence[Sequence[Effect]]) -> list[FloatArray | None]:
        """Return what each of many sets of effects changes, as `change`; several are simulated at a time.

        Frames that follow each other keep one thread busy, so that many histories take as many threads.
        """
        base = self.base

        def one(effects: Sequence[Effect]) -> FloatArray | None:
            try:
                return self.predictor.predict(effects, threads=1) - base
            except NO_ANSWER:
                return None

        return self.side_by_side(one, tried)

    def side_by_side(self, work: Callable[[_In], _Out], tried: Sequence[_In]) -> list[_Out]:
        """Return what pieces of work, each for one thread, give, in their order."""
        workers = self.predictor.threads or os.cpu_count() or 1
        if workers == 1 or len(tried) == 1:
            return [work(one) for one in tried]
        with ThreadPoolExecutor(workers) as pool:
            return list(pool.map(work, tried))

    @property
    def first_time(self) -> float:
        """Begin of the first case in s."""
        return min(float(part.times[0]) for part in self.layout.parts)

    @property
    def last_time(self) -> float:
        """End of the last case in s."""
        return max(float(part.times[-1]) for part in self.layout.parts)

    @property
    def frame_step(self) -> float:
        """Median time between frames in s; 0 where every case is a single one."""
        steps = np.concatenate([np.diff(part.times) for part in self.layout.parts])
        return float(np.median(steps)) if len(steps) else 0.0

    @property
    def longest_case(self) -> float:
        """Duration of the longest case in s."""
        return max(float(part.times[-1] - part.times[0]) for part in self.layout.parts)
