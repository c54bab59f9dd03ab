"""Blocks of tetrahedra, smooth nonlinear fields on them, data sets and one small trained model."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest
import torch

from tissuereg_training.cli import main
from tissuereg_training.data import Split, mesh_digest
from tissuereg_training.graph import Hierarchy, hierarchy
from tissuereg_training.model import GraphVae

# Corners of the six tets of a cube around its diagonal (Kuhn).
_KUHN = [(1, 3), (1, 5), (2, 3), (2, 6), (4, 5), (4, 6)]


torch.set_num_threads(1)  # these networks are too small to share


@pytest.fixture
def on_the_processor(monkeypatch):
    """Hide graphics cards, on which sums run in no fixed order, from this process and those it starts."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)


@dataclass
class Block:
    """A box of tetrahedra, held at z = 0."""

    nodes: Any
    tets: Any
    held: Any

    @property
    def n_nodes(self) -> int:
        return len(self.nodes)


def make_block(nx: int, ny: int, nz: int, spacing: float = 10.0) -> Block:
    shape = (nx, ny, nz)
    grid = np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1).reshape(-1, 3)
    number = np.arange(len(grid)).reshape(shape)
    corner = np.stack([number[i : nx - 1 + i, j : ny - 1 + j, k : nz - 1 + k].ravel()
                       for i in (0, 1) for j in (0, 1) for k in (0, 1)], axis=1)  # fmt: skip
    tets = np.concatenate([corner[:, [0, a, b, 7]] for a, b in _KUHN])
    nodes = grid * spacing
    a, b, c, d = (nodes[tets[:, i]] for i in range(4))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[turned] = tets[turned][:, [1, 0, 2, 3]]
    return Block(nodes, tets.astype(np.int64), np.flatnonzero(grid[:, 2] == 0))


def smooth_fields(block: Block, n: int, seed: int, rank: int = 6) -> Any:
    """Fields in mm that hang nonlinearly on `rank` numbers and vanish on the held nodes."""
    rng = np.random.default_rng(99)
    x = block.nodes / np.ptp(block.nodes, axis=0)
    waves = np.sin(x @ rng.normal(0, 2.0, (3, rank)) + rng.uniform(0, 6, rank))
    modes = x[:, 2, None, None] * waves[:, :, None] * rng.normal(size=(rank, 3))
    bend = x[:, 2, None, None] ** 2 * rng.normal(size=(rank, 3))
    q = np.random.default_rng(seed).normal(size=(n, rank))
    fields = np.einsum("fr,nrx->fnx", 2.0 * q, modes) + np.einsum("fr,nrx->fnx", 0.3 * q * q, bend)
    return fields.astype(np.float32)


@pytest.fixture(scope="module")
def block() -> Block:
    """A block of 150 nodes."""
    return make_block(5, 5, 6)


@pytest.fixture(scope="module")
def fields(block: Block) -> Any:
    """Eighty fields of the block."""
    return smooth_fields(block, 80, 1, rank=40)


def split_of(n_members: int, seed: int) -> Split:
    """The split that `tissuereg simulate` writes."""
    n_held_out = n_members // 10
    order = np.random.default_rng([seed, 10]).permutation(n_members)
    parts = np.split(order, [n_members - 2 * n_held_out, n_members - n_held_out])
    return Split(*(np.sort(part) for part in parts))


def write_hdf5(path: Path, **arrays: np.ndarray) -> None:
    with h5py.File(path, "w") as file:
        for name, array in arrays.items():
            file.create_dataset(name, data=array)


def write_dataset(
    folder: Path, block: Block, n_members: int, n_pairs: int = 12, chunks: int = 2, seed: int = 1
) -> Path:
    folder.mkdir(parents=True)
    fields = smooth_fields(block, n_members, seed)
    np.savez(folder / "mesh.npz", nodes_mm=block.nodes.astype(float), tets=block.tets, fixed_nodes=block.held)
    entries = []
    for k, rows in enumerate(np.array_split(np.arange(n_members), chunks)):
        entries.append({"file": f"chunk_{k:04d}.h5", "members": len(rows)})
        write_hdf5(folder / entries[-1]["file"], index=rows, displacement_mm=fields[rows])
    if n_pairs:
        simulated = smooth_fields(block, n_pairs, 2)
        write_hdf5(folder / "pairs.h5", simulation_mm=simulated, truth_mm=1.1 * simulated)
    card = {
        "schema": "tissuereg.dataset/2",
        "recipe": {"mesh": {"file": "block.vtu"}},
        "seed": 0,
        "members": n_members,
        "failed": [],
        "mesh": {
            "file": "mesh.npz",
            "digest": mesh_digest(block.nodes, block.tets, block.held),
            "n_nodes": block.n_nodes,
        },
        "chunks": entries,
        "pairs": {"file": "pairs.h5"} if n_pairs else None,
        "split": {name: rows.tolist() for name, rows in vars(split_of(n_members, 0)).items()},
    }
    (folder / "dataset.json").write_text(json.dumps(card))
    return folder


RECIPE = """
seed = 3
[mesh]
file = "block.vtu"
[train]
epochs = 60
batch = 8
n_latent = 6
channels = [8, 16, 32]
kl_weight = 5e-3
"""


@dataclass
class Workplace:
    """A folder with a data set and a recipe, and the command on them."""

    folder: Path
    block: Block
    data: Path
    recipe: Path

    def train(self, *words: str, recipe: str | None = None, out: str = "model") -> int:
        if recipe is not None:
            self.recipe.write_text(recipe)
        fixed = ["--data", str(self.data), "--out", str(self.folder / out), "--json", str(self.folder / "answer.json")]
        return main([str(self.recipe), *fixed, "--quiet", "--threads", "1", *words])

    def answer(self) -> Any:
        return json.loads((self.folder / "answer.json").read_text())


def make_workplace(folder: Path, n_members: int = 60, recipe: str = RECIPE, **data: int) -> Workplace:
    block = make_block(5, 5, 6)
    place = Workplace(folder, block, write_dataset(folder / "data", block, n_members, **data), folder / "recipe.toml")
    place.recipe.write_text(recipe)
    return place


@pytest.fixture(scope="session")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Workplace:
    """One training of the command, for all tests that look at what it left."""
    place = make_workplace(tmp_path_factory.mktemp("trained"), n_members=200)
    assert place.train() == 0
    return place


@pytest.fixture
def workplace(tmp_path: Path) -> Workplace:
    """A small data set and a recipe of two epochs."""
    return make_workplace(tmp_path, recipe=RECIPE.replace("epochs = 60", "epochs = 2"))


@pytest.fixture(scope="session")
def block_1331() -> Block:
    return make_block(11, 11, 11, 6.0)


@pytest.fixture(scope="session")
def levels_1331(block_1331: Block) -> Hierarchy:
    return hierarchy(block_1331.n_nodes, block_1331.tets)


@pytest.fixture
def untrained() -> Callable[..., GraphVae]:
    """Networks with random weights, normalisation and all."""

    def make(levels: Hierarchy, channels: tuple[int, ...] = (8, 16, 32), n_latent: int = 6) -> GraphVae:
        torch.manual_seed(0)
        model = GraphVae(levels, channels, 9, n_latent)
        torch.nn.init.normal_(model.log_variance_head.weight, std=0.1)
        model.mean_mm.normal_()
        model.scale_mm.fill_(2.5)
        return model

    return make
