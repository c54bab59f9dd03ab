"""Settings of a diagnosis: they are passed in, used, and written whole."""

import json
from dataclasses import asdict, fields, is_dataclass, replace

import numpy as np
import pytest

import tissuereg as tr
from support.material_curves import believed, in_modes
from support.rigs import rig
from tissuereg.diagnosis.bank import numbers_of
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.material import diagnose_material
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.errors import ArgumentError

GROUPS = [f.name for f in fields(DiagnoseSettings) if is_dataclass(getattr(DEFAULT, f.name))]


def watched(group, read):
    """Return settings of the same values, which note the names that are read of them."""
    kind = type(group)

    class Watched(kind):
        def __getattribute__(self, name):
            if name in kind.__dataclass_fields__:
                read.add(name)
            return super().__getattribute__(name)

    return Watched(**asdict(group))


@pytest.fixture(scope="module")
def of_rig():
    read = {name: set() for name in GROUPS}
    settings = DiagnoseSettings(**{name: watched(getattr(DEFAULT, name), read[name]) for name in GROUPS})
    found = tr.diagnose(rig(), keep=False, settings=settings)
    return found, {name: set(names) for name, names in read.items()}


def test_a_diagnosis_reads_its_numbers_from_the_settings_that_it_is_given(of_rig):
    _, read = of_rig
    # A block has no facets beside its surface; with three cases and no tie nothing is advised or located.
    seldom = {
        "noise": {"least_evidence"},
        "shape": {"most_places", "most_patterns", "length_share", "held_variance"},
        "search": {"determined_modulus", "clear"},
        "readings": {"most_digits", "nothing", "force"},
        "report": {
            "near", "reach", "variances", "least_cases", "hold_s", "ramp_s", "long_hold_s", "measured_to",
        },
        "material": {f.name for f in fields(DEFAULT.material)},
    }  # fmt: skip
    for name in GROUPS:
        assert {f.name for f in fields(getattr(DEFAULT, name))} - read[name] <= seldom.get(name, set()), name
    assert read["material"] == set()


def test_all_numbers_stand_in_the_answer(of_rig):
    found, _ = of_rig
    said = json.loads(
        json.dumps(
            tr.diagnose(rig(), keep=False, settings=replace(DEFAULT, left_out=("gravity",))).to_json()["settings"]
        )
    )
    for name in GROUPS:
        for one in fields(getattr(DEFAULT, name)):
            assert json.loads(json.dumps(getattr(getattr(DEFAULT, name), one.name))) == said[name][one.name]
    assert said["causes"]["actuator_gain"] == {"spread": 0.08}
    assert said["left_out"] == ["gravity"]
    assert set(found.to_json()["settings"]) == {*GROUPS, "causes", "left_out"}


def test_a_changed_value_changes_the_answer_and_the_name_of_its_bank(of_rig):
    found, _ = of_rig
    wide = replace(CAUSES["poisson"], spread=0.12)
    changed = replace(DEFAULT, left_out=("layer",), causes=(wide,), nulls=replace(DEFAULT.nulls, least_threshold=9.0))
    other = tr.diagnose(rig(), keep=False, settings=changed)
    tried = {row["id"]: row["log_bayes_factor"] for row in found.candidates}
    again = {row["id"]: row["log_bayes_factor"] for row in other.candidates}
    assert set(tried) - set(again) == {"layer"}
    assert again["poisson"] != tried["poisson"]
    assert again["fibre"] == tried["fibre"]
    assert min(other.details["thresholds"].values()) >= 9.0 > min(found.details["thresholds"].values())
    assert numbers_of(changed) != numbers_of(DEFAULT)
    assert numbers_of(replace(DEFAULT, search=replace(DEFAULT.search, clear=1.0))) == numbers_of(DEFAULT)


def test_a_material_test_reads_them_too():
    read = {name: set() for name in GROUPS}
    settings = DiagnoseSettings(**{name: watched(getattr(DEFAULT, name), read[name]) for name in GROUPS})
    experiment = believed(in_modes(np.random.default_rng(6), ("fung", 1.0)))
    answer = diagnose_material(experiment, settings=settings).answer
    assert answer == {**diagnose_material(experiment).answer}
    assert answer["settings"]["material"]["quantile"] == 0.99
    needs_others = {"share_of_patch", "most_of_misfit", "part", "same_rate", "most_folds", "most_terms", "advised_rows"}
    assert {f.name for f in fields(DEFAULT.material)} - read["material"] <= needs_others
    high = replace(DEFAULT, material=replace(DEFAULT.material, least_threshold=1e4))
    assert diagnose_material(experiment, settings=high).verdict == "unexplained"


def test_settings_of_another_type_are_refused():
    with pytest.raises(ArgumentError, match="settings"):
        tr.diagnose(rig(), settings={"search": 1})
