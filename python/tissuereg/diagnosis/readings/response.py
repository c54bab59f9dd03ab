"""Linear response of the believed model at rest: fields and forces for a unit command of every actuator."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg.diagnosis.readings.settings import RECORDINGS, RecordingSettings
from tissuereg.errors import TissueRegError
from tissuereg.experiment.effects import extended
from tissuereg.experiment.experiment import Case, Experiment
from tissuereg.simulation.experiment import solve_cases
from tissuereg.simulation.frames import FrameSettings
from tissuereg.simulation.memory import goes_through_time


@dataclass(frozen=True, eq=False)
class Response:
    """Answer of the body at rest to unit commands of the actuators that are present together.

    `pads`: their names; `fields` (n_pads, 3, n_nodes, 3): displacement of the nodes by a unit command of each pad along
    each axis, mm per mm or mm per mN; `forces` by displacement pad, (n_pads, 3, 3): force on it, mN per mm or per mN.
    """

    pads: tuple[str, ...]
    fields: FloatArray
    forces: dict[str, FloatArray]


def responses(
    experiment: Experiment, *, element: Element, threads: int, settings: RecordingSettings = RECORDINGS
) -> dict[tuple[str, ...], Response]:
    """Return the linear response of the believed model for every set of actuators that a case has, by their names.

    `experiment`: the believed model; weight and memory are left out; `element`: elements of the model; `threads`:
    threads to use, 0 for all cores. The result is empty where the model has no equilibrium.
    """
    plain = replace(experiment, gravity=None)
    if goes_through_time(plain):
        plain = replace(plain, effects=())
    sets = dict.fromkeys(present(experiment, case) for case in experiment.cases.values())
    cases = {str(i): _unit_case(plain, str(i), pads, settings) for i, pads in enumerate(sets) if pads}
    try:
        worked = extended(replace(plain, cases=cases, rest_case=None), element)
        solved = solve_cases(
            worked, list(worked.cases.values()), settings=FrameSettings(element, settings.tolerance, threads)
        )
        if any(one.failed for one in solved.values()):
            return {}
    except TissueRegError:
        return {}
    found = {}
    for i, pads in enumerate(sets):
        if pads:
            units = np.repeat([_unit(plain, pad, settings) for pad in pads], 3)
            answer = solved[str(i)]
            fields = (answer.displacement[1:] - answer.displacement[0]) / units[:, None, None]
            forces = {
                pad: ((values[1:] - values[0]) / units[:, None]).reshape(len(pads), 3, 3)
                for pad, values in answer.forces.items()
            }
            found[pads] = Response(pads, fields.reshape(len(pads), 3, -1, 3), forces)
    return found


def present(experiment: Experiment, case: Case) -> tuple[str, ...]:
    """Return the names of the actuators that a case commands, in the experiment's order."""
    return tuple(
        pad.name for pad in experiment.actuators if pad.name in case.displacements or pad.name in case.applied_forces
    )


def _unit(experiment: Experiment, name: str, settings: RecordingSettings) -> float:
    extent = experiment.mesh.extent
    if experiment.actuator(name).kind == "displacement":
        return settings.motion * extent
    return settings.force * float(experiment.material.young_array.mean()) * extent**2


def _unit_case(experiment: Experiment, name: str, pads: Sequence[str], settings: RecordingSettings) -> Case:
    """Return a case whose first frame is at rest, followed by a small command of every pad along each axis."""
    n_frames = 1 + 3 * len(pads)
    given: dict[str, FloatArray] = {}
    for i, pad in enumerate(pads):
        given[pad] = np.zeros((n_frames, 3))
        given[pad][1 + 3 * i : 4 + 3 * i] = _unit(experiment, pad, settings) * np.eye(3)
    moves = {pad: values for pad, values in given.items() if experiment.actuator(pad).kind == "displacement"}
    return Case(
        name,
        np.arange(float(n_frames)),
        np.full((n_frames, len(experiment.marker_names), 3), np.nan),
        moves,
        {pad: values for pad, values in given.items() if pad not in moves},
    )
