"""Points of 3D Slicer: both formats, frames, units, what is not defined, and what is refused."""

import json

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from support.slicer import control_point, fcsv_text, markups, other_frame, write_mrk
from tissuereg.errors import FormatError, MarkerError, MeshError
from tissuereg.io.meshes import write_vtu
from tissuereg.io.mrk_json import read_mrk_json, write_mrk_json

SIT = {"F-1": (30.0, 10.0, 40.0), "F-2": (0.0, 10.0, 40.0), "F-3": (15.0, 0.0, 20.0)}
SEEN = {"F-3": (15.5, 0.25, 20.0), "F-1": (31.0, 10.0, 40.5), "F-2": (1.0, 10.0, 39.75)}


def lists(places):
    return {name: place.tolist() for name, place in places.items()}


def as_lists(points):
    return {label: list(place) for label, place in points.items()}


# --- targets, one file ---


@pytest.mark.parametrize("frame", ["LPS", "RAS"])
@pytest.mark.parametrize("kind", ["mrk.json", "fcsv"])
def test_points_keep_the_files_own_frame_until_another_one_is_asked_for(tmp_path, kind, frame):
    file = tmp_path / f"t.{kind}"
    if kind == "fcsv":
        file.write_text(fcsv_text(SIT, frame))
    else:
        write_mrk(file, SIT, frame)
    other = "RAS" if frame == "LPS" else "LPS"
    assert lists(tr.read_targets(file)) == as_lists(SIT)
    assert lists(tr.read_targets(file, frame=frame)) == as_lists(SIT)
    assert lists(tr.read_targets(file, frame=other)) == as_lists(other_frame(SIT))


@pytest.mark.parametrize(("number", "frame"), [("0", "RAS"), ("1", "LPS")])
def test_older_files_number_their_frame(tmp_path, number, frame):
    (tmp_path / "old.fcsv").write_text(fcsv_text(SIT, number))
    assert lists(tr.read_targets(tmp_path / "old.fcsv", frame=frame)) == as_lists(SIT)


@pytest.mark.parametrize(
    ("units", "scale"),
    [
        ("mm", 1.0),
        ("um", 1000.0),
        ("nm", 1e6),
        ("cm", 0.1),
        ("m", 0.001),
        (["mm", "UCUM", "millimeter"], 1.0),
        (["um", "UCUM", "micrometer"], 1000.0),
    ],
)
def test_the_unit_of_a_file_becomes_mm(tmp_path, units, scale):
    file = write_mrk(tmp_path / "t.mrk.json", SIT, units=units, scale=scale)
    for name, place in tr.read_targets(file).items():
        np.testing.assert_allclose(place, SIT[name], rtol=1e-15)


def test_where_a_file_says_nothing_it_is_lps_and_mm_and_defined(tmp_path):
    bare = {"label": "a", "position": [1, -2, 3]}
    content = markups([bare], coordinateSystem=None, coordinateUnits=None)
    (tmp_path / "t.mrk.json").write_text(json.dumps(content))
    assert lists(tr.read_targets(tmp_path / "t.mrk.json", frame="RAS")) == {"a": [-1.0, 2.0, 3.0]}


def test_labels_of_text_files_may_be_quoted_and_lines_may_be_longer(tmp_path):
    text = fcsv_text({"F-1": SIT["F-1"]}, beyond=",2,0").replace("F-1", '"lesion, the ""left"" one"')
    (tmp_path / "t.fcsv").write_text(text)
    assert lists(tr.read_targets(tmp_path / "t.fcsv")) == {'lesion, the "left" one': [30.0, 10.0, 40.0]}


def test_a_target_without_a_place_is_refused_by_name(tmp_path):
    file = write_mrk(tmp_path / "t.mrk.json", SIT, not_seen=["F-2"])
    with pytest.raises(FormatError, match=r"'F-2' in .*t\.mrk\.json is not defined") as caught:
        tr.read_targets(file)
    assert caught.value.where == f"{file}: F-2"


# --- markers, two files ---


@pytest.mark.parametrize("frames", [("LPS", "LPS"), ("LPS", "RAS"), ("RAS", "LPS"), ("RAS", "RAS")], ids="-".join)
@pytest.mark.parametrize("wanted", [None, "LPS", "RAS"])
def test_markers_are_joined_by_label_whatever_the_frames_of_their_files(tmp_path, frames, wanted):
    """The truth is stated in LPS; each file may tell it in its own frame."""
    first, second = (
        points if f == "LPS" else other_frame(points) for f, points in zip(frames, (SIT, SEEN), strict=True)
    )
    sit = write_mrk(tmp_path / "sit.mrk.json", first, frames[0])
    (tmp_path / "seen.fcsv").write_text(fcsv_text(second, frames[1]))
    markers = tr.read_markers(sit, 0.25, measured=tmp_path / "seen.fcsv", frame=wanted)
    in_lps = (wanted or frames[0]) == "LPS"
    expected = [points if in_lps else other_frame(points) for points in (SIT, SEEN)]
    assert markers.names == ("F-1", "F-2", "F-3")
    assert markers.reference.tolist() == [list(expected[0][name]) for name in markers.names]
    assert markers.measured.tolist() == [list(expected[1][name]) for name in markers.names]
    assert markers.std.tolist() == [0.25] * 3


def test_what_is_not_defined_or_missing_was_not_seen(tmp_path):
    sit = write_mrk(tmp_path / "sit.mrk.json", {**SIT, "F-4": (0.0, 0.0, 20.0), "F-5": (30.0, 20.0, 30.0)})
    fewer = {"F-5": (30.0, 20.0, 30.0), **SEEN}
    seen = write_mrk(tmp_path / "seen.mrk.json", fewer, not_seen=["F-1", "F-2", "F-3"])
    markers = tr.read_markers(sit, measured=seen)
    assert markers.seen.tolist() == [False, False, False, False, True]
    assert markers.std.tolist() == [0.1] * 5


def test_text_files_say_what_is_not_defined_by_empty_cells_or_by_a_number(tmp_path):
    sit = write_mrk(tmp_path / "sit.mrk.json", SIT)
    lines = fcsv_text(SEEN, beyond=",2,0").splitlines()
    lines[3] = lines[3].replace("15.5,0.25,20.0", ",,")
    lines[4] = lines[4].replace(",2,0", ",3,0")
    (tmp_path / "seen.fcsv").write_text("\n".join(lines))
    markers = tr.read_markers(sit, measured=tmp_path / "seen.fcsv")
    assert dict(zip(markers.names, markers.seen.tolist(), strict=True)) == {"F-1": False, "F-2": True, "F-3": False}


def test_a_marker_that_sits_nowhere_is_left_out_and_said(tmp_path):
    sit = write_mrk(tmp_path / "sit.mrk.json", SIT, not_seen=["F-2"])
    seen = write_mrk(tmp_path / "seen.mrk.json", SEEN)
    with pytest.warns(UserWarning, match=r"sit\.mrk\.json: F-2 left out"):
        markers = tr.read_markers(sit, measured=seen)
    assert markers.names == ("F-1", "F-3")
    assert markers.seen.all()


def test_a_measured_label_that_no_marker_has_is_refused(tmp_path):
    sit = write_mrk(tmp_path / "sit.mrk.json", SIT)
    seen = write_mrk(tmp_path / "seen.mrk.json", {"F1": (1.0, 2.0, 3.0), **SEEN})
    with pytest.raises(
        FormatError, match=r"label in .*seen\.mrk\.json must .*'F1' does not, at control point 1"
    ) as caught:
        tr.read_markers(sit, measured=seen)
    assert caught.value.where == f"{seen}: F1"


def test_markers_need_both_files_of_one_kind(tmp_path):
    sit = write_mrk(tmp_path / "sit.mrk.json", SIT)
    (tmp_path / "m.csv").write_text("marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm\nF-1,1,2,3,1,2,3\n")
    (tmp_path / "n.csv").write_text((tmp_path / "m.csv").read_text())
    with pytest.raises(FormatError, match="the measured one is missing"):
        tr.read_markers(sit)
    with pytest.raises(FormatError, match=r"the measured one is .*m\.csv"):
        tr.read_markers(sit, measured=tmp_path / "m.csv")
    with pytest.raises(FormatError, match=r"the reference one is .*m\.csv"):
        tr.read_markers(tmp_path / "m.csv", measured=sit)
    with pytest.raises(FormatError, match=r"n\.csv must be left out with .*m\.csv"):
        tr.read_markers(tmp_path / "m.csv", measured=tmp_path / "n.csv")


def test_noise_must_be_positive(tmp_path):
    sit, seen = write_mrk(tmp_path / "sit.mrk.json", SIT), write_mrk(tmp_path / "seen.mrk.json", SEEN)
    with pytest.raises(MarkerError, match=r"sit\.mrk\.json: std must be positive"):
        tr.read_markers(sit, -1.0, measured=seen)


# --- frames of tables and meshes ---


def test_tables_are_taken_as_they_are_unless_their_frame_is_another_one(tmp_path):
    header = "marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm,std_x_mm,std_y_mm,std_z_mm\n"
    (tmp_path / "m.csv").write_text(header + "A,1,-2,3,4,0,6,0.1,0.2,0.3\nB,1,2,3,,,,0.1,0.2,0.3\n")
    (tmp_path / "t.csv").write_text("target,x_mm,y_mm,z_mm\na,1,-2,3\n")
    (tmp_path / "s.csv").write_text("x_mm,y_mm,z_mm\n1,-2,3\n")
    for frames in ({}, {"frame": "LPS"}, {"frame": "RAS", "table_frame": "RAS"}):
        assert tr.read_markers(tmp_path / "m.csv", **frames).reference[0].tolist() == [1, -2, 3]
        assert tr.read_targets(tmp_path / "t.csv", **frames)["a"].tolist() == [1, -2, 3]
    turned = {"frame": "LPS", "table_frame": "RAS"}
    markers = tr.read_markers(tmp_path / "m.csv", **turned)
    assert markers.reference[0].tolist() == [-1, 2, 3]
    assert markers.measured[0].tolist() == [-4, 0, 6]
    assert markers.seen.tolist() == [True, False]
    assert markers.axis_std[0].tolist() == [0.1, 0.2, 0.3]
    assert tr.read_targets(tmp_path / "t.csv", **turned)["a"].tolist() == [-1, 2, 3]
    assert tr.read_surface(tmp_path / "s.csv", **turned).tolist() == [[-1, 2, 3]]


def test_a_frame_must_be_one_and_that_of_a_table_does_not_stand_alone(tmp_path):
    (tmp_path / "t.csv").write_text("target,x_mm,y_mm,z_mm\na,1,-2,3\n")
    with pytest.raises(MarkerError, match="`frame` must be one of LPS, RAS, got 'IJK'"):
        tr.read_targets(tmp_path / "t.csv", frame="IJK")
    with pytest.raises(MarkerError, match="`table_frame` must come with `frame`"):
        tr.read_surface(tmp_path / "t.csv", table_frame="LPS")
    with pytest.raises(MeshError, match="`frame` must be one of LPS, RAS, got 'lps'"):
        block().in_frame("lps")


def test_a_mesh_has_a_frame_by_declaration_and_keeps_its_numbers(tmp_path):
    write_vtu(tmp_path / "mesh.vtu", block())
    assert tr.read_mesh(tmp_path / "mesh.vtu").frame is None
    mesh = tr.read_mesh(tmp_path / "mesh.vtu", fixed="plane 0 0 1 0 0.1", frame="RAS")
    assert mesh.frame == "RAS"
    assert np.array_equal(mesh.nodes, block().nodes)
    assert mesh.digest() == block().digest()


# --- what is refused ---


def refused(tmp_path, text, words, suffix="mrk.json"):
    file = tmp_path / f"bad.{suffix}"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(FormatError, match=words) as caught:
        tr.read_targets(file)
    assert str(file) in str(caught.value)
    assert caught.value.where.startswith(str(file))


POINT = control_point("a", (1, 2, 3))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ([], "@schema of .* got None"),
        ({"markups": []}, "@schema of .* must name a markups schema of 3D Slicer, version 1, got None"),
        ({**markups([POINT]), "@schema": "x/markups-schema-v2.0.0.json#"}, r"version 1, got 'x/markups-schema-v2"),
        ({**markups([POINT]), "markups": []}, "markups of .* must hold one list of points, got 0"),
        ({**markups([POINT]), "markups": [{}, {}]}, "got 2"),
        ({**markups([POINT]), "markups": 3}, "got 3"),
        (markups([POINT], type="Plane"), r"markups\[0\]\.type of .* must be Fiducial, a list of points, got 'Plane'"),
        (markups([POINT], frame="IJK"), "coordinateSystem of .* must be LPS or RAS, got 'IJK'"),
        (markups([POINT], units="inch"), "coordinateUnits of .* must be one of .*mm.*, got 'inch'"),
        (markups([POINT], units=["mm", "DCM", "x"]), r"coordinateUnits of .*, got \['mm', 'DCM', 'x'\]"),
        (markups({}), "controlPoints of .* must be a list, got dict"),
        (markups([]), "must hold at least one point"),
        (markups([POINT, 3]), "control point 2 of .* must be a table, got float"),
        (markups([POINT, {**POINT, "label": 7}]), "control point 2 of .* must have text for its label, got 7"),
        (markups([POINT, {**POINT, "label": " "}]), "must have a label, the one at control point 2 .* has none"),
        (markups([POINT, POINT]), "'a' is at control point 1 and control point 2"),
        (markups([{**POINT, "position": [1, 2]}]), r"control point 1 of .* \('a'\) must have a position of three"),
        (markups([{**POINT, "position": ""}]), "three finite numbers, got ''"),
        (markups([{**POINT, "position": [1, 2, "3"]}]), "three finite numbers"),
        (markups([{**POINT, "position": [1, 2, float("nan")]}]), "three finite numbers"),
        (markups([{**POINT, "position": [True, 2, 3]}]), "three finite numbers"),
        (markups([{**POINT, "position": [10**400, 2, 3]}]), "three finite numbers, got .inf, 2.0, 3.0"),
        (markups([{**POINT, "positionStatus": "lost"}]), "positionStatus defined, undefined.*, got 'lost'"),
    ],
)
def test_a_faulty_list_is_refused_by_place(tmp_path, content, words):
    refused(tmp_path, json.dumps(content), words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "must be JSON; it is not, at line 1 column 1"),
        ('{\n"@schema": 1,,}', "it is not, at line 2 column"),
        ("[" * 100000, "cannot be read|must be JSON"),
        ("1" * 5000, "@schema of .* got None"),
    ],
)
def test_a_list_that_is_no_json_is_refused_by_line(tmp_path, text, words):
    refused(tmp_path, text, words)


GOOD = fcsv_text(SIT)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "must state its frame"),
        (GOOD.replace("# CoordinateSystem = LPS\n", ""), "must state its frame in a line '# CoordinateSystem = LPS'"),
        (GOOD.replace("= LPS", "= 2"), "CoordinateSystem must be LPS, RAS, 1 or 0, got '2' at .* line 2"),
        (GOOD.replace(",label,", ",name,"), "label is missing at line 3"),
        (GOOD.replace("30.0,", "thirty,"), "x, y, z must be finite numbers, got 'thirty,10.0,40.0' at .* line 4"),
        (GOOD.replace("15.0,", "inf,"), "finite numbers, got 'inf,0.0,20.0' at .* line 6"),
        (GOOD.replace("15.0,", ","), "finite numbers, got ',0.0,20.0' at .* line 6"),
        (GOOD.replace("F-2", "F-1"), "'F-1' is at line 4 and line 5"),
        (GOOD.replace("F-2", ""), "the one at line 5 of .* has none"),
        (GOOD + "7,1,2\n", "12 cells or more, got 3 at .* line 7"),
        (GOOD + '7,"1\n', "line 7 cannot be read"),
        (GOOD[: GOOD.index("1,30.0")], "must hold at least one point"),
    ],
)
def test_faulty_text_is_refused_by_line(tmp_path, text, words):
    refused(tmp_path, text, words, "fcsv")


@pytest.mark.parametrize("suffix", ["mrk.json", "fcsv"])
def test_a_file_that_is_missing_or_in_another_encoding_is_refused(tmp_path, suffix):
    with pytest.raises(FormatError, match="no such file"):
        tr.read_targets(tmp_path / f"gone.{suffix}")
    (tmp_path / f"bad.{suffix}").write_bytes(GOOD.replace("F-1", "Brustwarze-ä").encode("latin-1"))
    with pytest.raises(FormatError, match="UTF-8"):
        tr.read_targets(tmp_path / f"bad.{suffix}")


# --- out ---


@pytest.mark.parametrize("frame", [None, "LPS", "RAS"])
def test_points_are_read_as_they_were_written(tmp_path, frame):
    rng = np.random.default_rng(5)
    places = {f"point {i}, ä": rng.standard_normal(3) * 100 for i in range(20)}
    write_mrk_json(tmp_path / "t.mrk.json", {name: (place, "words") for name, place in places.items()}, frame)
    again = read_mrk_json(tmp_path / "t.mrk.json")
    assert again.frame == (frame or "LPS")
    assert again.names == tuple(places)
    assert np.array_equal(again.places, np.array(list(places.values())))


def test_a_written_list_has_all_that_slicer_asks_for(tmp_path):
    write_mrk_json(tmp_path / "targets.mrk.json", {"lesion": ((1.0, 2.0, 3.0), "90 % region")}, "RAS")
    content = json.loads((tmp_path / "targets.mrk.json").read_text(encoding="utf-8"))
    assert content["@schema"] == markups([])["@schema"]
    (markup,) = content["markups"]
    assert (markup["type"], markup["coordinateSystem"], markup["coordinateUnits"]) == ("Fiducial", "RAS", "mm")
    (point,) = markup["controlPoints"]
    known = set(control_point("a", (0, 0, 0)))
    assert set(point) <= known
    assert point["positionStatus"] == "defined"
    assert (point["label"], point["position"], point["description"]) == ("lesion", [1.0, 2.0, 3.0], "90 % region")
