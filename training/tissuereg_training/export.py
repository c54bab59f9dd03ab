r"""The network as two ONNX files, written node by node from the learned tables.

Batch-first inside, `(batch, n_nodes, channels)`. A convolution takes one of two forms, by where it stands:

* **Encoder**, coefficients first: `gather_neighbours` (n, D) lists every node's neighbours, padded to the largest
  degree D; `mix` is a product of the padded coefficients (n, M, D) with the gathered features, `multiply_bases` the
  product over (M, I).
* **Decoder**, bases first: `multiply_bases` is one product with (I, M O); then unpooling and the sum over neighbours
  are one table. Both are linear with nothing between them, so `c_ikm = sum_j a_ijm rho'_jk` represents the two, and its
  edges (fine node i, coarse node k) are *fewer* than the convolution's own. Stored by edges, it is laid out in full,
  (n_fine, n_coarse M), when the file is loaded (`scatter_edges`, folded by onnxruntime), because a dense product beats
  a gather there: 8 to 16 times at 1,213 nodes. Above `DENSE_LIMIT` the neighbours are gathered instead.

The decoder's input `nodes` has a default, all nodes in order; given, the last layer is computed at those nodes alone.
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper
from scipy import sparse

from tissuereg_training.layers import DensityPool, FloatArray, VertexConv
from tissuereg_training.model import GraphVae
from tissuereg_training.onnx_graph import GraphBuilder, narrowest

#: Largest table, in numbers, that a decoder layer lays out in full: 256 MiB.
DENSE_LIMIT = 2**26


def encoder_onnx(model: GraphVae, facts: dict[str, Any]) -> onnx.ModelProto:
    """Return the encoder.

    Parameters
    ----------
    model : GraphVae
        Trained.
    facts : dict
        Metadata of the whole model.

    Returns
    -------
    onnx.ModelProto
        `displacement` (batch, n_nodes, 3) mm to `mean`, `log_variance` (batch, n_latent).
    """
    graph = GraphBuilder("encoder")
    x = graph.node("Sub", ["displacement", graph.table("mean_mm", _numpy(model.mean_mm))], "normalise/subtract_mean")
    x = graph.node("Div", [x, graph.table("scale_mm", _numpy(model.scale_mm))], "normalise/scale")
    layers = []
    for k, (conv, pool) in enumerate(model.encoder_layers(), start=1):
        x = mixed_conv(graph, f"conv{k}", conv, x)
        x = graph.node("Elu", [x], f"conv{k}/elu")
        edges = pool.pattern.edges
        shape = (pool.pattern.n_owners, pool.pattern.n_others)
        table = graph.scattered(f"pool{k}", edges, _numpy(pool.weights()), shape)
        x = graph.node("MatMul", [table, x], f"pool{k}/average_neighbours")
        layers += [conv_fact(f"conv{k}", conv), _pool_fact("pool", f"pool{k}", pool)]
    x = graph.reshape(x, "flatten", 0, model.levels.sizes[-1] * model.channels[-1])
    outputs = {}
    for name, head in (("mean", model.mean_head), ("log_variance", model.log_variance_head)):
        weight, bias = (
            graph.table(f"{name}/weight", _numpy(head.weight)),
            graph.table(f"{name}/bias", _numpy(head.bias)),
        )
        outputs[name] = graph.node("Gemm", [x, weight, bias], f"{name}/fully_connected", transB=1)
    given = helper.make_tensor_value_info("displacement", TensorProto.FLOAT, ["batch", model.n_nodes, 3])
    signature = {name: ["batch", model.n_latent] for name in outputs}
    return graph.build([given], outputs, signature, {**facts, "layers": layers})


def decoder_onnx(model: GraphVae, facts: dict[str, Any]) -> onnx.ModelProto:
    """Return the decoder.

    Parameters
    ----------
    model : GraphVae
        Trained.
    facts : dict
        Metadata of the whole model.

    Returns
    -------
    onnx.ModelProto
        `z` (batch, n_latent), and `nodes` (k,) where given, to `displacement` (batch, k, 3) mm.
    """
    graph = GraphBuilder("decoder")
    head, depth = model.fully_connected, len(model.channels)
    weight, bias = (graph.table(f"fully_connected/{n}", _numpy(getattr(head, n))) for n in ("weight", "bias"))
    x = graph.node("Gemm", ["z", weight, bias], "fully_connected", transB=1)
    x = graph.reshape(x, "nodes_and_channels", 0, model.levels.sizes[-1], model.channels[-1])
    nodes = graph.named_table("nodes", np.arange(model.n_nodes, dtype=np.int64))
    layers = []
    for k, (unpool, conv) in enumerate(model.decoder_layers(), start=1):
        x = _decoder_conv(graph, k, unpool, conv, x, nodes if k == depth else None)
        layers += [_pool_fact("unpool", f"unpool{k}", unpool), conv_fact(f"conv{k}", conv)]
        if k < depth:
            x = graph.node("Add", [x, graph.table(f"conv{k}/bias", _numpy(conv.bias))], f"conv{k}/add_bias")
            x = graph.node("Elu", [x], f"conv{k}/elu")
        else:
            offset = _numpy(model.mean_mm) + _numpy(model.scale_mm) * _numpy(conv.bias)
            offset_at = graph.node("Gather", [graph.table("offset_mm", offset), nodes], "in_mm/offset_at_nodes")
            x = graph.node("Mul", [x, graph.table("scale_mm", _numpy(model.scale_mm))], "in_mm/scale")
            x = graph.node("Add", [x, offset_at], "in_mm/add_mean_and_bias")
    given = [
        helper.make_tensor_value_info("z", TensorProto.FLOAT, ["batch", model.n_latent]),
        helper.make_tensor_value_info("nodes", TensorProto.INT64, ["k"]),
    ]
    return graph.build(given, {"displacement": x}, {"displacement": ["batch", "k", 3]}, {**facts, "layers": layers})


def decoder_weights(model: GraphVae) -> dict[str, npt.NDArray[Any]]:
    """Return every table of the decoder, layer by layer, unpooling and convolution as one (`folded_edges`).

    Parameters
    ----------
    model : GraphVae
        Trained.

    Returns
    -------
    dict of str to ndarray
        ``fully_connected.weight`` (n_L * C, q) and ``.bias``; for k = 1, 2, .. from coarse to fine ``conv{k}.edges``
        (e, 2) rows (fine node, coarse node), ``conv{k}.coefficients`` (e, M), ``conv{k}.bases`` (M, I, O) and
        ``conv{k}.bias`` (O,); ``levels``, coarsest first; ``mean_mm`` (n, 3) and ``scale_mm`` (): displacement = mean +
        scale * output.
    """
    head = model.fully_connected
    tables: dict[str, npt.NDArray[Any]] = {
        "levels": np.array(model.levels.sizes[::-1], np.int64),
        "fully_connected.weight": _numpy(head.weight),
        "fully_connected.bias": _numpy(head.bias),
        "mean_mm": _numpy(model.mean_mm),
        "scale_mm": _numpy(model.scale_mm),
    }
    for k, (unpool, conv) in enumerate(model.decoder_layers(), start=1):
        edges, coefficients = folded_edges(unpool, conv)
        tables |= conv_tables(k, conv, edges.astype(np.int32), coefficients)
    return tables


def conv_tables(
    k: int, conv: VertexConv, edges: npt.NDArray[Any], coefficients: npt.NDArray[Any]
) -> dict[str, npt.NDArray[Any]]:
    """Return the tables of the decoder's layer `k`, between two levels."""
    return {
        f"conv{k}.edges": edges,
        f"conv{k}.coefficients": coefficients,
        f"conv{k}.bases": _numpy(conv.bases),
        f"conv{k}.bias": _numpy(conv.bias),
    }


def mixed_conv(
    graph: GraphBuilder, name: str, conv: VertexConv, x: str, nodes: str | None = None, *, half: bool = False
) -> str:
    """Add a convolution, coefficients first.

    Parameters
    ----------
    graph : GraphBuilder
        Added to.
    name : str
        Of the layer.
    conv : VertexConv
        Within a level or between two.
    x : str
        Features (batch, n_sources, n_in).
    nodes : str, optional
        Compute these alone.
    half : bool
        Store tables compactly, for weights that are rounded so.

    Returns
    -------
    str
        Features (batch, n_nodes, n_out), or (batch, k, n_out), before the activation.
    """
    edges, coefficients = conv.edge_table()
    neighbours, slots = padded_neighbours(edges, conv.n_nodes)
    n, degree = neighbours.shape
    stored = graph.compact if half else graph.table
    table = graph.scattered(name, slots, coefficients, (n, degree, conv.n_bases), half=half)
    table = graph.node("Transpose", [table], f"{name}/coefficients_by_basis", perm=[0, 2, 1])
    near = (
        graph.indices(f"{name}/neighbours", narrowest(neighbours))
        if half
        else graph.table(f"{name}/neighbours", neighbours)
    )
    if nodes is not None:
        table = graph.node("Gather", [table, nodes], f"{name}/rows_at_nodes")
        near = graph.node("Gather", [near, nodes], f"{name}/neighbours_at_nodes")
    near = graph.node("Gather", [x, near], f"{name}/gather_neighbours", axis=1)
    mixed = graph.node("MatMul", [table, near], f"{name}/mix")
    flat = graph.reshape(mixed, f"{name}/join_bases", 0, 0, conv.n_bases * conv.n_in)
    bases = stored(f"{name}/bases", _numpy(conv.bases).reshape(-1, conv.n_out))
    x = graph.node("MatMul", [flat, bases], f"{name}/multiply_bases")
    return graph.node("Add", [x, stored(f"{name}/bias", _numpy(conv.bias))], f"{name}/add_bias")


def _decoder_conv(graph: GraphBuilder, k: int, unpool: DensityPool, conv: VertexConv, x: str, nodes: str | None) -> str:
    """Add bases, unpooling and the sum over neighbours; at given nodes only if requested."""
    n_coarse, n_bases, n_out = unpool.pattern.n_others, conv.n_bases, conv.n_out
    bases = graph.table(f"conv{k}/bases", _numpy(conv.bases).transpose(1, 0, 2).reshape(conv.n_in, -1))
    x = graph.node("MatMul", [x, bases], f"conv{k}/multiply_bases")
    edges, coefficients = folded_edges(unpool, conv)
    layer = f"unpool{k}+conv{k}"
    if conv.n_nodes * n_coarse * n_bases > DENSE_LIMIT:
        return _gathered_sum(graph, layer, edges, coefficients, conv, x, nodes)
    table = graph.scattered(layer, edges, coefficients, (conv.n_nodes, n_coarse, n_bases))
    table = graph.reshape(table, f"{layer}/table", conv.n_nodes, n_coarse * n_bases)
    if nodes is None:
        x = graph.reshape(x, f"{layer}/split_bases", 0, n_coarse * n_bases, n_out)
        return graph.node("MatMul", [table, x], f"{layer}/sum_over_neighbours")
    # The last layer has 3 channels only: the batch joins them, so that the product is one.
    table = graph.node("Gather", [table, nodes], f"{layer}/rows_at_nodes")
    x = graph.reshape(x, f"{layer}/split_bases", 0, n_coarse * n_bases, n_out)
    x = graph.node("Transpose", [x], f"{layer}/batch_last", perm=[1, 0, 2])
    x = graph.reshape(x, f"{layer}/join_batch", n_coarse * n_bases, -1)
    x = graph.node("MatMul", [table, x], f"{layer}/sum_over_neighbours")
    x = graph.reshape(x, f"{layer}/split_batch", 0, -1, n_out)
    return graph.node("Transpose", [x], f"{layer}/batch_first", perm=[1, 0, 2])


def _gathered_sum(
    graph: GraphBuilder,
    layer: str,
    edges: npt.NDArray[Any],
    coefficients: FloatArray,
    conv: VertexConv,
    x: str,
    nodes: str | None,
) -> str:
    """Add the sum over neighbours for meshes too large for a full table."""
    neighbours, slots = padded_neighbours(edges, conv.n_nodes)
    n, degree = neighbours.shape
    table = graph.scattered(layer, slots, coefficients, (n, degree, conv.n_bases))
    table = graph.reshape(table, f"{layer}/table", n, 1, degree * conv.n_bases)
    near = graph.table(f"{layer}/neighbours", neighbours)
    if nodes is not None:
        table = graph.node("Gather", [table, nodes], f"{layer}/rows_at_nodes")
        near = graph.node("Gather", [near, nodes], f"{layer}/neighbours_at_nodes")
    x = graph.node("Gather", [x, near], f"{layer}/gather_neighbours", axis=1)
    x = graph.reshape(x, f"{layer}/split_bases", 0, 0, degree * conv.n_bases, conv.n_out)
    x = graph.node("MatMul", [table, x], f"{layer}/sum_over_neighbours")
    return graph.reshape(x, f"{layer}/nodes_and_channels", 0, 0, conv.n_out)


def folded_edges(unpool: DensityPool, conv: VertexConv) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Return unpooling and convolution as one table by edges.

    Parameters
    ----------
    unpool : DensityPool
        Coarse to fine.
    conv : VertexConv
        On the fine level.

    Returns
    -------
    edges : ndarray of int64, shape (n_edges, 2)
        Rows (fine node, coarse node), sorted.
    coefficients : ndarray of float32, shape (n_edges, M)
        c_ikm = sum_j a_ijm rho'_jk.
    """
    edges, coefficients = conv.edge_table()
    pool = unpool.pattern
    rho = _matrix(pool.edges, _numpy(unpool.weights()), (pool.n_owners, pool.n_others))
    ones = [np.ones(len(e)) for e in (edges, pool.edges)]
    square = (conv.n_nodes, conv.n_nodes)
    reach = _matrix(edges, ones[0], square) @ _matrix(pool.edges, ones[1], rho.shape)
    reach.sort_indices()
    folded = reach.tocoo()
    rows, columns = folded.row.astype(np.int64), folded.col.astype(np.int64)
    by_basis = [(_matrix(edges, a, square) @ rho)[rows, columns] for a in coefficients.T]
    return np.stack([rows, columns], axis=1), np.stack(by_basis, axis=1).astype(np.float32)


def padded_neighbours(edges: npt.NDArray[Any], n_nodes: int) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.int32]]:
    """Return neighbour lists of one length.

    Parameters
    ----------
    edges : ndarray of int, shape (n_edges, 2)
        Rows (node, neighbour), sorted.
    n_nodes : int
        Number of nodes.

    Returns
    -------
    neighbours : ndarray of int32, shape (n_nodes, D)
        Padded with node 0, whose coefficient there is zero.
    slots : ndarray of int32, shape (n_edges, 2)
        Rows (node, place in its list): where each edge's coefficients go.
    """
    starts = np.searchsorted(edges[:, 0], np.arange(n_nodes))
    place = np.arange(len(edges)) - starts[edges[:, 0]]
    neighbours = np.zeros((n_nodes, int(place.max()) + 1), np.int32)
    neighbours[edges[:, 0], place] = edges[:, 1]
    return neighbours, np.stack([edges[:, 0], place], axis=1).astype(np.int32)


def _matrix(edges: npt.NDArray[Any], values: npt.NDArray[Any], shape: tuple[int, ...]) -> Any:
    return sparse.csr_array((values.astype(np.float64), (edges[:, 0], edges[:, 1])), shape)


def conv_fact(name: str, conv: VertexConv) -> dict[str, Any]:
    """Return what a file's metadata tells of a convolution."""
    return {
        "name": name,
        "kind": "vcConv",
        "nodes": conv.n_nodes,
        "edges": conv.pattern.n_edges,
        "bases": conv.n_bases,
        "channels_in": conv.n_in,
        "channels_out": conv.n_out,
    }


def _pool_fact(kind: str, name: str, pool: DensityPool) -> dict[str, Any]:
    pattern = pool.pattern
    return {
        "name": name,
        "kind": f"vd{kind.capitalize()}",
        "nodes_in": pattern.n_others,
        "nodes_out": pattern.n_owners,
        "edges": pattern.n_edges,
    }


def _numpy(tensor: Any) -> FloatArray:
    array: FloatArray = tensor.detach().cpu().numpy()
    return array
