"""What was recorded in a case, in the form in which other readings of it are weighed: motion, forces, commands."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.readings.response import Response, present
from tissuereg.diagnosis.readings.settings import RECORDINGS, RecordingSettings
from tissuereg.diagnosis.signals import CasePart, SignalLayout
from tissuereg.experiment.experiment import Case, Experiment


@dataclass(frozen=True, eq=False)
class Recorded:
    """One case: its commands and what was measured, less what was measured without a command.

    `response`: answer of the believed model to the actuators of the case; `commands` (n_pads, n_frames, 3): mm or mN,
    as given; `is_motion` bool (n_pads,): whether each is a displacement; `motion` (n_frames, n_markers, 3): motion of
    the markers, mm; `rest` (n_markers, 3): their places without a command, mm; `felt`: names of the pads whose force
    was measured; `forces` (n_frames, n_felt, 3): mN. NaN = not measured.
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
    settings: RecordingSettings = RECORDINGS,
) -> list[Recorded]:
    """Return the cases in which an actuator acts; `known`: responses by the actuators present."""
    found = []
    for part in layout.parts:
        case = experiment.cases[part.name]
        response = known.get(present(experiment, case))
        if response is not None:
            one = _case(experiment, layout, part, case, response, settings.frames)
            if one is not None:
                found.append(one)
    return found


def _case(
    experiment: Experiment, layout: SignalLayout, part: CasePart, case: Case, response: Response, most: int
) -> Recorded | None:
    commands = np.array(
        [case.displacements[pad] if pad in case.displacements else case.applied_forces[pad] for pad in response.pads]
    )
    acts = np.abs(commands).max(axis=(0, 2)) > 0.0
    frames = np.flatnonzero(acts)
    if not len(frames):
        return None
    frames = frames[np.unique(np.linspace(0, len(frames) - 1, min(len(frames), most)).round().astype(int))]
    measured = layout.measured
    motion, forces = part.markers(measured), part.forces(measured)
    rest = _mean(motion[~acts])
    return Recorded(
        response,
        commands[:, frames],
        np.array([pad in case.displacements for pad in response.pads]),
        motion[frames] - np.nan_to_num(rest),
        experiment.marker_reference + rest,
        part.pads,
        forces[frames] - np.nan_to_num(_mean(forces[~acts])),
    )


def _mean(values: FloatArray) -> FloatArray:
    """Return the mean (...) over frames of values (n_frames, ...); NaN where none was measured."""
    seen = np.isfinite(values)
    count = seen.sum(axis=0)
    total = np.where(seen, values, 0.0).sum(axis=0)
    return np.asarray(np.where(count > 0, total / np.maximum(count, 1), np.nan))
