"""What was recorded in a case, in the form in which other readings of it are weighed: motion, forces, commands.

Beside it stands the linear response of the believed model at rest: fields and forces for a unit command of every
actuator.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg._base.choices import Element
from tissuereg.diagnosis.settings import RecordingSettings
from tissuereg.diagnosis.signals import SignalLayout
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
    experiment: Experiment, *, element: Element, threads: int, settings: RecordingSettings
) -> dict[tuple[str, ...], Response]:
    """Return the linear response of the believed model for every set of actuators that a case has, by their names.

    Weight and memory are left out; `threads`: 0 for all cores. The result is empty where the model has no equilibrium.
    """
    plain = replace(experiment, gravity=None)
    if goes_through_time(plain):
        plain = replace(plain, effects=())
    sets = dict.fromkeys(present(experiment, case) for case in experiment.cases.values())
    cases = {str(i): _unit_case(plain, str(i), pads, settings) for i, pads in enumerate(sets) if pads}
    try:
        worked = extended(replace(plain, cases=cases, rest_case=None), element)
        frames = FrameSettings(element, settings.tolerance, threads)
        solved = solve_cases(worked, list(worked.cases.values()), settings=frames)
        if any(one.failed for one in solved.values()):
            return {}
    except TissueRegError:
        return {}
    found = {}
    for i, pads in enumerate(sets):
        if pads:
            answer, units = solved[str(i)], np.repeat([_unit(plain, pad, settings) for pad in pads], 3)[:, None]
            fields = (answer.displacement[1:] - answer.displacement[0]) / units[:, None]
            forces = {pad: ((f[1:] - f[0]) / units).reshape(len(pads), 3, 3) for pad, f in answer.forces.items()}
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
    given = {pad: _unit(experiment, pad, settings) * np.eye(n_frames, 3, -1 - 3 * i) for i, pad in enumerate(pads)}
    moves = {pad: values for pad, values in given.items() if experiment.actuator(pad).kind == "displacement"}
    return Case(
        name,
        np.arange(float(n_frames)),
        np.full((n_frames, len(experiment.marker_names), 3), np.nan),
        moves,
        {pad: values for pad, values in given.items() if pad not in moves},
    )


@dataclass(frozen=True, eq=False)
class Recorded:
    """One case: its commands and what was measured, less what was measured without a command; NaN = not measured.

    `response`: of the believed model to the actuators of the case; `commands` (n_pads, n_frames, 3): mm or mN;
    `is_motion` bool (n_pads,): whether each is a displacement; `motion` (n_frames, n_markers, 3): of the markers, mm;
    `rest` (n_markers, 3): their places without a command, mm; `felt`: pads whose force was measured; `forces`
    (n_frames, n_felt, 3): mN.
    """

    response: Response
    commands: FloatArray
    is_motion: BoolArray
    motion: FloatArray
    rest: FloatArray
    felt: tuple[str, ...]
    forces: FloatArray


def recorded(
    experiment: Experiment,
    layout: SignalLayout,
    known: dict[tuple[str, ...], Response],
    settings: RecordingSettings,
) -> list[Recorded]:
    """Return the cases in which an actuator acts; `known`: responses by the actuators present."""
    found = []
    for part in layout.parts:
        case = experiment.cases[part.name]
        response = known.get(present(experiment, case))
        if response is None:
            continue
        given = {**case.applied_forces, **case.displacements}
        commands = np.array([given[pad] for pad in response.pads])
        acts = np.abs(commands).max(axis=(0, 2)) > 0.0
        frames = np.flatnonzero(acts)
        if not len(frames):
            continue
        frames = frames[
            np.unique(np.linspace(0, len(frames) - 1, min(len(frames), settings.frames)).round().astype(int))
        ]
        motion, forces = part.markers(layout.measured), part.forces(layout.measured)
        rest = _mean(motion[~acts])
        one = Recorded(
            response,
            commands[:, frames],
            np.array([pad in case.displacements for pad in response.pads]),
            motion[frames] - np.nan_to_num(rest),
            experiment.marker_reference + rest,
            part.pads,
            forces[frames] - np.nan_to_num(_mean(forces[~acts])),
        )
        found.append(one)
    return found


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean (...) over frames of values (n_frames, ...); NaN where none was measured."""
    seen = np.isfinite(values)
    count = seen.sum(axis=0)
    total = np.where(seen, values, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
