"""Hidden effects of stiffness and memory in data of another solver are named, and a sound body is left alone."""

import pytest

import tissuereg as tr
from figures.open_cases import hiding, without_effect


@pytest.mark.parametrize("cause", ["layer", "relaxation"])
def test_a_hidden_effect_is_named(cause, tmp_path):
    rig, alike = hiding(cause, tmp_path)
    told = tr.diagnose(rig, keep=False)
    assert told.verdict == "named"
    assert {finding.id for finding in told.findings} <= set(alike)


@pytest.mark.parametrize("rig", [0, 1])
def test_a_body_without_an_effect_is_consistent(rig, tmp_path):
    told = tr.diagnose(without_effect(rig, tmp_path), keep=False)
    assert (told.verdict, told.findings) == ("consistent", ())
