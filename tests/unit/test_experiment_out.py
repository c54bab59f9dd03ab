"""Experiment files that we write: what is read back, from where."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import EXPERIMENT, write_experiment
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects import Inclusion, Latency, MarkerSwap
from tissuereg.io.experiment_out import write_experiment as write
from tissuereg.io.toml import read_toml
from tissuereg.io.toml_text import toml_text

EFFECTS = (
    Inclusion(centre_mm=(15.0, 10.0, 20.0), semi_axes_mm=(4.0, 5.0, 6.1), contrast=1 / 3),
    Latency(latency_s=0.1),
    MarkerSwap(markers=("P1", "P2"), from_time_s=10.5),
)


@pytest.fixture
def rig(tmp_path):
    toml = EXPERIMENT + "[gravity]\ndirection = [0, 0.1, -1]\nin_reference = false\n"
    return replace(tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml)), effects=EFFECTS, trial_share=0.03)


@pytest.mark.parametrize("place", ["rig/experiment.extended.toml", "out/experiment.extended.toml", "e.toml"])
def test_what_is_written_is_read_back_the_same_from_any_folder(rig, tmp_path, place):
    write(rig, tmp_path / place)
    back = tr.read_experiment(tmp_path / place)
    for plain in (
        "name",
        "young_std",
        "poisson_std",
        "marker_names",
        "marker_std",
        "force_std",
        "rest_case",
        "effects",
        "trial_share",
    ):
        assert getattr(back, plain) == getattr(rig, plain)
    assert (back.material.young, back.material.poisson, back.material.density) == (10.0, 0.45, 1.0)
    assert np.array_equal(back.marker_reference, rig.marker_reference)
    assert back.mesh.digest() == rig.mesh.digest()
    assert np.array_equal(back.gravity.direction, rig.gravity.direction)
    for mine, theirs in zip((*rig.boundaries, *rig.actuators), (*back.boundaries, *back.actuators), strict=True):
        assert (mine.name, mine.kind, mine.rule) == (theirs.name, theirs.kind, theirs.rule)
        assert np.array_equal(mine.nodes, theirs.nodes)
    assert list(back.cases) == list(rig.cases)
    for name, case in rig.cases.items():
        assert np.array_equal(case.markers, back.case(name).markers, equal_nan=True)
        assert all(
            np.array_equal(case.displacements[who], back.case(name).displacements[who]) for who in case.displacements
        )
    assert back.folder.resolve() == rig.folder.resolve()


def test_a_file_next_to_its_tables_names_no_folder(rig, tmp_path):
    write(rig, tmp_path / "rig" / "experiment.extended.toml")
    assert "tables" not in read_toml(tmp_path / "rig" / "experiment.extended.toml").rest()
    write(rig, tmp_path / "out" / "experiment.extended.toml")
    written = read_toml(tmp_path / "out" / "experiment.extended.toml").rest()
    assert (written["tables"], written["mesh"]) == ("../rig", {"file": "../rig/mesh.vtu"})


def test_changed_beliefs_are_written(rig, tmp_path):
    write(replace(rig, material=tr.Material(7.25, 0.3), young_std=None, gravity=None), tmp_path / "soft.toml")
    back = tr.read_experiment(tmp_path / "soft.toml")
    assert (back.material.young, back.material.poisson, back.young_std, back.gravity) == (7.25, 0.3, None, None)
    ogden = tr.Material(9.0, 0.4, "ogden", 1.1, {"alpha": [-4.0, 2.0], "weight": (0.25, 0.75)}, "quadratic")
    write(replace(rig, material=ogden), tmp_path / "ogden.toml")
    assert tr.read_experiment(tmp_path / "ogden.toml").material.digest() == ogden.digest()


def test_what_a_file_cannot_say_is_refused_and_the_old_file_stays(rig, tmp_path):
    target = tmp_path / "old.toml"
    target.write_text("old")
    field = tr.Material(np.full(rig.mesh.n_tets, 10.0), 0.45)
    with pytest.raises(ExperimentError, match="`young` of an experiment file must be one for the whole body, got 360"):
        write(replace(rig, material=field), target)
    with pytest.raises(ExperimentError, match="fibres of an experiment file must be an effect"):
        write(replace(rig, material=tr.Material(10.0, 0.45, fibre=tr.Fibre())), target)
    ruleless = tuple(replace(pad, rule=None) for pad in rig.actuators)
    with pytest.raises(ExperimentError, match="must have a rule for its nodes; 'push' has nodes alone"):
        write(replace(rig, actuators=ruleless), target)
    assert target.read_text() == "old"


def test_toml_text_reads_back_to_the_same_bits(tmp_path):
    content = {
        "text": 'quote " back \\ line \n tab \t bell \x07 delete \x7f umlaut ü',
        "number": 0.1 + 0.2,
        "tiny": 5e-324,
        "whole": -7,
        "yes": True,
        "list": [1.5, "a", [True, 2]],
        "table": {"a key": 1e22, "inner": {"x": [1.0]}},
        "several": [{"id": "a", "rule": {"plane": [0.0, 1.0]}}, {"id": "b"}],
    }
    (tmp_path / "a.toml").write_text(toml_text(content), encoding="utf-8")
    assert read_toml(tmp_path / "a.toml").rest() == content
    with pytest.raises(ExperimentError, match="must be a text, number, truth value, list or table, got ndarray"):
        toml_text({"x": np.zeros(3)})
