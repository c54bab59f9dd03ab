"""Markers and targets as tables."""

import numpy as np
import pytest

import tissuereg as tr
from support.files import GOOD_MARKERS, MARKERS_HEADER
from tissuereg.errors import FormatError, MarkerError
from tissuereg.io.csv import read_table
from tissuereg.io.tables import write_targets


def written(tmp_path, text, encoding="utf-8"):
    path = tmp_path / "table.csv"
    path.write_text(text, encoding=encoding)
    return path


def test_empty_cells_mean_not_seen(tmp_path):
    markers = tr.read_markers(written(tmp_path, GOOD_MARKERS))
    assert markers.names == ("P1", "P2", "P3")
    assert markers.seen.tolist() == [True, True, False]
    assert markers.measured[0].tolist() == [31, 10, 40]
    assert markers.std.tolist() == [0.1, 0.1, 0.1]


def test_noise_stands_in_the_table_or_is_given(tmp_path):
    text = MARKERS_HEADER.replace("\n", ",std_mm\n") + "A,1,2,3,1,2,3,0.5\nB,1,2,3,nan,2,3,\n"
    markers = tr.read_markers(written(tmp_path, text), std=0.2)
    assert markers.std.tolist() == [0.5, 0.2]
    assert markers.seen.tolist() == [True, False]


def test_a_byte_order_mark_spaces_blank_lines_and_column_order_do_not_matter(tmp_path):
    text = "target , z_mm,x_mm,y_mm\r\n\r\n a ,3,1,2\r\n"
    targets = tr.read_targets(written(tmp_path, text, "utf-8-sig"))
    assert {name: place.tolist() for name, place in targets.items()} == {"a": [1, 2, 3]}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "must begin with the header marker,x_mm"),
        ("marker,x,y,z\n", r"must begin with the header .*got 'marker,x,y,z' at line 1"),
        (MARKERS_HEADER, "at least one row"),
        (MARKERS_HEADER + "P1,1,2,3,4,5\n", "7 cells, got 6 at .*line 2"),
        (MARKERS_HEADER + "P1,1,2,3,4,5,6\nP2,1,2,x,4,5,6\n", "'z_mm' must hold a finite number, got 'x' at .*line 3"),
        (MARKERS_HEADER + "P1,1,2,,4,5,6\n", "'z_mm' must hold a finite number, got '' at .*line 2"),
        (MARKERS_HEADER + "P1,1,2,3,4,inf,6\n", "'moved_y_mm' must hold a finite number or empty, got 'inf'"),
        (MARKERS_HEADER + ",1,2,3,4,5,6\n", "'marker' must not be empty"),
        (MARKERS_HEADER + "P1,1,2,3,4,5,6\nP1,1,2,3,4,5,6\n", "'P1' is at line 2 and line 3"),
        (MARKERS_HEADER.replace("\n", ",colour\n") + "P1,1,2,3,4,5,6,red\n", "must begin with the header"),
        (MARKERS_HEADER.replace("\n", ",std_mm\n") + "P1,1,2,3,4,5,6,two\n", "'std_mm' must hold a finite number"),
        (MARKERS_HEADER + '"P1,1,2\n', "comma-separated UTF-8 text"),
    ],
)
def test_a_faulty_table_is_refused_by_line(tmp_path, text, words):
    with pytest.raises(FormatError, match=words):
        tr.read_markers(written(tmp_path, text))


def test_noise_must_be_positive(tmp_path):
    text = MARKERS_HEADER.replace("\n", ",std_mm\n") + "P1,1,2,3,4,5,6,0\n"
    with pytest.raises(MarkerError, match=r"table\.csv: std must be positive.*'P1'"):
        tr.read_markers(written(tmp_path, text))


def test_a_table_in_another_encoding_is_refused(tmp_path):
    with pytest.raises(FormatError, match="UTF-8"):
        tr.read_targets(written(tmp_path, "target,x_mm,y_mm,z_mm\nBrustwarze-ä,1,2,3\n", "latin-1"))


def test_registered_targets_are_written_with_nine_digits(tmp_path):
    target = {
        "reference_mm": [1.0, 2.0, 3.0],
        "mean_mm": np.array([1.0, 2.0, 5.123456789]),
        "covariance_mm2": np.diag([0.01, 0.02, 0.03]),
        "region90_radii_mm": [0.2, 0.3, 0.4],
        "simulation_mm": None,
    }
    write_targets(tmp_path / "targets.csv", {"lesion": target})
    header = (tmp_path / "targets.csv").read_text().splitlines()[0].split(",")
    (row,) = read_table(tmp_path / "targets.csv", header)
    assert row.number("moved_z_mm") == 5.12345679
    assert row.numbers(["cov_xx_mm2", "cov_xy_mm2", "cov_zz_mm2"]) == (0.01, 0.0, 0.03)
    assert row.cells["simulated_x_mm"] == ""
