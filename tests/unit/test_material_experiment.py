"""Material-test folders: what is read, what is refused, what comes back."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.material_curves import believed, in_modes
from tissuereg.diagnosis.material import predicted_stresses
from tissuereg.errors import ExperimentError, FormatError
from tissuereg.experiment.effects import Asymmetry, Inclusion, Relaxation, Stiffening
from tissuereg.experiment.material_experiment import Curve
from tissuereg.io.material_experiments import (
    read_material_experiment,
    write_test_table,
)

TOML = """
kind = "material-test"
name = "gel"
[material]
law = "neo-hookean"
young_kpa = [10.0, 3.0]
poisson = 0.45
density_g_per_cm3 = 1.0
"""
HEADER = "specimen,mode,rate_per_s,time_s,stretch_or_shear,stress_kPa\n"
ROWS = "a,tension,,,1.0,0.0\na,tension,,,1.1,0.9\na,tension,,,1.2,1.7\n"


def folder(path, toml=TOML, rows=ROWS, header=HEADER):
    (path / "experiment.toml").write_text(toml, encoding="utf-8")
    (path / "test.csv").write_text(header + rows, encoding="utf-8")
    return path


def test_a_folder_of_the_formats_keys_is_read(tmp_path):
    experiment = read_material_experiment(folder(tmp_path))
    (curve,) = experiment.curves
    assert (experiment.name, experiment.young_std, experiment.poisson_std) == ("gel", 3.0, None)
    assert (curve.specimen, curve.mode, curve.timed) == ("a", "tension", False)
    assert np.isnan(curve.rate)
    assert curve.amounts.tolist() == [1.0, 1.1, 1.2]
    assert experiment.values("rate") == []


def test_time_that_falls_begins_another_load_history(tmp_path):
    once = "a,simple-shear,0.1,0,0,0\na,simple-shear,0.1,1,0.1,0.3\na,simple-shear,0.1,2,0.2,0.6\n"
    experiment = read_material_experiment(folder(tmp_path, rows=once + once))
    assert [len(curve.amounts) for curve in experiment.curves] == [3, 3]


def test_a_stress_that_was_not_measured_keeps_its_place_in_the_path(tmp_path):
    rows = ROWS + "a,tension,,,1.3,\n"
    (curve,) = read_material_experiment(folder(tmp_path, rows=rows)).curves
    assert np.isnan(curve.stress[3])
    assert curve.amounts[3] == 1.3


def test_the_clock_follows_from_the_rate_where_no_times_are_given():
    curve = Curve("a", "compression", 0.1, [np.nan] * 3, [0.9, 0.8, 0.7], [-1.0, -2.0, -3.0])
    assert curve.clock.tolist() == pytest.approx([1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (ROWS.replace("tension", "torsion"), "column 'mode' must hold one of"),
        (ROWS.replace("1.2,1.7", "-1.2,1.7"), "stretches must be positive"),
        (ROWS.replace("1.1,0.9", ",0.9"), "must hold a finite number"),
        (ROWS.replace("0.9", "-0.9").replace("1.7", "-1.7"), "must have the sign of the strain"),
        (ROWS.replace("a,tension,,,1.1", "a,tension,,3.0,1.1"), "in all rows or in none"),
        (ROWS.replace("tension,,", "tension,-0.1,"), "its rate must be positive"),
        (ROWS.replace("1.2,1.7", "1.2,"), "at least three stresses"),
        (ROWS.replace("a,tension", ",tension"), "column 'specimen' must not be empty"),
    ],
)
def test_bad_rows_are_refused_with_their_file(tmp_path, rows, message):
    with pytest.raises(FormatError, match=message) as caught:
        read_material_experiment(folder(tmp_path, rows=rows))
    assert "test.csv" in str(caught.value)


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        (TOML.replace('"material-test"', '"rig"'), 'must be "material-test"'),
        (TOML.replace("[material]", "[stuff]"), r"a table \[material\] must be given"),
        (TOML.replace("neo-hookean", "gent"), "law"),
        (TOML + "colour = 1\n", "only the keys"),
        (TOML + '[test]\nhold_out = "day"\n', "must be one of mode, rate, specimen"),
        (TOML + "[test]\nstd_kpa = 0.0\n", "must be a finite number greater than 0"),
        (TOML + '[[effect]]\nid = "latency"\nlatency_s = 0.1\n', "must be an effect on a material"),
        (
            TOML + '[[effect]]\nid = "stiffening"\nlaw = "fung"\nb = 1.0\n[[effect]]\nid = "mooney"\n'
            'law = "mooney-rivlin"\nshare = 0.1\n',
            "one other law",
        ),
    ],
)
def test_bad_beliefs_are_refused_with_their_file(tmp_path, toml, message):
    with pytest.raises(ExperimentError, match=message) as caught:
        read_material_experiment(folder(tmp_path, toml=toml))
    assert "experiment.toml" in str(caught.value)


def test_missing_files_and_other_headers_are_refused(tmp_path):
    with pytest.raises(FormatError, match=r"no such file.*experiment\.toml"):
        read_material_experiment(tmp_path)
    with pytest.raises(FormatError, match="must begin with the header"):
        read_material_experiment(folder(tmp_path, header=HEADER.replace("rate_per_s", "rate")))
    (tmp_path / "test.csv").unlink()
    with pytest.raises(FormatError, match=r"test\.csv"):
        read_material_experiment(tmp_path)


def test_an_unknown_mode_and_other_lengths_are_refused_in_python():
    with pytest.raises(ExperimentError, match="its mode must be one of"):
        Curve("a", "torsion", np.nan, [np.nan] * 3, [1.0, 1.1, 1.2], [0.0, 1.0, 2.0])
    with pytest.raises(ExperimentError, match="must be equally many"):
        Curve("a", "tension", np.nan, [np.nan] * 3, [1.0, 1.1], [0.0, 1.0, 2.0])
    with pytest.raises(ExperimentError, match="must be finite"):
        Curve("a", "tension", np.nan, [np.nan] * 3, [1.0, 1.1, np.nan], [0.0, 1.0, 2.0])


def test_an_experiment_comes_back_as_it_was_written(tmp_path):
    curves = in_modes(np.random.default_rng(1), ("plain",))
    write_test_table(tmp_path / "test.csv", curves)
    effects = (
        Asymmetry(law="ogden", alpha=(-12.0,), weight=(1.0,)),
        Relaxation(g=(0.2, 0.1), tau_s=(1.0, 30.0)),
    )
    experiment = replace(believed(curves, folder=tmp_path), effects=effects, hold_out="mode", stress_std=0.1)
    (tmp_path / "out").mkdir()
    tr.write_experiment(experiment, tmp_path / "out" / "experiment.extended.toml")
    again = read_material_experiment(tmp_path / "out" / "experiment.extended.toml")
    assert again.effects == effects
    assert (again.hold_out, again.stress_std, again.young_std) == ("mode", 0.1, 3.0)
    for here, there in zip(predicted_stresses(experiment), predicted_stresses(again), strict=True):
        # The table keeps nine digits.
        assert there == pytest.approx(here, rel=1e-6, abs=1e-7)


def test_what_a_material_test_cannot_hold_is_not_written_or_run(tmp_path):
    curves = in_modes(np.random.default_rng(1), ("plain",))
    varied = replace(believed(curves), material=tr.Material(np.array([1.0, 2.0]), 0.45))
    with pytest.raises(ExperimentError, match="must be one for the whole body"):
        tr.write_experiment(varied, tmp_path / "experiment.toml")
    ball = Inclusion(centre_mm=(0, 0, 0), semi_axes_mm=(1, 1, 1), contrast=2.0)
    with pytest.raises(ExperimentError, match="must be one on the material"):
        predicted_stresses(believed(curves, effects=(ball,)))


def test_an_effect_changes_what_is_predicted():
    curves = in_modes(np.random.default_rng(1), ("plain",))
    plain, stiff = (predicted_stresses(believed(curves, effects=e)) for e in ((), (Stiffening(law="fung", b=2.0),)))
    assert all(np.abs(b[-1]) > 1.1 * np.abs(a[-1]) for a, b in zip(plain, stiff, strict=True))
