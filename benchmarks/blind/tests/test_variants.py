"""Variants of the diagnoser: each changes its step, everything is restored, and stored banks stay valid."""

from contextlib import ExitStack
from types import SimpleNamespace

import numpy as np
import pytest

from blind import variants
from blind.materialise import CASES, case_names, materialise
from tissuereg.diagnosis import bank, candidates, findings, run, search
from tissuereg.diagnosis.causes import CAUSES, Variant
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.nuisances import Nuisances
from tissuereg.diagnosis.nulls import Nulls
from tissuereg.diagnosis.proof import HeldOut
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.io.experiments import read_experiment


@pytest.fixture(scope="module")
def experiment(tmp_path_factory):
    case = next(name for name in case_names() if np.load(CASES / f"{name}.npz")["forces_given"])
    return read_experiment(materialise(case, tmp_path_factory.mktemp("case")))


#: Modules in which variants replace names.
MODULES = {"run": run, "search": search, "candidates": candidates, "findings": findings}


def seen_by(monkeypatch, variant, ids=()):
    """Return the modules' names and the catalogue as a variant shows them to a diagnosis."""
    seen = {}

    def look(experiment, threads):
        modules = {name: dict(vars(module)) for name, module in MODULES.items()}
        seen.update(**modules, ids=list(CAUSES), experiment=experiment)
        return {}

    monkeypatch.setattr(variants, "answer", look)
    monkeypatch.setattr(variants, "read_experiment", lambda folder: folder)
    variant(None, ids)
    return SimpleNamespace(**seen)


def names_now():
    return {name: dict(vars(module)) for name, module in MODULES.items()}, list(CAUSES.items())


@pytest.mark.parametrize(
    ("variant", "module", "name"),
    [
        (variants.no_mesh_correction, "run", "make_correction"),
        (variants.no_third_mesh, "run", "draw_nulls"),
        (variants.no_proof, "search", "_prove"),
        (variants.no_mesh_nuisances, "run", "make_nuisances"),
    ],
)
def test_an_ablation_replaces_one_step_and_restores_it(variant, module, name, monkeypatch):
    before = names_now()
    seen = getattr(seen_by(monkeypatch, variant), module)
    plain = before[0][module]
    assert [key for key in plain if seen[key] is not plain[key]] == [name]
    assert names_now() == before


def test_oracle_and_without_see_their_catalogues_and_restore_all(monkeypatch):
    before = names_now()
    oracle = seen_by(monkeypatch, variants.oracle, ("relaxation", "inclusion"))
    assert oracle.ids == ["inclusion", "relaxation"]
    assert oracle.search["MOST_CAUSES"] == 2
    # The oracle fit is never rejected for its misfit.
    assert oracle.run["MISFIT"] <= 0.0
    assert not oracle.candidates["_repeats"]("inclusion")
    assert seen_by(monkeypatch, variants.oracle, ("inclusion", "inclusion")).candidates["_repeats"]("inclusion")
    lacking = seen_by(monkeypatch, variants.without, ("stiffness",))
    assert lacking.ids == [name for name in CAUSES if name != "stiffness"]
    assert lacking.findings["modulus_finding"](None, None, None) is None
    assert names_now() == before


def test_all_is_restored_when_a_diagnosis_fails(monkeypatch):
    before = names_now()

    def fail(experiment, threads):
        raise ArithmeticError

    monkeypatch.setattr(variants, "answer", fail)
    monkeypatch.setattr(variants, "read_experiment", lambda folder: folder)
    for variant in (variants.oracle, variants.without, variants.no_proof):
        with pytest.raises(ArithmeticError):
            variant(None, ("layer",))
    assert names_now() == before


def test_without_a_judge_every_cause_passes_and_figures_stay():
    density = np.array([[5.0, 0.0], [1.0, -9.0], [2.0, 7.0], [3.0, 0.0]])
    left = np.ones((4, 4))
    passed = variants._passed(HeldOut(("a", "b"), density, left))
    before, cause, rival, _ = passed.log_density.sum(axis=1)
    assert cause == density[1].sum()
    assert cause > before + search.PROVED
    assert cause > rival
    assert passed.residuals is left


def test_draws_of_noise_alone_hold_no_nuisances_and_no_meshes():
    null = Null(np.ones((2, 5)))
    given = variants._of_noise_alone(lambda screen, null, noise, layout, errors, seed: (null, errors))(
        None, null, None, None, [np.ones(5)], 0
    )
    assert given[0].nuisances.shape == (0, 5)
    assert given[1] == []
    np.testing.assert_array_equal(given[0].reduced(np.ones(5)), null.reduced(np.ones(5)))
    assert null.nuisances.shape == (2, 5)


def test_nuisances_of_the_mesh_are_removed_and_others_stay():
    names = ("stiffness", "mesh push_x 0 1", "tilt of push_x 0", "frame shift 0")
    kept = variants._but_the_mesh(Nuisances(names, np.arange(8.0).reshape(4, 2)))
    assert kept.names == ("stiffness", "frame shift 0")
    np.testing.assert_array_equal(kept.columns, [[0.0, 1.0], [6.0, 7.0]])


def test_the_oracle_fit_has_no_threshold():
    assert variants._without_threshold(Nulls(np.zeros((1, 2)), {"layer": 12.0})).thresholds == {
        "layer": variants.NO_THRESHOLD
    }


def test_ignored_forces_are_not_measured_and_leave_the_bank_where_it_is(experiment):
    blind = variants.forceless(experiment)
    before, after = SignalLayout(experiment), SignalLayout(blind)
    assert before.seen[~before.of_markers()].any()
    assert not after.seen[~after.of_markers()].any()
    np.testing.assert_array_equal(after.measured[after.of_markers()], before.measured[before.of_markers()])
    assert bank.fingerprint(blind, "tet4") == bank.fingerprint(experiment, "tet4")


def test_another_catalogue_leaves_stored_banks_valid(experiment, tmp_path, monkeypatch):
    monkeypatch.setenv("TISSUEREG_CACHE", str(tmp_path))
    made = []

    class FakeCause:
        def __init__(self, name, value):
            self.name, self.value = name, value

        def variants(self, bench):
            made.append(self.name)
            return [Variant("one", np.full((1, 3), self.value))]

    causes = {"poisson": FakeCause("poisson", 1.0), "layer": FakeCause("layer", 2.0), "scale": FakeCause("scale", 3.0)}
    bench = SimpleNamespace(experiment=experiment, predictor=SimpleNamespace(element="tet4"), base=np.zeros(3))

    def bank_of(*ids):
        made.clear()
        with ExitStack() as stack:
            stack.enter_context(variants.catalogue(ids))
            return {name: float(several[0].columns[0, 0]) for name, several in bank.make_bank(bench).items()}

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
