"""What a model with any effects says of all that was measured."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.signals import Layout
from tissuereg.effects import ChainEffect, Effect, extended, seen_markers
from tissuereg.errors import ConvergenceError
from tissuereg.experiment import Experiment
from tissuereg.observe import MarkerObservation
from tissuereg.simulate.experiment import Simulators, solve_cases

#: Residual over load. It leaves some 1e-6 mm, far below any noise.
TOLERANCE = 1e-6

#: Solved models that are kept for others that differ in the tracker alone.
MOST_SOLVED = 4


@dataclass(frozen=True, eq=False)
class _Solved:
    """What a model says of its body, before the tracker sees it."""

    effects: tuple[Effect, ...]
    young: float | None
    places: dict[str, FloatArray]
    forces: dict[str, dict[str, FloatArray]]
    times: dict[str, FloatArray]


class Predictor:
    """The believed model of an experiment, asked again and again with other effects.

    Parameters
    ----------
    experiment : Experiment
        What is believed, its own effects included.
    layout : Layout
        Order of the answer.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements to use.
    threads : int
        Threads to use; 0 takes all cores.
    """

    def __init__(self, experiment: Experiment, layout: Layout, *, element: str = "tet4", threads: int = 0) -> None:
        self.experiment = experiment
        self.layout = layout
        self.element = element
        self.threads = threads
        self.observation = MarkerObservation(experiment.mesh, experiment.marker_reference, experiment.marker_names)
        self._simulators: Simulators = {}
        self._solved: list[_Solved] = []

    def predict(
        self, effects: Sequence[Effect] = (), *, young: float | None = None, threads: int | None = None
    ) -> FloatArray:
        """Return what is predicted with further effects.

        Parameters
        ----------
        effects : sequence of Effect
            Beside those of the experiment.
        young : float, optional
            Factor on the believed modulus.
        threads : int, optional
            Threads to use; the predictor's own number where absent.

        Returns
        -------
        ndarray of float64, shape (size,)
            As `Layout.measured`, everywhere finite.

        Raises
        ------
        ConvergenceError
            If a frame finds no equilibrium.
        ExperimentError
            If an effect does not fit.
        """
        believed = replace(self.experiment, effects=(*self.experiment.effects, *effects))
        # The body does not feel its tracker: what differs in that alone is solved once.
        bodily = tuple(effect for effect in effects if not isinstance(effect, ChainEffect))
        for solved in reversed(self._solved):
            if solved.young == young and solved.effects == bodily:
                break
        else:
            solved = self._solve(bodily, young, self.threads if threads is None else threads)
            self._solved = [*self._solved, solved][-MOST_SOLVED:]
        seen = {name: seen_markers(believed, places, solved.times[name]) for name, places in solved.places.items()}
        return self.layout.flatten(seen, solved.forces)

    def _solve(self, effects: tuple[Effect, ...], young: float | None, threads: int) -> "_Solved":
        believed = replace(self.experiment, effects=(*self.experiment.effects, *effects))
        if young is not None:
            believed = replace(believed, material=believed.material.scaled(young))
        worked = extended(believed, self.element)
        cases = list(worked.cases.values())
        solved = solve_cases(
            worked, cases, element=self.element, tolerance=TOLERANCE, threads=threads, simulators=self._simulators
        )
        places, forces = {}, {}
        for case in cases:
            found = solved[case.name]
            refuse_failures(case.name, found.failed)
            moved = self.observation.predict(found.displacement[:, self.observation.nodes])
            places[case.name] = worked.marker_reference + moved
            forces[case.name] = found.forces
        return _Solved(effects, young, places, forces, {case.name: case.times for case in cases})


def refuse_failures(case: str, failed: Sequence[tuple[int, str]]) -> None:
    """Refuse a case with a frame that found no equilibrium.

    Parameters
    ----------
    case : str
        Its name.
    failed : sequence of (int, str)
        Frames without equilibrium, with the reason.

    Raises
    ------
    ConvergenceError
        It names the first one.
    """
    if failed:
        frame, why = failed[0]
        message = f"every frame must find equilibrium; frame {frame} of case '{case}' does not: {why}"
        raise ConvergenceError(message, where=case)
