"""A tracker driven by another solver's result files, as a user runs the example."""

import json
import subprocess
import sys

import numpy as np
import pytest

import tissuereg as tr
from support.scripts import REPOSITORY
from tissuereg.errors import FormatError
from tissuereg.io.fields import read_displacement
from tissuereg.io.meshes import write_vtu


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="module")
def told(folder):
    words = [sys.executable, str(REPOSITORY / "examples" / "track_results.py"), "--make", str(folder)]
    words += ["--data", str(folder), "--json", str(folder / "told.json")]
    subprocess.run(words, check=True, capture_output=True)
    return json.loads((folder / "told.json").read_text(encoding="utf-8"))


def test_the_lesion_is_tracked_closer_than_the_files_have_it(told):
    simulated, tracked = (
        np.mean([frame[f"{name}_off_mm"] for frame in told["frames"]]) for name in ("simulated", "tracked")
    )
    assert len(told["frames"]) == 12
    assert tracked < 0.5 * simulated


def test_a_file_of_another_mesh_or_other_data_is_refused(folder, told):
    assert told
    mesh = tr.read_mesh(folder / "body.vtu")
    field = read_displacement(folder / "push_0.5.vtu", mesh)
    # Written as 64-bit numbers.
    np.savez(folder / "field.npz", displacement_mm=field)
    assert np.array_equal(read_displacement(folder / "field.npz", mesh), field)
    with pytest.raises(FormatError, match="point data 'velocity'; it has displacement"):
        read_displacement(folder / "push_0.5.vtu", mesh, "velocity")
    write_vtu(folder / "deformed.vtu", mesh, {"displacement": field}, places=mesh.nodes + field)
    with pytest.raises(FormatError, match="undeformed mesh"):
        read_displacement(folder / "deformed.vtu", mesh)
    with pytest.raises(FormatError, match=r"must have the .* nodes of the mesh"):
        read_displacement(folder / "push_0.5.vtu", tr.phantom.truth_mesh("small"))
    write_vtu(
        folder / "holes.vtu", mesh, {"displacement": np.where(np.arange(mesh.n_nodes)[:, None] == 3, np.nan, field)}
    )
    with pytest.raises(FormatError, match="finite"):
        read_displacement(folder / "holes.vtu", mesh)
