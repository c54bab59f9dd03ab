"""Data sets: reading the folder that `tissuereg simulate` makes, and checking it.

The layout (`dataset.json`, `mesh.npz`, `chunk_*.h5`, `pairs.h5`) is the whole interface to the main package.
Displacements are taken as they are, in mm, in the frame of the held nodes.
"""

import hashlib
import json
import os
import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import numpy.typing as npt

from tissuereg_training.errors import EnsembleError, ExperimentError, FormatError, MeshError
from tissuereg_training.graph import IntArray
from tissuereg_training.recipe import Recipe

FieldArray = npt.NDArray[np.float32]

SCHEMA = "tissuereg.dataset/2"


@dataclass(frozen=True, eq=False)
class Split:
    """Rows of the three splits, ascending."""

    train: IntArray
    valid: IntArray
    test: IntArray


@dataclass(frozen=True, eq=False)
class Dataset:
    """All fields of a data set in memory.

    Attributes
    ----------
    folder : Path
        Where it was read.
    mesh_digest : str
        Fingerprint of nodes, tets and held nodes.
    nodes : ndarray of float64, shape (n_nodes, 3)
        At rest, mm.
    tets : ndarray of int64, shape (n_tets, 4)
        Node indices.
    index : ndarray of int64, shape (n_members,)
        Which member of the recipe each field is, ascending.
    fields : ndarray of float32, shape (n_members, n_nodes, 3)
        Displacement in mm.
    simulations, truths : ndarray of float32, shape (n_pairs, n_nodes, 3)
        The same event simulated by the believed model and by another one, mm; may be empty.
    split : Split
        The data set's own.
    """

    folder: Path
    mesh_digest: str
    nodes: npt.NDArray[np.float64]
    tets: IntArray
    index: IntArray
    fields: FieldArray
    simulations: FieldArray
    truths: FieldArray
    split: Split

    @property
    def n_nodes(self) -> int:
        """Number of nodes."""
        return len(self.nodes)

    def fingerprint(self) -> str:
        """Return a SHA-256 over mesh, members, fields and split, so that a checkpoint knows its data."""
        digest = hashlib.sha256(self.mesh_digest.encode())
        for array in (self.index, self.fields, self.split.train, self.split.valid, self.split.test):
            digest.update(np.ascontiguousarray(array).tobytes())
        return digest.hexdigest()


def read_dataset(folder: str | os.PathLike[str]) -> Dataset:
    """Read and check a data set.

    Parameters
    ----------
    folder : path-like
        Made by `tissuereg simulate RECIPE.toml --out FOLDER`.

    Returns
    -------
    Dataset
        Every number finite.

    Raises
    ------
    FormatError
        If a file is missing, spoilt, holds pickled objects or arrays of the wrong shape, or numbers that are not
        finite.
    MeshError
        If the card's fingerprint is not that of `mesh.npz`, or fields have another mesh's number of nodes.
    """
    folder = Path(folder)
    card = _read_card(folder)
    mesh = _read_arrays(folder / "mesh.npz", ("nodes_mm", "tets", "fixed_nodes"))
    nodes, tets, held = mesh["nodes_mm"], mesh["tets"], mesh["fixed_nodes"]
    _check_mesh(folder / "mesh.npz", nodes, tets)
    digest = mesh_digest(nodes, tets, held)
    if digest != card["mesh"]["digest"]:
        message = (
            f"{folder} must hold one mesh: dataset.json was made for mesh {card['mesh']['digest'][:12]}, "
            f"mesh.npz is {digest[:12]}"
        )
        raise MeshError(message, where=str(folder / "mesh.npz"))
    chunks = [read_chunk(folder / entry["file"], len(nodes)) for entry in card["chunks"]]
    index = np.concatenate([np.empty(0, np.int64), *(c[0] for c in chunks)])
    fields = np.concatenate([np.empty((0, len(nodes), 3), np.float32), *(c[1] for c in chunks)])
    if (np.diff(index) <= 0).any():
        row = int(np.flatnonzero(np.diff(index) <= 0)[0])
        message = f"{folder}: members must be numbered upwards; member {index[row + 1]} comes after {index[row]}"
        raise FormatError(message, where=str(folder))
    pairs = card.get("pairs")
    simulations, truths = _read_pairs(folder, pairs["file"] if pairs else None, len(nodes))
    split = _read_split(folder / "dataset.json", card, len(fields))
    tets = np.ascontiguousarray(tets, dtype=np.int64)
    return Dataset(folder, digest, nodes.astype(np.float64), tets, index, fields, simulations, truths, split)


def mesh_digest(nodes: Any, tets: Any, held_nodes: Any) -> str:
    """Return the fingerprint that the main package gives this mesh.

    Parameters
    ----------
    nodes : ndarray of float64, shape (n_nodes, 3)
        mm; counted to 1e-6 mm.
    tets : ndarray of int, shape (n_tets, 4)
        Node indices.
    held_nodes : ndarray of int, shape (n_held,)
        Sorted.

    Returns
    -------
    str
        SHA-256, hexadecimal.
    """
    digest = hashlib.sha256()
    digest.update(np.round(np.asarray(nodes) * 1e6).astype("<i8").tobytes())
    digest.update(np.asarray(tets).astype("<i8").tobytes())
    digest.update(np.asarray(held_nodes).astype("<i8").tobytes())
    return digest.hexdigest()


def check_recipe_fits(recipe: Recipe, dataset_recipe: Any) -> None:
    """Check that a recipe refers to the mesh on which the data were made.

    Parameters
    ----------
    recipe : Recipe
        What to train.
    dataset_recipe : dict
        The recipe that `dataset.json` quotes.

    Raises
    ------
    ExperimentError
        If both name a mesh, and not the same.
    """
    wanted = recipe.raw.get("mesh")
    made = dataset_recipe.get("mesh") if isinstance(dataset_recipe, dict) else None
    if not isinstance(wanted, dict) or not isinstance(made, dict):
        return
    names = [_mesh_name(table) for table in (wanted, made)]
    if all(names) and names[0] != names[1]:
        message = f"{recipe.path}: [mesh] must name the data's, {names[1]!r}; got {names[0]!r}"
        raise ExperimentError(message, where=f"{recipe.path}: [mesh]")


def _mesh_name(table: dict[str, Any]) -> str:
    if "source" in table:
        return f"{table['source']} of {table.get('n_nodes', 'default')} nodes"
    return Path(str(table.get("file", ""))).name


def read_chunk_files(folder: str | os.PathLike[str]) -> tuple[str, list[Path]]:
    """Return the mesh's fingerprint that a data set states, and its chunk files.

    Parameters
    ----------
    folder : path-like
        Made by `tissuereg simulate`.

    Returns
    -------
    digest : str
        SHA-256, hexadecimal.
    files : list of Path
        Chunks in order.

    Raises
    ------
    FormatError
        If `dataset.json` is missing or spoilt.
    """
    folder = Path(folder)
    card = _read_card(folder)
    return card["mesh"]["digest"], [folder / entry["file"] for entry in card["chunks"]]


def read_dataset_recipe(folder: str | os.PathLike[str]) -> Any:
    """Return the recipe that a data set quotes, {} where it quotes none."""
    return _read_card(Path(folder)).get("recipe", {})


def read_origin(folder: str | os.PathLike[str]) -> dict[str, Any]:
    """Return where a data set comes from, for the model card.

    Parameters
    ----------
    folder : path-like
        Made by `tissuereg simulate`.

    Returns
    -------
    dict
        ``seed``, ``members``, ``recipe_sha256``; "" where the last is not stated.
    """
    card = _read_card(Path(folder))
    return {"seed": card.get("seed"), "members": card.get("members"), "recipe_sha256": card.get("recipe_sha256", "")}


def check_split(split: Split, n_latent: int) -> None:
    """Check that a split is large enough to train on.

    Parameters
    ----------
    split : Split
        The data set's.
    n_latent : int
        Latents; the training split must hold more fields than that, or principal components would be exact.

    Raises
    ------
    EnsembleError
        If there are too few members.
    """
    if min(len(split.valid), len(split.test)) < 1 or len(split.train) <= n_latent:
        n_members = len(split.train) + len(split.valid) + len(split.test)
        message = (
            f"training {n_latent} latents must have more than {n_latent} fields in its training split and one in each "
            f"of the others, got {n_members} members in all; simulate more"
        )
        raise EnsembleError(message, where="members")


def _read_card(folder: Path) -> dict[str, Any]:
    path = folder / "dataset.json"
    try:
        card = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        message = f"a data set must hold a readable dataset.json (made by `tissuereg simulate`): {error}"
        raise FormatError(message, where=str(path)) from error
    if not isinstance(card, dict) or card.get("schema") != SCHEMA:
        message = f"{path} must have schema {SCHEMA}, got {card.get('schema') if isinstance(card, dict) else card!r}"
        raise FormatError(message, where=str(path))
    mesh, chunks, pairs = card.get("mesh"), card.get("chunks"), card.get("pairs")
    files = [mesh, *(chunks if isinstance(chunks, list) else [None]), *([pairs] if pairs is not None else [])]
    names = [entry.get("file") if isinstance(entry, dict) else None for entry in files]
    names_ok = all(isinstance(name, str) and Path(name).name == name for name in names)
    if not names_ok or not isinstance(card["mesh"].get("digest"), str):
        message = f"{path} must name its mesh, with digest, and its chunks (plain file names)"
        raise FormatError(message, where=str(path))
    return card


def _read_split(path: Path, card: dict[str, Any], n_members: int) -> Split:
    given = card.get("split")
    parts = [given.get(name) for name in ("train", "valid", "test")] if isinstance(given, dict) else [None]
    rows = [row for part in parts for row in (part if isinstance(part, list) else [None])]
    if not all(type(row) is int and 0 <= row < n_members for row in rows) or len(set(rows)) != len(rows):
        message = f"{path}: split must hold rows below {n_members} of train, valid and test, each once"
        raise FormatError(message, where=f"{path}: split")
    return Split(*(np.sort(np.array(part, dtype=np.int64)) for part in parts))


def _read_arrays(path: Path, names: tuple[str, ...]) -> dict[str, npt.NDArray[Any]]:
    try:
        archive = np.load(path, allow_pickle=False)
        if not isinstance(archive, np.lib.npyio.NpzFile):
            message = f"{path} must be an .npz archive, got a single array"
            raise FormatError(message, where=str(path))
        with archive:
            missing = [name for name in names if name not in archive]
            if missing:
                message = f"{path} must hold {', '.join(names)}; it lacks {', '.join(missing)}"
                raise FormatError(message, where=str(path))
            return {name: archive[name] for name in names}
    except FormatError:
        raise
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        message = f"{path} must be an .npz archive of plain arrays (no pickled objects): {error}"
        raise FormatError(message, where=str(path)) from error


def _read_hdf5(path: Path, names: tuple[str, ...]) -> dict[str, npt.NDArray[Any]]:
    """Return arrays of an HDF5 file; their checksums are compared."""
    try:
        with h5py.File(path, "r", locking=False) as file:
            missing = [name for name in names if not isinstance(file.get(name), h5py.Dataset)]
            if missing:
                message = f"{path} must hold {', '.join(names)}; it lacks {', '.join(missing)}"
                raise FormatError(message, where=str(path))
            return {name: file[name][()] for name in names}
    except FormatError:
        raise
    except (OSError, RuntimeError, ValueError, TypeError, KeyError) as error:
        message = f"{path} must be a whole HDF5 file of the data set: {error}"
        raise FormatError(message, where=str(path)) from error


def _check_mesh(path: Path, nodes: Any, tets: Any) -> None:
    if nodes.ndim != 2 or nodes.shape[1] != 3 or nodes.dtype.kind != "f" or not np.isfinite(nodes).all():
        message = f"{path}: nodes_mm must be finite floats of shape (n, 3), got {nodes.dtype} {nodes.shape}"
        raise FormatError(message, where=f"{path}: nodes_mm")
    fits = tets.ndim == 2 and tets.shape[1] == 4 and len(tets) > 0 and tets.dtype.kind in "iu"
    if not fits or tets.min() < 0 or tets.max() >= len(nodes):
        message = f"{path}: tets must be node indices of shape (m, 4) below {len(nodes)}, got {tets.dtype} {tets.shape}"
        raise FormatError(message, where=f"{path}: tets")


def read_chunk(path: Path, n_nodes: int) -> tuple[IntArray, FieldArray]:
    """Return numbers and fields of the members in a chunk file.

    Parameters
    ----------
    path : Path
        Of the chunk.
    n_nodes : int
        Of the mesh.

    Returns
    -------
    index : ndarray of int64, shape (n_members,)
        Which members of the recipe.
    fields : ndarray of float32, shape (n_members, n_nodes, 3)
        Finite, mm.

    Raises
    ------
    FormatError
        If the file is missing or spoilt, or holds numbers that are not finite.
    MeshError
        If the fields have another number of nodes.
    """
    arrays = _read_hdf5(path, ("index", "displacement_mm"))
    index, fields = arrays["index"], _fields(path, "displacement_mm", arrays["displacement_mm"], n_nodes)
    if index.dtype.kind not in "iu" or index.shape != (len(fields),):
        message = f"{path}: index must be whole numbers of shape ({len(fields)},), got {index.dtype} {index.shape}"
        raise FormatError(message, where=f"{path}: index")
    return index.astype(np.int64), fields


def _read_pairs(folder: Path, name: Any, n_nodes: int) -> tuple[FieldArray, FieldArray]:
    if name is None:
        empty = np.empty((0, n_nodes, 3), np.float32)
        return empty, empty
    path = folder / str(name)
    arrays = _read_hdf5(path, ("simulation_mm", "truth_mm"))
    simulations, truths = (_fields(path, key, array, n_nodes) for key, array in arrays.items())
    if len(simulations) != len(truths):
        message = f"{path}: every simulation must have its truth, got {len(simulations)} and {len(truths)}"
        raise FormatError(message, where=str(path))
    return simulations, truths


def _fields(path: Path, name: str, array: Any, n_nodes: int) -> FieldArray:
    where = f"{path}: {name}"
    if array.ndim != 3 or array.shape[2] != 3 or array.dtype.kind != "f":
        message = f"{where} must be floats of shape (members, {n_nodes}, 3), got {array.dtype} {array.shape}"
        raise FormatError(message, where=where)
    if array.shape[1] != n_nodes:
        message = f"{where} must be fields on the data set's own mesh of {n_nodes} nodes, got {array.shape[1]} nodes"
        raise MeshError(message, where=where)
    finite = np.isfinite(array).all(axis=(1, 2))
    if not finite.all():
        bad = np.flatnonzero(~finite)
        message = f"{where} must be finite; {len(bad)} of {len(array)} fields are not, the first in row {bad[0]}"
        raise FormatError(message, where=where)
    return np.ascontiguousarray(array, dtype=np.float32)
