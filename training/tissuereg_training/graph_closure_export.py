"""The decoder of a closure with a graph network as an ONNX file and a table of weights.

The encoder is the closure's own (`closure_export`).
"""

from typing import Any

import numpy as np
import numpy.typing as npt
import onnx

from tissuereg_training import closure_export
from tissuereg_training.closure_export import activated, built_decoder, fully_connected, to_numpy
from tissuereg_training.digits import stored
from tissuereg_training.export import conv_fact, conv_tables, mixed_conv
from tissuereg_training.graph_closure import GraphClosure
from tissuereg_training.onnx_graph import GraphBuilder, narrowest


def decoder_onnx(model: GraphClosure, facts: dict[str, Any]) -> onnx.ModelProto:
    """Return the decoder of a trained and finished model; arguments and result as of `closure_export.decoder_onnx`."""
    graph, depth = GraphBuilder("decoder"), len(model.channels)
    nodes = graph.named_table("nodes", np.arange(model.n_nodes, dtype=np.int64))
    field = closure_export.decoded_at(graph, model, nodes)
    x = fully_connected(graph, "graph", model.fully_connected, "z")
    x = graph.reshape(x, "nodes_and_channels", 0, model.levels.sizes[-1], model.channels[-1])
    layers = []
    for k, conv in enumerate(model.graph_layers(), start=1):
        x = mixed_conv(graph, f"conv{k}", conv, x, nodes if k == depth else None, half=True)
        x = activated(graph, x, f"conv{k}", model.activation) if k < depth else x
        layers.append(conv_fact(f"conv{k}", conv))
    x = graph.node("Mul", [x, graph.table("scale_mm", to_numpy(model.scale_mm))], "in_mm/scale")
    x = graph.node("Add", [field, x], "in_mm/add_graph_network")
    return built_decoder(graph, model, x, {**facts, "layers": layers})


def decoder_weights(model: GraphClosure) -> dict[str, npt.NDArray[Any]]:
    """Return every table of the decoder.

    Parameters
    ----------
    model : GraphClosure
        Trained and finished.

    Returns
    -------
    dict of str to ndarray
        Those of the closure (`closure_export.decoder_weights`) and of the graph network (`export.decoder_weights`), in
        digits or half precision; displacement = closure's + scale * graph network's output; both have the one
        `activation`.
    """
    tables = closure_export.decoder_weights(model)
    tables["levels"] = np.array(model.levels.sizes[::-1], np.int64)
    tables["scale_mm"] = to_numpy(model.scale_mm)
    tables |= stored("fully_connected.weight", to_numpy(model.fully_connected.weight))
    tables |= stored("fully_connected.bias", to_numpy(model.fully_connected.bias))
    for k, conv in enumerate(model.graph_layers(), start=1):
        edges, coefficients = conv.edge_table()
        for name, table in conv_tables(k, conv, narrowest(edges), coefficients).items():
            tables |= stored(name, table) if table.dtype == np.float32 else {name: table}
    return tables
