"""Tiny random decoders, as the tables of `decoder_weights.npz`, with the plain equations beside them."""

from itertools import pairwise

import numpy as np


def closure_tables(rng, *, activation="elu", widths=(4, 7, 9, 5), n_nodes=12, skip=False):
    """Tables of ``mean + components @ MLP(z)``; `widths` from the latents to the components."""
    tables = {
        "mean_mm": rng.standard_normal((n_nodes, 3)),
        "components_mm": rng.standard_normal((widths[-1], n_nodes, 3)),
        "activation": np.array(activation),
    }
    if skip:
        tables["skip/weight"] = rng.standard_normal((widths[-1], widths[0]))
    for k, (n_in, n_out) in enumerate(pairwise(widths)):
        tables[f"layer{k}/weight"] = rng.standard_normal((n_out, n_in)) / np.sqrt(n_in)
        tables[f"layer{k}/bias"] = rng.standard_normal(n_out)
    return tables


def graph_tables(rng, *, sizes=(3, 8, 20), channels=(6, 5, 3), n_bases=2, n_latent=4, degree=4):
    """Tables of a graph network; `sizes` of the levels, coarsest first, `channels` after each of them."""
    tables = {
        "levels": np.array(sizes),
        "fully_connected.weight": rng.standard_normal((sizes[0] * channels[0], n_latent)),
        "fully_connected.bias": rng.standard_normal(sizes[0] * channels[0]),
        "mean_mm": rng.standard_normal((sizes[-1], 3)),
        "scale_mm": np.array(2.5),
    }
    for k in range(1, len(sizes)):
        n_coarse, n_fine = sizes[k - 1], sizes[k]
        near = edges_between(rng, n_fine, n_coarse, degree)
        tables |= {
            f"conv{k}.edges": near,
            f"conv{k}.coefficients": rng.standard_normal((len(near), n_bases)) / degree,
            f"conv{k}.bases": rng.standard_normal((n_bases, channels[k - 1], channels[k])),
            f"conv{k}.bias": rng.standard_normal(channels[k]),
        }
    return tables


def graph_closure_tables(rng, **how):
    """Tables of a closure with a graph network; `how` of the latter."""
    graph = graph_tables(rng, **how)
    closure = closure_tables(rng, activation="silu", n_nodes=len(graph["mean_mm"]), skip=True)
    return {**graph, **closure}


def edges_between(rng, n_rows, n_columns, degree):
    """So many neighbours of every row, near it, as meshes have them."""
    middle = np.arange(n_rows) * n_columns // n_rows
    steps = np.stack([rng.permutation(2 * degree)[:degree] - degree for _ in range(n_rows)])
    pairs = np.stack([np.repeat(np.arange(n_rows), degree), ((middle[:, None] + steps) % n_columns).ravel()], axis=1)
    return np.unique(pairs, axis=0)


def activated(name, x):
    """An activation by its name."""
    return {
        "elu": lambda: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
        "silu": lambda: x / (1 + np.exp(-x)),
        "relu": lambda: np.maximum(x, 0),
        "tanh": lambda: np.tanh(x),
    }[name]()


def closure_field(tables, z):
    """The field (n_nodes, 3) of one code."""
    n_layers = sum(name.startswith("layer") and name.endswith("/weight") for name in tables)
    straight = tables["skip/weight"] @ z if "skip/weight" in tables else 0.0
    for k in range(n_layers):
        z = tables[f"layer{k}/weight"] @ z + tables[f"layer{k}/bias"]
        if k < n_layers - 1:
            z = activated(str(tables["activation"]), z)
    return tables["mean_mm"] + np.tensordot(z + straight, tables["components_mm"], 1)


def graph_field(tables, z, activation="elu"):
    """The field (n_nodes, 3) of one code, edge by edge."""
    sizes = tables["levels"]
    x = (tables["fully_connected.weight"] @ z + tables["fully_connected.bias"]).reshape(sizes[0], -1)
    for k in range(1, len(sizes)):
        bases = tables[f"conv{k}.bases"]
        coarse, x = x, np.tile(tables[f"conv{k}.bias"], (sizes[k], 1))
        for (i, j), row in zip(tables[f"conv{k}.edges"], tables[f"conv{k}.coefficients"], strict=True):
            x[i] += coarse[j] @ np.tensordot(row, bases, 1)
        if k < len(sizes) - 1:
            x = activated(activation, x)
    return tables["mean_mm"] + tables["scale_mm"] * x


def graph_closure_field(tables, z):
    """The field (n_nodes, 3) of one code: the closure's and, about zero, the graph network's."""
    return closure_field(tables, z) + graph_field({**tables, "mean_mm": 0.0}, z, "silu")
