"""Recordings of trackers are read as what they hold: places in mm, missing as missing, clocks that are believed."""

import itertools
import re

import numpy as np
import pytest
import SimpleITK
from scipy.spatial.transform import Rotation

import tissuereg as tr
from support.recordings import (
    ANY_COLUMNS,
    ANY_TABLE,
    MOTIVE,
    NDI_COUNTED,
    NDI_ROWS,
    NDI_TIMED,
    NDI_TRACK,
    TRC,
    c3d_bytes,
    plus_text,
)
from tissuereg.errors import FormatError

#: What most of the small files hold.
PLACES = np.array([[[30.0, 10, 40], [0, 10, 40]], [[np.nan] * 3, [1, 10, 40]]])
OWN = "time_s,marker,x_mm,y_mm,z_mm\n"


def written(folder, content, name="recording.dat"):
    """Write a file whose ending says nothing."""
    path = folder / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


def pose(turn, shift):
    found = np.eye(4)
    found[:3, :3], found[:3, 3] = turn.as_matrix(), shift
    return found


# --- formats ---


@pytest.mark.parametrize(
    ("content", "how", "times"),
    [
        (MOTIVE, {}, [0.0, 0.01]),
        (TRC, {}, [0.0, 0.017]),
        (ANY_TABLE, {"columns": ANY_COLUMNS}, [0.0, 0.02]),
        (OWN + "0,P1,30,10,40\n0,P2,0,10,40\n0.5,P2,1,10,40\n", {}, [0.0, 0.5]),
        ("t,who,x,y,z\n7,P1,.03,.01,.04\n7,P2,0,.01,.04\n8,P2,.001,.01,.04\n",
         {"columns": {"frame": "t", "marker": "who", "x": "x", "y": "y", "z": "z", "unit": "m"}, "rate_hz": 10.0},
         [0.7, 0.8]),
        *((c3d_bytes(PLACES, ["P1", "P2"], order=order, floats=floats), {}, [0.0, 0.02])
          for order, floats in itertools.product(("<", ">", "dec"), (True, False))),
    ],
    ids=["motive", "trc", "columns", "own", "rows", *("c3d" + "-".join(one) for one in itertools.product("iso", "fi"))],
)  # fmt: skip
def test_a_file_is_read_by_its_content_alone(tmp_path, content, how, times):
    found = tr.read_recording(written(tmp_path, content), **how)
    whole = found.of(("P1", "P2")) if "P1" in found.names else found.of(("plate:P1", "P2"))
    np.testing.assert_allclose(whole.times, times, atol=1e-9)
    # A .c3d file has floats of single precision.
    np.testing.assert_allclose(whole.places, PLACES, atol=1e-5)


def test_expected_places_of_a_rigid_body_are_never_measurements(tmp_path):
    found = tr.read_recording(written(tmp_path, MOTIVE))
    assert found.names == ("plate:P1", "P2")
    assert found.up == "y"
    assert any("expected places" in text for text in found.notes)
    bare = MOTIVE.replace(",Marker,Marker,Marker,Marker,Marker,Marker\n", ",Rigid Body Marker" * 6 + "\n")
    without = bare.replace(",Type" + ",Rigid Body" * 8, ",Type" + ",Bone" * 8)
    with pytest.raises(FormatError, match="expected places of a model's markers"):
        tr.read_recording(written(tmp_path, without))


def test_a_header_in_another_code_is_read(tmp_path):
    text = MOTIVE.replace("Take Name,t", "Take Name,Größe").encode("cp1252")
    np.testing.assert_allclose(tr.read_recording(written(tmp_path, text)).places, PLACES, atol=1e-9)


def test_an_export_of_an_older_motive_is_read(tmp_path):
    """Its rows of types, names and IDs have no names, and its time no unit."""
    text = MOTIVE.replace(",1.23,", ",1.21,").replace("Time (Seconds)", "Time")
    for row in ("Type", "Name", "ID"):
        text = text.replace(f"\n,{row},", "\n,,")
    found = tr.read_recording(written(tmp_path, text))
    assert found.names == ("plate:P1", "P2")
    np.testing.assert_allclose(found.times, [0.0, 0.01])
    np.testing.assert_allclose(found.places, PLACES, atol=1e-9)


#: What programs write in place of parts of TRC, or of all of it.
TRC_WAYS = {
    "names without gaps": [("P1\t\t\tP2\t\t\n", "P1\tP2\n")],
    "names with one gap, after a gap": [("Time\tP1\t\t\tP2\t\t\n\t\t", "Times\t\tP1\t\tP2\t\n\t\t\t")],
    "axes from the first column": [("\t\tX1", "X1")],
    "gaps in the header": [("60.00\t60.00\t2\t2\tcm", " 60.00\t\t 60.00\t\t 2\t\t 2\t\t cm")],
    "a gap for a number": [("60.00\t60.00\t2", "60.00\t\t2")],
    "commas": [("\t", ",")],
}


@pytest.mark.parametrize("way", TRC_WAYS)
def test_a_trc_is_read_however_its_header_is_laid_out(tmp_path, way):
    text = TRC
    for old, new in TRC_WAYS[way]:
        assert old in text
        text = text.replace(old, new)
    found = tr.read_recording(written(tmp_path, text))
    assert found.names == ("P1", "P2")
    np.testing.assert_allclose(found.times, [0.0, 0.017])
    np.testing.assert_allclose(found.places, PLACES, atol=1e-9)


@pytest.mark.parametrize(
    ("names", "said"),
    [
        ("P1", "got 1 names, and 8 cells in line 7"),
        ("P1\tP2\tP3", "got 3 names, and 6 axes in line 5"),
    ],
)
def test_a_trc_that_does_not_name_each_marker_is_refused(tmp_path, names, said):
    with pytest.raises(FormatError, match=said):
        tr.read_recording(written(tmp_path, TRC.replace("P1\t\t\tP2\t\t\n", f"{names}\n")))


def test_a_rigid_body_of_motive_is_a_marker_at_its_offset(tmp_path):
    found = tr.read_recording(written(tmp_path, MOTIVE), offsets={"plate": (5.0, 0.0, 0.0)})
    # A quarter turn about z takes the offset to y.
    np.testing.assert_allclose(found.of(("plate",)).places[:, 0], [[10, 25, 30], [10, 25, 40]], atol=1e-6)


def test_a_file_without_a_unit_or_times_asks_for_them(tmp_path):
    bare = written(tmp_path, MOTIVE.split("\n", 2)[2])
    with pytest.raises(FormatError, match="states no unit of length"):
        tr.read_recording(bare)
    assert tr.read_recording(bare, unit="m").places[0, 0, 0] == pytest.approx(30.0)
    with pytest.raises(FormatError, match="states the unit m; cm contradicts it"):
        tr.read_recording(written(tmp_path, MOTIVE), unit="cm")
    with pytest.raises(FormatError, match="say how many a second"):
        tr.read_recording(written(tmp_path, NDI_TRACK))
    with pytest.raises(FormatError, match="name the columns of other tables"):
        tr.read_recording(written(tmp_path, "a,b\n1,2\n"))


#: A line of a Polaris before the table; one marker counted for a tool says the same.
NDI_OPTICAL = "Polaris Vega ST\n" + NDI_TRACK


@pytest.mark.parametrize("content", [NDI_OPTICAL, NDI_ROWS])
def test_tools_of_ndi_are_markers_with_their_error_as_noise(tmp_path, content):
    found = tr.read_recording(written(tmp_path, content), rate_hz=60.0)
    np.testing.assert_allclose(found.times, [2.0, 2.1, 2.2])
    seen = [[[30, 10, 40], [0, 10, 40]], [[31, 10, 40], [np.nan] * 3], [[np.nan] * 3, [1, 10, 40]]]
    np.testing.assert_array_equal(found.places, seen)
    np.testing.assert_array_equal(found.std, [[0.25, 0.1], [0.25, np.nan], [np.nan, 0.1]])
    assert not any("index of quality" in text for text in found.notes)
    tip = tr.read_recording(written(tmp_path, content), rate_hz=60.0, offsets={found.names[0]: (10.0, 0.0, 2.0)})
    np.testing.assert_allclose(tip.places[0, 0], [30, 20, 42], atol=1e-6)
    with pytest.raises(FormatError, match="an offset must be of a tool of the file"):
        tr.read_recording(written(tmp_path, content), rate_hz=60.0, offsets={"probe": (0, 0, 1)})


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (NDI_TRACK, "nothing tells that the tracker was optical"),
        ("NDI Aurora V3\n" + NDI_TRACK, "of an Aurora is an index of quality"),
        (NDI_OPTICAL.replace("Port 2", "Aurora 2"), "of an Aurora is an index of quality"),
        (NDI_ROWS.replace("Port:1", "Aurora 1"), "of an Aurora is an index of quality"),
        (NDI_ROWS.replace("0.25,1,OK,1,2,3", "0.25,0"), "nothing tells that the tracker was optical"),
    ],
    ids=["unknown", "aurora", "both", "aurora-with-markers", "no-markers"],
)
def test_an_index_of_quality_of_ndi_is_no_length(tmp_path, content, said):
    found = tr.read_recording(written(tmp_path, content), rate_hz=40.0)
    assert found.std is None
    assert sum(said in text and "--std" in text for text in found.notes) == 1
    assert np.isfinite(found.places[0]).all()
    # Where there is no error, nothing is said of it.
    plain = re.sub(r",0\.(25|1)\b", ",", content)
    assert not any("index of quality" in text for text in tr.read_recording(written(tmp_path, plain), rate_hz=40).notes)


def test_more_than_255_points_of_c3d_have_their_names(tmp_path):
    names = [f"M{i}" for i in range(600)]
    places = np.arange(2 * 600 * 3, dtype=float).reshape(2, 600, 3) + 1.0
    found = tr.read_recording(written(tmp_path, c3d_bytes(places, names)))
    assert found.names == tuple(names)
    np.testing.assert_allclose(found.places, places, rtol=1e-6)


def test_times_and_lost_numbers_of_ndi(tmp_path):
    head = (
        "ToolCount,ToolInfo,Frame#,PortHandle,Face#,timespec_s,timespec_ns,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"
    )
    rows = ["1,a,7,A,0,100,500000000,OK,1,0,0,0,1,2,3,0.2", "1,a,8,A,0,101,0,OK,1,0,0,0,-3.697314e28,0,0,0.2"]
    found = tr.read_recording(written(tmp_path, "\n".join([head, *rows])))
    assert found.times.tolist() == [100.5, 101.0]
    np.testing.assert_array_equal(found.places[:, 0], [[1, 2, 3], [np.nan] * 3])


def test_a_table_of_ndi_with_times_needs_no_rate(tmp_path):
    found = tr.read_recording(written(tmp_path, NDI_TIMED))
    assert found.names == ("Port 0x01: Probe  s/n:3E4C", "Port 0x02: Bone  s/n:3E4D")
    assert found.times.tolist() == [1700000000.25, 1700000000.5]
    np.testing.assert_array_equal(found.places, [[[30, 10, 40], [0, 10, 40]], [[np.nan] * 3, [1, 10, 40]]])
    # Markers are counted for its tools, so that the error is a length.
    np.testing.assert_array_equal(found.std, [[0.25, 0.1], [np.nan, 0.1]])


def test_all_tools_of_a_row_of_ndi_are_read_where_the_header_names_one(tmp_path):
    found = tr.read_recording(written(tmp_path, NDI_COUNTED), rate_hz=60.0)
    assert found.names == ("Port:1", "Port:2")
    np.testing.assert_allclose(found.times, [2.0, 2.1])
    np.testing.assert_array_equal(found.places, [[[30, 10, 40], [0, 10, 40]], [[np.nan] * 3, [1, 10, 40]]])
    np.testing.assert_array_equal(found.std, [[0.25, 0.1], [np.nan, 0.1]])


def test_a_quaternion_turns_an_offset_as_scipy_does(tmp_path):
    turn = Rotation.random(random_state=np.random.default_rng(2))
    x, y, z, w = turn.as_quat()
    row = f"1,Port:1,0,OK,{w},{x},{y},{z},1,2,3,0.1,0\n"
    found = tr.read_recording(written(tmp_path, NDI_ROWS.split("\n")[0] + "\n" + row), rate_hz=1.0,
                              offsets={"Port:1": (7.0, -8.0, 9.0)})  # fmt: skip
    np.testing.assert_allclose(found.places[0, 0], turn.apply([7.0, -8.0, 9.0]) + np.array([1, 2, 3]), atol=1e-9)


def test_a_repeated_pose_of_plus_is_not_seen_whatever_its_status(tmp_path):
    rng = np.random.default_rng(0)
    stylus = np.array([pose(Rotation.random(random_state=rng), rng.normal(size=3)) for _ in range(4)])
    stylus[2] = stylus[1]
    probe = np.array([pose(Rotation.identity(), (0.0, 0.0, k)) for k in range(4)])
    statuses = {"Stylus": ["OK"] * 4, "Probe": ["OK", "INVALID", "OK", "OK"]}
    path = written(tmp_path, plus_text({"Stylus": stylus, "Probe": probe}, statuses))
    found = tr.read_recording(path, offsets={"Stylus": (0.0, 0.0, -150.0)}).of(("Stylus", "Probe"))
    tip = stylus @ [0.0, 0.0, -150.0, 1.0]
    tip[2] = np.nan
    np.testing.assert_allclose(found.places[:, 0], tip[:, :3], atol=1e-9)
    np.testing.assert_array_equal(found.places[:, 1, 2], [0, np.nan, 2, 3])
    assert any("Stylus: 1 poses repeat the one before" in text for text in found.notes)
    assert any("Probe: 1 frames have another status than OK" in text for text in found.notes)


def test_a_sequence_of_plus_without_times_asks_for_a_rate(tmp_path):
    poses = {"Tool": np.array([pose(Rotation.identity(), (0.0, 0.0, k)) for k in range(3)])}
    path = written(tmp_path, re.sub(r"Seq_Frame\d+_Timestamp.*\n", "", plus_text(poses)))
    with pytest.raises(FormatError, match="say how many a second with --rate"):
        tr.read_recording(path)
    np.testing.assert_allclose(tr.read_recording(path, rate_hz=20.0).times, [0.0, 0.05, 0.1])


def test_the_header_of_plus_is_what_simpleitk_reads(tmp_path):
    poses = {"Tool": np.array([pose(Rotation.identity(), (1.5, -2.25, k)) for k in range(3)])}
    path = written(tmp_path, plus_text(poses).encode() + bytes(3), "a.igs.mha")
    image = SimpleITK.ImageFileReader()
    image.SetFileName(str(path))
    image.ReadImageInformation()
    found = tr.read_recording(path)
    for k in range(3):
        matrix = [float(word) for word in image.GetMetaData(f"Seq_Frame{k:04d}_ToolToTrackerTransform").split()]
        assert found.places[k, 0].tolist() == matrix[3:12:4]
        assert found.times[k] == float(image.GetMetaData(f"Seq_Frame{k:04d}_Timestamp"))


def test_a_place_that_no_tracker_sees_is_not_seen(tmp_path):
    found = tr.read_recording(written(tmp_path, OWN + "0,P1,1,2,3\n0,P2,1e10,2,3\n0.1,P1,1,2,-3.697314e8\n"))
    np.testing.assert_array_equal(found.places, [[[1, 2, 3], [np.nan] * 3], [[np.nan] * 3] * 2])
    assert any("2 places farther away than a kilometre" in text for text in found.notes)


# --- tracks without labels ---


def motive_of(tracks, rate=100.0):
    """A Motive file of unlabelled tracks, each (n_frames, 3), mm, NaN where it is not there."""
    names = [f"Unlabeled {1000 + i}" for i in range(len(tracks))]
    head = ["Format Version,1.23,Length Units,Millimeters,Coordinate Space,Global", ""]
    for key, words in (("Type", ["Marker"] * len(names)), ("Name", names)):
        head.append(f",{key}," + ",".join(word for word in words for _ in range(3)))
    head += [",," + ",".join(["Position"] * 3 * len(names)), "Frame,Time (Seconds)," + ",".join(["X,Y,Z"] * len(names))]
    rows = []
    for k in range(len(tracks[0])):
        cells = ["" if np.isnan(value) else repr(float(value)) for track in tracks for value in track[k]]
        rows.append(f"{k},{k / rate:.6f}," + ",".join(cells))
    return "\n".join([*head, *rows]) + "\n"


def moving(start, n=400, seed=0):
    """A marker that moves slowly, (n, 3), mm."""
    t = np.arange(n)[:, None] / 100.0
    noise = np.random.default_rng(seed).normal(0.0, 0.02, (n, 3))
    return np.asarray(start) + 3.0 * np.sin(2.0 * np.pi * 0.3 * t + np.arange(3)) + noise


def cut(track, *gaps):
    """Return the parts of a track between gaps (begin, end), each as a track of its own."""
    parts, begin = [], 0
    for end, again in (*gaps, (len(track), len(track))):
        part = np.full_like(track, np.nan)
        part[begin:end] = track[begin:end]
        parts.append(part)
        begin = again
    return parts


def test_made_up_numbers_join_no_markers(tmp_path):
    track = np.cumsum(np.full((60, 3), 0.01), axis=0)
    found = tr.read_recording(written(tmp_path, motive_of([track, track + 50.0])))
    assert found.numbered == ("U1", "U2")
    with pytest.raises(FormatError, match=r"made up, in the order in which unlabelled tracks appear.*--nearest"):
        found.of(["F-1", "F-2"], "number")
    for match, names in (("label", ["U1", "U2"]), ("order", ["a", "b"])):
        joined = found.of(names, match)
        assert any("U1, U2 are unlabelled tracks" in text for text in joined.notes)
        assert joined.numbered == ()
    # Those with names of their own are joined by their numbers, the others left out.
    mixed = tr.read_recording(written(tmp_path, motive_of([track, track + 50.0]).replace("Unlabeled 1001", "M2")))
    joined = mixed.of(["F-1", "F-2"], "number")
    assert np.isnan(joined.places[:, 0]).all()
    np.testing.assert_allclose(joined.places[:, 1], track + 50.0, atol=1e-9)


def test_unlabelled_tracks_are_joined_across_losses(tmp_path):
    one, two, three = (moving(start, seed=i) for i, start in enumerate(((0, 0, 0), (60, 0, 0), (0, 60, 0))))
    parts = [*cut(one, (100, 110), (200, 215)), *cut(two, (150, 155)), three]
    found = tr.read_recording(written(tmp_path, motive_of(parts)))
    assert found.names == ("U1", "U2", "U3")
    for i, whole in enumerate((one, two, three)):
        seen = np.isfinite(found.places[:, i]).all(axis=1)
        assert seen.sum() == (375, 395, 400)[i]
        np.testing.assert_allclose(found.places[seen, i], whole[seen], atol=1e-9)
    assert any("U1: Unlabeled 1000, Unlabeled 1001, Unlabeled 1002" in text and "%" in text for text in found.notes)


def test_tracks_that_may_be_either_of_two_are_left_apart(tmp_path):
    # Two markers 2 mm apart are both lost for half a second in which they move by more.
    one, two = moving((0, 0, 0)), moving((2, 0, 0), seed=1)
    found = tr.read_recording(written(tmp_path, motive_of([*cut(one, (100, 150)), *cut(two, (100, 150))])))
    assert len(found.names) == 4


def test_what_could_be_either_of_two_markers_is_never_taken_for_one(tmp_path):
    columns = "time=t x=x y=y z=z unit=mm"
    for content, how, said in (
        ("t,x,y,z,x\n0,1,2,3,9\n", {"columns": columns}, "only one column may be named 'x'"),
        ("t,n,x,y,z\n0,a,1,2,3\n0,a,9,9,9\n", {"columns": f"{columns} marker=n"}, "once at one time, got 'a' again"),
        ("t,x,y,z\n0,1_0,2,3\n", {"columns": columns}, "got '1_0'"),
        (MOTIVE.replace(",P2", ",plate:P1").replace('"D"', '"C"'), {}, "'plate:P1' twice"),
    ):
        with pytest.raises(FormatError, match=said):
            tr.read_recording(written(tmp_path, content), **how)
    # The second P1 of a file is not the marker number 2, and a made-up name is not a stated one.
    found = tr.read_recording(written(tmp_path, TRC.replace("P2", "P1")))
    with pytest.raises(FormatError, match="each number must stand"):
        found.of(["P1", "P2"], "number")
    track = moving((0, 0, 0))
    found = tr.read_recording(written(tmp_path, motive_of([track, track + 50.0]).replace("Unlabeled 1001", "U1")))
    assert len(set(found.names)) == 2
    np.testing.assert_allclose(found.of(["U1"]).places[:, 0], track + 50.0, atol=1e-9)


def test_a_place_of_zeros_is_not_seen_where_formats_write_it_for_none(tmp_path):
    places = np.array([[[30.0, 10, 40], [0, 10, 40]], [[0, 0, 0], [1, 10, 40]]])
    for content in (c3d_bytes(places, ["P1", "P2"]), c3d_bytes(places, ["P1", "P2"], floats=False)):
        found = tr.read_recording(written(tmp_path, content))
        np.testing.assert_allclose(found.places, PLACES, atol=1e-6)
        assert found.notes == ("P1 is at 0, 0, 0 in 1 frames and counts as not seen there",)
    found = tr.read_recording(written(tmp_path, TRC.replace("\t\t\t\t", "\t0\t0.0\t0\t")))
    assert np.isnan(found.places[1, 0]).all()
    assert "P1 is at 0, 0, 0" in found.notes[0]


def test_transforms_that_end_in_several_frames_are_told(tmp_path):
    poses = {"A": np.array([pose(Rotation.identity(), (k, 0, 0)) for k in range(3)])}
    text = plus_text({**poses, "B": poses["A"]})
    assert not any("frames that" in text for text in tr.read_recording(written(tmp_path, text)).notes)
    notes = tr.read_recording(written(tmp_path, text.replace("BToTracker", "BToReference"))).notes
    assert any("AToTracker, BToReference" in text for text in notes)


def test_remarks_above_the_names_of_columns_are_no_header(tmp_path):
    content = 'by "the" tracker, at some time: x y z t\nt,x,y,z\n0,1,2,3\n1,1,2,4\n'
    found = tr.read_recording(written(tmp_path, content), columns="time=t x=x y=y z=z unit=mm")
    np.testing.assert_array_equal(found.places[:, 0], [[1, 2, 3], [1, 2, 4]])


def test_a_missing_column_is_named_beside_those_that_are_there(tmp_path):
    content = "recorded by x, in two rows\nTime (s),Name,X (mm),Y (mm),Z (mm)\n0,a,1,2,3\n"
    how = "time=Time (s) marker=Name x=X y=Y (mm) z=Z (mm) unit=mm"
    with pytest.raises(FormatError, match=r"line 2 lacks 'X' and has Time \(s\), Name, X \(mm\), Y \(mm\), Z \(mm\)"):
        tr.read_recording(written(tmp_path, content), columns=how)


# --- clocks ---


def test_a_clock_that_errs_is_told_frame_by_frame(tmp_path):
    times = np.arange(40) / 10.0
    times[10], times[20], times[30:] = times[9], times[18] - 0.05, times[30:] + 5.0
    rows = "".join(f"{time};{k};0;0\n" for k, time in enumerate(times))
    found = tr.read_recording(written(tmp_path, "t;x;y;z\n" + rows), columns="time=t x=x y=y z=z unit=mm")
    assert [(one.frame, one.kind) for one in found.clock] == [(11, "repeat"), (21, "back"), (31, "jump")]
    assert len(found) == 38
    assert (np.diff(found.times) > 0).all()
    assert 10 not in found.places[:, 0, 0]
    assert 20 not in found.places[:, 0, 0]
    assert sum(text.startswith("clock: frame") for text in found.notes) == 3


def test_a_clock_that_begins_anew_is_refused(tmp_path):
    rows = "".join(f"{(k % 20) / 10};{k};0;0\n" for k in range(40))
    with pytest.raises(FormatError, match=r"20 of 40 frames are not later .* frame 21 at 0 s"):
        tr.read_recording(written(tmp_path, "t;x;y;z\n" + rows), columns="time=t x=x y=y z=z unit=mm")


# --- joined with a reference ---


def test_markers_that_only_one_side_names_are_told(tmp_path):
    found = tr.read_recording(written(tmp_path, TRC)).of(("P2", "P9"))
    np.testing.assert_array_equal(found.places[:, 0], PLACES[:, 1])
    assert np.isnan(found.places[:, 1]).all()
    assert any("left out, since the reference does not name them: P1" in text for text in found.notes)
    assert any("never seen, since the file does not name them: P9" in text for text in found.notes)
    with pytest.raises(FormatError, match=r"every label in .* must stand in the reference too"):
        tr.read_recording(written(tmp_path, TRC)).of(("F-7",))
    by_number = tr.read_recording(written(tmp_path, TRC)).of(("F-2", "F-1"), match="number")
    np.testing.assert_array_equal(by_number.places, PLACES[:, ::-1])


def test_tracks_without_names_are_joined_by_place(tmp_path):
    starts = ((0, 0, 0), (60, 0, 0), (0, 60, 0), (90, 90, 90))
    one, two, three, ghost = (moving(start, seed=i) for i, start in enumerate(starts))
    found = tr.read_recording(written(tmp_path, motive_of([three, ghost, *cut(one, (100, 110)), two])))
    reference = np.array([one[0], two[0], three[0]]) + 1.0
    joined = found.nearest(("a", "b", "c"), reference, 5.0)
    for i, whole in enumerate((one, two, three)):
        seen = np.isfinite(joined.places[:, i]).all(axis=1)
        assert seen.sum() >= 390
        np.testing.assert_allclose(joined.places[seen, i], whole[seen], atol=1e-9)
    assert any("joined by place, within 5 mm: a is U3, b is U4, c is U1" in text for text in joined.notes)
    with pytest.raises(FormatError, match="'a' must have one partner within 100 mm"):
        found.nearest(("a", "b", "c"), reference, 100.0)
    with pytest.raises(FormatError, match=r"must begin within 0\.1 mm of one of the reference; the closest is"):
        found.nearest(("a", "b", "c"), reference, 0.1)


# --- alignment ---


def points():
    rng = np.random.default_rng(3)
    body = rng.uniform(-40, 40, (6, 3))
    turn = Rotation.random(random_state=rng)
    return body, turn.apply(body) + np.array([300.0, -20.0, 1500.0]), turn


def test_a_rigid_alignment_is_the_one_of_scipy():
    body, tracker, turn = points()
    tracker = tracker + np.random.default_rng(4).normal(0.0, 0.1, tracker.shape)
    found = tr.tracking.rigid_alignment(tracker, body, [f"P{i}" for i in range(6)])
    expected, distance = Rotation.align_vectors(body - body.mean(axis=0), tracker - tracker.mean(axis=0))
    np.testing.assert_allclose(found.rotation, expected.as_matrix(), atol=1e-9)
    assert found.rms_mm == pytest.approx(distance / np.sqrt(6.0))
    np.testing.assert_allclose(found.rotation, turn.inv().as_matrix(), atol=0.01)
    assert set(found.residual_mm) == {f"P{i}" for i in range(6)}


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda p: p[[1, 0, 2, 3, 4, 5]], "Are points exchanged"),
        (lambda p: p * (-1, 1, 1), "Mirrored they fit"),
        (lambda p: p / 10.0, "Times 10 they fit"),
        (lambda p: p[0] + np.arange(6)[:, None] * (p[1] - p[0]), "must not lie on one line"),
        (lambda p: np.where(np.arange(6)[:, None] < 2, p, np.nan), "3 or more points must be known"),
    ],
)
def test_an_alignment_that_does_not_fit_is_refused(change, said):
    body, tracker, _ = points()
    place = (body[0] + np.arange(6)[:, None] * (body[1] - body[0])) if "line" in said else body
    with pytest.raises(tr.errors.MarkerError, match=said):
        tr.tracking.rigid_alignment(change(tracker), place)
