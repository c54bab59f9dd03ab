"""Tables of control points, carriage returns inside rows, and how two lists of points are joined."""

import numpy as np
import pytest

import tissuereg as tr
from support.files import run, run_json
from support.meshes import block
from support.slicer import fcsv_text, other_frame
from tissuereg.errors import FormatError
from tissuereg.io.meshes import write_vtu
from tissuereg.io.tables import read_reference

SIT = {"F-1": (30.0, 10.0, 40.0), "F-2": (0.0, 10.0, 40.0), "F-3": (15.0, 0.0, 20.0)}
SEEN = {"F_1-1": (31.0, 10.5, 40.25), "F_1-2": (1.0, 10.5, 40.25), "F_1-3": (15.5, 0.25, 20.0)}


def table_text(points, axes="lps", cell=",", not_defined=(), more=True):
    """Return places by label as 3D Slicer exports them to a table; places in LPS."""
    head = ["label", *axes, "defined", *(["selected", "visible", "locked", "description"] if more else [])]
    places = points if axes == "lps" else other_frame(points)
    rows = [
        [label, *map(repr, place), "0" if label in not_defined else "1", *(["1", "1", "0", ""] if more else [])]
        for label, place in places.items()
    ]
    return "\n".join(cell.join(row) for row in [head, *rows]) + "\n"


def write(folder, **texts):
    """Write files by name, the dot of whose ending is a double underscore; return their paths."""
    paths = [folder / name.replace("__", ".") for name in texts]
    for path, text in zip(paths, texts.values(), strict=True):
        path.write_bytes(text.encode())
    return paths


# --- tables of control points ---


@pytest.mark.parametrize("axes", ["lps", "ras"])
@pytest.mark.parametrize(("suffix", "cell"), [("csv", ","), ("tsv", "\t"), ("csv", "\t"), ("csv", ";"), ("csv", ", ")])
def test_a_table_of_control_points_is_read_in_the_frame_of_its_columns(tmp_path, axes, suffix, cell):
    (file,) = write(tmp_path, **{f"t__{suffix}": table_text(SIT, axes, cell)})
    assert {name: tuple(place) for name, place in tr.read_targets(file, frame="LPS").items()} == SIT
    own = SIT if axes == "lps" else other_frame(SIT)
    assert {name: tuple(place) for name, place in tr.read_targets(file).items()} == own
    assert tr.read_surface(file, frame="LPS").tolist() == [list(place) for place in SIT.values()]
    assert read_reference(file, frame="LPS").names == tuple(SIT)


def test_columns_may_stand_in_any_order_quoted_and_with_others_between(tmp_path):
    text = '"S";"Label";"note";"P";"L"\n3;a;"one, two\nlines";-2;1\n'.replace(";", ",")
    (file,) = write(tmp_path, t__csv=text)
    assert tr.read_targets(file)["a"].tolist() == [1.0, -2.0, 3.0]


@pytest.mark.parametrize("head", ["", "sep=;\n", "\n"])
def test_a_table_with_decimal_commas_is_read(tmp_path, head):
    german = head + table_text(SIT, cell=";").replace(".", ",")
    own = head + "target;x_mm;y_mm;z_mm\na;1,5;-2;3e0\n"
    slicer, table, tabs = write(tmp_path, s__csv=german, t__csv=own, tabs__csv=own.replace(";", "\t"))
    assert head[:3] == "sep" or tr.read_targets(tabs)["a"].tolist() == [1.5, -2.0, 3.0]
    assert {name: tuple(place) for name, place in tr.read_targets(slicer).items()} == SIT
    assert tr.read_targets(table)["a"].tolist() == [1.5, -2.0, 3.0]


def test_what_else_is_no_file_of_points_is_said(tmp_path):
    sit, other = write(tmp_path, s__csv=table_text(SIT), m__csv=table_text(SIT).replace("l,p,s", "x,y,z"))
    with pytest.raises(FormatError, match=r"m\.csv, which is no file of points \(.*columns label and r,a,s or l,p,s"):
        tr.read_markers(sit, measured=other)


def test_two_tables_without_a_frame_are_told_what_states_one(tmp_path):
    bare = table_text(SIT).replace("l,p,s", "x,y,z")
    sit, seen = write(tmp_path, s__csv=bare, m__csv=bare)
    with pytest.raises(FormatError, match=r"both be files of points \(.* r,a,s or l,p,s, which state its frame"):
        tr.read_markers(sit, measured=seen)


def test_a_target_that_was_seen_twice_is_refused(tmp_path):
    (file,) = write(tmp_path, s__fcsv=fcsv_text({**SIT, "F-4": (1.0, 2.0, 3.0)}).replace("F-4", "F-1"))
    with pytest.raises(FormatError, match=r"each label must stand in .*s\.fcsv once; 'F-1'"):
        tr.read_seen(file)


@pytest.mark.parametrize(
    "line",
    ["#CoordinateSystem=ras", " # coordinatesystem = RAS,,,,", "# CoordinateSystem: 0"],
)
def test_the_frame_of_a_text_may_be_spelt_otherwise(tmp_path, line):
    text = fcsv_text(SIT)
    stated = next(row for row in text.splitlines() if "CoordinateSystem" in row)
    one, two = write(tmp_path, a__fcsv=text.replace(stated, line), b__fcsv=f"{line}\n# CoordinateSystem = LPS\n{text}")
    assert tr.read_targets(one, frame="LPS")["F-1"].tolist() == [-30.0, -10.0, 40.0]
    with pytest.raises(FormatError, match="must be RAS, as it is stated before, got 'LPS'"):
        tr.read_targets(two)


def test_what_a_table_does_not_define_was_not_seen(tmp_path):
    sit, seen = write(tmp_path, s__csv=table_text(SIT), m__csv=table_text(SIT, not_defined=["F-2"]))
    assert tr.read_markers(sit, measured=seen).seen.tolist() == [True, False, True]
    for cells in (",,", "nan,NaN,nan"):
        (other,) = write(tmp_path, o__csv=table_text(SIT).replace("15.0,0.0,20.0", cells))
        assert tr.read_markers(sit, measured=other).seen.tolist() == [True, True, False]
    assert len(tr.read_surface(seen)) == 2


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("15.0,0.0", "15.0,none", r"l,p,s must be finite numbers, got '15\.0,none,20\.0' at .*t\.csv line 4"),
        ("15.0,0.0", "inf,0.0", "finite numbers, got 'inf,0.0,20.0'"),
        ("15.0,0.0", ",0.0", "finite numbers, got ',0.0,20.0'"),
        ("20.0,1,1", "20.0,perhaps,1", "column 'defined' must hold 1 or 0, got 'perhaps' at .* line 4"),
        ("20.0,1,1", "20.0,1", "every row must have 9 cells, got 8 at .* line 4"),
        ("F-3", "F-2", "'F-2' is at line 3 and line 4"),
        ("F-3", "", "must have a label, the one at line 4"),
        ("selected,visible", "r,a", "either r,a,s or l,p,s, once each, got"),
        ("visible", "label", "once each, got"),
    ],
)
def test_a_faulty_table_is_refused_by_line(tmp_path, old, new, words):
    (file,) = write(tmp_path, t__csv=table_text(SIT).replace(old, new))
    with pytest.raises(FormatError, match=words) as caught:
        tr.read_targets(file)
    assert caught.value.where.startswith(str(file))


def test_a_table_without_points_is_refused(tmp_path):
    (file,) = write(tmp_path, t__csv=table_text({}))
    with pytest.raises(FormatError, match="at least one point"):
        tr.read_targets(file)


# --- carriage returns ---


@pytest.mark.parametrize("where", [",,vtk", "\r\n", "\r"])
def test_rows_end_at_line_feeds_wherever_carriage_returns_stand(tmp_path, where):
    text = fcsv_text(SIT, beyond=",2,0")
    text = text.replace("vtkMRMLScalarVolumeNode1", "\r") if where == ",,vtk" else text.replace("\n", where)
    (file,) = write(tmp_path, s__fcsv=text)
    assert {name: tuple(place) for name, place in tr.read_targets(file).items()} == SIT


def test_a_fault_beside_a_carriage_return_is_named_by_its_row(tmp_path):
    text = fcsv_text(SIT, beyond=",2,0").replace("vtkMRMLScalarVolumeNode1", "\r").replace("15.0,", "far,")
    (file,) = write(tmp_path, s__fcsv=text)
    with pytest.raises(FormatError, match=r"got 'far,0\.0,20\.0' at .* line 6"):
        tr.read_targets(file)


# --- two lists ---


def test_two_lists_with_other_labels_are_joined_by_order_or_by_number(tmp_path):
    turned = dict(reversed(SEEN.items()))
    sit, seen, back = write(tmp_path, s__fcsv=fcsv_text(SIT), m__csv=table_text(SEEN), b__fcsv=fcsv_text(turned))
    expected = [list(place) for place in SEEN.values()]
    for measured, match in ((seen, "order"), (seen, "number"), (back, "number")):
        markers = tr.read_markers(sit, measured=measured, match=match)
        assert markers.names == tuple(SIT)
        assert markers.measured.tolist() == expected
    assert tr.read_markers(sit, measured=back, match="order").measured.tolist() == expected[::-1]


def test_an_accent_may_be_a_character_of_its_own(tmp_path):
    places = {"\u00c9-1": (1.0, 2.0, 3.0)}
    sit, seen = write(tmp_path, s__csv=table_text(places), m__csv=table_text({"E\u0301-1": (1.0, 2.0, 4.0)}))
    assert tr.read_markers(sit, measured=seen).displacement.tolist() == [[0.0, 0.0, 1.0]]


def test_labels_that_differ_name_the_option(tmp_path):
    sit, seen = write(tmp_path, s__fcsv=fcsv_text(SIT), m__fcsv=fcsv_text(SEEN))
    with pytest.raises(FormatError, match=r"joined by --match order or --match number \(match= in Python\)") as caught:
        tr.read_markers(sit, measured=seen)
    assert caught.value.where == f"{seen}: F_1-1"


def test_by_order_labels_may_repeat_and_by_number_some_may_be_missing(tmp_path):
    same = fcsv_text(SEEN).replace("F_1-2", "F_1-1").replace("F_1-3", "")
    fewer = {label: SEEN[label] for label in ("F_1-3", "F_1-1")}
    sit, seen, less = write(tmp_path, s__fcsv=fcsv_text(SIT), m__fcsv=same, l__fcsv=fcsv_text(fewer))
    assert tr.read_markers(sit, measured=seen, match="order").seen.all()
    markers = tr.read_markers(sit, measured=less, match="number")
    assert markers.seen.tolist() == [True, False, True]
    assert markers.measured[2].tolist() == list(SEEN["F_1-3"])


@pytest.mark.parametrize(
    ("old", "new", "match", "words"),
    [
        ("F_1-3", "F_1-2", "label", "'F_1-2' is at line 5 and line 6"),
        ("F_1-3", "F_2-2", "number", "each number must stand in .* once; 'F_1-2' and 'F_2-2' have the same"),
        ("F_1-3", "apex", "number", "must hold a number to be joined by it; 'apex' has none"),
        ("F_1-3", "F_1-4", "number", "every number in .* 'F_1-4' does not, at line 6 .* joined by --match order"),
        ("3,15.5,", "#", "order", "as many points as each other; .* has 3, .* has 2"),
        ("F_1-3", "F_1-3", "place", "`match` must be one of label, order, number, got 'place'"),
    ],
)
def test_lists_that_do_not_go_together_are_refused(tmp_path, old, new, match, words):
    sit, seen = write(tmp_path, s__fcsv=fcsv_text(SIT), m__fcsv=fcsv_text(SEEN).replace(old, new))
    with pytest.raises(FormatError, match=words):
        tr.read_markers(sit, measured=seen, match=match)


def test_a_table_that_joins_by_itself_takes_no_other_way(tmp_path):
    (file,) = write(tmp_path, m__csv="marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm\nA,1,2,3,1,2,3\n")
    with pytest.raises(FormatError, match=r"`match` must be left out with .*m\.csv"):
        tr.read_markers(file, match="order")


def test_a_recording_is_joined_to_its_reference_the_same_ways(tmp_path):
    head = "time_s,marker,x_mm,y_mm,z_mm\n"
    whole, late = write(
        tmp_path,
        w__csv=f"{head}0,R_2,1,0,0\n0,R_1,,,\n1,R_1,2,0,0\n",
        l__csv=f"{head}0,R_1,1,0,0\n1,R_1,2,0,0\n1,R_2,3,0,0\n",
    )
    names = ("F-1", "F-2")
    by_number = tr.read_recording(whole).of(names, match="number").places[..., 0]
    assert np.array_equal(by_number, [[np.nan, 1.0], [2.0, np.nan]], equal_nan=True)
    by_order = tr.read_recording(whole).of(names, match="order").places[..., 0]
    assert np.array_equal(by_order, [[1.0, np.nan], [np.nan, 2.0]], equal_nan=True)
    with pytest.raises(FormatError, match=r"every label in .*w\.csv must stand in the reference too"):
        tr.read_recording(whole).of(names)
    with pytest.raises(FormatError, match=r"the reference has 2, .*l\.csv has 1"):
        tr.read_recording(late).of(names, match="order")
    with pytest.raises(FormatError, match="one of the first frame"):
        tr.read_recording(late).of(names[:1], match="order")


def test_a_list_joined_in_the_wrong_order_is_found_out(capsys, tmp_path):
    """The labels no longer hold the points together: the geometry has to."""
    mesh = block()
    nodes = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)[::8]
    places = {f"F-{i}": tuple(map(float, place)) for i, place in enumerate(mesh.nodes[nodes], 1)}
    moved = {f"G-{i}": (x + 0.03 * z, y, z) for i, (x, y, z) in enumerate(places.values(), 1)}
    names = list(moved)
    names[2], names[4] = names[4], names[2]
    write_vtu(tmp_path / "b.vtu", mesh)
    sit, right, wrong = write(
        tmp_path,
        s__fcsv=fcsv_text(places),
        r__fcsv=fcsv_text(moved),
        w__fcsv=fcsv_text({name: moved[name] for name in names}),
    )
    words = ["register", tmp_path / "b.vtu", sit, "--quiet", "--out", tmp_path / "out", "--frame", "LPS"]
    assert run(capsys, *words, "--measured", right, "--match", "order")[0] == 0
    code, said, _ = run_json(capsys, *words, "--measured", wrong, "--match", "order")
    assert code in (2, 4)
    assert "swapped" in (said["message"] if code == 2 else said["trust"]["reasons"][0])
    assert run(capsys, *words, "--measured", wrong, "--match", "number")[0] == 0


# --- small inputs that went wrong before ---


@pytest.mark.parametrize(
    ("folder", "was", "now", "match"),
    [
        ("slicer-table", "was_table.csv", "now_table.csv", "label"),
        ("fcsv-cr", "was.fcsv", "now.fcsv", "label"),
        ("default-labels", "was_default.fcsv", "now_default.fcsv", "order"),
        ("default-labels", "was_default.fcsv", "now_default.fcsv", "number"),
    ],
)
def test_lists_as_slicer_writes_them_are_the_markers_of_the_table(shared_data, folder, was, now, match):
    cases = shared_data / "cases"
    table = tr.read_markers(cases / "markers.csv")
    markers = tr.read_markers(cases / folder / was, measured=cases / folder / now, match=match)
    np.testing.assert_allclose(markers.reference, table.reference, atol=1e-4)
    np.testing.assert_allclose(markers.measured, table.measured, atol=1e-4)
