"""A chunk of a simulated data set as an HDF5 file: members (simulated deformations) and the members that failed.

`docs/files.md` describes the layout.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import IntArray
from tissuereg.errors import FormatError
from tissuereg.io.hdf5 import array_of, checked, opened, packed
from tissuereg.io.stores import Store

CHUNK_SCHEMA = "tissuereg.chunk/1"

#: Displacements in mm, as stored.
Fields = npt.NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Chunk:
    """Members (simulated deformations of one mesh) of a data set that were made together and lie in one file.

    Attributes
    ----------
    number : int
        Number of the chunk in the data set, from 0 on.
    index : ndarray of int64, shape (k,)
        Number of each member in the recipe, ascending.
    displacement : ndarray of float32, shape (k, n_nodes, 3)
        Displacement of the nodes in each member, mm.
    parameters : dict of str to ndarray, shape (k, ...)
        Parameters of material and load, one row per member, by name, which ends in the unit; NaN where a member has
        none.
    failed : list of (int, str)
        Number in the recipe of each member without equilibrium, and the reason.
    """

    number: int
    index: IntArray
    displacement: Fields
    parameters: dict[str, npt.NDArray[Any]]
    failed: list[tuple[int, str]]


def chunk_name(number: int) -> str:
    """Return the name of the file that holds the chunk of this number, such as ``chunk_0003.h5``."""
    return f"chunk_{number:04d}.h5"


def pack_chunk(chunk: Chunk, mark: str, version: str) -> bytes:
    """Return the bytes of the HDF5 file of a chunk; they are the same for the same content.

    `chunk`: content of the file; `mark`: fingerprint (SHA-256) of the data set's recipe, seed, mesh and version;
    `version`: version of tissuereg.
    """
    reasons = [reason for _, reason in chunk.failed]
    arrays: dict[str, npt.NDArray[Any]] = {
        "index": chunk.index,
        "displacement_mm": chunk.displacement,
        **{f"parameters/{name}": column for name, column in chunk.parameters.items()},
        "failed_index": np.array([index for index, _ in chunk.failed], dtype=np.int64),
        "failed_reason": np.array(reasons, dtype=np.str_),
    }
    attributes = {"schema": CHUNK_SCHEMA, "number": chunk.number, "recipe_sha256": mark, "version": version}
    return packed(arrays, attributes, frozenset({"displacement_mm"}))


def read_chunk(store: Store, number: int, n_nodes: int, mark: str, content: bytes | None = None) -> Chunk:
    """Read a whole chunk of a data set from its HDF5 file, comparing its checksums.

    `store`: place of the data set; `number`: number of the chunk; `n_nodes`: number of nodes of the mesh; `mark`:
    fingerprint (SHA-256) of the data set that the file must state; `content`: the file's bytes, if they have been read
    already. In the result all displacements are finite. Raises `FormatError` if the file is missing, spoilt, or of
    another data set.
    """
    name = chunk_name(number)
    where = store.where(name)
    with opened(store, name, content) as file:
        check_chunk(file, where, number, mark)
        index = array_of(file, where, "index", "iu", (None,)).astype(np.int64)
        displacement = checked(file, where, "displacement_mm", "f", (len(index), n_nodes, 3))[()].astype(np.float32)
        failed_index = array_of(file, where, "failed_index", "iu", (None,))
        reasons = array_of(file, where, "failed_reason", "SO", (len(failed_index),))
        parameters = read_parameters(file, where, len(index))
    if not np.isfinite(displacement).all():
        message = f"array 'displacement_mm' in {where} must be finite"
        raise FormatError(message, where=f"{where}:displacement_mm")
    failed = [
        (int(i), r.decode("utf-8", "replace") if isinstance(r, bytes) else str(r))
        for i, r in zip(failed_index, reasons, strict=True)
    ]
    return Chunk(number, index, displacement, parameters, failed)


def check_chunk(file: Any, where: str, number: int, mark: str) -> None:
    """Raise `FormatError` unless an open HDF5 file is chunk `number` of the data set with the fingerprint `mark`."""
    found = {name: file.attrs.get(name) for name in ("schema", "number", "recipe_sha256")}
    if found["schema"] != CHUNK_SCHEMA or found["number"] != number or found["recipe_sha256"] != mark:
        message = (
            f"{where} must be chunk {number} of this data set ({CHUNK_SCHEMA}), got {found['schema']}, number "
            f"{found['number']} of a data set with another fingerprint or none"
            if found["recipe_sha256"] != mark
            else f"{where} must be chunk {number} ({CHUNK_SCHEMA}), got {found['schema']}, number {found['number']}"
        )
        raise FormatError(message, where=where)


def read_parameters(file: Any, where: str, n_members: int) -> dict[str, npt.NDArray[Any]]:
    """Return the parameters of the members in an open chunk file by name, arrays of shape (n_members, ...).

    `where`: the file's name, for messages. Raises `FormatError` if they are missing, not numbers, or have another
    number of rows.
    """
    group = file.get("parameters")
    if group is None or not hasattr(group, "keys"):
        message = f"{where} must hold a group 'parameters'"
        raise FormatError(message, where=f"{where}:parameters")
    columns = {}
    for name in group:
        data = group.get(name)
        if not hasattr(data, "shape") or not data.shape or data.shape[0] != n_members or data.dtype.kind not in "biuf":
            message = f"column 'parameters/{name}' in {where} must hold numbers, one row a member ({n_members})"
            raise FormatError(message, where=f"{where}:parameters/{name}")
        columns[name] = data[()]
    return columns
