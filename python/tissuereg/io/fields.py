"""Displacement fields: in numpy archives, and as point data of the meshes of other solvers.

Arrays of an archive are checked when they are read: pickled objects are refused, and an error names file and array.
"""

import contextlib
import io
import os
import warnings
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import text
from tissuereg._base.arrays import FloatArray, IntArray, float_array, index_array
from tissuereg.body.mesh import Mesh
from tissuereg.errors import FormatError, ShapeError, TissueRegError
from tissuereg.io.atomic import atomic_file
from tissuereg.io.bounds import FILES, existing_file, mesh_file, too_large
from tissuereg.io.extents import UNITS_MM
from tissuereg.io.foreign import GRID_READERS, read_grid
from tissuereg.io.grid import Grid
from tissuereg.io.grid_meshes import mesh_of_grid
from tissuereg.io.notes import unit_in

#: What numpy and zipfile raise on spoilt archives.
_SPOILT = (
    ValueError, TypeError, EOFError, OSError, KeyError, zipfile.BadZipFile, zlib.error, MemoryError, SyntaxError,
    RuntimeError,
)  # fmt: skip


class Archive:
    """An open .npz file whose arrays are checked as they are read.

    `path`: name of the file, for messages; `arrays`: mapping of names to arrays, such as numpy's archive, which reads
    an array on access.
    """

    def __init__(self, path: Path | str, arrays: Mapping[str, Any]) -> None:
        self.path = path
        self._arrays = arrays

    def __contains__(self, name: str) -> bool:
        return name in self._arrays

    @property
    def arrays(self) -> Mapping[str, Any]:
        """The arrays by their names, each read on access and unchecked."""
        return self._arrays

    @property
    def names(self) -> list[str]:
        """Names of the arrays in the file, in file order."""
        return list(self._arrays)

    def floats(self, name: str, *shape: int | None, finite: bool = True) -> FloatArray:
        """Return an array of real numbers as float64.

        `name`: name in the archive; `*shape`: wanted shape, in which None stands for any length; `finite`: whether NaN
        and infinities are refused. Raises `FormatError` if it is missing, spoilt, not numeric, of another shape, or not
        finite.
        """
        array = self._checked(name, float_array, shape)
        if finite and not np.isfinite(array).all():
            place = tuple(int(i) for i in np.argwhere(~np.isfinite(array))[0])
            message = f"array '{name}' in {self.path} must be finite, got {array[place]} at {list(place)}"
            raise FormatError(message, where=f"{self.path}:{name}")
        return array

    def indices(self, name: str, *shape: int | None) -> IntArray:
        """Return an array of whole numbers as int64.

        `name`: name in the archive; `*shape`: wanted shape, in which None stands for any length. Raises `FormatError`
        if it is missing, spoilt, not of whole numbers, or of another shape.
        """
        return self._checked(name, index_array, shape)

    def raw(self, name: str) -> npt.NDArray[Any]:
        """Return an array with the shape and dtype that it has in the archive.

        `name`: name in the archive. Raises `FormatError` if it is missing, holds pickled objects or is spoilt.
        """
        where = f"{self.path}:{name}"
        if name not in self._arrays:
            message = f"{self.path} must hold an array '{name}'; it holds: {', '.join(self.names) or 'nothing'}"
            raise FormatError(message, where=where)
        try:
            array = np.asarray(self._arrays[name])
        except FormatError:
            raise  # of a file beside the archive, which it names
        except _SPOILT as error:
            pickled = "allow_pickle" in str(error)
            reason = "pickled objects, which are never loaded" if pickled else str(error) or type(error).__name__
            message = f"array '{name}' in {self.path} must hold plain numbers, got {reason}"
            raise FormatError(message, where=where) from error
        return array

    def _checked(self, name: str, check: Any, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
        array = self.raw(name)
        if array.dtype.kind not in "biuf":
            message = f"array '{name}' in {self.path} must hold real numbers, got dtype {array.dtype}"
            raise FormatError(message, where=f"{self.path}:{name}")
        try:
            checked: npt.NDArray[Any] = check(name, array, shape)
        except ShapeError as error:
            message = f"array {error} in {self.path}"
            raise FormatError(message, where=f"{self.path}:{name}") from error
        return checked


@contextlib.contextmanager
def open_npz(path: str | os.PathLike[str]) -> Iterator[Archive]:
    """Open an .npz file and yield its arrays as an `Archive`, which checks each one when it is read.

    Raises `FormatError` if there is no such file, if it is no archive of numpy arrays, or if it is too large, packed or
    unpacked.
    """
    file = existing_file(path, FILES.mesh_mb)
    with file.open("rb") as handle, _unpacked(file, handle) as archive:
        yield archive


@contextlib.contextmanager
def npz_of_bytes(where: str, content: bytes) -> Iterator[Archive]:
    """Open the bytes of an .npz file and yield its arrays as an `Archive`, which checks each one when it is read.

    `where`: name of the file, for messages; `content`: the whole file. Raises `FormatError` if it is no archive of
    numpy arrays, or is too large, unpacked.
    """
    with _unpacked(where, io.BytesIO(content)) as archive:
        yield archive


@contextlib.contextmanager
def _unpacked(file: Path | str, handle: BinaryIO) -> Iterator[Archive]:
    with _loaded(file, handle) as arrays:
        assert arrays.zip is not None  # it is open here
        unpacked = sum(int(one.file_size) for one in arrays.zip.infolist())
        if unpacked > FILES.mesh_mb * 1_000_000:
            raise too_large(file, FILES.mesh_mb, f"unpacked it has {unpacked / 1e6:.0f} MB")
        yield Archive(file, arrays)


def _loaded(file: Path | str, handle: BinaryIO) -> "np.lib.npyio.NpzFile":
    try:
        arrays = np.load(handle, allow_pickle=False)
    except _SPOILT as error:
        pickled = "pickle" in str(error)
        reason = "and pickled objects are never loaded" if pickled else str(error) or type(error).__name__
        message = f"{file} must be a numpy archive (.npz) of plain arrays; it is none, {reason}"
        raise FormatError(message, where=str(file)) from error
    if not isinstance(arrays, np.lib.npyio.NpzFile):
        message = f"{file} must be a numpy archive (.npz) with named arrays, got a single array (.npy)"
        raise FormatError(message, where=str(file))
    return arrays


def read_npy(path: str | os.PathLike[str]) -> npt.NDArray[Any]:
    """Return the array of an .npy file, unchecked, with the shape and dtype that it has there.

    Raises `FormatError` if there is no such file, it is too large, or no array of plain numbers.
    """
    file = existing_file(path, FILES.mesh_mb)
    try:
        with file.open("rb") as handle:
            return np.asarray(np.lib.format.read_array(handle, allow_pickle=False))
    except _SPOILT as error:
        message = f"{file} must be an array of plain numbers (.npy): {error or type(error).__name__}"
        raise FormatError(message, where=str(file)) from error


def write_npz(path: str | os.PathLike[str], arrays: Mapping[str, Any]) -> None:
    """Write arrays as an .npz file, whole or not at all.

    `path`: the file, whose name is kept as given; `arrays`: the arrays, or values that numpy can turn into arrays, by
    name.
    """
    with atomic_file(path) as temporary, temporary.open("wb") as handle:
        content: dict[str, Any] = {name: np.asarray(array) for name, array in arrays.items()}
        np.savez(handle, **content)


#: Schema of the pairs of a data set.
PAIRS_SCHEMA = "tissuereg.pairs/1"


def check_pairs(file: Any, where: str, mark: str) -> None:
    """Raise `FormatError` unless an open HDF5 file holds the pairs of a data set: fields of two models for one load.

    `file`: the open file; `where`: its name, for messages; `mark`: fingerprint (SHA-256) of the data set that it must
    state.
    """
    if (file.attrs.get("schema"), file.attrs.get("recipe_sha256")) != (PAIRS_SCHEMA, mark):
        message = f"{where} must hold the pairs of this data set ({PAIRS_SCHEMA}); it holds something else"
        raise FormatError(message, where=where)


def read_pairs(folder: str | os.PathLike[str], n_nodes: int) -> tuple[FloatArray, FloatArray]:
    """Return displacement fields of the same loading events by the believed model and by another model, the truth.

    `folder`: folder with files ``pairs_*.npz``, each with ``simulation_mm`` and ``truth_mm`` of shape (n, n_nodes, 3);
    they are joined in the order of their names; `n_nodes`: number of nodes of the mesh. Result: two arrays (n_pairs,
    n_nodes, 3), mm: the believed model's and the truth's. Raises `FormatError` if there is no such file, or an array is
    missing or of another shape.
    """
    files = sorted(Path(folder).glob("pairs_*.npz"))
    if not files:
        message = f"{folder} must hold files pairs_*.npz; there are none"
        raise FormatError(message, where=str(folder))
    simulations, truths = [], []
    for path in files:
        with open_npz(path) as file:
            simulations.append(file.floats("simulation_mm", None, n_nodes, 3))
            truths.append(file.floats("truth_mm", len(simulations[-1]), n_nodes, 3))
    return np.concatenate(simulations), np.concatenate(truths)


def read_displacement(path: str | os.PathLike[str], mesh: Mesh, name: str = "displacement") -> FloatArray:
    """Read the displacement (n_nodes, 3), in mm, that another solver found at the nodes of a mesh.

    `path`: a .vtu, .vtk, .msh or .xdmf file with the undeformed mesh and vectors at its points; or an .npz with the
    array ``displacement_mm``. Lengths in mm; `mesh`: the mesh whose nodes the file has, in the same order, or which
    `read_mesh` made of them. Further points after them, such as middles of edges, are left out; `name`: name of the
    vectors in the point data; not used for an .npz. Raises `FormatError` if the file cannot be read, has no such data,
    is of another mesh or of the deformed one, or holds numbers that are not finite.
    """
    text("name", name)
    file = mesh_file(path, "mesh")
    if file.suffix.lower() not in GRID_READERS:
        with open_npz(file) as archive:
            return archive.floats("displacement_mm", mesh.n_nodes, 3)
    grid = read_grid(file, "mesh")
    factor = UNITS_MM[unit_in(grid.notes) or "mm"]
    if len(grid.points) < mesh.n_nodes:
        message = f"{file} must have the {mesh.n_nodes} nodes of the mesh, it has {len(grid.points)} points"
        raise FormatError(message, where=str(file))
    away = np.linalg.norm(factor * grid.points[: mesh.n_nodes] - mesh.nodes, axis=1)
    rows: IntArray = np.arange(mesh.n_nodes)
    if not away.max() <= FILES.same_place * mesh.extent:
        rows, away = _as_joined(file, grid, mesh, away)
    if not away.max() <= FILES.same_place * mesh.extent:
        node = int(np.argmax(away))
        message = (
            f"the points of {file} must be the nodes of the undeformed mesh, in mm and in its order; "
            f"point {node} is {away[node]:.3g} mm away from its node"
        )
        raise FormatError(message, where=str(file))
    return factor * _vectors(str(file), name, grid.point_data, rows)


def _as_joined(file: Path, grid: Grid, mesh: Mesh, away: FloatArray) -> tuple[IntArray, FloatArray]:
    """Return the points that `read_mesh` would keep of a file, if they are those of the mesh, and how far they are."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the file, which was told when the mesh was read
        try:
            own, rows = mesh_of_grid(file, grid)
        except TissueRegError:
            return np.arange(mesh.n_nodes), away
    if own.n_nodes != mesh.n_nodes:
        return np.arange(mesh.n_nodes), away
    return rows, np.linalg.norm(own.nodes - mesh.nodes, axis=1)


def _vectors(file: str, name: str, data: Any, rows: IntArray) -> FloatArray:
    if name not in data:
        message = f"{file} must have the point data '{name}'; it has {', '.join(sorted(data)) or 'none'}"
        raise FormatError(message, where=file)
    found = np.asarray(data[name])
    if found.ndim != 2 or found.shape[1] != 3 or found.dtype.kind not in "fiu":
        message = f"'{name}' in {file} must be three numbers a point, got an array of shape {found.shape}"
        raise FormatError(message, where=file)
    field = np.ascontiguousarray(found[rows], np.float64)
    if not np.isfinite(field).all():
        message = f"'{name}' in {file} must be finite at every node"
        raise FormatError(message, where=file)
    return field
