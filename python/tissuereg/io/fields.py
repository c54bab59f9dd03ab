"""Displacement fields of other solvers: point data of .vtu, .vtk and .msh files, or an .npz."""

import os
from typing import Any

import numpy as np

from tissuereg._base.arguments import text
from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, mesh_file
from tissuereg.io.foreign import MESHIO_MODULES, meshio_content
from tissuereg.io.npz import open_npz


def read_displacement(path: str | os.PathLike[str], mesh: Mesh, name: str = "displacement") -> FloatArray:
    """Read the displacement that another solver found at the nodes of a mesh.

    `path`: a .vtu, .vtk or .msh file with the undeformed mesh and vectors at its points; or an .npz with the array
    ``displacement_mm``. Lengths in mm; `mesh`: whose nodes the file has, in the same order. Further points after them,
    such as middles of edges, are left out; `name`: of the point data; not of an .npz. Result: (n_nodes, 3), mm. Raises
    `FormatError` if the file cannot be read, has no such data, is of another mesh or of the deformed one, or holds
    numbers that are not finite.
    """
    text("name", name)
    file = mesh_file(path, "mesh")
    if file.suffix.lower() not in MESHIO_MODULES:
        with open_npz(file) as archive:
            return archive.floats("displacement_mm", mesh.n_nodes, 3)
    content = meshio_content(file, "a mesh with displacements")
    points = np.asarray(content.points, np.float64)
    if len(points) < mesh.n_nodes:
        message = f"{file} must have the {mesh.n_nodes} nodes of the mesh, it has {len(points)} points"
        raise FormatError(message, where=str(file))
    away = np.linalg.norm(points[: mesh.n_nodes] - mesh.nodes, axis=1)
    if not away.max() <= FILES.same_place * mesh.extent:
        node = int(np.argmax(away))
        message = (
            f"the points of {file} must be the nodes of the undeformed mesh, in mm and in its order; "
            f"point {node} is {away[node]:.3g} mm away from its node"
        )
        raise FormatError(message, where=str(file))
    return _vectors(str(file), name, content.point_data, mesh.n_nodes)


def _vectors(file: str, name: str, data: Any, n_nodes: int) -> FloatArray:
    if name not in data:
        message = f"{file} must have the point data '{name}'; it has {', '.join(sorted(data)) or 'none'}"
        raise FormatError(message, where=file)
    found = np.asarray(data[name])
    if found.ndim != 2 or found.shape[1] != 3 or found.dtype.kind not in "fiu":
        message = f"'{name}' in {file} must be three numbers a point, got an array of shape {found.shape}"
        raise FormatError(message, where=file)
    field = np.ascontiguousarray(found[:n_nodes], np.float64)
    if not np.isfinite(field).all():
        message = f"'{name}' in {file} must be finite at every node"
        raise FormatError(message, where=file)
    return field
