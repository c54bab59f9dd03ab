"""``tissuereg track``: a recording frame after frame, what it writes, and what it refuses."""

import csv
import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tissuereg as tr
from support.files import run, run_json
from support.meshes import block
from support.slicer import write_mrk
from support.small_model import SMALL_MODEL
from tissuereg.errors import EnsembleError
from tissuereg.io import tables
from tissuereg.io.atomic import OutputError
from tissuereg.io.meshes import write_vtu
from tissuereg.io.problems import read_simulations, write_simulations
from tissuereg.tracking import TablePhysics
from tissuereg.tracking.align import another_frame

BODY = tr.phantom.phantom_mesh("small")
PLACES = BODY.nodes[np.setdiff1d(BODY.surface_nodes, BODY.fixed_nodes)[::60]]
NAMES = [f"P{i + 1}" for i in range(len(PLACES))]
TIMES = [0.0, 0.025, 0.05, 0.1]
HEADER = "time_s,marker,x_mm,y_mm,z_mm\n"


def leaning(time_s):
    """A field that grows with time and vanishes where the body is held."""
    return np.c_[0.2 * (1.0 + 10.0 * time_s) * BODY.nodes[:, 2] / 10.0, np.zeros((BODY.n_nodes, 2))]


def measured(time_s):
    held = np.setdiff1d(BODY.surface_nodes, BODY.fixed_nodes)[::60]
    return PLACES + leaning(time_s)[held]


def rows_of(time_s, places, names=NAMES):
    return [f"{time_s},{name},{x},{y},{z}\n" for name, (x, y, z) in zip(names, places.tolist(), strict=True)]


@pytest.fixture
def inputs(tmp_path):
    """A body, a recording in which two markers are not seen at the second time, and simulations."""
    write_vtu(tmp_path / "body.vtu", BODY)
    reference = [f"{name},{x},{y},{z}\n" for name, (x, y, z) in zip(NAMES, PLACES.tolist(), strict=True)]
    (tmp_path / "reference.csv").write_text("marker,x_mm,y_mm,z_mm\n" + "".join(reference))
    rows = [row for time_s in TIMES for row in rows_of(time_s, measured(time_s))]
    second = len(NAMES)
    rows[second] = f"{TIMES[1]},{NAMES[0]},,,\n"
    del rows[second + 1]
    (tmp_path / "recording.csv").write_text(HEADER + "".join(rows))
    (tmp_path / "targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,5,5,20\n")
    write_simulations(tmp_path / "simulations.npz", [0.0, 0.06, 0.1], [0.8 * leaning(t) for t in (0.0, 0.06, 0.1)])
    return tmp_path


def track(capsys, folder, *words, out="out"):
    files = [folder / "body.vtu", folder / "recording.csv", "--reference", folder / "reference.csv"]
    return run_json(capsys, "track", *files, "--out", folder / out, "--quiet", *words)


def with_model(folder):
    return ["--model", SMALL_MODEL, "--members", 40, "--targets", folder / "targets.csv"]


def recorded():
    """Return the frames of the recording, those that were not seen NaN."""
    frames = [measured(time_s) for time_s in TIMES]
    frames[1][:2] = np.nan
    return frames


def tracker(**changed):
    settings = tr.RegisterSettings(smoother=tr.SmootherSettings(n_members=40))
    targets = {"lesion": (5.0, 5.0, 20.0)}
    registrar = tr.Registrar(BODY, tr.Markers(PLACES, names=NAMES), SMALL_MODEL, targets, settings=settings)
    return tr.Tracker(registrar, **changed)


def test_the_answers_are_those_of_a_tracker(inputs, capsys):
    code, said, _ = track(capsys, inputs, *with_model(inputs))
    assert code in (0, 4)
    plain = tracker()
    for frame, time_s, seen in zip(said["frames"], TIMES, recorded(), strict=True):
        result = plain.step(seen, time_s)
        assert frame["time_s"] == time_s
        # The table has as many digits as a float.
        assert frame["targets"]["lesion"]["mean_mm"] == result.target("lesion").mean.tolist()
        assert frame["markers_rms_mm"] == result.markers.after_rms_mm
        assert frame["trust"] == {
            "ok": result.trust.ok,
            "p_value": result.trust.p_value,
            "reasons": list(result.trust.reasons),
        }
        assert frame["skipped"] == 0
        assert frame["latency_ms"] > 0.0
    assert [frame["markers_used"] for frame in said["frames"]] == [len(NAMES), len(NAMES) - 2, len(NAMES), len(NAMES)]


def test_it_tells_and_writes_all(inputs, capsys):
    code, said, err = track(capsys, inputs, *with_model(inputs), "--fields", out="deep/out")
    assert err == ""
    assert set(said) >= {"schema", "seconds", "threads", "machine", "versions", "seed"}
    assert said["schema"] == "tissuereg.track/1"
    assert said["dropped_frames"] == 0
    assert said["failed"] == []
    assert said["hz"] == pytest.approx(len(TIMES) / said["seconds"]["track"])
    assert code == (0 if all(frame["trust"]["ok"] for frame in said["frames"]) else 4)
    out = inputs / "deep" / "out"
    assert {file.name for file in out.iterdir()} == {"track.json", "targets.csv", "fields.npz"}
    kept = json.loads((out / "track.json").read_text())
    assert kept["frames"] == said["frames"]
    made = kept["provenance"]
    assert {"body.vtu", "recording.csv", "reference.csv"} <= {one["path"] for one in made["inputs"]}
    assert made["command"].startswith("tissuereg track ")
    assert "smoother" in made["settings"]
    with (out / "targets.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["time_s"]) for row in rows] == TIMES
    assert {row["target"] for row in rows} == {"lesion"}
    # A cell has nine digits.
    found = [[float(row[f"moved_{axis}_mm"]) for axis in "xyz"] for row in rows]
    np.testing.assert_allclose(found, [frame["targets"]["lesion"]["mean_mm"] for frame in said["frames"]], rtol=1e-8)
    times, fields = read_simulations(out / "fields.npz", BODY.n_nodes)
    assert times.tolist() == TIMES
    assert fields.shape == (len(TIMES), BODY.n_nodes, 3)
    # The folder holds what a transform with time needs.
    seq = inputs / "field.seq.nrrd"
    code, said, err = run_json(capsys, "warp", out, "--grid", seq, "--spacing", 20)
    assert (code, said["moments"], said["written"]) == (0, len(TIMES), [str(seq)])
    assert "taken for LPS" in " ".join(err.split())
    assert b"kinds: vector domain domain domain list\n" in seq.read_bytes()
    for words in (["--direction", "resampling"], ["--std", inputs / "std.nrrd"]):
        code, said, _ = run_json(capsys, "warp", out, "--grid", seq, "--spacing", 20, *words)
        assert (code, said["where"]) == (2, words[0])


def test_simulations_are_linear_in_time(inputs, capsys):
    words = [*with_model(inputs), "--simulations", inputs / "simulations.npz"]
    _, said, _ = track(capsys, inputs, *words)
    table = TablePhysics([0.0, 0.06, 0.1], [0.8 * leaning(t) for t in (0.0, 0.06, 0.1)])
    known = tracker(simulator=table)
    for frame, time_s, seen in zip(said["frames"], TIMES, recorded(), strict=True):
        result = known.step(seen, time_s, actuator=time_s)
        assert frame["targets"]["lesion"]["mean_mm"] == result.target("lesion").mean.tolist()
        assert frame["targets"]["lesion"]["simulation_mm"] is not None


def test_a_replay_drops_what_comes_too_fast_and_counts_it(inputs, capsys):
    rows = [row for k in range(400) for row in rows_of(1e-5 * k, measured(1e-5 * k))]
    (inputs / "recording.csv").write_text(HEADER + "".join(rows))
    _, said, _ = track(capsys, inputs, *with_model(inputs), "--live")
    # No computer registers within a hundredth of a millisecond; first and last frame are always registered.
    assert said["dropped_frames"] > 0
    assert said["live"] is True
    assert len(said["frames"]) + said["dropped_frames"] == 400
    assert sum(frame["skipped"] for frame in said["frames"]) == said["dropped_frames"]
    assert said["frames"][-1]["time_s"] == pytest.approx(1e-5 * 399)


def test_a_replay_takes_as_long_as_the_recording(inputs, capsys):
    _, said, _ = track(capsys, inputs, *with_model(inputs), "--live")
    assert said["seconds"]["track"] >= TIMES[-1]
    assert said["hz"] <= len(TIMES) / TIMES[-1]


def test_a_frame_without_any_marker_is_left_out_and_told(inputs, capsys):
    unseen = [f"0.025,{name},,,\n" for name in NAMES]
    seen = [rows_of(time_s, measured(time_s)) for time_s in (0.0, 0.05)]
    # A replay never drops its first and last frames.
    for words, rows in (([], [*seen[0], *unseen, *seen[1]]), (["--live"], [*seen[0], *unseen])):
        (inputs / "recording.csv").write_text(HEADER + "".join(rows))
        code, said, _ = track(capsys, inputs, *with_model(inputs), *words)
        assert code == 4
        assert [frame["time_s"] for frame in said["frames"]] == ([0.0] if words else [0.0, 0.05])
        assert [frame["time_s"] for frame in said["failed"]] == [0.025]
        assert "must have been seen" in said["failed"][0]["reason"]


TURN = Rotation.from_rotvec([0.4, -0.2, 1.1])
ORIGIN = np.array([250.0, 900.0, -60.0])


#: The body at rest for a tenth of a second, then as recorded.
MOMENTS = [*(0.01 * k - 0.1 for k in range(10)), *TIMES]


def at_rest_first():
    return [*[PLACES] * 10, *recorded()]


def motive(frames, names=NAMES):
    """A Motive file in metres of markers (n_frames, n_markers, 3), mm in the body's frame, in a tracker's frame."""
    head = ["Format Version,1.24,Length Units,Meters,Coordinate Space,Global", ""]
    for key, words in (("Type", ["Marker"] * len(names)), ("Name", names)):
        head.append(f",{key}," + ",".join(word for word in words for _ in range(3)))
    head += [",," + ",".join(["Position"] * 3 * len(names)), "Frame,Time (Seconds)" + ",X,Y,Z" * len(names)]
    rows = []
    for k, frame in enumerate(frames):
        seen = np.where(np.isnan(frame), np.nan, TURN.apply(np.nan_to_num(frame)) + ORIGIN) / 1000.0
        rows.append(f"{k},{MOMENTS[k]}," + ",".join("" if np.isnan(one) else repr(float(one)) for one in seen.ravel()))
    return "\n".join([*head, *rows]) + "\n"


def test_an_export_of_a_tracker_is_aligned_and_tracked_like_a_table(inputs, capsys):
    frames = at_rest_first()
    (inputs / "motive.csv").write_text(motive(frames))
    rows = [row for time_s, seen in zip(MOMENTS, frames, strict=True) for row in rows_of(time_s, seen)]
    (inputs / "recording.csv").write_text(HEADER + "".join(rows).replace("nan", ""))
    _, table, _ = track(capsys, inputs, *with_model(inputs))
    assert table["recording"]["format"].startswith("table")
    pairs = ["point,x_mm,y_mm,z_mm,tracker_x_mm,tracker_y_mm,tracker_z_mm\n"]
    for name, place in zip("abcd", PLACES[:4], strict=True):
        pairs.append(f"{name},{','.join(map(str, [*place, *(TURN.apply(place) + ORIGIN)]))}\n")
    (inputs / "pairs.csv").write_text("".join(pairs))
    (inputs / "motive.csv").rename(inputs / "recording.csv")
    for align in ("first", inputs / "pairs.csv"):
        _, said, err = track(capsys, inputs, *with_model(inputs), "--align", align, out=f"out-{len(str(align))}")
        assert "aligned to the body's by" in err
        assert said["alignment"]["rms_mm"] < 1e-6
        assert said["recording"]["up"] == "y"
        for frame, plain in zip(said["frames"], table["frames"], strict=True):
            found, wanted = (one["targets"]["lesion"]["mean_mm"] for one in (frame, plain))
            # The alignment rounds in the last digits.
            np.testing.assert_allclose(found, wanted, atol=1e-4)


def test_tracks_without_names_are_joined_by_place(inputs, capsys):
    (inputs / "recording.csv").write_text(motive(at_rest_first()))
    pairs = ["point,x_mm,y_mm,z_mm,tracker_x_mm,tracker_y_mm,tracker_z_mm\n"]
    for name, place in zip("abcd", PLACES[:4], strict=True):
        pairs.append(f"{name},{','.join(map(str, [*place, *(TURN.apply(place) + ORIGIN)]))}\n")
    (inputs / "pairs.csv").write_text("".join(pairs))
    words = [*with_model(inputs), "--align", inputs / "pairs.csv"]
    _, named, _ = track(capsys, inputs, *words)
    exchanged = [frame[::-1] for frame in at_rest_first()]
    (inputs / "recording.csv").write_text(motive(exchanged, [f"Unlabeled {i}" for i in range(len(NAMES))]))
    _, said, _ = track(capsys, inputs, *words, "--nearest", "2", out="nearest")
    assert [frame["targets"] for frame in said["frames"]] == [frame["targets"] for frame in named["frames"]]
    for more in (["--align", "first"], ["--align", inputs / "pairs.csv", "--match", "order"]):
        code, said, _ = track(capsys, inputs, *with_model(inputs), "--nearest", "2", *more)
        assert (code, said["where"]) == (2, "--nearest")


def test_an_alignment_that_does_not_fit_is_refused(inputs, capsys):
    exchanged = [frame[[2, 1, 0, *range(3, len(PLACES))]] for frame in at_rest_first()]
    (inputs / "recording.csv").write_text(motive(exchanged))
    code, said, _ = track(capsys, inputs, *with_model(inputs), "--align", "first")
    assert (code, said["error"]) == (2, "MarkerError")
    assert "must fit one rigid motion" in said["message"]
    assert not (inputs / "out").exists()


def test_columns_offsets_and_the_noise_of_a_tracker_are_taken(inputs, capsys):
    head = "Frame#,ToolHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error,#Markers\n"
    rows = [f"{k},{name},0,OK,1,0,0,0,{x - 5},{y},{z},0.5,4\n" for k, frame in enumerate([PLACES] * 2)
            for name, (x, y, z) in zip(NAMES, frame.tolist(), strict=True)]  # fmt: skip
    (inputs / "recording.csv").write_text(head + "".join(rows))
    words = [word for name in NAMES for word in ("--offset", f"{name} 5 0 0")]
    _, said, _ = track(capsys, inputs, *with_model(inputs), "--rate", "50", *words)
    assert [frame["time_s"] for frame in said["frames"]] == [0.0, 0.02]
    # The stated error is larger than the noise by default, so that regions are larger.
    _, quiet, _ = track(capsys, inputs, *with_model(inputs), "--rate", "50", *words, "--std", "0.1", out="quiet")
    wide, narrow = (np.prod(one["frames"][0]["targets"]["lesion"]["region90_radii_mm"]) for one in (said, quiet))
    assert wide > 1.2 * narrow
    # What the reference states counts, also where it is the noise by default.
    rows = (inputs / "reference.csv").read_text().splitlines()
    (inputs / "reference.csv").write_text("\n".join([f"{rows[0]},std_mm", *(f"{row},0.1" for row in rows[1:])]))
    _, stated, _ = track(capsys, inputs, *with_model(inputs), "--rate", "50", *words, out="stated")
    assert stated["frames"][0]["targets"] == quiet["frames"][0]["targets"]
    for words, message in ((["--offset", "P1 5"], "must be a tool and three numbers"), ([], "say how many a second")):
        code, said, _ = track(capsys, inputs, *words)
        assert code == 2
        assert message in said["message"]


def test_if_no_frame_can_be_registered_nothing_is_written(inputs, capsys, monkeypatch):
    (inputs / "recording.csv").write_text(HEADER + "".join(f"0.0,{name},,,\n" for name in NAMES))
    code, said, _ = track(capsys, inputs, *with_model(inputs))
    assert (code, said["error"]) == (2, "MarkerError")

    def lost(*_, **__):
        message = "two or more members must survive, one did"
        raise EnsembleError(message, where="ensemble")

    (inputs / "recording.csv").write_text(HEADER + "".join(rows_of(0.0, measured(0.0))))
    monkeypatch.setattr(tr.Registrar, "register", lost)
    code, said, _ = track(capsys, inputs, *with_model(inputs))
    assert (code, said["error"]) == (3, "EnsembleError")
    assert not (inputs / "out").exists()


def test_a_fault_while_writing_leaves_nothing(inputs, capsys, monkeypatch):
    def full(*_):
        message = "no room"
        raise OutputError(message, where="disk")

    monkeypatch.setattr(tables, "write_tracked_targets", full)
    code, said, _ = track(capsys, inputs, *with_model(inputs))
    assert (code, said["error"]) == (2, "OutputError")
    assert not (inputs / "out").exists()


def test_without_a_model_contacts_are_searched(tmp_path, capsys):
    mesh = block()
    write_vtu(tmp_path / "body.vtu", mesh)
    (tmp_path / "reference.csv").write_text("marker,x_mm,y_mm,z_mm\nP1,30,10,40\nP2,0,10,40\n")
    rows = [f"{0.1 * k},P1,{30 + k},10,40\n{0.1 * k},P2,{k},10,40\n" for k in range(2)]
    (tmp_path / "recording.csv").write_text(HEADER + "".join(rows))
    code, said, _ = track(capsys, tmp_path)
    assert code in (0, 4)
    assert len(said["frames"]) == 2
    assert said["frames"][-1]["markers_rms_mm"] < 0.5
    assert said["frames"][-1]["targets"] == {}


def test_the_reference_may_be_points_of_slicer_or_the_table_of_register(inputs, capsys):
    _, table, _ = track(capsys, inputs, *with_model(inputs), "--frame", "LPS")
    places = {name: tuple(place) for name, place in zip(NAMES, PLACES.tolist(), strict=True)}
    write_mrk(inputs / "reference.mrk.json", places, "LPS")
    rows = [f"{name},{x},{y},{z},,,,0.1\n" for name, (x, y, z) in places.items()]
    (inputs / "moved.csv").write_text("marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm,std_mm\n" + "".join(rows))
    for name in ("reference.mrk.json", "moved.csv"):
        words = ["--reference", inputs / name, "--frame", "LPS"]
        _, said, _ = track(capsys, inputs, *with_model(inputs), *words, out=f"{name}-out")
        assert [frame["targets"] for frame in said["frames"]] == [frame["targets"] for frame in table["frames"]]


def test_a_frame_that_targets_alone_state_is_asked_for(inputs, capsys):
    write_mrk(inputs / "t.mrk.json", {"t": tuple(PLACES[0])}, "LPS")
    code, said, _ = track(capsys, inputs, *with_model(inputs), "--targets", inputs / "t.mrk.json")
    assert (code, said["where"]) == (2, "--frame")


def test_a_recording_in_the_other_frame_is_turned(inputs, capsys):
    _, plain, _ = track(capsys, inputs, *with_model(inputs), "--frame", "LPS")
    for name in ("reference.csv", "recording.csv", "targets.csv"):
        with (inputs / name).open(newline="") as file:
            rows = list(csv.DictReader(file))
        for row in rows:
            row.update({axis: repr(-float(row[axis])) for axis in ("x_mm", "y_mm") if row[axis]})
        with (inputs / name).open("w", newline="") as file:
            writer = csv.DictWriter(file, list(rows[0]))
            writer.writeheader()
            writer.writerows(rows)
    _, turned, _ = track(capsys, inputs, *with_model(inputs), "--frame", "LPS", "--tables-frame", "RAS")
    assert [frame["targets"] for frame in turned["frames"]] == [frame["targets"] for frame in plain["frames"]]


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([], "at least one row below its header"),
        (["0,P1,1,2,3\n", "0,Q,1,2,3\n"], "'Q' does not, at line 3"),
        (["1,P1,1,2,3\n", "0.5,P1,1,2,3\n"], "time must not go back; 0.5 s at"),
        (["0,P1,1,2,3\n", "0,P2,1,2,3\n", "0,P1,1,2,3\n"], "'P1' at"),
        (["0,P1,1,2,three\n"], "must hold a finite number or empty"),
        ([",P1,1,2,3\n"], "column 'time_s' must hold a finite number"),
        (["0,P1,1,2\n"], "every row must have 5 cells"),
    ],
    ids=["empty", "unknown marker", "back in time", "twice", "no number", "no time", "short row"],
)
def test_a_spoilt_recording_is_refused_by_its_line(inputs, capsys, rows, message):
    (inputs / "recording.csv").write_text(HEADER + "".join(rows))
    code, said, err = track(capsys, inputs)
    assert (code, said["error"]) == (2, "FormatError")
    assert message in said["message"]
    assert "recording.csv" in said["where"]
    assert "Traceback" not in err
    assert not (inputs / "out").exists()


def test_simulations_must_cover_the_recording_and_ascend(inputs, capsys):
    for times, message in (
        ([0.0, 0.03, 0.06], "must cover the recording, from 0 to 0.1 s; they go from 0 to 0.06 s"),
        ([0.0, 0.2, 0.1], "2 or more ascending times"),
    ):
        write_simulations(inputs / "short.npz", times, [leaning(t) for t in times])
        code, said, _ = track(capsys, inputs, "--simulations", inputs / "short.npz")
        assert (code, said["error"]) == (2, "FormatError")
        assert message in said["message"]


def test_bad_words_exit_with_two(inputs, capsys):
    files = [inputs / "body.vtu", inputs / "recording.csv"]
    code, said, _ = run_json(capsys, "track", *files, "--out", inputs / "out")
    assert (code, said["error"]) == (2, "UsageError")
    assert "--reference" in said["message"]
    gravity = ["--simulations", inputs / "simulations.npz", "--gravity", "0 0 -9810"]
    for words, message in (
        (["--reference", inputs / "none.csv"], "no such file"),
        (gravity, "--gravity must be left out with --simulations"),
        (["--tables-frame", "LPS"], "--tables-frame must come with --frame"),
        (["--time", "3"], "--time"),
    ):
        code, said, _ = track(capsys, inputs, *words)
        assert code == 2, words
        assert message in said["message"]
    (inputs / "out").mkdir()
    (inputs / "recording.csv").rename(inputs / "out" / "targets.csv")
    words = [inputs / "body.vtu", inputs / "out" / "targets.csv", "--reference", inputs / "reference.csv"]
    code, said, _ = run_json(capsys, "track", *words, "--out", inputs / "out")
    assert code == 2
    assert "must not replace an input" in said["message"]


def test_without_json_it_prints_a_summary(inputs, capsys):
    files = [inputs / "body.vtu", inputs / "recording.csv", "--reference", inputs / "reference.csv"]
    code, out, _ = run(capsys, "track", *files, *with_model(inputs), "--out", inputs / "out", "--quiet")
    lines = out.splitlines()
    assert lines[0].startswith("4 frames registered, 0 dropped, 0 failed, ")
    assert lines[3].startswith("target lesion at 0.1 s: at (")
    assert lines[-1].startswith("Nothing speaks against any frame." if code == 0 else "Not to be trusted: ")


def test_a_report_is_written_on_request_and_says_what_was_lost(inputs, capsys):
    model = ("--model", SMALL_MODEL, "--targets", inputs / "targets.csv")
    code, said, _ = track(capsys, inputs, *model, "--report")
    assert code in (0, 4)
    lost = [(event["marker"], event["reason"], event["frames"]) for event in said["events"] if event["marker"]]
    assert lost == [(NAMES[0], "not seen", 1), (NAMES[1], "not seen", 1)]
    page = (inputs / "out" / "report.html").read_text(encoding="utf-8")
    assert "lesion" in page
    assert f"<td>{NAMES[0]}</td><td>not seen</td><td>1</td>" in page
    track(capsys, inputs, *model, out="plain")
    assert not (inputs / "plain" / "report.html").exists()


def test_a_recording_in_another_frame_or_unit_is_refused_at_once(inputs, capsys):
    with (inputs / "recording.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        row.update({axis: repr(1000.0 + float(row[axis])) for axis in ("x_mm", "y_mm", "z_mm") if row[axis]})
    with (inputs / "recording.csv").open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    code, said, _ = track(capsys, inputs)
    assert (code, said["where"]) == (2, "--align")
    assert "a rigid motion brings them to" in said["message"]
    assert not (inputs / "out").exists()
    # A motion of less than the body's size is one.
    assert another_frame(PLACES[None] + np.array([30.0, 0.0, 0.0]), PLACES, BODY.extent) == ""
    assert another_frame(np.full((2, *PLACES.shape), np.nan), PLACES, BODY.extent) == ""
