"""A released beam, tracked through the example script, as a user runs it."""

import json
import os
import subprocess
import sys

import numpy as np
import pytest

from support.scripts import REPOSITORY

SCRIPT = REPOSITORY / "examples" / "track_beam.py"


def told(shared_data, folder, *words):
    data = shared_data / "data" / "beam"
    if not (data / "own_weight_a.csv").is_file():
        pytest.skip(f"the recordings of the beam are absent: {data}")
    pytest.importorskip("pytetwild", reason="the extra `mesh` is not installed")
    command = [sys.executable, str(SCRIPT), "--data", str(data), "--trial", "own_weight_a", *words]
    environment = {**os.environ, "TISSUEREG_CACHE": str(folder / "cache")}
    summary = folder / "told.json"
    subprocess.run([*command, "--json", str(summary)], check=True, env=environment, cwd=folder, capture_output=True)
    return json.loads(summary.read_text(encoding="utf-8"))["trials"][0]


def error(frames, method):
    return np.mean([frame["error_mm"][method] for frame in frames])


def test_a_released_beam_is_followed_through_its_swing(shared_data, tmp_path):
    # Its first half swing: down by 12 mm in a fifth of a second.
    trial = told(shared_data, tmp_path, "--from-s", "0", "--to-s", "0.21", "--every", "3", "--no-replay")
    frames = trial["frames"]
    assert max(frame["moved_mm"] for frame in frames) > 8.0
    assert error(frames, "tracked") < 0.5 * error(frames, "copied")
    # A tenth of the motion in the worst frame: a tracker that lags would be off by millimetres.
    assert max(frame["error_mm"]["tracked"] for frame in frames) < 1.0


def test_at_rest_tracking_is_not_worse_than_frame_by_frame_and_a_replay_counts_all_frames(shared_data, tmp_path):
    trial = told(shared_data, tmp_path, "--from-s", "3.9", "--every", "6")
    # The samples and the mesh, which is not the same in every run, change either by 0.005 mm (standard deviation).
    assert trial["rest_mm"]["tracked"] <= trial["rest_mm"]["alone"] + 0.02
    assert trial["rest_mm"]["tracked"] < 0.5 * trial["rest_mm"]["copied"]
    # Every frame of the recording at 100 Hz, from 3.9 s on, whatever --every says.
    replay = trial["replay"]
    assert trial["hz"] == pytest.approx(100.0)
    assert replay["registered"] + replay["dropped"] > 5 * len(trial["frames"])
    assert replay["error_mm"] < 0.5 * trial["rest_mm"]["copied"]
