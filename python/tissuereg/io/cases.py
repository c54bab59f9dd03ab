"""The tables of an experiment folder, ``case,time_s,<name>,x,y,z``, grouped into load cases (histories of loads).

The frames of a case are the times of its rows in markers.csv, or of its actuators' rows if it has no markers. Measured
forces and targets must fall on frames; prescribed motions and forces of actuators are interpolated linearly.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ExperimentError
from tissuereg.experiment.experiment import Actuator, Case
from tissuereg.io.bounds import FILES
from tissuereg.io.csv import Row, read_table, write_table
from tissuereg.io.experiment_keys import CsvTable


@dataclass
class History:
    """Rows of one marker, actuator or target in one load case, in the order of time.

    `rows`: lines of the table, for messages; `times`: time of each row in s, strictly increasing; `values`: three
    numbers per row, along x, y and z, in the table's unit (mm or mN); NaN where the cell is empty.
    """

    rows: list[Row] = field(default_factory=list)
    times: list[float] = field(default_factory=list)
    values: list[tuple[float, ...]] = field(default_factory=list)


#: History by name, by case.
Histories = dict[str, dict[str, History]]


def read_histories(path: Path, table: CsvTable, known: Iterable[str] | None) -> Histories:
    """Read one comma-separated table of an experiment folder, grouped by load case and by marker, actuator or target.

    `path`: the file; `table`: the table's columns; `known`: names that may stand in the third column; None allows any.
    Result: a `History` by case and then by name, in file order. Raises `ExperimentError` if a name is unknown, a row is
    repeated or time runs backwards; the message names the line; `FormatError` if the table cannot be read.
    """
    who, components = table.who, table.columns[3:]
    names = None if known is None else tuple(known)
    histories: Histories = {}
    for row in read_table(path, table.columns):
        name = row.text(who)
        if names is not None and name not in names:
            message = (
                f"{who} '{name}' must be declared in the experiment file for this table; "
                f"declared: {', '.join(names) or 'none'}, at {path} line {row.line}"
            )
            raise ExperimentError(message, where=row.where)
        history = histories.setdefault(row.text("case"), {}).setdefault(name, History())
        _append(history, row, row.number("time_s"), row.numbers(components, may_miss=True))
    return histories


def _append(history: History, row: Row, time: float, values: tuple[float, ...]) -> None:
    if history.times and time <= history.times[-1]:
        rule = "a row must not be repeated" if time == history.times[-1] else "time must increase"
        before = f"{history.times[-1]:g} s at line {history.rows[-1].line}"
        message = f"{rule} within one case: {time:g} s at {row.file} line {row.line} follows {before}"
        raise ExperimentError(message, where=row.where)
    history.rows.append(row)
    history.times.append(time)
    history.values.append(values)


def assemble_cases(
    markers: Histories,
    marker_names: Sequence[str],
    actuators: Sequence[Actuator],
    controls: Mapping[str, Histories],
    forces: Histories,
    targets: Histories,
) -> dict[str, Case]:
    """Return the load cases of an experiment by name, made from its tables, with all values at the frames of each case.

    `markers`, `forces`, `targets`: rows of the tables of measured marker places (mm), forces (mN) and places of inner
    points (mm), by case, then by name; `marker_names`: order of the marker arrays; `actuators`: declared actuators;
    `controls`: rows of the tables of prescribed values by the actuators' kind: ``displacement`` in mm, ``force`` in mN.
    Result: cases with marker rows in file order, then those that appear only in actuator tables. Raises
    `ExperimentError` if a measured row falls on no frame, an actuator's rows do not cover the frames, or a case is
    unknown.
    """
    kinds = {actuator.name: actuator.kind for actuator in actuators}
    names = list(dict.fromkeys([*markers, *(case for table in controls.values() for case in table)]))
    _refuse_unknown_cases(names, forces, targets)
    cases = {}
    for name in names:
        given = {who: h for table in controls.values() for who, h in table.get(name, {}).items()}
        frames = _frames(markers.get(name) or given)
        moved = {who: _interpolated(h, frames, who, name) for who, h in given.items()}
        cases[name] = Case(
            name=name,
            times=frames,
            markers=_stacked(markers.get(name, {}), marker_names, frames),
            displacements={who: values for who, values in moved.items() if kinds[who] == "displacement"},
            applied_forces={who: values for who, values in moved.items() if kinds[who] == "force"},
            forces={who: _on_frames(h, frames) for who, h in forces.get(name, {}).items()},
            targets={who: _on_frames(h, frames) for who, h in targets.get(name, {}).items()},
        )
    return cases


def _refuse_unknown_cases(names: list[str], *tables: Histories) -> None:
    for table in tables:
        for case, histories in table.items():
            if case not in names:
                row = next(iter(histories.values())).rows[0]
                message = (
                    f"case '{case}' must have marker or actuator rows as well; cases that have: "
                    f"{', '.join(names)}, at {row.file} line {row.line}"
                )
                raise ExperimentError(message, where=row.where)


def _frames(histories: Mapping[str, History]) -> FloatArray:
    return np.unique(np.concatenate([history.times for history in histories.values()]))


def _stacked(histories: Mapping[str, History], names: Sequence[str], frames: FloatArray) -> FloatArray:
    measured = np.full((len(frames), len(names), 3), np.nan)
    for column, name in enumerate(names):
        if name in histories:
            measured[:, column] = _on_frames(histories[name], frames)
    return measured


def _on_frames(history: History, frames: FloatArray) -> FloatArray:
    """Return the values of one marker, actuator or target at the frames, shape (n_frames, 3); NaN where it has no row.

    `frames`: times of the frames (n_frames,), s; values keep the unit of the table (mm or mN). Raises `ExperimentError`
    if a row falls on no frame.
    """
    times = np.asarray(history.times)
    nearest = np.argmin(np.abs(frames[:, None] - times), axis=0)
    step = float(np.median(np.diff(frames))) if len(frames) > 1 else 0.0
    off = np.abs(frames[nearest] - times) > max(FILES.same_time * step, 1e-6)
    if off.any():
        row = history.rows[int(np.argmax(off))]
        message = (
            f"every measured row must fall on a frame of its case; "
            f"{row.cells['time_s']} s at {row.file} line {row.line} does not"
        )
        raise ExperimentError(message, where=row.where)
    values = np.full((len(frames), 3), np.nan)
    values[nearest] = history.values
    return values


def _interpolated(history: History, frames: FloatArray, who: str, case: str) -> FloatArray:
    """Return the prescribed values of an actuator at the frames, shape (n_frames, 3), interpolated linearly in time.

    `frames`: times of the frames (n_frames,), s; values keep the unit of the table (mm or mN); `who`, `case`: names of
    the actuator and the load case, for the message if the rows do not cover the frames (`ExperimentError`).
    """
    values = np.asarray(history.values)
    whole = np.isfinite(values).all(axis=1)
    times = np.asarray(history.times)[whole]
    if times.size == 0 or times[0] > frames[0] + 1e-6 or times[-1] < frames[-1] - 1e-6:
        row = history.rows[0]
        covered = f"{times[0]:g} to {times[-1]:g} s" if times.size else "nothing"
        message = (
            f"the rows of actuator '{who}' must cover case '{case}' from {frames[0]:g} to {frames[-1]:g} s; "
            f"they cover {covered}, from {row.file} line {row.line}"
        )
        raise ExperimentError(message, where=row.where)
    return np.stack([np.interp(frames, times, values[whole, axis]) for axis in range(3)], axis=1)


def write_histories(
    path: Path, table: CsvTable, histories: Mapping[str, tuple[FloatArray, Mapping[str, FloatArray]]]
) -> None:
    """Write one comma-separated table of an experiment folder, whole or not at all.

    `table`: the table's columns; `histories`: for each load case by name, its times (n_frames,) in s, and by marker,
    actuator or target the values (n_frames, 3) in the table's unit; NaN becomes an empty cell.
    """
    rows = (
        (case, float(time), name, *map(float, values[frame]))
        for case, (times, named) in histories.items()
        for frame, time in enumerate(times)
        for name, values in named.items()
    )
    write_table(path, table.columns, rows)
