"""The closure as two ONNX files and a table of weights: digits or half precision in the files, single when it runs."""

from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper
from torch import nn

from tissuereg_training.closure import Closure
from tissuereg_training.digits import stored
from tissuereg_training.network import Network
from tissuereg_training.onnx_graph import GraphBuilder


def encoder_onnx(model: Closure, facts: dict[str, Any]) -> onnx.ModelProto:
    """Return the encoder.

    Parameters
    ----------
    model : Closure
        Trained and finished.
    facts : dict
        Metadata of the whole model.

    Returns
    -------
    onnx.ModelProto
        `displacement` (batch, n_nodes, 3) mm to `mean`, `log_variance` (batch, n_latent).
    """
    graph = GraphBuilder("encoder")
    x = graph.node("Sub", ["displacement", graph.table("mean_mm", to_numpy(model.mean_mm))], "normalise/subtract_mean")
    x = graph.reshape(x, "normalise/flatten", 0, 3 * model.n_nodes)
    components = graph.compact("components_mm", to_numpy(model.components_mm).reshape(model.n_components, -1))
    share = 1.0 / float(model.coefficient_scale_mm) ** 2
    x = given = graph.node("Gemm", [x, components], "normalise/coefficients", transB=1, alpha=share)
    for k, layer in enumerate(model.encoder_layers()):
        x = activated(graph, fully_connected(graph, f"layer{k}", layer, x), f"layer{k}", model.activation)
    outputs = {
        "mean": _with_skip(
            graph, "mean", model.encoder_skip, given, fully_connected(graph, "mean", model.mean_head, x)
        ),
        "log_variance": fully_connected(graph, "log_variance", model.log_variance_head, x),
    }
    signature = helper.make_tensor_value_info("displacement", TensorProto.FLOAT, ["batch", model.n_nodes, 3])
    return graph.build([signature], outputs, {name: ["batch", model.n_latent] for name in outputs}, facts)


def decoder_onnx(model: Closure, facts: dict[str, Any]) -> onnx.ModelProto:
    """Return the decoder.

    Parameters
    ----------
    model : Closure
        Trained and finished.
    facts : dict
        Metadata of the whole model.

    Returns
    -------
    onnx.ModelProto
        `z` (batch, n_latent), and `nodes` (k,) where given, to `displacement` (batch, k, 3) mm.
    """
    graph = GraphBuilder("decoder")
    nodes = graph.named_table("nodes", np.arange(model.n_nodes, dtype=np.int64))
    return built_decoder(graph, model, decoded_at(graph, model, nodes), facts)


def decoded_at(graph: GraphBuilder, model: Closure, nodes: str) -> str:
    """Add the closure's decoder of `z` at nodes; return the node of its displacement (batch, k, 3) in mm."""
    layers, x = model.decoder_layers(), "z"
    for k, layer in enumerate(layers):
        x = fully_connected(graph, f"layer{k}", layer, x)
        if k < len(layers) - 1:
            x = activated(graph, x, f"layer{k}", model.activation)
    x = _with_skip(graph, "coefficients", model.decoder_skip, "z", x)
    whole = graph.compact("components_mm", to_numpy(model.components_mm))
    columns = graph.node("Gather", [whole, nodes], "in_mm/components_at_nodes", axis=1)
    columns = graph.reshape(columns, "in_mm/components_by_number", model.n_components, -1)
    x = graph.node("Gemm", [x, columns], "in_mm/combine_components")
    x = graph.reshape(x, "in_mm/nodes", 0, -1, 3)
    mean = graph.node("Gather", [graph.table("mean_mm", to_numpy(model.mean_mm)), nodes], "in_mm/mean_at_nodes")
    return graph.node("Add", [x, mean], "in_mm/add_mean")


def built_decoder(graph: GraphBuilder, model: Network, displacement: str, facts: dict[str, Any]) -> onnx.ModelProto:
    """Return the decoder of `z`, and of `nodes` where given, whose output is given."""
    given = [
        helper.make_tensor_value_info("z", TensorProto.FLOAT, ["batch", model.n_latent]),
        helper.make_tensor_value_info("nodes", TensorProto.INT64, ["k"]),
    ]
    return graph.build(given, {"displacement": displacement}, {"displacement": ["batch", "k", 3]}, facts)


def decoder_weights(model: Closure) -> dict[str, npt.NDArray[Any]]:
    """Return every table of the decoder.

    Parameters
    ----------
    model : Closure
        Trained and finished.

    Returns
    -------
    dict of str to ndarray
        ``mean_mm`` (n, 3) float32; ``components_mm`` (K, n, 3), ``skip/weight`` (K, q), ``layer{k}/weight``
        (out, in) and ``layer{k}/bias`` (out,), each in digits or float16 (`digits.stored`); ``activation``, a text.
        Displacement = mean + sum over K of y
        times ``components_mm``; y = skip z + the last layer's output, after which there is no activation.
    """
    tables: dict[str, npt.NDArray[Any]] = {
        "mean_mm": to_numpy(model.mean_mm),
        "activation": np.array(model.activation),
        **stored("components_mm", to_numpy(model.components_mm)),
        **stored("skip/weight", to_numpy(model.decoder_skip.weight)),
    }
    for k, layer in enumerate(model.decoder_layers()):
        tables |= stored(f"layer{k}/weight", to_numpy(layer.weight)) | stored(f"layer{k}/bias", to_numpy(layer.bias))
    return tables


def fully_connected(graph: GraphBuilder, name: str, layer: nn.Linear, x: str) -> str:
    """Add a linear layer with a bias."""
    weight, bias = (graph.compact(f"{name}/{part}", to_numpy(getattr(layer, part))) for part in ("weight", "bias"))
    return graph.node("Gemm", [x, weight, bias], f"{name}/fully_connected", transB=1)


def _with_skip(graph: GraphBuilder, name: str, skip: nn.Linear, given: str, x: str) -> str:
    weight = graph.compact(f"{name}/skip", to_numpy(skip.weight))
    return graph.node("Gemm", [given, weight, x], f"{name}/add_linear_part", transB=1)


def activated(graph: GraphBuilder, x: str, name: str, activation: str) -> str:
    """Add an activation."""
    if activation == "elu":
        return graph.node("Elu", [x], f"{name}/elu")
    return graph.node("Mul", [x, graph.node("Sigmoid", [x], f"{name}/sigmoid")], f"{name}/silu")


def to_numpy(tensor: Any) -> npt.NDArray[np.float32]:
    """Return a tensor's numbers."""
    array: npt.NDArray[np.float32] = tensor.detach().cpu().numpy()
    return array
