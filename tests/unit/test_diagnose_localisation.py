"""What to check next where nothing explains the data: the component near which the residual is largest."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.rigs import rig
from support.targets import target_of
from tissuereg.diagnosis.advice import components_of, next_check


@pytest.fixture(scope="module")
def bench():
    return target_of().bench


def noise(bench, seed=0):
    return np.random.default_rng(seed).standard_normal(bench.layout.size) * bench.layout.seen


def spoilt(bench, wanted, seed=0, size=6.0):
    """Noise, and more of it near one component."""
    part = next(part for part in components_of(bench) if (part.kind, part.name) == wanted)
    return noise(bench, seed) + size * np.sqrt(part.proximity) * noise(bench, seed + 100)


PLACES = [
    ("marker", "P1"),
    ("marker", "P4"),
    ("pad", "top"),
    ("pad", "side"),
    ("support", "base"),
    ("case", "in"),
    ("body", "tet4"),
]


@pytest.mark.parametrize("wanted", PLACES, ids=" ".join)
def test_the_component_that_is_wrong_is_the_one_to_check(bench, wanted):
    hits = 0
    for seed in range(5):
        advice = next_check(bench, spoilt(bench, wanted, seed))
        hits += (advice["check"]["kind"], advice["check"]["name"]) == wanted
    assert hits >= 4


def test_the_action_says_what_where_and_when(bench):
    advice = next_check(bench, spoilt(bench, ("marker", "P4"), size=20.0))
    check = advice["check"]
    assert "marker P4" in advice["action"]
    assert check["share"] > 0.9
    assert check["where"][0] == "P4"
    assert f"{check['share']:.0%}" in advice["action"]
    assert f"{check['time_s']:.4g} s under case {check['case']}" in advice["action"]
    # The moment is that of the component, not the worst of all.
    part = bench.layout[check["case"]]
    assert part.times[0] <= check["time_s"] <= part.times[-1]


def test_the_moment_is_that_in_which_the_component_is_worst(bench):
    left, layout = noise(bench), bench.layout
    layout["down"].markers(left)[2, 3] += 30.0
    check = next_check(bench, left)["check"]
    assert (check["kind"], check["name"], check["case"]) == ("marker", layout.marker_names[3], "down")
    assert check["time_s"] == layout["down"].times[2]


def test_the_advice_says_what_the_residual_looks_like(bench):
    left = spoilt(bench, ("pad", "top"))
    assert "; sliding comes nearest)" in next_check(bench, left, "sliding comes nearest")["action"]
    assert ";" not in next_check(bench, left)["action"].partition("(")[2]


def test_the_answer_keeps_the_keys_of_advice_and_numbers_that_json_takes(bench):
    advice = next_check(bench, noise(bench))
    assert advice["separates"] == []
    assert advice["separability"] is None
    assert 0.0 <= advice["check"]["share"] <= 1.0


def test_names_are_kept_whatever_they_hold(bench):
    assert {part.kind for part in components_of(bench)} == {"marker", "pad", "support", "case", "body"}
    for part in components_of(bench):
        assert part.proximity.shape == (bench.layout.size,)
        assert 0.0 <= part.proximity.min() <= part.proximity.max() <= 1.0


def test_an_unexplained_diagnosis_advises_to_check_the_case_that_differs():
    believed = rig()
    case, rng = believed.cases["in"], np.random.default_rng(5)
    shaken = replace(case, markers=case.markers + rng.standard_normal(case.markers.shape))
    found = tr.diagnose(replace(believed, cases={**believed.cases, "in": shaken}), keep=False)
    assert found.verdict == "unexplained"
    advice = found.to_json()["next_experiment"]
    assert (advice["check"]["kind"], advice["check"]["name"]) == ("case", "in")
    assert "measure case in again" in advice["action"]
