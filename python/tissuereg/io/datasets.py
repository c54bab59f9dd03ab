"""Simulated data sets, opened lazily: only the members (simulated deformations) that are accessed are read.

`docs/files.md` describes the folder of a data set.
"""

import hashlib
import io
import json
import operator
import os
from collections import OrderedDict
from collections.abc import Iterator, Mapping, Sequence
from functools import cached_property
from pathlib import PurePosixPath
from typing import Any, overload

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import found
from tissuereg._base.arrays import IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError, FormatError
from tissuereg.io.bounds import FILES
from tissuereg.io.chunks import Fields, check_chunk, read_parameters
from tissuereg.io.fields import check_pairs, npz_of_bytes
from tissuereg.io.hdf5 import OpenFile, array_of, checked, opened, spoilt_is_said
from tissuereg.io.meshes import mesh_arrays, mesh_from_archive
from tissuereg.io.stores import Store, store_of

CARD_NAME = "dataset.json"
DATASET_SCHEMA = "tissuereg.dataset/2"
_OLD_SCHEMA = "tissuereg.dataset/1"


def open_dataset(path: str | os.PathLike[str]) -> "Dataset":
    """Open a data set that ``tissuereg simulate RECIPE.toml`` has made: many simulated deformations of one mesh.

    Parameters
    ----------
    path : path-like
        Folder of the data set, or its URL if it lies in a file system of the package fsspec.

    Returns
    -------
    Dataset
        The data set, of which nothing but ``dataset.json`` has been read; other files are read when they are accessed.

    Raises
    ------
    FormatError
        If the folder holds no finished data set in the format that this version reads.
    MissingPackageError
        If it is a URL and fsspec is not installed.

    Examples
    --------
    >>> import tissuereg as tr
    >>> data = tr.open_dataset("data")  # doctest: +SKIP
    >>> data.displacement[7].shape, data.parameters[7]["young_kpa"]  # doctest: +SKIP
    ((4223, 3), 31.4)
    """
    return Dataset(store_of(path, error=FormatError))


class Dataset:
    """A finished data set of simulated deformations of one mesh (its members); made by `open_dataset`.

    Members have rows from 0 on; ``len`` gives their number.

    Parameters
    ----------
    store : Store
        Place of the data set: a folder or a URL.

    Attributes
    ----------
    recipe : dict
        Content of the recipe, the TOML file from which the data set was made.
    failed : list of (int, str)
        Simulations of the recipe that found no equilibrium and are no members: their number in the recipe and the
        reason.
    card : dict
        Whole content of ``dataset.json``.
    """

    def __init__(self, store: Store) -> None:
        self._store = store
        self.card = read_card(store)
        self.recipe: dict[str, Any] = self.card["recipe"]
        self.failed: list[tuple[int, str]] = [(index, reason) for index, reason in self.card["failed"]]
        self._chunks = _Chunks(store, self.card)

    def __len__(self) -> int:
        return self._chunks.n_members

    def __repr__(self) -> str:
        return (
            f"Dataset({len(self)} members on {self.card['mesh']['n_nodes']} nodes, {len(self.failed)} failed, "
            f"{self._store.url})"
        )

    @cached_property
    def mesh(self) -> Mesh:
        """The undeformed mesh of which all members are deformations, coordinates in mm."""
        mesh = read_data_mesh(self._store)
        if mesh.digest() != self.card["mesh"]["digest"]:
            where = self._store.where(MESH_NAME)
            message = f"{where} must hold the mesh that the data were made on; it holds another one"
            raise FormatError(message, where=where)
        return mesh

    @property
    def displacement(self) -> "Displacements":
        """Displacements of the members: ``data.displacement[i]`` is the array of member i, (n_nodes, 3) float32 in mm.

        A member is read from its file when it is accessed.
        """
        return Displacements(self._chunks)

    @property
    def parameters(self) -> "Parameters":
        """Material and load of members: ``data.parameters[i]`` is a dict of numbers and arrays; keys state units."""
        return Parameters(self._chunks)

    @property
    def index(self) -> IntArray:
        """Number of each member in the recipe, int64 (n_members,); it differs from the row after a failed member."""
        lost = {index for index, _ in self.failed}
        return np.array([i for i in range(len(self) + len(lost)) if i not in lost], dtype=np.int64)

    @property
    def split(self) -> dict[str, IntArray]:
        """Rows of the members for training, validation and test, by the names ``train``, ``valid`` and ``test``.

        Each is an ascending int64 array; they hold 80, 10 and 10 % of the members, drawn at random by the data set's
        seed.
        """
        return {name: np.array(self.card["split"][name], dtype=np.int64) for name in ("train", "valid", "test")}

    @property
    def pairs(self) -> tuple[Fields, Fields] | None:
        """Displacements by the believed model and by another model, the truth, of the same loading events.

        Two arrays (n_pairs, n_nodes, 3), float32 in mm: the believed model's and the truth's; None if the data set has
        none.
        """
        entry = self.card.get("pairs")
        if not entry:
            return None
        name, where, n_nodes = entry["file"], self._store.where(entry["file"]), self._chunks.n_nodes
        with opened(self._store, name) as file:
            check_pairs(file, where, self.card["recipe_sha256"])
            simulations = array_of(file, where, "simulation_mm", "f", (None, n_nodes, 3))
            truths = array_of(file, where, "truth_mm", "f", (len(simulations), n_nodes, 3))
        return np.asarray(simulations, np.float32), np.asarray(truths, np.float32)

    def verify(self) -> None:
        """Compare the SHA-256 of every file with that in ``dataset.json``; all files are read whole.

        Raises
        ------
        FormatError
            If a file is missing or has changed; the message names the first one.
        """
        entries = [self.card["mesh"], *self.card["chunks"], *([self.card["pairs"]] if self.card["pairs"] else [])]
        for entry in entries:
            content = self._store.read(entry["file"])
            if hashlib.sha256(content).hexdigest() != entry["sha256"]:
                where = self._store.where(entry["file"])
                message = f"{where} must be the file that was written; its SHA-256 has changed"
                raise FormatError(message, where=where)


class Displacements:
    """Displacements of the members of a data set, read from the files member by member.

    Indexed by a member's row, it gives the displacement of the nodes, (n_nodes, 3) float32 in mm; by a slice or a list
    of k rows, (k, n_nodes, 3).
    """

    def __init__(self, chunks: "_Chunks") -> None:
        self._chunks = chunks

    @property
    def shape(self) -> tuple[int, int, int]:
        """Numbers of members, nodes and coordinates: (n_members, n_nodes, 3)."""
        return self._chunks.n_members, self._chunks.n_nodes, 3

    def __len__(self) -> int:
        return self._chunks.n_members

    def __iter__(self) -> Iterator[Fields]:
        return (self[row] for row in range(len(self)))

    def __getitem__(self, rows: Any) -> Fields:
        """Return the displacement of one member, (n_nodes, 3) float32 in mm, or of k members, (k, n_nodes, 3).

        `rows`: row of a member, counted from the end if it is negative; or a slice or list of k rows.
        """
        if isinstance(rows, slice | list) or (isinstance(rows, np.ndarray) and rows.ndim):
            many = range(len(self))[rows] if isinstance(rows, slice) else _rows(rows, len(self))
            taken = np.empty((len(many), *self.shape[1:]), np.float32)
            for place, row in enumerate(many):
                self._chunks.read_into(row, taken[place])
            return taken
        one = np.empty(self.shape[1:], np.float32)
        self._chunks.read_into(_row(rows, len(self)), one)
        return one


class Parameters(Sequence[dict[str, Any]]):
    """Parameters of material and load by member: each is a dict of numbers and arrays, whose names state the units."""

    def __init__(self, chunks: "_Chunks") -> None:
        self._chunks = chunks

    def __len__(self) -> int:
        return self._chunks.n_members

    @overload
    def __getitem__(self, rows: int) -> dict[str, Any]: ...
    @overload
    def __getitem__(self, rows: slice) -> list[dict[str, Any]]: ...
    def __getitem__(self, rows: int | slice) -> dict[str, Any] | list[dict[str, Any]]:
        """Return a member's parameters, a dict of numbers and arrays by name; for a slice of rows, a list of dicts."""
        if isinstance(rows, slice):
            return [self._chunks.parameters(row) for row in range(len(self))[rows]]
        return self._chunks.parameters(_row(rows, len(self)))


class _Chunks:
    """The chunk files of a data set, each with some of its members; opened when needed, the last few are kept open."""

    def __init__(self, store: Store, card: Mapping[str, Any]) -> None:
        self._store = store
        self._mark = card["recipe_sha256"]
        self._names = [entry["file"] for entry in card["chunks"]]
        self._counts = [entry["members"] for entry in card["chunks"]]
        self._ends = np.cumsum(self._counts)
        self.n_members = int(sum(self._counts))
        self.n_nodes: int = card["mesh"]["n_nodes"]
        self._open: OrderedDict[tuple[int, int], OpenFile] = OrderedDict()
        self._columns: dict[int, dict[str, npt.NDArray[Any]]] = {}

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_open": OrderedDict(), "_columns": {}}

    def read_into(self, row: int, taken: Fields) -> None:
        number, within = self._place(row)
        with spoilt_is_said(self._store, self._names[number]):
            self._file(number)["displacement_mm"].read_direct(taken, np.s_[within])

    def parameters(self, row: int) -> dict[str, Any]:
        number, within = self._place(row)
        if number not in self._columns:
            with spoilt_is_said(self._store, self._names[number]):
                where = self._store.where(self._names[number])
                self._columns[number] = read_parameters(self._file(number), where, self._counts[number])
        columns = self._columns[number]
        return {name: (c[within].item() if c.ndim == 1 else c[within].copy()) for name, c in columns.items()}

    def _place(self, row: int) -> tuple[int, int]:
        """Return, for the member of a row of the data set, the number of its chunk file and its row in that file."""
        number = int(np.searchsorted(self._ends, row, side="right"))
        return number, row - int(self._ends[number]) + self._counts[number]

    def _file(self, number: int) -> Any:
        """Return the open, checked HDF5 file of the chunk of this number; each forked process opens its own files."""
        key = (os.getpid(), number)
        if key in self._open:
            self._open.move_to_end(key)
            return self._open[key].file
        whole = OpenFile(self._store, self._names[number])
        try:
            where = self._store.where(self._names[number])
            check_chunk(whole.file, where, number, self._mark)
            checked(whole.file, where, "displacement_mm", "f", (self._counts[number], self.n_nodes, 3))
        except BaseException:
            whole.close()
            raise
        self._open[key] = whole
        if len(self._open) > FILES.open_chunks:
            self._open.popitem(last=False)[1].close()
        return whole.file


def split_of(n_members: int, seed: int) -> dict[str, IntArray]:
    """Return the rows of the members for training, validation and test, drawn at random: 80, 10 and 10 % of them.

    `n_members`: number of members (simulations with equilibrium); `seed`: seed of the draw. Result: int64 arrays
    ``train``, ``valid`` and ``test``, each ascending.
    """
    n_held_out = int(n_members * FILES.held_out_share)
    n_train = n_members - 2 * n_held_out
    order = np.random.default_rng([seed, 10]).permutation(n_members)
    parts = np.split(order, [n_train, n_train + n_held_out])
    return {name: np.sort(part) for name, part in zip(("train", "valid", "test"), parts, strict=True)}


def read_card(store: Store) -> dict[str, Any]:
    """Return the checked content of ``dataset.json``, the description of a finished data set.

    `store`: place of the data set. Result: a dict with the keys that `docs/files.md` lists, such as ``chunks``,
    ``mesh``, ``recipe``, ``failed`` and ``split``. Raises `FormatError` if the file is missing, of an older format, or
    faulty.
    """
    where = store.where(CARD_NAME)
    if not store.exists(CARD_NAME):
        message = (
            f"no such file: {where}; a finished data set holds it. `tissuereg simulate RECIPE.toml --out DATA` makes "
            "one, and finishes one that was begun"
        )
        raise FormatError(message, where=where)
    try:
        card = json.loads(store.read(CARD_NAME))
    except (ValueError, RecursionError) as error:
        message = f"{where} must be JSON: {error}"
        raise FormatError(message, where=where) from error
    schema = card.get("schema") if isinstance(card, dict) else None
    if schema == _OLD_SCHEMA:
        message = (
            f"{store.url} holds a data set of the older form {_OLD_SCHEMA} (.npz chunks), which is no longer read; "
            "make it anew in another folder, from its recipe"
        )
        raise FormatError(message, where=where)
    if schema != DATASET_SCHEMA:
        message = f"{where} must have the schema {DATASET_SCHEMA}, got {schema!r}"
        raise FormatError(message, where=where)
    if fault := _fault(card):
        message = f"{where} must be as `tissuereg simulate` writes it; {fault}"
        raise FormatError(message, where=where)
    return dict(card)


def _fault(card: Mapping[str, Any]) -> str | None:
    """Return in words the first fault in the content of ``dataset.json``; None if it has none."""
    files = [card.get("mesh"), *(card["chunks"] if isinstance(card.get("chunks"), list) else [None])]
    files += [card["pairs"]] if card.get("pairs") is not None else []
    if not all(isinstance(one, dict) and _plain_name(one.get("file")) for one in files):
        return "mesh, chunks and pairs must name plain files"
    if not all(isinstance(one.get("sha256"), str) for one in files):
        return "every file must have its sha256"
    counts = [one.get("members") for one in card["chunks"]]
    if not all(_count(one) for one in counts) or not _count(card["mesh"].get("n_nodes")):
        return "every chunk must state its members, and the mesh its n_nodes"
    if not isinstance(card["mesh"].get("digest"), str) or not isinstance(card.get("recipe_sha256"), str):
        return "it must hold the fingerprints of mesh and recipe"
    if not isinstance(card.get("recipe"), dict) or not _failures(card.get("failed")):
        return "it must hold the recipe, and the failed members as [number, reason]"
    n_members, split = sum(counts), card.get("split")
    numbers = {one[0] for one in card["failed"]}
    if len(numbers) < len(card["failed"]) or any(one >= n_members + len(numbers) for one in numbers):
        return "failed must hold every failed member once, by its number in the recipe"
    rows = [split.get(name) for name in ("train", "valid", "test")] if isinstance(split, dict) else [None]
    if not all(isinstance(part, list) and all(_count(row) and row < n_members for row in part) for part in rows):
        return "split must hold rows of train, valid and test"
    return None


def _plain_name(name: object) -> bool:
    return isinstance(name, str) and bool(name) and "\\" not in name and PurePosixPath(name).name == name


def _count(value: object) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 0 <= value < 2**53


def _failures(failed: object) -> bool:
    return isinstance(failed, list) and all(
        isinstance(one, list) and len(one) == 2 and _count(one[0]) and isinstance(one[1], str) for one in failed
    )


def _row(row: Any, n_members: int) -> int:
    """Return a member's row as an int from 0 on; a negative one counts from the end, one out of range is refused."""
    whole: Any = None if isinstance(row, bool) else row  # a mask would be taken for rows 0 and 1
    try:
        number = operator.index(whole)
    except TypeError:
        message = f"a member must be named by a whole number, a slice or a list of numbers, got {found(row)}"
        raise ArgumentError(message, where="row") from None
    if not -n_members <= number < n_members:
        message = f"a member's row must lie from {-n_members} to {n_members - 1}, got {number}"
        raise IndexError(message)
    return number % n_members


def _rows(rows: Any, n_members: int) -> list[int]:
    return [_row(one, n_members) for one in rows]


MESH_NAME = "mesh.npz"


def pack_mesh(mesh: Mesh) -> bytes:
    """Return a mesh as the bytes of an .npz file, with nodes in mm; they are the same for the same mesh."""
    whole = io.BytesIO()
    kept: dict[str, Any] = mesh_arrays(Mesh(mesh.nodes, mesh.tets, {"fixed": mesh.fixed_nodes}, mesh.frame))
    np.savez(whole, **kept)
    return whole.getvalue()


def read_data_mesh(store: Store) -> Mesh:
    """Read the mesh of a data set, with nodes in mm, from the place where the data set lies.

    Raises `FormatError`, `MeshError` or `ShapeError` if it is missing, spoilt or unusable.
    """
    with npz_of_bytes(store.where(MESH_NAME), store.read(MESH_NAME)) as kept:
        return mesh_from_archive(kept)
