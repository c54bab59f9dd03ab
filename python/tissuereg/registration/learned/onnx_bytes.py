"""ONNX networks as bytes, written without the package `onnx`, with only the operators that a decoder needs.

An ONNX file is a message of Google's protocol buffers. A message is a sequence of fields, each with a number, a wire
type (0: whole number in groups of seven bits; 2: length and bytes; 5: four bytes) and a value. Field numbers are those
of ``onnx.proto3``, intermediate representation 8; operators are those of operator set 13.
"""

import struct
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

#: Version of the representation, and of the operators.
_IR_VERSION, _OPSET = 8, 13

#: Numbers of element types, and of kinds of attributes.
_FLOAT, _INT64 = 1, 7
_ATTRIBUTE_INT, _ATTRIBUTE_INTS = 2, 7


class OnnxGraph:
    """An ONNX network under construction, to which operators and constants are added one by one."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._nodes: list[bytes] = []
        self._tables: list[bytes] = []

    def table(self, values: npt.NDArray[np.float64] | npt.NDArray[np.int64]) -> str:
        """Add a constant array, as int64 if `values` are whole numbers and as float32 otherwise; return its name."""
        whole = values.dtype.kind == "i"
        array = np.ascontiguousarray(values, np.dtype("<i8") if whole else np.dtype("<f4"))
        name = f"table{len(self._tables)}"
        dims = b"".join(_number(1, n) for n in array.shape)
        content = dims + _number(2, _INT64 if whole else _FLOAT) + _bytes(8, name.encode())
        self._tables.append(content + _bytes(9, array.tobytes()))
        return name

    def node(self, kind: str, inputs: Sequence[str], *, output: str = "", **attributes: int | Sequence[int]) -> str:
        """Add an operator and return the name of its result.

        `kind` is the operator's name in the operator set; `inputs` are the names of inputs, constants or results;
        `output` is the name of the result, by default a new one; `**attributes` are the operator's attributes.
        """
        name = output or f"node{len(self._nodes)}"
        content = b"".join(_bytes(1, one.encode()) for one in inputs) + _bytes(2, name.encode())
        content += _bytes(3, name.encode()) + _bytes(4, kind.encode())
        self._nodes.append(content + b"".join(_bytes(5, _attribute(*one)) for one in attributes.items()))
        return name

    def reshape(self, name: str, *shape: int) -> str:
        """Add a reshape of the array `name` and return the result's name; 0 keeps an axis, -1 takes what is left."""
        return self.node("Reshape", [name, self.table(np.array(shape, np.int64))])

    def to_bytes(self, given: tuple[str | int, ...], *found: tuple[str | int, ...]) -> bytes:
        """Return the content of the ONNX file, which `onnxruntime.InferenceSession` takes.

        `given` and `*found` hold the name of the input and of every output, each followed by the lengths of its axes
        after the first, which is that of the ensemble members; all are float32.
        """
        graph = b"".join(_bytes(1, node) for node in self._nodes) + _bytes(2, self._name.encode())
        graph += b"".join(_bytes(5, table) for table in self._tables)
        graph += _bytes(11, _value(*given)) + b"".join(_bytes(12, _value(*one)) for one in found)
        opset = _bytes(1, b"") + _number(2, _OPSET)
        return _number(1, _IR_VERSION) + _bytes(2, b"tissuereg") + _bytes(7, graph) + _bytes(8, opset)


def _value(name: str | int, *lengths: str | int) -> bytes:
    """Return the description of a float32 input or output with axes of members and then of the given lengths."""
    shape = _bytes(1, _bytes(2, b"members")) + b"".join(_bytes(1, _number(1, int(one))) for one in lengths)
    return _bytes(1, str(name).encode()) + _bytes(2, _bytes(1, _number(1, _FLOAT) + _bytes(2, shape)))


def _attribute(name: str, value: int | Sequence[int]) -> bytes:
    if isinstance(value, int):
        return _bytes(1, name.encode()) + _number(3, value) + _number(20, _ATTRIBUTE_INT)
    return _bytes(1, name.encode()) + b"".join(_number(8, one) for one in value) + _number(20, _ATTRIBUTE_INTS)


def _number(field: int, value: int) -> bytes:
    """Return a protocol buffer field with a whole number; negative numbers are in two's complement of 64 bits."""
    return _varint(field << 3) + _varint(value & (2**64 - 1))


def _bytes(field: int, content: bytes) -> bytes:
    return _varint(field << 3 | 2) + _varint(len(content)) + content


def _varint(value: int) -> bytes:
    groups = []
    while value > 127:
        groups.append(value & 127 | 128)
        value >>= 7
    return struct.pack(f"{len(groups) + 1}B", *groups, value)
