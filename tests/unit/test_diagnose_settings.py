"""Settings of a diagnosis: they are passed in, used, and written whole."""

import json
from copy import copy
from dataclasses import asdict, fields, is_dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

import tissuereg as tr
from support.material_curves import believed, in_modes
from support.rigs import rig
from support.targets import hidden, part, screen_of, target_of
from tissuereg.diagnosis import search as search_module
from tissuereg.diagnosis.answer import DiagnosisDetails
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.material import diagnose_material
from tissuereg.diagnosis.noise import estimate_noise
from tissuereg.diagnosis.nulls import smooth_subspaces
from tissuereg.diagnosis.proof import HeldOut
from tissuereg.diagnosis.report.charts import rankings
from tissuereg.diagnosis.screen import Screened, numbers_of
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.diagnosis.signals import SignalLayout, generic_columns
from tissuereg.errors import ArgumentError
from tissuereg.experiment.effects import Latency, Poisson, Relaxation

#: Where the edges of its pads are known the rig has a misfit, about which more is asked.
SHARP = replace(DEFAULT, shape=replace(DEFAULT.shape, edge_share=0.01))

GROUPS = [f.name for f in fields(DiagnoseSettings) if is_dataclass(getattr(DEFAULT, f.name))]


def watched(group, read):
    """Return settings of the same values, which note the names that are read of them."""
    kind = type(group)

    class Watched(kind):
        __repr__ = object.__repr__  # the name of a bank has all numbers, whether used or not

        def __getattribute__(self, name):
            if name in kind.__dataclass_fields__:
                read.add(name)
            return super().__getattribute__(name)

    before = set(read)
    made = Watched(**asdict(group))
    read.intersection_update(before)  # without what was checked
    return made


def late_and_relaxing():
    """The rig with two hidden effects, one of which resembles others."""
    return hidden(replace(rig(), force_std=20.0), Latency(latency_s=0.5), Relaxation(g=(0.4,), tau_s=(2.0,)))


@pytest.fixture(scope="module")
def of_rig():
    read = {name: set() for name in GROUPS}
    for given, numbers in ((late_and_relaxing(), DEFAULT), (rig(), SHARP)):  # with findings, and with a misfit
        settings = DiagnoseSettings(**{name: watched(getattr(numbers, name), read[name]) for name in GROUPS})
        found = tr.diagnose(given, keep=False, settings=settings)
    return found, {name: set(names) for name, names in read.items()}


def test_a_diagnosis_reads_its_numbers_from_the_settings_that_it_is_given(of_rig):
    _, read = of_rig
    # The rig states how well its modulus is known; a block has no facets beside its surface, and its pads are no balls;
    # with three cases and no tie nothing is advised or located; a misfit beside findings is seldom.
    seldom = {
        "model": {"young_spread"},
        "noise": {"least_evidence"},
        "shape": {"most_places", "most_patterns", "length_share", "held_variance", "lattice", "finer"},
        "nulls": {"explained"},
        "search": {"determined_modulus"},
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
    given = replace(found, numbers=replace(DEFAULT, left_out=("gravity",)))
    said = json.loads(json.dumps(given.to_json()["settings"]))
    for name in GROUPS:
        for one in fields(getattr(DEFAULT, name)):
            assert json.loads(json.dumps(getattr(getattr(DEFAULT, name), one.name))) == said[name][one.name]
    assert said["causes"]["actuator_gain"] == {"spread": 0.08}
    assert said["left_out"] == ["gravity"]
    assert set(found.to_json()["settings"]) == {*GROUPS, "causes", "left_out"}


def test_a_changed_value_changes_the_answer_and_the_name_of_its_bank(of_rig):
    found, _ = of_rig
    wide = replace(CAUSES["poisson"], spread=0.12)
    changed = replace(SHARP, left_out=("layer",), causes=(wide,), nulls=replace(DEFAULT.nulls, least_threshold=9.0))
    other = tr.diagnose(rig(), keep=False, settings=changed)
    tried = {row["id"]: row["log_bayes_factor"] for row in found.candidates}
    again = {row["id"]: row["log_bayes_factor"] for row in other.candidates}
    assert set(tried) - set(again) == {"layer"}
    assert again["poisson"] != tried["poisson"]
    assert again["fibre"] == tried["fibre"]
    assert min(other.details.thresholds.values()) >= 9.0 > min(found.details.thresholds.values())
    assert numbers_of(changed) != numbers_of(DEFAULT)
    assert numbers_of(replace(DEFAULT, search=replace(DEFAULT.search, better=1.0))) == numbers_of(DEFAULT)


def test_a_material_test_reads_them_too():
    read = {name: set() for name in GROUPS}
    settings = DiagnoseSettings(**{name: watched(getattr(DEFAULT, name), read[name]) for name in GROUPS})
    experiment = believed(in_modes(np.random.default_rng(6), ("fung", 1.0)))
    answer = diagnose_material(experiment, settings=settings).to_json()
    assert answer == {**diagnose_material(experiment).to_json()}
    assert answer["settings"]["material"]["quantile"] == 0.99
    needs_others = {"share_of_patch", "most_of_misfit", "part", "same_rate", "most_folds", "most_terms", "advised_rows"}
    assert {f.name for f in fields(DEFAULT.material)} - read["material"] <= needs_others
    high = replace(DEFAULT, material=replace(DEFAULT.material, least_threshold=1e4))
    assert diagnose_material(experiment, settings=high).verdict == "unexplained"


def test_settings_of_another_type_are_refused():
    with pytest.raises(ArgumentError, match="settings"):
        tr.diagnose(rig(), settings={"search": 1})
    with pytest.raises(ArgumentError, match=r"`search` must be of the kind SearchSettings"):
        replace(DEFAULT, search=DEFAULT.nulls)


@pytest.mark.parametrize(
    ("changed", "where"),
    [
        ({"left_out": ("gravty",)}, "settings.left_out"),
        ({"causes": ("poisson",)}, "settings.causes"),
        ({"search": replace(DEFAULT.search, repeated=("slip",))}, "settings.search.repeated"),
    ],
)
def test_a_cause_that_the_catalogue_lacks_is_refused_and_not_passed_over(changed, where):
    for given in (rig(), believed(in_modes(np.random.default_rng(6), ("fung", 1.0)))):
        with pytest.raises(ArgumentError, match=where) as caught:
            tr.diagnose(given, settings=replace(DEFAULT, **changed))
        assert caught.value.where == where
    with pytest.raises(ArgumentError, match=where):
        tr.diagnose_many([], "out", settings=replace(DEFAULT, **changed))


@pytest.mark.parametrize(
    "changed", [{"spread": 0.0}, {"largest_factor": 1.0}, {"least_factor": 0.0}, {"least_freedom": 0.0}]
)
def test_numbers_of_noise_without_sense_are_refused(changed):
    (name,) = changed
    with pytest.raises(ArgumentError, match=f"`noise.{name}` must be a"):
        replace(DEFAULT.noise, **changed)


def of_groups(**changed):
    return replace(DEFAULT, **{name: replace(getattr(DEFAULT, name), **values) for name, values in changed.items()})


def test_the_noise_is_estimated_by_the_numbers_given():
    given = rig()
    layout = SignalLayout(given)
    rest = layout["rest"].markers(layout.measured)
    rest[:] = 0.2 * np.cumsum(np.random.default_rng(3).standard_normal(rest.shape), axis=0)
    usual = estimate_noise(given, layout)
    assert usual.memory > 0.3
    assert usual.evidence > DEFAULT.noise.least_evidence
    assert estimate_noise(given, layout, replace(DEFAULT.noise, correlated=1e3)).memory == 0.0
    assert not estimate_noise(given, layout, replace(DEFAULT.noise, least_frames=99)).from_rest
    assert estimate_noise(given, layout, replace(DEFAULT.noise, spread=1.0)).evidence < 0.5 * usual.evidence
    assert estimate_noise(given, layout, replace(DEFAULT.noise, level=0.0)).marker_std[0] == given.marker_std


def test_the_modulus_has_the_spread_of_the_settings_where_the_experiment_states_none():
    given = replace(rig(), young_std=None)
    layout = SignalLayout(given)
    assert Bench(given, layout).young_spread == pytest.approx(DEFAULT.model.young_spread)
    assert Bench(given, layout, settings=of_groups(model={"young_spread": 0.1})).young_spread == pytest.approx(0.1)


def test_the_generic_rival_and_the_misfit_test_follow_their_numbers():
    target = target_of(Poisson(poisson=0.38))

    def shapes(**evidence):
        bench = copy(target.bench)
        bench.settings = of_groups(evidence=evidence)
        return generic_columns(bench.layout, bench.base, bench.extent, 0.01, bench.settings), smooth_subspaces(
            bench.layout, bench.base, bench.extent, target.noise, bench.settings
        )

    columns, spaces = shapes()
    slow, others = shapes(fading=2.0)
    assert slow.shape == columns.shape
    assert not np.allclose(slow, columns)
    assert any(a.shape != b.shape or not np.allclose(np.abs(a), np.abs(b)) for a, b in zip(spaces, others, strict=True))
    still, _ = shapes(jam_above=1e6)
    assert still.shape[1] < columns.shape[1]
    assert len(shapes(generic_sizes=((1.0, 0.01),))[0]) == 1


def test_rounds_judge_by_the_settings_of_the_bench():
    target = target_of(Latency(latency_s=0.15))
    base = fit(target, [])
    found = search_module.Candidate("latency", fit(target, [part(target, "latency")]), 20.0, target)
    screen = screen_of(target, ("latency",))

    def round_of(monkeypatch, **changed):
        target.bench.settings = of_groups(**changed)
        monkeypatch.setattr(search_module, "refitted", lambda *_: [found])
        return search_module._Bodies(target, screen, base, {"latency": 6.0}).round(target, base)

    with pytest.MonkeyPatch.context() as patched:
        assert round_of(patched).found is found
        for changed in ({"search": {"stated": 1.0}}, {"search": {"proved": 1e9, "refused": 1.0}},
                        {"evidence": {"look_alike": 0.6}}, {"evidence": {"temper": 1e9}}):  # fmt: skip
            step = round_of(patched, **changed)
            assert step.found is None, changed
        blocks = round_of(patched, search={"determined": 0.0, "time_blocks": 3}).proof.blocks
        assert len(blocks) == 3


def test_charts_of_later_rounds_show_the_thresholds_that_were_required():
    held = HeldOut(("case",), np.zeros((4, 1)), np.zeros((4, 1)))
    body, slip = (search_module.Candidate(name, None, 50.0, None) for name in ("layer", "marker_slip"))
    screened = {"layer": Screened(9.0, None, np.ones(1)), "fibre": Screened(1.0, None, np.ones(1))}
    steps = [search_module.Step(screened, [one], one, held, held) for one in (body, slip)]
    findings = [SimpleNamespace(id=one.id, group=(one.id,), threshold=6.0) for one in (body, slip)]
    details = DiagnosisDetails(search_module.Search(None, None, steps), None, None, {"layer": 6.0, "fibre": 44.0})
    drawn = rankings(SimpleNamespace(details=details, findings=findings, candidates=(), numbers=DEFAULT))
    first, _, later = drawn.partition("Round 2")
    assert "threshold 44.0" in later
    assert "threshold 44.0" not in first
