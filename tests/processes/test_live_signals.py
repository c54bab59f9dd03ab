"""A live registration that is interrupted or terminated ends well, and keeps what it recorded."""

import os
import re
import signal
import subprocess
import sys

import numpy as np
import pytest

from support.meshes import block
from support.openigtlink import NAMES, SIT, Peer, point_message
from tissuereg.io.meshes import write_vtu
from tissuereg.io.recordings import read_recording


@pytest.mark.skipif(sys.platform == "win32", reason="signals of another kind")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM], ids=["ctrl-c", "terminated"])
def test_a_live_registration_that_is_ended_keeps_its_recording(tmp_path, number):
    write_vtu(tmp_path / "body.vtu", block())
    rows = [f"{name},{x},{y},{z}\n" for name, (x, y, z) in zip(NAMES, SIT.tolist(), strict=True)]
    (tmp_path / "sit.csv").write_text("marker,x_mm,y_mm,z_mm\n" + "".join(rows))
    words = ["live", "body.vtu", "--reference", "sit.csv", "--listen", "0", "--record", "kept.csv", "--surface", "none"]
    command = [sys.executable, "-m", "tissuereg", *words]
    with subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True,
                          env={**os.environ, "TISSUEREG_CACHE": str(tmp_path / "cache")}) as process:  # fmt: skip
        found = next(found for line in process.stderr if (found := re.search(r"listening on (\S+):(\d+)", line)))
        assert found[1] == "127.0.0.1"  # this machine alone
        peer = Peer((found[1], int(found[2])), timeout_s=60.0)
        for k in range(2):
            peer.send(point_message(SIT + k, time_s=9.0 + k))
            peer.read("STRING")
        process.send_signal(number)
        said, errors = process.communicate(timeout=60)
        peer.close()
    assert process.returncode in (0, 4)
    assert "Traceback" not in errors
    assert "Task" not in errors
    assert "2 frames registered of 2" in said
    kept = read_recording(tmp_path / "kept.csv")
    np.testing.assert_allclose(kept.places, [SIT, SIT + 1.0], atol=1e-5)
    assert {file.name for file in tmp_path.iterdir()} - {"cache"} == {"body.vtu", "sit.csv", "kept.csv"}
