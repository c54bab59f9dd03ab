"""One frame of an experiment, registered: what is believed of the rig becomes the prior."""

from dataclasses import replace
from typing import Any

from tissuereg.effects import extended, true_markers
from tissuereg.experiment import Experiment
from tissuereg.registration import register
from tissuereg.result import Registration
from tissuereg.simulate.experiment import believed_case


def frame_input(
    experiment: Experiment, case: str, time: float, *, element: str = "tet4", threads: int = 0
) -> dict[str, Any]:
    """Return the arguments of `register` that a frame of an experiment stands for.

    Body, supports and actuators act with their effects; what the measuring chain does to the markers is undone.

    Parameters
    ----------
    experiment : Experiment
        What is believed and what was measured.
    case : str
        Name of the case.
    time : float
        Time in s on the experiment's clock.
    element : {"tet4", "tet10"}
        Elements of our own simulations.
    threads : int
        Threads to use; 0 takes all cores.

    Returns
    -------
    dict
        ``mesh``, ``markers``, ``targets``, ``load`` (gravity and actuators), ``material``, ``held_nodes``.

    Raises
    ------
    ExperimentError
        If there is no such case, or no frame near that time.
    """
    experiment = extended(experiment, element)
    history = experiment.case(case)
    measured = replace(history, markers=true_markers(experiment, history.markers, history.times))
    experiment = replace(experiment, cases={**experiment.cases, case: measured})
    frame = experiment.frame(case, time)
    believed = believed_case(experiment, measured, element=element, threads=threads)
    return {
        "mesh": experiment.mesh,
        "markers": frame.markers,
        "targets": dict(experiment.targets),
        "load": believed.loads[frame.index],
        "material": experiment.material,
        "held_nodes": believed.simulator.held_nodes,
    }


def register_frame(
    experiment: Experiment, case: str, time: float, *, element: str = "tet4", threads: int = 0, **options: Any
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
    element : {"tet4", "tet10"}
        Elements of our own simulations.
    threads : int
        Threads to use; 0 takes all cores.
    **options
        As in `register`: ``model``, ``simulation``, ``seed``, ``settings``, ``progress``.

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
    given = frame_input(experiment, case, time, element=element, threads=threads)
    return register(**given, element=element, threads=threads, **options)
