"""A small builder of ONNX graphs: named nodes, named tables, metadata."""

import json
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

from tissuereg_training.digits import halved, split

#: Understood by onnxruntime 1.18 and later.
OPSET = 17
IR_VERSION = 8


class GraphBuilder:
    """Collects nodes and tables of one network.

    Parameters
    ----------
    name : str
        Of the graph; every node and table is named below it, ``name/layer/part``.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self._nodes: list[Any] = []
        self._tables: dict[str, Any] = {}

    def node(self, kind: str, inputs: list[str], name: str, **attributes: Any) -> str:
        """Add a node with one output.

        Parameters
        ----------
        kind : str
            ONNX operator.
        inputs : list of str
            Names of what it reads.
        name : str
            Below the graph's name; also the name of its output.
        **attributes
            Of the operator.

        Returns
        -------
        str
            Name of its output.
        """
        full = f"{self.name}/{name}"
        self._nodes.append(helper.make_node(kind, inputs, [full], name=full, **attributes))
        return full

    def table(self, name: str, array: npt.NDArray[Any]) -> str:
        """Add a constant, once a name; float64 becomes float32.

        Parameters
        ----------
        name : str
            Below the graph's name.
        array : ndarray
            Its value.

        Returns
        -------
        str
            Full name.
        """
        return self.named_table(f"{self.name}/{name}", array)

    def named_table(self, full: str, array: npt.NDArray[Any]) -> str:
        """Add a constant under its full name."""
        if full not in self._tables:
            array = array.astype(np.float32) if array.dtype == np.float64 else array
            self._tables[full] = numpy_helper.from_array(np.ascontiguousarray(array), full)
        return full

    def compact(self, name: str, array: npt.NDArray[Any]) -> str:
        """Add a constant that is stored in digits or half precision (`digits.split`) and widened when it is loaded."""
        parts = split(array)
        if parts is None:
            stored = self.table(f"{name}/half", halved(array))
            return self.node("Cast", [stored], name, to=TensorProto.FLOAT)
        digits, exponents = parts
        places = np.ldexp(1.0, exponents.astype(int) + 8 * np.arange(len(digits))[:, None])
        places = places.reshape(*places.shape, *(1,) * (array.ndim - 1))
        x = self.node("Cast", [self.table(f"{name}/digits", digits)], f"{name}/single", to=TensorProto.FLOAT)
        x = self.node("Mul", [x, self.table(f"{name}/places", places)], f"{name}/by_place")
        return self.node("ReduceSum", [x, self.table("first_axis", np.array([0]))], name, keepdims=0)

    def indices(self, name: str, array: npt.NDArray[Any]) -> str:
        """Add whole numbers that are widened to 64 bits when the network is loaded."""
        return self.node("Cast", [self.table(name, array)], f"{name}/index", to=TensorProto.INT64)

    def shape(self, *sizes: int) -> str:
        """Add a shape, for Reshape: 0 keeps an axis, -1 takes the rest."""
        return self.table("shape/" + "x".join(map(str, sizes)), np.array(sizes, np.int64))

    def reshape(self, x: str, name: str, *sizes: int) -> str:
        """Add a Reshape."""
        return self.node("Reshape", [x, self.shape(*sizes)], name)

    def scattered(
        self,
        name: str,
        edges: npt.NDArray[Any],
        values: npt.NDArray[Any],
        shape: tuple[int, ...],
        *,
        half: bool = False,
    ) -> str:
        """Add a table that is stored by its edges and laid out in full when the network is loaded.

        Parameters
        ----------
        name : str
            Of the layer.
        edges : ndarray of int, shape (n_edges, 2)
            Rows (node, neighbour).
        values : ndarray of float, shape (n_edges, ...)
            Coefficients of each edge.
        shape : tuple of int
            Of the full table, (n_nodes, n_neighbours, ...).
        half : bool
            Store coefficients compactly, and edges in as few bits as they need.

        Returns
        -------
        str
            Name of the full table; all its inputs are constants, so onnxruntime folds it.
        """
        index = self.indices(f"{name}/edges", narrowest(edges) if half else edges.astype(np.int32))
        zeros = self.node("ConstantOfShape", [self.shape(*shape)], f"{name}/zeros")
        coefficients = (self.compact if half else self.table)(f"{name}/coefficients", values)
        return self.node("ScatterND", [zeros, index, coefficients], f"{name}/scatter_edges")

    def build(
        self,
        inputs: list[Any],
        outputs: dict[str, str],
        signature: dict[str, list[Any]],
        facts: dict[str, Any],
    ) -> onnx.ModelProto:
        """Return the model.

        Parameters
        ----------
        inputs : list of ValueInfoProto
            Of the graph; one with the name of a table is an input with a default.
        outputs : dict of str to str
            Public name of an output and the node that makes it.
        signature : dict of str to list
            Shape of each output.
        facts : dict
            Metadata: texts as they are, everything else as JSON.

        Returns
        -------
        onnx.ModelProto
            Checked.
        """
        for public, inner in outputs.items():
            self._nodes.append(helper.make_node("Identity", [inner], [public], name=f"{self.name}/output_{public}"))
        shapes = [helper.make_tensor_value_info(k, TensorProto.FLOAT, signature[k]) for k in outputs]
        graph = helper.make_graph(self._nodes, self.name, inputs, shapes, list(self._tables.values()))
        model = helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", OPSET)], producer_name="tissuereg-training"
        )
        model.ir_version = IR_VERSION
        texts = {key: value if isinstance(value, str) else json.dumps(value) for key, value in facts.items()}
        helper.set_model_props(model, texts)
        onnx.checker.check_model(model)
        return model


def narrowest(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return whole numbers that are not negative in as few bits as the largest needs."""
    return array.astype(np.min_scalar_type(array.max()))
