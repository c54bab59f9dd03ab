"""Large tables that networks and weights have in common are stored once, in a file of their own.

An ONNX file may keep a constant in another file of its folder; an .npy file is a header and the numbers, so numpy and
onnxruntime read the same bytes.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto

#: Smaller tables stay where they are, bytes.
_LARGE = 50_000


def write_shared(
    folder: Path, networks: Sequence[onnx.ModelProto], weights: dict[str, npt.NDArray[Any]]
) -> dict[str, npt.NDArray[Any]]:
    """Write the tables of `weights` that networks hold as constants, as ``NAME.npy``.

    Parameters
    ----------
    folder : Path
        Where the networks' files will stand.
    networks : sequence of onnx.ModelProto
        Their constants become references to the files.
    weights : dict of str to ndarray
        Tables.

    Returns
    -------
    dict of str to ndarray
        The other tables.
    """
    rest = dict(weights)
    for name, table in weights.items():
        if table.nbytes < _LARGE:
            continue
        stored = np.ascontiguousarray(table)
        found = [constant for network in networks for constant in _same(network, stored.tobytes())]
        if not found:
            continue
        path = folder / f"{name.replace('/', '.')}.npy"
        np.save(path, stored)
        for constant in found:
            _refer(constant, path.name, path.stat().st_size - stored.nbytes, stored.nbytes)
        del rest[name]
    return rest


def _same(network: onnx.ModelProto, numbers: bytes) -> list[TensorProto]:
    return [constant for constant in network.graph.initializer if constant.raw_data == numbers]


def _refer(constant: TensorProto, location: str, offset: int, length: int) -> None:
    constant.ClearField("raw_data")
    constant.data_location = TensorProto.EXTERNAL
    for key, value in (("location", location), ("offset", str(offset)), ("length", str(length))):
        constant.external_data.add(key=key, value=value)
