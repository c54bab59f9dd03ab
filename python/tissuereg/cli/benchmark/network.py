"""A network of the paper's Table II for any mesh, with random weights: for timings, which do not depend on the values.

The network works on a sequence of coarser and coarser graphs, as in the paper: no node of the next graph has another
one within one edge of the present graph, unpooling reaches one edge, and nodes of the next graph are neighbours if at
most three edges separate them. It has 32, 64 and 128 channels, nine bases for each convolution, 26 latents.
"""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ModelError
from tissuereg.registration.learned.card import CARD_SCHEMA, MODEL_FILES, list_file
from tissuereg.registration.learned.decoders import GraphDecoder, read_decoder
from tissuereg.registration.learned.onnx_bytes import OnnxGraph


@dataclass(frozen=True)
class Table2Network:
    """Sizes of the network of the paper's Table II: channels, bases of a convolution, latents, error fields.

    `scale_mm`: size of the displacements that it decodes, small enough that no tetrahedron is inverted.
    """

    channels: tuple[int, int, int] = (32, 64, 128)  # of its levels
    n_bases: int = 9  # of a convolution
    n_latent: int = 26
    n_errors: int = 64  # error fields: as many as trained ones have
    # Size of its displacements: they turn no tetrahedron inside out, as a trained network's do not.
    scale_mm: float = 0.5


TABLE2 = Table2Network()


def write_random_table2(mesh: Mesh, folder: Path, seed: int = 0) -> None:
    """Write the files of a network of Table II for `mesh`, with random weights, into a model folder that is empty."""
    rng = np.random.default_rng(seed)
    levels = _levels(mesh)
    tables = _decoder_tables(levels, mesh.n_nodes, rng)
    np.savez(folder / "decoder_weights.npz", **tables)
    decoder = read_decoder(folder / "decoder_weights.npz")
    if not isinstance(decoder, GraphDecoder):
        message = f"the tables in {folder} must be those of a graph network"
        raise ModelError(message, where=str(folder))
    (folder / "decoder.onnx").write_bytes(decoder.whole())
    (folder / "encoder.onnx").write_bytes(_encoder(levels, mesh.n_nodes, rng))
    unit = np.eye(TABLE2.n_latent)
    card: dict[str, Any] = {
        "schema": CARD_SCHEMA,
        "kind": "gnn-vae",
        "mesh_digest": mesh.digest(),
        "n_nodes": mesh.n_nodes,
        "n_latent": TABLE2.n_latent,
        "members": 1,
        "errors_mm": {"test": 0.25, "pca": 0.25},
        "prior": {
            "mean": [0.0] * TABLE2.n_latent,
            "covariance": unit.tolist(),
            "mismatch_covariance": (0.05 * unit).tolist(),
        },
        "files": {},
    }
    for name in MODEL_FILES:
        list_file(card, folder / name)
    (folder / "model.json").write_text(json.dumps(card), encoding="utf-8")


@dataclass(frozen=True, eq=False)
class _Level:
    """One graph of the network: its number of nodes, and pairs of node indices.

    `edges` (n_edges, 2): neighbours, where each node is its own neighbour too; `pools` (n_pools, 2): node of the next
    coarser graph, and a node of this one that is pooled into it.
    """

    n_nodes: int
    edges: IntArray
    pools: IntArray


def _levels(mesh: Mesh) -> list[_Level]:
    """Return the graphs of the network, finest first; the coarsest has nodes only, and no edges."""
    both = np.concatenate([mesh.edges, mesh.edges[:, ::-1], np.repeat(np.arange(mesh.n_nodes)[:, None], 2, axis=1)])
    graph = _matrix(both, mesh.n_nodes)
    found = []
    for _ in TABLE2.channels:
        near = np.zeros(graph.shape[0], dtype=bool)
        centres = []
        for node in range(graph.shape[0]):
            if not near[node]:
                centres.append(node)
                near[graph.indices[graph.indptr[node] : graph.indptr[node + 1]]] = True
        found.append(_Level(graph.shape[0], _pairs(graph), _pairs(graph[centres])))
        graph = _matrix(_pairs((graph @ graph @ graph)[centres][:, centres]), len(centres))
    found.append(_Level(graph.shape[0], np.empty((0, 2), np.int64), np.empty((0, 2), np.int64)))
    return found


def _matrix(pairs: IntArray, n_rows: int) -> Any:
    from scipy import sparse

    return sparse.csr_array((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), (n_rows, int(pairs[:, 1].max()) + 1))


def _pairs(matrix: Any) -> IntArray:
    table = matrix.tocoo()
    pairs = np.stack([table.row, table.col], axis=1).astype(np.int64)
    return pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))]


def _shares(owners: IntArray, rng: np.random.Generator) -> FloatArray:
    """Return random positive weights (n,) of graph edges that add up to 1 for each node in `owners` (n,)."""
    sizes = rng.uniform(0.5, 1.5, len(owners))
    return np.asarray(sizes / np.bincount(owners, sizes)[owners])


def _coefficients(edges: IntArray, n_nodes: int, rng: np.random.Generator) -> FloatArray:
    return np.asarray(
        rng.standard_normal((len(edges), TABLE2.n_bases)) * np.sqrt(n_nodes / (len(edges) * TABLE2.n_bases))
    )


def _decoder_tables(levels: list[_Level], n_nodes: int, rng: np.random.Generator) -> dict[str, Any]:
    widths = (3, *TABLE2.channels)
    width = levels[-1].n_nodes * TABLE2.channels[-1]
    tables: dict[str, Any] = {
        "levels": np.array([level.n_nodes for level in reversed(levels)]),
        "fully_connected.weight": rng.standard_normal((width, TABLE2.n_latent)) / np.sqrt(TABLE2.n_latent),
        "fully_connected.bias": np.zeros(width),
        "mean_mm": np.zeros((n_nodes, 3)),
        "scale_mm": np.array(TABLE2.scale_mm),
    }
    for name, size in (("error", "error_sizes_mm"), ("change_error", "change_sizes_mm")):
        tables |= {
            f"{name}_fields_mm": 0.1 * rng.standard_normal((TABLE2.n_errors, n_nodes, 3)),
            size: np.full(TABLE2.n_errors, 3.0),
        }
    for k, fine in enumerate(reversed(range(len(TABLE2.channels))), start=1):
        level, n_in, n_out = levels[fine], widths[fine + 1], widths[fine]
        # Unpooling and convolution are one table: the coarse nodes that are pooled from a node's neighbours.
        edges = _pairs(_matrix(level.edges, level.n_nodes) @ _matrix(level.pools[:, ::-1], level.n_nodes))
        tables |= {
            f"conv{k}.edges": edges,
            f"conv{k}.coefficients": _coefficients(edges, level.n_nodes, rng),
            f"conv{k}.bases": rng.standard_normal((TABLE2.n_bases, n_in, n_out)) / np.sqrt(n_in),
            f"conv{k}.bias": np.zeros(n_out),
        }
    return tables


def _encoder(levels: list[_Level], n_nodes: int, rng: np.random.Generator) -> bytes:
    """Return the encoder as ONNX bytes, as the training package exports it: it gathers neighbours, then mixes bases."""
    graph, x = OnnxGraph("encoder"), "displacement"
    widths = (3, *TABLE2.channels)
    for level, coarser, n_in, n_out in zip(levels[:-1], levels[1:], widths[:-1], widths[1:], strict=True):
        starts = np.searchsorted(level.edges[:, 0], np.arange(level.n_nodes))
        place = np.arange(len(level.edges)) - starts[level.edges[:, 0]]
        neighbours = np.zeros((level.n_nodes, int(place.max()) + 1), np.int64)
        neighbours[level.edges[:, 0], place] = level.edges[:, 1]
        mixed = np.zeros((level.n_nodes, TABLE2.n_bases, neighbours.shape[1]))
        mixed[level.edges[:, 0], :, place] = _coefficients(level.edges, level.n_nodes, rng)
        x = graph.node("Gather", [x, graph.table(neighbours)], axis=1)
        x = graph.reshape(graph.node("MatMul", [graph.table(mixed), x]), 0, level.n_nodes, TABLE2.n_bases * n_in)
        bases = rng.standard_normal((TABLE2.n_bases * n_in, n_out)) / np.sqrt(n_in)
        x = graph.node("Elu", [graph.node("MatMul", [x, graph.table(bases)])])
        pool = np.zeros((coarser.n_nodes, level.n_nodes))
        pool[level.pools[:, 0], level.pools[:, 1]] = _shares(level.pools[:, 0], rng)
        x = graph.node("MatMul", [graph.table(pool), x])
    width = levels[-1].n_nodes * TABLE2.channels[-1]
    x = graph.reshape(x, 0, width)
    head = graph.table(rng.standard_normal((width, TABLE2.n_latent)) / width)
    graph.node("MatMul", [x, head], output="mean")
    spread = [graph.table(np.zeros((width, TABLE2.n_latent))), graph.table(np.full(TABLE2.n_latent, -4.0))]
    graph.node("Gemm", [x, *spread], output="log_variance")
    return graph.to_bytes(("displacement", n_nodes, 3), ("mean", TABLE2.n_latent), ("log_variance", TABLE2.n_latent))
