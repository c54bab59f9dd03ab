"""Readings (ways to interpret the recording): other units, axes and signs of its channels, each with its prior cost."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.readings.frames import signed_permutations
from tissuereg.registration.readings.settings import COSTS

#: Factors that convert a force to mN and a length to mm, with the names of the units.
FORCES = {1000.0: "N", 9.80665: "gf", 9806.65: "kgf", 4448.222: "lbf", 1e-3: "\u00b5N"}
LENGTHS = {1000.0: "m", 10.0: "cm", 25.4: "inches", 1e-3: "\u00b5m"}

_ONE: FloatArray = np.eye(3)


@dataclass(frozen=True, eq=False)
class _Channel:
    """A group of columns of a file that can be misread alone; `pads`: the actuators whose rows they are."""

    file: str
    columns: str
    units: Mapping[float, str]
    pads: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class RecordingReading:
    """One way to interpret the recording: linear maps from the vectors as given to the true ones.

    `kind`: ``unit``, ``frame``, ``mirrored`` or ``sign``, the first word of the sentence; ``""`` for the input as
    given; `cost`: minus the logarithm of the prior odds of the mistake; `words`: the change of the input; `write`: what
    to write in the files; `files`: those that are misread. Maps (3, 3): `places` of the reference places, `markers` of
    measured places, `commands` and `forces` of those of an actuator, by its name; what is absent is as given.
    """

    kind: str
    cost: float
    words: str
    write: str
    files: tuple[str, ...]
    places: FloatArray = field(default_factory=lambda: _ONE)
    markers: FloatArray = field(default_factory=lambda: _ONE)
    commands: Mapping[str, FloatArray] = field(default_factory=dict)
    forces: Mapping[str, FloatArray] = field(default_factory=dict)


AS_GIVEN = RecordingReading("", 0.0, "", "", ())


def proposals(moved: Sequence[str], pulled: Sequence[str], felt: Sequence[str]) -> Iterator[RecordingReading]:
    """Yield the readings of a recording other than that as given.

    `moved`, `pulled`, `felt`: actuators whose motion and whose force is prescribed, and those whose force was measured.
    """
    reference = _Channel("[markers.reference]", "x, y, z", LENGTHS)
    markers = _Channel("markers.csv", "x_mm, y_mm, z_mm", LENGTHS)
    channels = [
        _Channel("actuators.csv", "x_mm, y_mm, z_mm", LENGTHS, tuple(moved)),
        _Channel("forces_applied.csv", "x_mN, y_mN, z_mN", FORCES, tuple(pulled)),
        _Channel("forces.csv", "x_mN, y_mN, z_mN", FORCES, tuple(felt)),
    ]
    channels = [channel for channel in channels if channel.pads]
    parts = [replace(one, pads=(pad,)) for one in channels if len(one.pads) > 1 for pad in one.pads]
    groups = [[markers], [reference, markers], [reference], *([channel] for channel in (*channels, *parts))]
    moving, pulling = ([one for one in channels if one.units is units] for units in (LENGTHS, FORCES))
    every = [reference, markers, *moving]

    def alone(group: Sequence[_Channel]) -> float:
        return COSTS.alone + (np.log(len(parts)) if group[0] in parts else 0.0)

    for group in [*groups, *([every, [markers, *moving]] if moving else [])]:
        yield from _in_units(group, alone(group))
    for group in [every, moving] if moving else [every]:
        for length, force in product(_in_units(group, COSTS.alone), _in_units(pulling, COSTS.alone)):
            yield _both(length, force)
    together = [[markers, *channels], [reference, markers, *channels], *([channels] if len(channels) > 1 else [])]
    for group in (*groups, *together):
        for turn, _, title in signed_permutations():
            signs = np.diag(turn)
            exchanged = not signs.all()
            if exchanged and group[0] in parts:
                continue  # one pad alone has no axes of its own
            one = not exchanged and int((signs < 0).sum()) in (1, 3)
            kind = "mirrored" if np.linalg.det(turn) < 0 else "frame"
            kind = "sign" if one and group[0].pads and len(group) == 1 else kind
            cost = (COSTS.axes if exchanged else COSTS.flip) + alone(group)
            write = f"write the columns {group[0].columns.split(',')[0]}, ... as {title}"
            yield _reading(kind, cost, f"read as {title}", write, group, turn)


def _in_units(group: Sequence[_Channel], cost: float) -> Iterator[RecordingReading]:
    """Yield the readings of channels in each other unit; none without a channel. `cost`: beside that of a unit."""
    for factor, name in group[0].units.items() if group else ():
        text = f"read in {name} (times {factor:g})"
        write = f"multiply the columns {group[0].columns} by {factor:g}"
        yield _reading("unit", COSTS.unit + cost, text, write, group, factor * _ONE)


def _both(one: RecordingReading, other: RecordingReading) -> RecordingReading:
    """Return the reading that makes the changes of two: `other` changes no markers."""
    return replace(
        one,
        cost=one.cost + other.cost,
        words=f"{one.words}, {other.words}",
        write=f"{one.write}, {other.write}",
        files=(*one.files, *other.files),
        commands={**one.commands, **other.commands},
        forces={**one.forces, **other.forces},
    )


def _reading(
    kind: str, cost: float, text: str, write: str, group: Sequence[_Channel], turn: FloatArray
) -> RecordingReading:
    files = tuple(channel.file for channel in group)
    *first, last = files
    whose = f" of {group[0].pads[0]}" if len(group) == 1 and len(group[0].pads) == 1 else ""
    named = f"{', '.join(first)} and {last}{whose}" if first else f"{last}{whose}"
    places, markers = (turn if file in files else _ONE for file in ("[markers.reference]", "markers.csv"))
    commands = {pad: turn for channel in group if channel.file != "forces.csv" for pad in channel.pads}
    felt = {pad: turn for channel in group if channel.file == "forces.csv" for pad in channel.pads}
    return RecordingReading(
        kind, cost, f"{named} {text}", f"{write} in {named}", files, places, markers, commands, felt
    )
