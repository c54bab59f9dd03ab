"""Reading of material tests: ``experiment.toml`` with ``kind = "material-test"``, and the curves in ``test.csv``."""

import math
import os
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tissuereg._base.provenance import reads
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects import Effect, effect_from_table
from tissuereg.experiment.effects.elastic import OtherLaw
from tissuereg.experiment.material_experiment import TEST_MODES, Curve, MaterialExperiment
from tissuereg.io.csv import Row, read_table, write_table
from tissuereg.io.experiment_keys import (
    TEST_COLUMNS,
    MaterialTestKeys,
    Top,
    folder_and_name,
    read_material,
)
from tissuereg.io.toml import Table, experiment_file, read_toml

_COLUMNS = tuple(TEST_COLUMNS)


@reads
def read_material_experiment(path: str | os.PathLike[str]) -> MaterialExperiment:
    """Read the stress-strain curves of a material test and the believed material.

    ``[material]`` is read as in the file of an experiment on a body. Two tables may be left out: ``[test]`` with
    ``hold_out`` (``mode``, ``rate`` or ``specimen``: the curves of one of these are left out of a fit, to test its
    prediction) and ``std_kpa`` (standard deviation of one stress), and ``[[effect]]``. Rows of one specimen, mode and
    rate are one load history from rest; where time falls, another one begins. Empty cells: rate and time where they are
    not known, a stress that was not measured.

    Parameters
    ----------
    path : path-like
        The folder, or the experiment file in it (``experiment.toml`` unless named).

    Returns
    -------
    MaterialExperiment
        The believed material and effects, and the measured curves (strains dimensionless, stresses in kPa).

    Raises
    ------
    ExperimentError
        If the file states another ``kind``, a key or mode is unknown, a stretch is not positive, times are given in
        part, a stress has the wrong sign, or an effect cannot be seen in a material test; the place is named.
    FormatError
        If a file is missing or cannot be read.
    """
    top = read_toml(experiment_file(path))
    kind = Top.of(top).kind
    if kind != "material-test":
        top.refuse('`kind` must be "material-test"', kind)
    folder, name = folder_and_name(top)
    material, young_std, poisson_std = read_material(top)
    hold_out, stress_std = _test(top)
    effects = tuple(_effect(table) for table in top.tables("effect"))
    _check_together(top, effects)
    top.finish()
    curves = _curves(folder / "test.csv")
    return MaterialExperiment(name, folder, material, young_std, poisson_std, curves, effects, hold_out, stress_std)


def write_test_table(path: str | os.PathLike[str], curves: Iterable[Curve]) -> None:
    """Write measured stress-strain curves as the table ``test.csv`` of a material test, whole or not at all.

    A rate, time or stress that is not known (NaN) becomes an empty cell.
    """
    rows = [
        (curve.specimen, curve.mode, curve.rate, float(time), float(amount), float(stress))
        for curve in curves
        for time, amount, stress in zip(curve.times, curve.amounts, curve.stress, strict=True)
    ]
    write_table(path, _COLUMNS, rows)


def _test(top: Table) -> tuple[str | None, float | None]:
    given = MaterialTestKeys.alone(top)
    return (None, None) if given is None else (given.hold_out, given.std_kpa)


def _effect(table: Table) -> Effect:
    try:
        effect = effect_from_table(table.rest())
    except ExperimentError as error:
        table.refuse(str(error))
    if not effect.of_specimen:
        table.refuse("`id` must be an effect on a material, which a test of it can show", effect.id)
    return effect


def _check_together(top: Table, effects: tuple[Effect, ...]) -> None:
    kinds = [OtherLaw if isinstance(effect, OtherLaw) else type(effect) for effect in effects]
    twice = [effect.id for kind, effect in zip(kinds, effects, strict=True) if kinds.count(kind) > 1]
    if twice:
        top.refuse("there must be one effect of an id at most, and one other law", ", ".join(twice))


def _curves(path: Path) -> tuple[Curve, ...]:
    groups: dict[tuple[str, str, float | None], list[list[Row]]] = {}
    times: dict[tuple[str, str, float | None], float] = {}
    for row in read_table(path, _COLUMNS):
        rate = row.number("rate_per_s", may_miss=True)
        key = (row.text("specimen"), row.text("mode"), None if math.isnan(rate) else rate)
        if key[1] not in TEST_MODES:
            message = (
                f"column 'mode' must hold one of {', '.join(TEST_MODES)}, got '{key[1]}' at {path} line {row.line}"
            )
            raise ExperimentError(message, where=row.where)
        time = row.number("time_s", may_miss=True)
        histories = groups.setdefault(key, [])
        if not histories or time < times[key]:
            histories.append([])
        histories[-1].append(row)
        times[key] = time
    return tuple(_curve(path, *key, rows) for key, histories in groups.items() for rows in histories)


def _curve(path: Path, specimen: str, mode: str, rate: float | None, rows: list[Row]) -> Curve:
    try:
        return Curve(
            specimen,
            mode,
            math.nan if rate is None else rate,
            np.array([row.number("time_s", may_miss=True) for row in rows]),
            np.array([row.number("stretch_or_shear") for row in rows]),
            np.array([row.number("stress_kPa", may_miss=True) for row in rows]),
        )
    except ExperimentError as error:
        message = f"{error} of {path} from line {rows[0].line} on"
        raise ExperimentError(message, where=rows[0].where) from error
