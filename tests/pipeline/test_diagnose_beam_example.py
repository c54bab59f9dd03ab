"""The measured silicone beam through the diagnosis, as a user runs the example."""

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tissuereg.diagnosis.settings import DEFAULT

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "diagnose_beam.py"

#: Whatever a diagnosis may blame the silicone for.
MATERIAL = {
    "stiffness", "poisson", "stiffening", "mooney", "asymmetry", "fibre", "inclusion", "layer",
    "relaxation", "rate", "softening", "set", "swelling", "drainage",
}  # fmt: skip


@pytest.fixture(scope="module")
def data(shared_data, tmp_path_factory):
    """Return a folder with the recordings under names of their own."""
    source = shared_data / "data" / "beam"
    if not source.is_dir():
        pytest.skip(f"measured data are absent: {source}")
    folder = tmp_path_factory.mktemp("beam")
    shutil.copy(source / "beam.stl", folder)
    for name, copy in (
        ("own_weight_a", "own_weight_x"),
        ("own_weight_b", "own_weight_y"),
        ("load_52g_a", "load_52g_z"),
    ):
        shutil.copy(source / f"{name}.csv", folder / f"{copy}.csv")
    return folder


def rows_of(data, *names):
    """Return rows of the example for some of its experiments."""
    told = data / "told.json"
    words = [sys.executable, str(EXAMPLE), "--data", str(data), "--json", str(told)]
    words += [word for name in names for word in ("--only", name)]
    environment = {**os.environ, "TISSUEREG_CACHE": str(data / "cache")}
    subprocess.run(words, check=True, env=environment, cwd=data, capture_output=True)
    return json.loads(told.read_text(encoding="utf-8"))["rows"]


@pytest.fixture(scope="module")
def answers(data):
    return rows_of(data, "own_weight_x_weightless", "own_weight_x_heavy", "load_52g_z_heavy")


def assert_weight(cause):
    assert cause["group"] == ["gravity"]
    assert cause["probability"] == pytest.approx(1.0 - DEFAULT.evidence.look_alike, abs=0.01)
    assert cause["parameters"]["direction_z"][0] < -0.99
    # Weight over modulus is what the markers tell; the modulus is believed to a tenth.
    assert cause["parameters"]["g_mm_per_s2"][0] == pytest.approx(9810.0, rel=0.15)
    held_out = cause["held_out"]
    assert held_out["rms_named_mm"] < 0.15 * min(held_out["rms_base_mm"], held_out["rms_generic_mm"])


def assert_slip(cause):
    assert (cause["group"], cause["parameters"]["marker"]) == (["marker_slip"], "Base-2")
    assert cause["parameters"]["offset_mm"][0][0] == pytest.approx(0.86, abs=0.1)


def test_a_weight_left_out_is_named_and_proved(answers):
    row = answers[0]
    assert (row["recording"], row["weight_believed"], row["verdict"]) == ("own_weight_x", False, "named")
    (weight,) = row["causes"]
    assert_weight(weight)


def test_with_its_weight_the_silicone_is_not_blamed(answers):
    assert answers[1]["verdict"] == "consistent"
    for row in answers[1:]:
        assert row["weight_believed"]
        assert not {name for cause in row["causes"] for name in cause["group"]} & MATERIAL
        assert row["p_misfit"] > 0.01


def test_a_marker_that_moves_on_the_rigid_holder_has_slipped(answers):
    (slip,) = answers[2]["causes"]
    assert_slip(slip)


@pytest.mark.slow
def test_weight_and_slip_are_both_named_where_a_load_hangs_too(data):
    (row,) = rows_of(data, "load_52g_z_weightless")
    weight, slip = row["causes"]
    assert_weight(weight)
    assert_slip(slip)
