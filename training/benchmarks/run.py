"""Time a training step and the exported pair on this machine: `python benchmarks/run.py [MESH.npz] [--threads N]`.

Prints one JSON object. MESH.npz holds `tets` (as a data set's `mesh.npz` does); without one, a block of 1,331 nodes.
A step is a batch of 16 fields through loss, gradients and Adam. `ours` uses the prebuilt CSR pair of `sparse.py`; the
others replace `spread` and `collect` by plain torch with its own gradients:

* `index_add`: gather the neighbours of every edge, weigh, add up by node;
* `padded_bmm`: gather padded neighbourhoods, one small product a node.
"""

import argparse
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch

from tissuereg_training import layers
from tissuereg_training.export import decoder_onnx, encoder_onnx, padded_neighbours
from tissuereg_training.graph import hierarchy
from tissuereg_training.host import machine, prepare, versions
from tissuereg_training.losses import kl_divergence, reconstruction
from tissuereg_training.model import GraphVae
from tissuereg_training.network import sampled_latents
from tissuereg_training.parity import onnx_session
from tissuereg_training.sparse import EdgePattern

BATCH = 16


def index_add_spread(values: torch.Tensor, x: torch.Tensor, pattern: EdgePattern) -> torch.Tensor:
    """K X by gather and index_add."""
    owner, other = torch.from_numpy(pattern.edges.copy()).T
    near = x[other]
    return torch.cat([torch.zeros(pattern.n_owners, x.shape[1]).index_add(0, owner, v[:, None] * near) for v in values])


def index_add_collect(values: torch.Tensor, u: torch.Tensor, pattern: EdgePattern) -> torch.Tensor:
    """K' U by gather and index_add."""
    owner, other = torch.from_numpy(pattern.edges.copy()).T
    result = torch.zeros(pattern.n_others, u.shape[1])
    for v, part in zip(values, u.view(len(values), pattern.n_owners, -1), strict=True):
        result = result.index_add(0, other, v[:, None] * part[owner])
    return result


def padded_spread(values: torch.Tensor, x: torch.Tensor, pattern: EdgePattern) -> torch.Tensor:
    """K X by padded neighbourhoods and a product a node."""
    neighbours, slots = padded_neighbours(pattern.edges, pattern.n_owners)
    table = torch.zeros(*neighbours.shape, len(values)).index_put(tuple(torch.from_numpy(slots.T).long()), values.t())
    near = x[torch.from_numpy(neighbours).long()]
    return torch.bmm(table.transpose(1, 2), near).transpose(0, 1).reshape(-1, x.shape[1])


def padded_collect(values: torch.Tensor, u: torch.Tensor, pattern: EdgePattern) -> torch.Tensor:
    """K' U by padded neighbourhoods and a product a node."""
    turned = pattern.edges[:, ::-1]
    order = np.lexsort((turned[:, 1], turned[:, 0]))
    neighbours, slots = padded_neighbours(turned[order], pattern.n_others)
    places = tuple(torch.from_numpy(slots.T).long())
    table = torch.zeros(*neighbours.shape, len(values)).index_put(places, values.t()[torch.from_numpy(order)])
    by_node = u.view(len(values), pattern.n_owners, -1).transpose(0, 1)
    near = by_node[torch.from_numpy(neighbours).long()].flatten(1, 2)
    return torch.bmm(table.flatten(1)[:, None], near)[:, 0]


WAYS: dict[str, tuple[Callable[..., torch.Tensor], Callable[..., torch.Tensor]]] = {
    "ours": (layers.spread, layers.collect),
    "index_add": (index_add_spread, index_add_collect),
    "padded_bmm": (padded_spread, padded_collect),
}


def times_ms(call: Callable[[], Any], seconds: float = 4.0) -> dict[str, float]:
    """Return the smallest and the median wall time of repeated calls, and the median processor time, in ms."""
    call()
    walls, works, end = [], [], time.perf_counter() + seconds
    while len(walls) < 5 or (time.perf_counter() < end and len(walls) < 100):
        wall, work = time.perf_counter(), time.process_time()
        call()
        walls.append(1e3 * (time.perf_counter() - wall))
        works.append(1e3 * (time.process_time() - work))
    return {
        "min": round(min(walls), 2),
        "median": round(statistics.median(walls), 2),
        "processor_median": round(statistics.median(works), 2),
    }


def step_times(model: GraphVae) -> dict[str, dict[str, float]]:
    """Return the time of a training step in each way."""
    x = torch.randn(BATCH, model.n_nodes, 3)
    optimiser = torch.optim.Adam(model.parameters(), lr=1e-4, fused=True)

    def step() -> None:
        mean, log_variance = model.encode(x)
        found = model.decode(sampled_latents(mean, log_variance, torch.randn_like(mean)))
        loss = reconstruction(found, x, "distance") + 1e-3 * kl_divergence(mean, log_variance).sum()
        optimiser.zero_grad()
        loss.backward()
        optimiser.step()

    result = {}
    for name, (spread, collect) in WAYS.items():
        layers.spread, layers.collect = spread, collect
        result[name] = times_ms(step)
    layers.spread, layers.collect = WAYS["ours"]
    return result


def onnx_times(model: GraphVae, threads: int) -> dict[str, Any]:
    """Return sizes in bytes and run times in ms of the exported pair."""
    encoder, decoder = encoder_onnx(model, {}), decoder_onnx(model, {})
    rng, result = np.random.default_rng(0), {"bytes": {"encoder": encoder.ByteSize(), "decoder": decoder.ByteSize()}}
    nodes = rng.permutation(model.n_nodes)[:150].astype(np.int64)
    for count in sorted({1, threads}):
        encode, decode = onnx_session(encoder, count), onnx_session(decoder, count)
        rows = result.setdefault(f"threads_{count}", {})
        for batch in (1, 25, 100):
            z = rng.standard_normal((batch, model.n_latent), dtype=np.float32)
            x = rng.standard_normal((batch, model.n_nodes, 3), dtype=np.float32)
            rows[f"encode_{batch}"] = times_ms(lambda e=encode, x=x: e.run(None, {"displacement": x}), 1.0)
            rows[f"decode_{batch}"] = times_ms(lambda d=decode, z=z: d.run(None, {"z": z}), 1.0)
            some = times_ms(lambda d=decode, z=z: d.run(None, {"z": z, "nodes": nodes}), 1.0)
            rows[f"decode_{batch}_at_150_nodes"] = some
    return result


def block_tets(n: int) -> tuple[int, Any]:
    """Return nodes and tets of a cube of n x n x n nodes, six tets a cell."""
    number = np.arange(n**3).reshape(n, n, n)
    corner = np.stack(
        [number[i : n - 1 + i, j : n - 1 + j, k : n - 1 + k].ravel() for i in (0, 1) for j in (0, 1) for k in (0, 1)],
        axis=1,
    )
    pairs = [(1, 3), (1, 5), (2, 3), (2, 6), (4, 5), (4, 6)]
    return n**3, np.concatenate([corner[:, [0, a, b, 7]] for a, b in pairs])


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("mesh", nargs="?", type=Path)
    parser.add_argument("--threads", type=int, default=0)
    args = parser.parse_args()
    threads = prepare(args.threads)
    if args.mesh is None:
        n_nodes, tets = block_tets(11)
    else:
        with np.load(args.mesh, allow_pickle=False) as mesh:
            n_nodes, tets = len(mesh["nodes_mm"]), mesh["tets"].astype(np.int64)
    levels = hierarchy(n_nodes, tets)
    torch.manual_seed(0)
    model = GraphVae(levels, (32, 64, 128), 9, 26)
    result = {
        "mesh": args.mesh.name if args.mesh else "block of 11 x 11 x 11 nodes",
        "levels": levels.sizes,
        "parameters": sum(p.numel() for p in model.parameters()),
        "batch": BATCH,
        "threads": threads,
        "step_ms": step_times(model),
        "onnx_ms": onnx_times(model, threads),
        "machine": machine(),
        "versions": versions(),
    }
    json.dump(result, sys.stdout, indent=1)
    print()


if __name__ == "__main__":
    main()
