"""Tables that networks and weights have in common."""

import numpy as np
import onnx
import onnxruntime
import pytest
from onnx import TensorProto, helper, numpy_helper

from tissuereg_training.shared import write_shared

# 2 MB of half precision: above the least size of a table that is shared.
TABLE = np.random.default_rng(0).normal(size=(1000, 1000)).astype(np.float16)


def network(table):
    """Return x @ table."""
    x = helper.make_tensor_value_info("x", TensorProto.FLOAT, [1, 1000])
    y = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1, 1000])
    nodes = [
        helper.make_node("Cast", ["half"], ["single"], to=TensorProto.FLOAT),
        helper.make_node("MatMul", ["x", "single"], ["y"]),
    ]
    graph = helper.make_graph(nodes, "g", [x], [y], [numpy_helper.from_array(table, "half")])
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", 17)], ir_version=8)


def test_a_shared_table_is_stored_once_and_read_by_numpy_and_onnxruntime(tmp_path):
    networks = [network(TABLE), network(TABLE)]
    rest = write_shared(tmp_path, networks, {"table": TABLE, "other": np.zeros(3)})
    assert list(rest) == ["other"]
    np.testing.assert_array_equal(np.load(tmp_path / "table.npy"), TABLE)
    x = np.random.default_rng(1).normal(size=(1, 1000)).astype(np.float32)
    for number, one in enumerate(networks):
        path = tmp_path / f"{number}.onnx"
        onnx.save(one, path)
        assert path.stat().st_size < 1000
        found = onnxruntime.InferenceSession(str(path)).run(None, {"x": x})[0]
        # Sums of 1,000 products of single precision, of size one each.
        np.testing.assert_allclose(found, x @ TABLE.astype(np.float32), atol=1e-3)


def test_a_table_of_one_network_alone_is_shared_with_it_and_the_other_keeps_its_own(tmp_path):
    networks = [network(TABLE), network(TABLE + np.float16(1))]
    assert not write_shared(tmp_path, networks, {"layer/table": TABLE})
    assert [path.name for path in tmp_path.iterdir()] == ["layer.table.npy"]
    sizes = [one.ByteSize() for one in networks]
    assert sizes[0] < 1000
    assert sizes[1] > TABLE.nbytes


@pytest.mark.parametrize("table", [TABLE[::-1], TABLE[:20]])
def test_a_table_that_no_network_has_or_that_is_small_stays_in_the_weights(tmp_path, table):
    networks = [network(TABLE)]
    if len(table) == 20:  # 40 kB
        networks[0].graph.initializer[0].CopyFrom(numpy_helper.from_array(table, "half"))
    assert list(write_shared(tmp_path, networks, {"table": table})) == ["table"]
    assert not list(tmp_path.iterdir())
