"""One fast draw of each measured body stays within bounds."""

import pytest

from real import beam, hydrogel


def test_hydrogel_targets_are_found_from_twenty_beads(shared_data):
    row = hydrogel.run(shared_data / "data" / "hydrogel", 20, 0, n_targets=60)
    assert row["none"] > 0.9
    assert row["registered"] < 0.65
    assert row["coverage90"] >= 0.80


def test_the_beam_under_its_own_weight_is_found_from_two_markers(shared_data):
    pytest.importorskip("pytetwild", reason="the extra `mesh` is not installed")
    folder = shared_data / "data" / "beam"
    mesh = beam.example().beam_mesh(folder / "beam.stl")
    row = beam.run(mesh, folder / "own_weight_a.csv", element="tet4-averaged")
    assert row["moved_mm"] > 6.0
    assert row["error_mm"] < 0.35
    assert row["inside_region90"]
