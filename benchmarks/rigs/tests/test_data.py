"""What is stored: whole, sealed, readable by the package, small; half of the rigs for development."""

import hashlib

import numpy as np
import pytest

import tissuereg as tr
from rigs.materialise import CASES, DATA, HALVES, case_names, materialise, rig_of
from rigs.scored import open_answers

LINES = [line.split("  ") for line in (DATA / "SHA256SUMS").read_text(encoding="utf-8").splitlines()]
SHOWN = [name for name in case_names("dev") if hashlib.sha256(name.encode()).hexdigest() < "2"]


def test_every_stored_file_has_its_checksum():
    wrong = [name for digest, name in LINES if hashlib.sha256((DATA / name).read_bytes()).hexdigest() != digest]
    assert wrong == []
    assert {path.name for path in CASES.glob("*.npz")} == {name.split("/")[1] for _, name in LINES if "cases/" in name}


def test_the_store_stays_below_6_megabytes():
    assert sum((DATA / name).stat().st_size for _, name in LINES) < 6e6


def test_every_answer_is_the_sealed_one():
    assert set(open_answers(set(case_names()))) == set(case_names())


def test_the_halves_are_of_rigs_and_equal():
    halves = [line.split(",")[1] for line in HALVES.read_text(encoding="utf-8").split()[1:]]
    assert abs(halves.count("dev") - halves.count("sealed")) <= 2
    dev, sealed = ({rig_of(name) for name in case_names(half)} for half in ("dev", "sealed"))
    assert not dev & sealed


@pytest.mark.parametrize("case", SHOWN)
def test_a_case_is_an_experiment_of_the_format(case, tmp_path):
    experiment = tr.read_experiment(materialise(case, tmp_path / case))
    assert 400 < len(experiment.mesh.nodes) < 1000
    assert next(iter(experiment.cases)) == experiment.rest_case == "rest"
    assert 3 <= len(experiment.marker_names) <= 25
    assert all(len(actuator.nodes) >= 3 for actuator in experiment.actuators)
    assert 0.05 <= experiment.marker_std <= 0.2


def test_the_rest_frames_of_a_case_scatter_as_it_says(tmp_path):
    ratios = []
    for case in SHOWN:
        experiment = tr.read_experiment(materialise(case, tmp_path / case))
        with np.load(CASES / f"{case}.npz") as stored:
            ratios.append((stored["markers"][:6] * 1e-3).std(axis=0, ddof=1).mean() / experiment.marker_std)
    # The mean of a standard deviation of six values is 0.95 of the true one.
    assert np.median(ratios) == pytest.approx(0.95, abs=0.1)
