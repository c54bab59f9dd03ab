"""Predictions of the fine model for the markers, forces and targets of an experiment."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from threading import Lock
from typing import Any

import numpy as np

from tissuereg._base.arguments import called, check_choice, check_running, each, flag, maybe, of_kind
from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg._base.machine import n_cores
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError
from tissuereg.experiment.effects import (
    ActuatorOffset,
    Detachment,
    Effect,
    Gravity,
    Reference,
    Sliding,
    check_effects,
    extended,
    seen_markers,
)
from tissuereg.experiment.effects.base import Vector
from tissuereg.experiment.effects.history import Memory
from tissuereg.experiment.experiment import Actuator, Case, Experiment
from tissuereg.simulation.experiment import CaseSimulation
from tissuereg.simulation.fine.elastic import solve_states
from tissuereg.simulation.fine.meshing import FineMeshing, fine_experiment, rim_of
from tissuereg.simulation.fine.reading import FineFrames, Reader, corrected
from tissuereg.simulation.fine.rims import Rim
from tissuereg.simulation.frames import FrameSettings, Similar
from tissuereg.simulation.loading import distinct_states, first_frames
from tissuereg.simulation.memory import SolvedCase, goes_through_time, is_carried, remembers, solve_through_time
from tissuereg.simulation.settings import FINE

#: Displacement of all nodes in the states of each case, (n_states, n_element_nodes, 3).
Fields = dict[str, FloatArray]


class FineModel:
    """An experiment on a mesh with pads cut out and small ten-node elements around them.

    Parameters
    ----------
    experiment : Experiment
        The believed model (as the user states it): mesh, material, supports, cases (load histories), effects.
    meshing : FineMeshing, optional
        Settings of the refinement.

    Attributes
    ----------
    experiment : Experiment
        The experiment as given.
    fine : Experiment
        The same experiment on the fine mesh.

    Raises
    ------
    MeshError
        If refinement does not end.

    Examples
    --------
    >>> import tissuereg as tr
    >>> from tissuereg.experiment.effects import Stiffness
    >>> rig = tr.read_experiment("rig")  # doctest: +SKIP
    >>> model = FineModel(rig)  # doctest: +SKIP
    >>> model.simulate([Stiffness(young_kpa=8.4)], cases=["push_x"])["push_x"].forces["push_x"]  # doctest: +SKIP
    """

    def __init__(self, experiment: Experiment, meshing: FineMeshing | None = None) -> None:
        self.experiment = of_kind("experiment", experiment, Experiment)
        self.meshing = maybe("meshing", meshing, FineMeshing) or FineMeshing()
        self.fine = fine_experiment(experiment, self.meshing)
        self._own: tuple[tuple[Rim | None, ...], Experiment] | None = None
        # Cached elastic solutions for corrections, newest last.
        self._elastic: dict[tuple[Any, ...], FineFrames] = {}
        # Initial guesses by case for the next warm call, and their mesh.
        self._near: tuple[Mesh, Fields] | None = None

    def __repr__(self) -> str:
        return f"FineModel('{self.experiment.name}', {self.experiment.mesh.n_nodes} > {self.mesh.n_nodes} nodes)"

    @property
    def mesh(self) -> Mesh:
        """The fine mesh. Its first nodes are those of the given mesh, some of them moved onto the rim of a pad."""
        return self.fine.mesh

    def simulate(
        self,
        effects: Sequence[Effect] | None = None,
        cases: Sequence[str] | None = None,
        *,
        through_time: str = "corrected",
        warm: bool = False,
        threads: int = 0,
        progress: Callable[[int, int], None] | None = None,
    ) -> dict[str, CaseSimulation]:
        """Return the model's predictions for cases (load histories) of the experiment.

        Parameters
        ----------
        effects : sequence of Effect, optional
            Effects (such as another stiffness, relaxation, a sliding support) instead of those of the experiment.
        cases : sequence of str, optional
            Names of the cases; by default all.
        through_time : {"corrected", "solved"}
            Treatment of materials with memory. `corrected`: four-node elements on the fine mesh, plus the difference
            between ten-node and four-node elements in the elastic solution, which is cached for the next call.
            `solved`: ten-node elements in every frame; this takes minutes per case on 4,000 nodes.
        warm : bool
            Start from the fields of the last such call on the same mesh, and keep the new ones for the next (24 bytes
            per node and distinct load). Between similar effects this halves the time, and changes answers within the
            solver's tolerance. It does not help frames with memory.
        threads : int
            Threads to use; 0 takes all cores. The result does not depend on it.
        progress : callable of (int, int), optional
            Called with frames done and frames in all.

        Returns
        -------
        dict of str to CaseSimulation
            One prediction per case, in the experiment's order, with displacements and places of markers and targets in
            mm and forces of the pads in mN. Displacements are those of the nodes of the experiment's mesh, at their
            places in it.

        Raises
        ------
        ConvergenceError
            If no frame of a case finds equilibrium, or a mesh that was imaged under gravity has no unloaded shape.
        ExperimentError
            If a case is unknown or an effect does not fit the experiment.

        Notes
        -----
        Elastic frames of equal load are solved once. Cases run in parallel, each on one thread.
        """
        check_choice("through_time", through_time, ("corrected", "solved"), ArgumentError)
        flag("warm", warm)
        check_running(threads=threads)
        called("progress", progress)
        own = self.experiment.effects if effects is None else each("effects", effects, Effect)
        cases = None if cases is None else each("cases", cases, str)
        fine = self._with_effects(own)
        wanted = [case for name, case in fine.cases.items() if cases is None or name in cases]
        for name in cases or ():
            fine.case(name)
        threads = threads or n_cores()
        worked = extended(fine, "tet10")
        if remembers(worked):
            readings = self._through_time(fine, wanted, through_time == "solved", threads, progress)
        else:
            if warm and (self._near is None or self._near[0] is not fine.mesh):
                self._near = (fine.mesh, {})
            near = self._near[1] if warm and self._near is not None else None
            readings = _by_load(fine, self.experiment.mesh, worked, wanted, threads, near, progress)
        answers = {}
        for case in wanted:
            reading = readings[case.name]
            answers[case.name] = CaseSimulation(
                case.times,
                reading.displacement,
                seen_markers(fine, reading.markers, case.times),
                reading.forces,
                {target: reading.targets[:, i] for i, target in enumerate(fine.targets)},
                reading.failed,
            )
        return answers

    def _through_time(
        self,
        fine: Experiment,
        cases: Sequence[Case],
        fully: bool,
        threads: int,
        progress: Callable[[int, int], None] | None,
    ) -> dict[str, FineFrames]:
        """Return displacements, markers and targets (mm) and forces (mN) of cases with memory, by name.

        `fully`: if True, ten-node elements solve every frame; otherwise first-order elements do, and the difference
        between ten-node and first-order elements in the elastic solution is added.
        """
        rough = rough_element(fine)
        element: Element = "tet10" if fully else rough
        worked = extended(fine, element)
        through = _with_those_before(worked, cases)
        n_frames = sum(len(case.times) for case in cases)
        report = FrameCount(progress, sum(len(case.times) for case in through) + (0 if fully else 2 * n_frames))
        solved = _remembering(worked, through, element, threads, report)
        reader = Reader(fine, self.experiment.mesh, quadratic=fully)
        readings = {case.name: reader.read(solved[case.name]) for case in cases}
        if fully:
            return readings
        twin = without_time(fine)
        of_rough = self._kept(twin, cases, rough, threads, report, "rough elastic frames")
        of_fine = self._kept(twin, cases, "tet10", threads, report, "fine elastic frames")
        return {name: corrected(reading, of_rough[name], of_fine[name]) for name, reading in readings.items()}

    def _kept(
        self, twin: Experiment, cases: Sequence[Case], element: Element, threads: int, report: "FrameCount", part: str
    ) -> dict[str, FineFrames]:
        """Return displacements and places (mm) and forces (mN) of elastic cases, by name, from the cache if possible.

        `twin`: experiment without memory; `report`: counts frames done; `part`: name of this part of the work there.
        """
        keys = {case.name: (case.name, element, twin.mesh, twin.gravity is None, twin.effects) for case in cases}
        missing = [case for case in cases if keys[case.name] not in self._elastic]
        for case in cases:
            if case not in missing and (notify := report.of(f"{part} of {case.name}")) is not None:
                notify(len(case.times))
        fresh = _elastic(twin, self.experiment.mesh, missing, element, threads, report, part) if missing else {}
        found = {name: fresh[name] if name in fresh else self._elastic.pop(key) for name, key in keys.items()}
        self._elastic |= {keys[name]: reading for name, reading in found.items()}
        while len(self._elastic) > FINE.solutions_kept:
            del self._elastic[next(iter(self._elastic))]
        return found

    def _with_effects(self, effects: Sequence[Effect]) -> Experiment:
        """Return the fine experiment with effects, on another mesh if the effects change where its surface is cut.

        The ball of a shifted pad is cut out at its new place, and so is the part of a boundary that is detached within
        a ball. The mesh of the last such effects is cached.
        """
        check_effects(replace(self.experiment, effects=tuple(effects)))
        pads = {pad.name: pad for pad in self.experiment.actuators if rim_of(pad) is not None}
        loose: list[Rim] = []
        rest = []
        for effect in effects:
            if isinstance(effect, ActuatorOffset) and effect.shift_mm is not None and effect.actuator in pads:
                pads[effect.actuator] = _shifted(pads[effect.actuator], effect.shift_mm)
                continue
            rest.append(effect)
            if isinstance(effect, Detachment) and effect.centre_mm is not None and effect.radius_mm is not None:
                # Nodes on this rim are not in the ball: they stay held.
                loose.append(Rim(effect.centre_mm, effect.radius_mm * (1.0 + 2.0 * FINE.inside)))
        key = (*(rim_of(pad) for pad in pads.values()), *loose)
        if key == tuple(rim_of(pad) for pad in self.experiment.actuators if pad.name in pads):
            return replace(self.fine, effects=tuple(rest))
        if self._own is None or self._own[0] != key:
            actuators = tuple(pads.get(pad.name, pad) for pad in self.experiment.actuators)
            moved = replace(self.experiment, actuators=actuators)
            self._own = (key, fine_experiment(moved, self.meshing, further=loose))
        return replace(self._own[1], effects=tuple(rest))


def _shifted(pad: Actuator, shift: Vector) -> Actuator:
    rule: Any = pad.rule
    return replace(pad, rule={**rule, "centre_mm": (np.asarray(rule["centre_mm"]) + shift).tolist()})


def rough_element(experiment: Experiment) -> Element:
    """Return the first-order element for an experiment: "tet4", or "tet4-averaged" where tet4 would lock."""
    locks = float(extended(experiment, "tet4").material.poisson_array.max()) > FINE.locks_above
    return "tet4-averaged" if locks else "tet4"


def without_time(experiment: Experiment, element: Element = "tet10") -> Experiment:
    """Return an experiment whose frames depend on their own load alone: without memory and sliding.

    Parameters
    ----------
    experiment : Experiment
        The believed model (as the user states it), with its effects.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements of the solve.

    Returns
    -------
    Experiment
        The experiment without those effects, and also without weight if the mesh was imaged under gravity.
    """
    gravity = extended(experiment, element).gravity
    weightless = gravity is not None and gravity.in_reference
    left_out = (Memory, Sliding, Gravity, Reference) if weightless else (Memory, Sliding)
    rest = tuple(effect for effect in experiment.effects if not isinstance(effect, left_out))
    return replace(experiment, effects=rest, gravity=None if weightless else experiment.gravity)


def _elastic(
    fine: Experiment,
    given: Mesh,
    cases: Sequence[Case],
    element: Element,
    threads: int,
    report: "FrameCount",
    part: str,
    near: Fields | None = None,
) -> dict[str, FineFrames]:
    """Return displacements, markers and targets (mm) and forces (mN) of elastic cases, by name, solved in parallel.

    `fine`: experiment on the fine mesh; `given`: mesh before refinement; `report`, `part`: count of frames done;
    `near`: by case, displacements (n_states, n_element_nodes, 3), mm, from which solves start, replaced by the new
    ones.
    """
    ready = extended(fine, element)
    reader = Reader(fine, given, quadratic=element == "tet10")
    share = max(1, threads // max(len(cases), 1))

    def read(case: Case) -> FineFrames:
        notify = report.of(f"{part} of {case.name}")
        # Effects on actuators are worked into the cases.
        moved = ready.cases[case.name]
        begin = None if near is None else near.get(case.name)
        solved = solve_states(ready, moved, element=element, threads=share, near=begin, progress=notify)
        if near is not None:
            near[case.name] = solved.all_displacement[first_frames(distinct_states(moved)[1])]
        return reader.read(solved)

    with ThreadPoolExecutor(max_workers=threads) as pool:
        return dict(zip([case.name for case in cases], pool.map(read, cases), strict=True))


def _with_those_before(worked: Experiment, cases: Sequence[Case]) -> list[Case]:
    """Return the given cases with effects applied, and all earlier ones if softening, set or friction carries over."""
    if not is_carried(worked):
        return [worked.cases[case.name] for case in cases]
    last = max(float(case.times[0]) for case in cases)
    return [case for case in worked.cases.values() if case.times[0] <= last]


def _by_load(
    fine: Experiment,
    given: Mesh,
    worked: Experiment,
    cases: Sequence[Case],
    threads: int,
    near: Fields | None,
    progress: Callable[[int, int], None] | None,
) -> dict[str, FineFrames]:
    """Return displacements and places (mm) and forces (mN) of cases without memory, by name, in ten-node elements.

    `worked`: `fine` with its effects applied; `near`: by case, displacements (n_states, n_element_nodes, 3), mm, from
    which the solves start; replaced by the new ones. With springs or friction, or if the mesh was imaged under gravity,
    a body without these is solved first: started from its changes between states, the solve is several times faster.
    """
    if not goes_through_time(worked):
        report = FrameCount(progress, sum(len(case.times) for case in cases))
        return _elastic(fine, given, cases, "tet10", threads, report, "frames", near)
    cases = _with_those_before(worked, cases)
    states = {case.name: distinct_states(case)[1] for case in cases}
    near = {} if near is None else near
    first = [case for case in cases if len(near.get(case.name, ())) != len(first_frames(states[case.name]))]
    report = FrameCount(progress, sum(len(case.times) for case in (*cases, *first)))
    if first:
        _elastic(without_time(fine), given, first, "tet10", threads, report, "elastic frames", near)
    solved = _remembering(worked, cases, "tet10", threads, report, near)
    reader = Reader(fine, given, quadratic=True)
    for case in cases:
        near[case.name] = solved[case.name].all_displacement[first_frames(states[case.name])]
    return {case.name: reader.read(solved[case.name]) for case in cases}


def _remembering(
    ready: Experiment,
    cases: Sequence[Case],
    element: Element,
    threads: int,
    report: "FrameCount",
    near: Fields | None = None,
) -> dict[str, SolvedCase]:
    """Return displacements (mm) and forces (mN) of cases solved frame after frame, by name; separate ones in parallel.

    `ready`: experiment with effects applied; `report`: counts frames done; `near`: by case, displacements (n_states,
    n_element_nodes, 3), mm, of a model without memory under each distinct load, or None.
    """
    settings, similar = FrameSettings(element, threads=threads), None
    if near is not None:
        similar = Similar({case.name: near[case.name][distinct_states(case)[1]] for case in cases})
        settings = replace(settings, tolerance=FINE.tolerance)
    if is_carried(ready):
        notify = report.of("history")
        return solve_through_time(ready, cases, settings=settings, similar=similar, progress=notify)
    own = replace(settings, threads=max(1, threads // max(len(cases), 1)))

    def solve(case: Case) -> SolvedCase:
        notify = report.of(f"history of {case.name}")
        return solve_through_time(ready, [case], settings=own, similar=similar, progress=notify)[case.name]

    with ThreadPoolExecutor(max_workers=threads) as pool:
        return dict(zip([case.name for case in cases], pool.map(solve, cases), strict=True))


class FrameCount:
    """Counter of frames done, summed over cases that run in parallel.

    `notify`: called with frames done and `in_all`, the number of all frames; None reports nothing.
    """

    def __init__(self, notify: Callable[[int, int], None] | None, in_all: int) -> None:
        self.in_all = in_all
        self._notify = notify
        self._done: dict[str, int] = {}
        self._lock = Lock()

    def of(self, part: str) -> Callable[[int], None] | None:
        """Return a callback that takes the frames done in one part of the work; None if nothing is reported."""
        if self._notify is None:
            return None
        notify = self._notify

        def report(done: int) -> None:
            with self._lock:
                self._done[part] = done
                notify(sum(self._done.values()), self.in_all)

        return report
