"""Files that are far too large, or noise: a clear error by the size or the head, memory bounded."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr
from support.files import GOOD_MARKERS, MARKERS_HEADER
from support.meshes import block
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES
from tissuereg.io.meshes import write_vtu
from tissuereg.io.problems import read_problem
from tissuereg.io.surfaces import read_triangles
from tissuereg.simulation.recipe import read_recipe

MESHES = ("vtu", "vtk", "msh", "npz")
SURFACES = ("stl", "ply", "obj", "off", "vtu", "vtk", "msh")

#: How files of each kind begin; noise may follow.
HEADS = {
    "vtu": b'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" version="0.1"><UnstructuredGrid>',
    "vtk": b"# vtk DataFile Version 3.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 10000000 double\n",
    "msh": b"$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n10000000\n",
    "npz": b"PK\x03\x04",
    "stl": b"solid body\n",
    "ply": b"ply\nformat ascii 1.0\nelement vertex 9\nproperty float x\nelement face 9\nend_header\n",
    "obj": b"v 0 0 0\n",
    "off": b"OFF\n10000000 10000000 0\n",
    "csv": MARKERS_HEADER.encode(),
}

#: What a reading process holds before it reads, MB: Python, numpy, scipy, the readers' packages.
BASE_MB = 500

READ = """\
import sys, warnings
import tissuereg as tr
from tissuereg.errors import FormatError, MeshError
from tissuereg.io.surfaces import read_triangles
warnings.simplefilter("ignore")
what, path = sys.argv[1:]
try:
    {"mesh": tr.read_mesh, "surface": read_triangles, "markers": tr.read_markers}[what](path)
except (FormatError, MeshError) as error:
    print(error)
    sys.exit(2)
"""


def large(path: Path, megabytes: int, begin: bytes = b"") -> Path:
    """A file of that size; what follows the beginning is never written, which reads as zeros."""
    with path.open("wb") as stream:
        stream.write(begin)
        stream.truncate(megabytes * 1_000_000)
    return path


#: Linux counts what a process held before it became a program as that program's: a small process starts the program.
STARTER = """
import os, sys
child = os.posix_spawn(sys.executable, [sys.executable, *sys.argv[1:]], os.environ)
_, status, used = os.wait4(child, 0)
print(f"\\n{os.waitstatus_to_exitcode(status)} {used.ru_maxrss}")
"""


def measured(*words):
    """Run this Python; return exit code, output, and the largest memory of the process in MB."""
    words = [sys.executable, "-S", "-c", STARTER, *map(str, words)]
    done = subprocess.run(words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, check=True)
    said, _, last = done.stdout.rstrip("\n").rpartition("\n")
    code, memory = last.split()
    return int(code), said, int(memory) / 1000  # kB


def test_the_memory_of_a_process_is_its_own_and_not_that_of_its_parent():
    held = bytearray(600_000_000)
    held[::4096] = b"x" * len(held[::4096])
    code, said, memory = measured("-c", "print('here')")
    assert (code, said.strip()) == (0, "here")
    assert memory < 100 < len(held) / 1e6
    assert measured("-c", "held = b'x' * 200_000_000")[2] > 200


@pytest.mark.parametrize("kind", MESHES)
def test_a_mesh_of_500_mb_is_refused_by_its_size(kind, tmp_path):
    with pytest.raises(FormatError, match=rf"mesh\.{kind} must have at most {FILES.mesh_mb} MB, it has 500 MB"):
        tr.read_mesh(large(tmp_path / f"mesh.{kind}", 500, HEADS[kind]))


@pytest.mark.parametrize("kind", SURFACES)
def test_a_surface_of_500_mb_is_refused_by_its_size(kind, tmp_path):
    with pytest.raises(FormatError, match=f"must have at most {FILES.mesh_mb} MB"):
        read_triangles(large(tmp_path / f"body.{kind}", 500, HEADS[kind]))


@pytest.mark.parametrize(
    ("read", "name", "most"),
    [
        (tr.read_markers, "markers.csv", FILES.table_mb),
        (tr.read_surface, "surface.csv", FILES.table_mb),
        (tr.read_targets, "targets.csv", FILES.table_mb),
        (tr.read_targets, "targets.fcsv", FILES.text_mb),
        (tr.read_targets, "targets.mrk.json", FILES.text_mb),
        (read_recipe, "recipe.toml", FILES.text_mb),
        (read_problem, "problem.npz", FILES.mesh_mb),
    ],
)
def test_two_gigabytes_of_anything_are_refused_by_their_size(read, name, most, tmp_path):
    with pytest.raises(FormatError, match=rf"must have at most {most} MB, it has 2000 MB; docs/files\.md"):
        read(large(tmp_path / name, 2000))


def test_a_small_archive_that_unpacks_to_gigabytes_is_refused(tmp_path):
    np.savez_compressed(tmp_path / "bomb.npz", nodes_mm=np.zeros((11_000_000, 3)))
    assert (tmp_path / "bomb.npz").stat().st_size < 1_000_000
    with pytest.raises(FormatError, match="unpacked it has 264 MB"):
        tr.read_mesh(tmp_path / "bomb.npz")


def test_more_markers_than_anybody_tracks_are_refused_at_the_first_too_many(tmp_path):
    row = "0,0,0,0,0,0\n"
    rows = "".join(f"P{number},{row}" for number in range(FILES.table_points))
    (tmp_path / "markers.csv").write_text(MARKERS_HEADER + rows)
    assert len(tr.read_markers(tmp_path / "markers.csv")) == FILES.table_points
    (tmp_path / "markers.csv").write_text(MARKERS_HEADER + rows + f"more,{row}" + "no row at all\n")
    with pytest.raises(
        FormatError, match=rf"at most {FILES.table_points} rows; more follow at line {FILES.table_points + 2}"
    ):
        tr.read_markers(tmp_path / "markers.csv")


def test_a_device_without_end_is_refused():
    with pytest.raises(FormatError, match="regular file"):
        tr.read_markers("/dev/zero")


@pytest.mark.parametrize("kind", sorted({*MESHES, *SURFACES} - {"npz"}))
def test_a_file_of_noise_is_refused_by_its_head(kind, tmp_path):
    noise = np.random.default_rng(3).bytes(100_000)
    (tmp_path / f"body.{kind}").write_bytes(noise)
    with pytest.raises(FormatError, match=rf"a surface of the kind that its name says \(\.{kind}\) and be"):
        read_triangles(tmp_path / f"body.{kind}")


@pytest.mark.slow
def test_a_registration_with_two_gigabytes_of_markers_ends_at_once(tmp_path):
    write_vtu(tmp_path / "mesh.vtu", block())
    large(tmp_path / "markers.csv", 2000, GOOD_MARKERS.encode())
    words = ("register", tmp_path / "mesh.vtu", tmp_path / "markers.csv", "--out", tmp_path / "out")
    code, said, memory = measured("-m", "tissuereg", *words)
    assert (code, "at most 64 MB" in " ".join(said.split())) == (2, True)
    assert memory < BASE_MB
    assert not (tmp_path / "out").exists()


def binary_stl_head(size):
    return b"\0" * 80 + np.uint32((size - 84) // 50).tobytes()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "kind", "noise"),
    [
        ("mesh", "vtu", "letters"),
        ("mesh", "msh", "letters"),
        ("surface", "stl", "letters"),
        ("surface", "stl", "bytes"),
        ("surface", "ply", "bytes"),
        ("surface", "obj", "letters"),
        ("surface", "off", "letters"),
        ("markers", "csv", "letters"),
    ],
)
def test_as_much_noise_with_a_good_head_as_is_read_is_refused_in_bounded_memory(what, kind, noise, tmp_path):
    most = FILES.table_mb if kind == "csv" else FILES.mesh_mb
    rng = np.random.default_rng(3)
    block_of_noise = (
        rng.bytes(1_000_000) if noise == "bytes" else bytes(rng.integers(32, 127, 1_000_000, dtype=np.uint8))
    )
    size = most * 1_000_000 - 16  # 84 bytes and whole triangles of 50 each
    file = tmp_path / f"body.{kind}"
    with file.open("wb") as stream:
        stream.write(binary_stl_head(size) if (kind, noise) == ("stl", "bytes") else HEADS[kind])
        while stream.tell() < size:
            stream.write(block_of_noise[: size - stream.tell()])
    code, said, memory = measured("-c", READ, what, file)
    assert code == 2, said
    assert str(file) in said
    assert memory < BASE_MB + 10 * most
