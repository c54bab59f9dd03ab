"""Registration of one frame (one measured moment) of an experiment, with its supports and actuators as the prior."""

from dataclasses import replace
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice, check_running, maybe, of_kind
from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import ELEMENTS, Element
from tissuereg._base.provenance import call_text, note_origins, recorded
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

#: Arguments of `register` that an experiment leaves open.
_OPTIONS = ("model", "simulation", "seed", "progress", "targets")


def frame_input(
    experiment: Experiment, case: str, time: float, *, element: Element = "tet4", threads: int = 0
) -> dict[str, Any]:
    """Return the arguments of `register` for one frame (one measured moment) of an experiment.

    An effect is a property that the basic elastic model lacks. Effects on body, supports and actuators, such as a
    sliding support, are included in the model; those of the measuring chain, such as latency, are removed from the
    markers. `experiment`: assumed model (mesh, material, supports, actuators, effects) and measurements; `case`: name
    of the case (one load history of the experiment); `time`: time in s on the experiment's clock; `element` {"tet4",
    "tet4-averaged", "tet10"}: finite elements of the package's own simulations: four-node tets, four-node tets with
    volume ratios averaged at the nodes, or ten-node tets; `threads`: threads to use; 0 takes all cores. Result:
    ``mesh`` (a `Body` of the experiment's material and these elements), ``markers`` (reference and measured places,
    mm), ``targets`` (inner points by name, mm), ``load`` (gravity and actuators). With a material whose response
    depends on the past, sliding supports, or a mesh that was imaged under gravity also ``simulation``, the displacement
    (n_nodes, 3) in mm; the prior around it is elastic with held supports. Raises `ExperimentError` if there is no such
    case, or no frame near that time.
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
    element: Element = "tet4",
    settings: RegisterSettings | None = None,
    **options: Any,
) -> Registration:
    """Register one frame (one measured moment) of an experiment; its gravity and actuators enter simulation and prior.

    Parameters
    ----------
    experiment : Experiment
        Assumed model and measurements, as returned by `read_experiment`.
    case : str
        Name of the case (one load history of the experiment).
    time : float
        Time in s on the experiment's clock.
    element : {"tet4", "tet4-averaged", "tet10"}
        Finite elements of the package's own simulations: four-node tets, four-node tets with volume ratios averaged at
        the nodes, or ten-node tets.
    settings : RegisterSettings, optional
        Settings of the registration, by default ``RegisterSettings()``; its threads also solve the frame.
    **options
        Further arguments of `register`: ``model``, ``simulation``, ``seed``, ``progress``, and ``targets`` in place of
        the experiment's.

    Returns
    -------
    Registration
        The registered body, with the experiment's targets (inner points).

    Raises
    ------
    ExperimentError
        If there is no such case, or no frame near that time.
    MarkerError, ModelError, ConvergenceError, EnsembleError
        If the markers or the model cannot be used, no equilibrium is found, or too few ensemble members survive; as in
        `register`.
    """
    for name in options:
        check_choice("option", name, _OPTIONS, ArgumentError)
    how = maybe("settings", settings, RegisterSettings) or RegisterSettings()
    call = call_text("tissuereg.register_frame", experiment=experiment, case=case, time=time, element=element)
    with recorded(call):
        note_origins(experiment)
        given = frame_input(experiment, case, time, element=element, threads=how.threads)
        return register(**{**given, **options}, settings=how)


def _through_time(experiment: Experiment, case: Case, frame: int, element: Element, threads: int) -> FloatArray:
    """Return the displacement (n_nodes, 3), in mm, of one frame by solving the load history `case` from its start.

    `frame`: number of the frame in the case; `element`: finite elements; `threads`: threads to use; 0 takes all cores.
    If a case depends on earlier cases, such as by softening, those are solved first. Raises `ConvergenceError` if the
    frame has no equilibrium.
    """
    carried = is_carried(experiment)
    before = [other for other in experiment.cases.values() if carried and other.times[0] < case.times[0]]
    settings = FrameSettings(element, threads=threads)
    solved = solve_through_time(experiment, [*before, case], settings=settings)[case.name]
    for lost, why in solved.failed:
        if lost == frame:
            message = f"frame {frame} of case '{case.name}' must find equilibrium: {why}"
            raise ConvergenceError(message, where=case.name)
    return np.asarray(solved.displacement[frame])
