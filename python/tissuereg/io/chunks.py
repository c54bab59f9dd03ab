"""A chunk of a data set as an HDF5 file: members with displacement and parameters, and members that failed.

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
    """Members made together.

    `number`: of the chunk, from 0 on; `index` int64 (k,): number of each member in the recipe, ascending;
    `displacement` float32 (k, n_nodes, 3): in mm; `parameters` (k, ...): columns; NaN where a member has none;
    `failed`: members without equilibrium, each with its reason.
    """

    number: int
    index: IntArray
    displacement: Fields
    parameters: dict[str, npt.NDArray[Any]]
    failed: list[tuple[int, str]]


def chunk_name(number: int) -> str:
    """Return the name of a chunk's file."""
    return f"chunk_{number:04d}.h5"


def pack_chunk(chunk: Chunk, mark: str, version: str) -> bytes:
    """Return the file of a chunk.

    `chunk`: what it holds; `mark`: fingerprint of recipe, seed, mesh and version; `version`: of tissuereg. Result: the
    same bytes for the same content.
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
    """Read a chunk as a whole; its checksums are compared.

    `n_nodes`: nodes of the mesh; `mark`: fingerprint that it must have; `content`: the file's content, where it has
    been read already. Result: every number of the displacements finite. Raises `FormatError` if the file is missing,
    spoilt, or of another data set.
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
    """Refuse an open file that is not the chunk of that number of the data set with that fingerprint."""
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
    """Return the columns of parameters of an open chunk."""
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
