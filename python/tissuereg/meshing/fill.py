"""Tetrahedra inside a surface, by fTetWild through pytetwild."""

import importlib.util
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.machine import n_cores
from tissuereg.body.triangles import Triangles
from tissuereg.errors import MeshingError, MissingPackageError
from tissuereg.io.drafts import draft
from tissuereg.meshing.worker import NO_MEMORY, NO_MESHER, SCRIPT

_MESHER = "pytetwild"

#: Runs a file as a script, wherever the process starts.
_RUN = "import runpy, sys; sys.argv = sys.argv[1:]; runpy.run_path(sys.argv[0], run_name='__main__')"


def check_mesher() -> None:
    """Raise MissingPackageError if the mesher pytetwild is not installed."""
    if importlib.util.find_spec(_MESHER) is None:
        raise _missing(_MESHER)


def filled(
    surface: Triangles, size_mm: float, deviation_mm: float, threads: int = 0, inner: Triangles | None = None
) -> tuple[FloatArray, IntArray, str]:
    """Fill a surface with tets; return nodes (n, 3), mm, tets (m, 4) as node indices, and the mesher and its version.

    All tets have positive volume. The surface's normals point outwards, edges become about `size_mm` long, faces lie
    within `deviation_mm` of the surface; 0 threads stand for all cores. The triangles `inner`, which need not be
    closed, become faces too. Raises MissingPackageError if pytetwild, or one of its dependencies, is not installed,
    MeshingError if the mesher fails or makes an element without volume, MemoryError if memory is spent. The mesher
    draws random numbers from the system: two runs give two similar meshes.
    """
    diagonal = float(np.linalg.norm(np.ptp(surface.vertices, axis=0)))
    vertices, triangles = surface.vertices, surface.triangles
    if inner is not None:
        triangles = np.concatenate([triangles, len(vertices) + inner.triangles])
        vertices = np.concatenate([vertices, inner.vertices])
    with draft(Path(tempfile.gettempdir())) as scratch:
        given, made = scratch / "given.npz", scratch / "made.npz"
        np.savez(
            given,
            vertices=vertices,
            triangles=triangles,
            edge_share=size_mm / diagonal,
            deviation_share=deviation_mm / diagonal,
            threads=threads or n_cores(),
        )
        words = [sys.executable, "-c", _RUN, SCRIPT, str(given), str(made)]
        done = subprocess.run(words, cwd=scratch, capture_output=True, text=True, errors="replace", check=False)
        if done.returncode:
            raise _failure(done.returncode, done.stderr)
        with np.load(made) as content:
            nodes, tets = np.asarray(content["nodes"], np.float64), np.asarray(content["tets"], np.int64)
            mesher = str(content["mesher"])
    return *_in_order(nodes, tets), mesher


def _in_order(nodes: FloatArray, tets: IntArray) -> tuple[FloatArray, IntArray]:
    """Return the nodes (n, 3), mm, that tets use, and the tets (m, 4) as node indices, ordered for positive volume."""
    if not len(tets):
        message = "the mesher must find an inside; it made no tetrahedron: repair the defects listed in `repaired`"
        raise MeshingError(message, where="surface")
    a, b, c, d = (nodes[tets[:, i]] for i in range(4))
    volumes = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) / 6.0
    if volumes.sum() < 0:
        tets, volumes = tets[:, [0, 2, 1, 3]], -volumes
    if volumes.min() <= 0:
        n = int(np.count_nonzero(volumes <= 0))
        message = (
            f"every tetrahedron must have a volume; {n} of {len(tets)} that the mesher made have none: try another size"
        )
        raise MeshingError(message, where="tets")
    used, corners = np.unique(tets, return_inverse=True)
    return nodes[used], np.asarray(corners.reshape(-1, 4), np.int64)


def _failure(code: int, output: str) -> Exception:
    last = " ".join(output.split()[-40:])
    if code == NO_MESHER:
        return _missing(last)
    if code == NO_MEMORY:
        return MemoryError()
    how = f"was ended by signal {-code}" if code < 0 else f"ended with code {code}"
    message = f"the mesher must fill the surface; it {how}{': ' + last if last else ''}. Try another size"
    return MeshingError(message, where="surface")


def _missing(what: str) -> MissingPackageError:
    message = (
        f"tetrahedra are made by pytetwild, which must be installed: pip install 'tissuereg[mesh]' (missing: {what})"
    )
    return MissingPackageError(message, where=_MESHER)
