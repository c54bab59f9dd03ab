"""Registration of one frame of an experiment: the believed rig becomes the prior."""

from dataclasses import replace
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice, check_running, maybe, of_kind
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ArgumentError, ConvergenceError
from tissuereg.experiment.effects import extended, true_markers
from tissuereg.experiment.experiment import Case, Experiment
from tissuereg.registration.body import Body
from tissuereg.registration.register import register
from tissuereg.registration.result import Registration
from tissuereg.registration.settings import RegisterSettings
from tissuereg.simulation.experiment import believed_case
from tissuereg.simulation.frames import FrameSettings
from tissuereg.simulation.memory import goes_through_time, is_carried, solve_through_time
from tissuereg.simulation.solve import ELEMENTS

#: Arguments of `register` that an experiment leaves open.
_OPTIONS = ("model", "simulation", "seed", "progress", "targets")


def frame_input(
    experiment: Experiment, case: str, time: float, *, element: str = "tet4", threads: int = 0
) -> dict[str, Any]:
    """Return the arguments of `register` for a frame of an experiment.

    Body, supports and actuators include their effects; effects of the measuring chain on the markers are undone.

    Parameters
    ----------
    experiment : Experiment
        Believed model and measurements.
    case : str
        Name of the case.
    time : float
        Time in s on the experiment's clock.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements of the package's own simulations.
    threads : int
        Threads to use; 0 takes all cores.

    Returns
    -------
    dict
        ``mesh`` (a `Body` of the experiment's material and these elements), ``markers``, ``targets``, ``load`` (gravity
        and actuators). With memory, sliding supports, or a mesh that was imaged under gravity also ``simulation``; the
        prior around it is elastic with held supports.

    Raises
    ------
    ExperimentError
        If there is no such case, or no frame near that time.
    """
    of_kind("experiment", experiment, Experiment)
    check_choice("element", element, ELEMENTS, ArgumentError)
    check_running(threads=threads)
    experiment = extended(experiment, element)
    history = experiment.case(case)
    measured = replace(history, markers=true_markers(experiment, history.markers, history.times))
    experiment = replace(experiment, cases={**experiment.cases, case: measured})
    frame = experiment.frame(case, time)
    believed = believed_case(experiment, measured, element=element, threads=threads)
    given: dict[str, Any] = {}
    if goes_through_time(experiment):
        given["simulation"] = _through_time(experiment, measured, frame.index, element, threads)
    return {
        **given,
        "mesh": Body(experiment.mesh, experiment.material, element, held_nodes=believed.simulator.held_nodes),
        "markers": frame.markers,
        "targets": dict(experiment.targets),
        "load": believed.loads[frame.index],
    }


def register_frame(
    experiment: Experiment,
    case: str,
    time: float,
    *,
    element: str = "tet4",
    settings: RegisterSettings | None = None,
    **options: Any,
) -> Registration:
    """Register one frame of an experiment, its gravity and actuators in simulation and prior.

    Parameters
    ----------
    experiment : Experiment
        As `read_experiment` gives it.
    case : str
        Name of the case.
    time : float
        Time in s on the experiment's clock.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements of the package's own simulations.
    settings : RegisterSettings, optional
        As in `register`; its threads also solve the frame.
    **options
        As in `register`: ``model``, ``simulation``, ``seed``, ``progress``.

    Returns
    -------
    Registration
        With the experiment's targets.

    Raises
    ------
    ExperimentError
        If there is no such case, or no frame near that time.
    MarkerError, ModelError, ConvergenceError, EnsembleError
        As in `register`.
    """
    for name in options:
        check_choice("option", name, _OPTIONS, ArgumentError)
    how = maybe("settings", settings, RegisterSettings) or RegisterSettings()
    given = frame_input(experiment, case, time, element=element, threads=how.threads)
    return register(**{**given, **options}, settings=how)


def _through_time(experiment: Experiment, case: Case, frame: int, element: str, threads: int) -> FloatArray:
    """Return the displacement (n_nodes, 3), mm, of one frame, by solving its case, or all cases, from the start."""
    carried = is_carried(experiment)
    before = [other for other in experiment.cases.values() if carried and other.times[0] < case.times[0]]
    settings = FrameSettings(element, threads=threads)
    solved = solve_through_time(experiment, [*before, case], settings=settings)[case.name]
    for lost, why in solved.failed:
        if lost == frame:
            message = f"frame {frame} of case '{case.name}' must find equilibrium: {why}"
            raise ConvergenceError(message, where=case.name)
    return np.asarray(solved.displacement[frame])
