"""Rivals on synthetic columns: a hidden cause is named, noise is not, and held-out figures follow."""

from types import SimpleNamespace

import numpy as np
import pytest

from blind import rivals
from blind.materialise import case_names, materialise
from tissuereg.diagnosis.causes import Variant
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.noise import estimate_noise
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.io.experiments import read_experiment

#: Length of the hidden effect, in standard deviations of the noise.
LENGTH = 40.0


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Return layout, noise, and a believed motion that loads all cases but the first."""
    experiment = read_experiment(materialise(case_names()[0], tmp_path_factory.mktemp("case")))
    layout = SignalLayout(experiment)
    base = np.zeros(layout.size)
    for part in layout.parts:
        if part.name != "rest":
            part.markers(base)[:] = np.sin(np.arange(part.n_frames))[:, None, None]
    return layout, estimate_noise(experiment, layout), base, experiment.mesh.extent


@pytest.fixture
def answer_of(rig, monkeypatch):
    """Return a function that runs a rival on data with given synthetic causes, modulus and frame as believed."""
    layout, noise, base, extent = rig
    generator = np.random.default_rng(4)
    columns = {}
    for name, (n, p) in {"layer": (3, 1), "scale": (1, 2), "fibre": (5, 1)}.items():
        drawn = generator.standard_normal((n, p, layout.size)) * np.where(base != 0.0, 1.0, 0.0)
        columns[name] = drawn / np.linalg.norm(noise.whitened(drawn, layout), axis=-1, keepdims=True)
    # Tied with the first hypothesis of the first cause.
    columns["poisson"] = columns["layer"][:1]
    bank = {name: [Variant(str(k), c) for k, c in enumerate(several)] for name, several in columns.items()}
    monkeypatch.setattr(rivals, "make_bank", lambda bench: bank)

    def run(rival, *hidden):
        measured = noise.draw(layout, np.random.default_rng(5))
        for name, number in hidden:
            measured = measured + LENGTH * noise.whitened(columns[name][number].sum(axis=0), layout)
        free = noise.whitened(np.where(layout.of_markers(), 0.02, 0.0)[None], layout)
        untouched = Correction(layout)
        bench = SimpleNamespace(base=base, layout=layout, extent=extent, settings=DEFAULT)
        scene = rivals.Scene(layout, bench, noise, untouched, measured, Null(free))
        monkeypatch.setattr(rivals, "look_at", lambda folder, threads: scene)
        return rival(None)

    return run


def test_sparse_regression_names_hidden_causes_one_after_another(answer_of):
    answer = answer_of(rivals.sparse_regression, ("fibre", 3), ("scale", 0))
    assert answer["verdict"] == "named"
    assert sorted(cause["id"] for cause in answer["causes"]) == ["fibre", "scale"]
    assert all(cause["probability"] > 0.99 for cause in answer["causes"])
    for block in ("push_x", "push_y", "push_z", "push_x, every 4th frame from 0"):
        _, base, final = answer["by_block"][block]
        assert final == pytest.approx(1.0, abs=0.1)
        assert base > final + 0.1


def test_sparse_regression_groups_tied_causes(answer_of):
    answer = answer_of(rivals.sparse_regression, ("layer", 0))
    assert answer["verdict"] == "group"
    assert sorted(answer["causes"][0]["group"]) == ["layer", "poisson"]
    assert answer["causes"][0]["probability"] == pytest.approx(0.5, abs=0.01)


def test_noise_alone_is_consistent_to_all_rivals(answer_of):
    for rival in (rivals.sparse_regression, rivals.error_ranking, rivals.gaussian_process):
        answer = answer_of(rival)
        assert answer["verdict"] == "consistent"
        assert answer["causes"] == []
        assert answer["by_block"]["push_x"][1] == pytest.approx(1.0, abs=0.1)


def test_error_ranking_names_the_least_error_where_it_falls_enough(answer_of, monkeypatch):
    answer = answer_of(rivals.error_ranking, ("fibre", 3))
    assert [cause["id"] for cause in answer["causes"]] == ["fibre"]
    monkeypatch.setattr(rivals, "FALL", 0.5)
    assert answer_of(rivals.error_ranking, ("fibre", 3))["verdict"] == "consistent"


def test_a_gaussian_process_detects_a_misfit_and_names_nothing(answer_of):
    answer = answer_of(rivals.gaussian_process, ("fibre", 3))
    assert answer["verdict"] == "unexplained"
    assert answer["causes"] == []
    assert answer["p_misfit"] < 0.01
