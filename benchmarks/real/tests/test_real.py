"""The page of the measured bodies is that of its archive, and one fast draw of each body stays within bounds."""

import pytest
from common import read_archive

from real import beam, hydrogel
from real.__main__ import ARCHIVE, PAGE
from real.page import page


def test_the_page_is_that_of_the_archive():
    answer, written = read_archive(ARCHIVE), PAGE.read_text(encoding="utf-8")
    assert written == page(answer)
    answer["hydrogel"][0]["registered"] += 1.0
    assert written != page(answer)


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
