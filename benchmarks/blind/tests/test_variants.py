"""Variants of the diagnoser: each is a change of its settings, and stored banks stay valid."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from blind import variants
from blind.materialise import CASES, case_names, materialise
from tissuereg.diagnosis import candidates, screen
from tissuereg.diagnosis.causes import CAUSES, Variant
from tissuereg.diagnosis.constancy import Constancy
from tissuereg.diagnosis.predictor import fingerprint
from tissuereg.diagnosis.proof import HeldOut
from tissuereg.diagnosis.search import modulus_finding
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.io.experiments import read_experiment


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    case = next(name for name in case_names() if np.load(CASES / f"{name}.npz")["forces_given"])
    return read_experiment(materialise(case, tmp_path_factory.mktemp("case")))


def settings_of(monkeypatch, variant, ids=()):
    """Return the settings with which a variant diagnoses."""
    seen = []
    monkeypatch.setattr(variants, "answer", lambda experiment, threads, settings: seen.append(settings) or {})
    monkeypatch.setattr(variants, "read_experiment", lambda folder: folder)
    variant(None, ids)
    return seen[0]


@pytest.mark.parametrize(
    ("variant", "group", "name", "value"),
    [
        (variants.no_mesh_correction, "model", "corrected", False),
        (variants.no_third_mesh, "nulls", "noise_alone", True),
        (variants.no_proof, "search", "judged", False),
        (variants.no_mesh_nuisances, "nuisances", "of_mesh", False),
    ],
)
def test_an_ablation_is_one_changed_value(variant, group, name, value, monkeypatch):
    changed = replace(DEFAULT, **{group: replace(getattr(DEFAULT, group), **{name: value})})
    assert settings_of(monkeypatch, variant) == changed != DEFAULT


def test_oracle_and_without_have_their_catalogues(monkeypatch):
    oracle = settings_of(monkeypatch, variants.oracle, ("relaxation", "inclusion"))
    assert [name for name in CAUSES if name not in oracle.left_out] == ["inclusion", "relaxation"]
    assert oracle.search.most_causes == 2
    # The oracle fit is never rejected for its misfit, its parts, nor its evidence.
    assert oracle.nulls.misfit <= 0.0
    assert Constancy("inclusion", 1e-300, "time", oracle.constancy.level).holds
    assert oracle.nulls.required == variants.NO_THRESHOLD
    assert not candidates._repeats("inclusion", oracle.search.repeated)
    twice = settings_of(monkeypatch, variants.oracle, ("inclusion", "inclusion"))
    assert candidates._repeats("inclusion", twice.search.repeated)
    lacking = settings_of(monkeypatch, variants.without, ("stiffness",))
    assert lacking.left_out == ("stiffness",)
    believed = SimpleNamespace(bench=SimpleNamespace(settings=lacking))
    found = SimpleNamespace(target=None, final=SimpleNamespace(ids=()))
    assert modulus_finding(believed, None, found) is None


def test_without_a_judge_every_cause_passes():
    density = np.array([[5.0, 0.0], [1.0, -9.0], [2.0, 7.0], [3.0, 0.0]])
    proof = HeldOut(("a", "b"), density, np.ones((4, 4)))
    assert not proof.proves(DEFAULT.search)
    assert proof.proves(replace(DEFAULT.search, judged=False))


def test_ignored_forces_are_not_measured_and_leave_the_bank_where_it_is(experiment):
    blind = variants.forceless(experiment)
    before, after = SignalLayout(experiment), SignalLayout(blind)
    assert before.seen[~before.of_markers()].any()
    assert not after.seen[~after.of_markers()].any()
    np.testing.assert_array_equal(after.measured[after.of_markers()], before.measured[before.of_markers()])
    assert fingerprint(blind, "tet4") == fingerprint(experiment, "tet4")


def test_another_catalogue_leaves_stored_banks_valid(experiment, tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path))
    made = []

    class FakeCause:
        def __init__(self, name, value):
            self.name, self.value, self.closed_form = name, value, name == "scale"

        def variants(self, bench):
            made.append(self.name)
            return [Variant("one", np.full((1, 3), self.value))]

    causes = {"poisson": FakeCause("poisson", 1.0), "layer": FakeCause("layer", 2.0), "scale": FakeCause("scale", 3.0)}
    predictor = SimpleNamespace(element="tet4")

    def bank_of(*ids):
        made.clear()
        settings = replace(DEFAULT, left_out=tuple(name for name in causes if name not in ids))
        bench = SimpleNamespace(
            experiment=experiment, predictor=predictor, base=np.zeros(3), settings=settings, progress=lambda _: None
        )
        return {name: float(several[0].columns[0, 0]) for name, several in screen.make_bank(bench).items()}

    with monkeypatch.context() as patched:
        for name in list(CAUSES):
            patched.delitem(CAUSES, name)
        for name, cause in causes.items():
            patched.setitem(CAUSES, name, cause)
        assert bank_of("layer", "scale") == {"layer": 2.0, "scale": 3.0}
        assert made == ["layer", "scale"]
        # The larger catalogue reuses what is stored, adds what is missing, and recomputes closed forms.
        assert bank_of("poisson", "layer", "scale") == {"poisson": 1.0, "layer": 2.0, "scale": 3.0}
        assert made == ["poisson", "scale"]
        assert bank_of("poisson") == {"poisson": 1.0}
        assert made == []
        assert bank_of("poisson", "layer", "scale") == {"poisson": 1.0, "layer": 2.0, "scale": 3.0}
        assert made == ["scale"]
    assert "rate" in CAUSES
