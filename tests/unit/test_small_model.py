"""The graph network of the small phantom, of Table II's layers according to its files."""

import json

import numpy as np
import onnx
import pytest
from onnx import numpy_helper

from support.small_model import SMALL_MODEL
from tissuereg.errors import ModelError
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.network import NetworkModel

CARD = json.loads((SMALL_MODEL / "model.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def network():
    return NetworkModel(SMALL_MODEL, phantom_mesh("small"), threads=2)


def graph_of(name):
    model = onnx.load(str(SMALL_MODEL / name))
    facts = {entry.key: entry.value for entry in model.metadata_props}
    return model.graph, json.loads(facts["layers"])


def tables_of(graph):
    return {table.name: numpy_helper.to_array(table) for table in graph.initializer}


def test_the_encoder_is_table_two_three_graph_convolutions_and_three_poolings():
    graph, layers = graph_of("encoder.onnx")
    assert [layer["kind"] for layer in layers] == ["vcConv", "vdPool"] * 3
    names = {node.name for node in graph.node}
    for k in (1, 2, 3):
        assert {f"encoder/conv{k}/gather_neighbours", f"encoder/conv{k}/multiply_bases"} <= names
    assert CARD["channels"] == [32, 64, 128]
    assert CARD["n_latent"] == 26
    assert CARD["n_bases"] == 9


def test_the_decoder_is_table_two_three_unpoolings_and_three_graph_convolutions():
    _, layers = graph_of("decoder.onnx")
    assert [layer["kind"] for layer in layers] == ["vdUnpool", "vcConv"] * 3


def test_the_first_convolution_runs_over_the_edges_of_the_mesh():
    graph, _ = graph_of("encoder.onnx")
    mesh = phantom_mesh("small")
    neighbours = tables_of(graph)["encoder/conv1/neighbours"]
    wanted = [{i} for i in range(mesh.n_nodes)]
    for a, b in mesh.edges:
        wanted[a].add(int(b))
        wanted[b].add(int(a))
    for node in range(mesh.n_nodes):
        # Rows are padded with a repeated index.
        assert set(neighbours[node].tolist()) - wanted[node] <= {0}
        assert wanted[node] <= set(neighbours[node].tolist())


def test_the_pair_of_files_is_small():
    size = sum((SMALL_MODEL / name).stat().st_size for name in ("encoder.onnx", "decoder.onnx"))
    assert size < 5_000_000


def test_the_card_has_the_test_error_and_that_of_pca(network):
    errors = CARD["errors_mm"]
    assert 0 < errors["train"] < errors["test"]
    assert errors["pca"] > 0
    assert network.card["test_error_mm"] == errors["test"]
    assert network.card["pca26_test_error_mm"] == errors["pca"]
    assert max(CARD["parity"].values()) <= 1e-4
    assert CARD["kl_weight"] > 0


def test_some_nodes_equal_rows_of_the_whole(network):
    latents = np.random.default_rng(0).standard_normal((26, 60))
    nodes = np.array([7, 1200, 33])
    # Single precision: sums over another grouping of the same terms.
    np.testing.assert_allclose(network.decode(latents, nodes), network.decode(latents)[:, nodes], atol=2e-4)


def test_threads_change_no_bit():
    latents = np.random.default_rng(1).standard_normal((26, 60))
    fields = [NetworkModel(SMALL_MODEL, phantom_mesh("small"), threads=t).decode(latents) for t in (1, 2)]
    assert np.array_equal(fields[0], fields[1])


def test_a_code_decodes_to_a_field_with_nearly_that_code(network):
    latents = np.asarray(CARD["prior"]["mean"])[:, None]
    field = network.decode(latents)[0]
    mean, variance = network.encode(field)
    prior = np.sqrt(np.diag(CARD["prior"]["covariance"]))
    assert np.abs((mean - latents[:, 0]) / prior).max() < 1.0
    assert (variance > 0).all()


@pytest.mark.parametrize("name", ["encoder.onnx", "decoder.onnx", "decoder_weights.npz"])
def test_a_spoilt_file_is_refused_by_name(name, tmp_path):
    for path in SMALL_MODEL.iterdir():
        (tmp_path / path.name).write_bytes(path.read_bytes())
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:-10])
    with pytest.raises(ModelError, match=rf"{name} must be the file its card describes"):
        NetworkModel(tmp_path, phantom_mesh("small"))


def test_a_missing_card_or_file_is_refused(tmp_path):
    with pytest.raises(ModelError, match=r"must hold model\.json"):
        NetworkModel(tmp_path, phantom_mesh("small"))
    (tmp_path / "model.json").write_bytes((SMALL_MODEL / "model.json").read_bytes())
    with pytest.raises(ModelError, match="it is missing"):
        NetworkModel(tmp_path, phantom_mesh("small"))
