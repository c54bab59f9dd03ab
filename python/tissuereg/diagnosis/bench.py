"""The believed model with everything that hypotheses are computed from.

A `Bench` gives the model's prediction on the user's mesh, its sensitivities (`tangents`), and the change that any
effect makes, all as flat vectors in the order of a `SignalLayout`.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from typing import TypeVar

import numpy as np
from scipy import sparse

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg.diagnosis.predictor import NO_ANSWER, Predictor
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.diagnosis.tangents import State, Tangents
from tissuereg.experiment.effects import Effect, extended
from tissuereg.experiment.experiment import Experiment
from tissuereg.simulation.fine import FineModel
from tissuereg.simulation.memory import goes_through_time
from tissuereg.simulation.sensitivity import Cause

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
    def tangents(self) -> Tangents:
        """The equilibria of the believed model with their tangent stiffnesses, for derivatives, where it is elastic."""
        return Tangents(self.predictor)

    def by(self, direction: Callable[[State], Sequence[Cause]], count: int) -> FloatArray:
        """Return the derivatives of the prediction by `count` parameters (`Tangents.columns`)."""
        return self.tangents.columns(direction, count)

    def by_fields(self, shares: "sparse.csr_array") -> FloatArray:
        """Return the derivatives of the prediction by the modulus in parts of the body (`Tangents.by_fields`)."""
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
