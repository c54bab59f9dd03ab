import json

import numpy as np
import onnx
import pytest
import torch
from conftest import make_block, smooth_fields

from tissuereg_training import export
from tissuereg_training.errors import ParityError
from tissuereg_training.evaluate import codes, decoded
from tissuereg_training.export import decoder_onnx, decoder_weights, encoder_onnx, folded_edges
from tissuereg_training.graph import hierarchy
from tissuereg_training.parity import checked_parity, onnx_session


@pytest.fixture(scope="module")
def block():
    return make_block(5, 5, 6)


@pytest.fixture
def model(block, untrained):
    return untrained(hierarchy(block.n_nodes, block.tets))


def elu(x):
    return np.where(x > 0, x, np.expm1(np.minimum(x, 0)))


def numpy_decoder(weights, z):
    """Table II's decoder from the exported arrays, edge by edge; nothing but numpy."""
    levels = weights["levels"]
    h = z @ weights["fully_connected.weight"].T + weights["fully_connected.bias"]
    h = h.reshape(len(z), levels[0], -1)
    for k in range(1, len(levels)):
        node, neighbour = weights[f"conv{k}.edges"].T
        kernels = np.einsum("em,mio->eio", weights[f"conv{k}.coefficients"], weights[f"conv{k}.bases"])
        coarse, h = h, np.zeros((len(z), levels[k], kernels.shape[2])) + weights[f"conv{k}.bias"]
        np.add.at(h, (slice(None), node), np.einsum("bei,eio->beo", coarse[:, neighbour], kernels))
        h = elu(h) if k < len(levels) - 1 else h
    return weights["mean_mm"] + weights["scale_mm"] * h


def layers_of(proto):
    return json.loads({p.key: p.value for p in proto.metadata_props}["layers"])


def test_onnx_says_what_torch_says(model, block):
    apart = checked_parity(model, encoder_onnx(model, {}), decoder_onnx(model, {}), smooth_fields(block, 5, 1), 0)
    # Single precision in another order of sums: some 1e-6; the limit is 1e-4.
    assert 0 < apart["encoder"] < 2e-5
    assert 0 < apart["decoder"] < 2e-5


@pytest.mark.parametrize(
    ("part", "table"),
    [
        ("encoder", "encoder/conv2/coefficients"),
        ("encoder", "encoder/log_variance/bias"),
        ("decoder", "decoder/unpool3+conv3/coefficients"),
        ("decoder", "decoder/offset_mm"),
    ],
)
def test_a_spoilt_export_is_refused(model, block, part, table):
    protos = {"encoder": encoder_onnx(model, {}), "decoder": decoder_onnx(model, {})}
    spoilt = next(t for t in protos[part].graph.initializer if t.name == table)
    values = onnx.numpy_helper.to_array(spoilt).copy()
    values.flat[len(values) // 2] += 0.01 * (1.0 + np.abs(values).max())
    spoilt.CopyFrom(onnx.numpy_helper.from_array(values, table))
    with pytest.raises(ParityError, match=f"exported {part} is off by"):
        checked_parity(model, protos["encoder"], protos["decoder"], smooth_fields(block, 5, 1), 0)


def test_the_decoder_can_be_rebuilt_in_numpy_from_the_exported_arrays(model, tmp_path):
    np.savez(tmp_path / "w.npz", **decoder_weights(model))
    with np.load(tmp_path / "w.npz", allow_pickle=False) as archive:
        weights = {name: archive[name] for name in archive}
    z = np.random.default_rng(0).normal(size=(3, 6)).astype(np.float32)
    found = onnx_session(decoder_onnx(model, {})).run(None, {"z": z})[0]
    wanted = numpy_decoder(weights, z.astype(np.float64))
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


@pytest.mark.parametrize("dense_limit", [2**26, 0])
def test_chosen_nodes_are_rows_of_the_full_decode_in_either_form(model, monkeypatch, dense_limit):
    monkeypatch.setattr(export, "DENSE_LIMIT", dense_limit)
    session = onnx_session(decoder_onnx(model, {}))
    z = torch.randn(7, 6)
    full = session.run(None, {"z": z.numpy()})[0]
    np.testing.assert_allclose(full, decoded(model, z), atol=1e-5 * np.abs(full).max())
    assert [i.name for i in session.get_inputs()] == ["z"]
    assert [i.name for i in session.get_overridable_initializers()] == ["nodes"]
    for nodes in ([3], [140, 2, 2, 77], range(150)):
        some = session.run(None, {"z": z.numpy(), "nodes": np.array(nodes, np.int64)})[0]
        np.testing.assert_allclose(some, full[:, nodes], atol=1e-6 * np.abs(full).max())


def test_the_encoder_takes_any_batch(model, block):
    session, fields = onnx_session(encoder_onnx(model, {})), smooth_fields(block, 4, 2)
    mean, log_variance = codes(model, fields)
    for rows in (slice(0, 1), slice(0, 4)):
        found = session.run(["mean", "log_variance"], {"displacement": fields[rows]})
        np.testing.assert_allclose(found[0], mean[rows], atol=1e-5)
        np.testing.assert_allclose(found[1], log_variance[rows], atol=1e-5)


def test_unpooling_and_convolution_fold_into_fewer_edges(levels_1331, untrained):
    for unpool, conv in untrained(levels_1331).decoder_layers():
        edges, coefficients = folded_edges(unpool, conv)
        assert len(edges) < conv.pattern.n_edges
        assert coefficients.shape == (len(edges), 9)


def test_the_graph_layers_can_be_read_out_of_the_files(model):
    sizes, channels = model.levels.sizes, [8, 16, 32]
    encoder, decoder = encoder_onnx(model, {"kind": "gnn-vae"}), decoder_onnx(model, {"levels": list(sizes)})
    assert [layer["kind"] for layer in layers_of(encoder)] == ["vcConv", "vdPool"] * 3
    assert [layer["kind"] for layer in layers_of(decoder)] == ["vdUnpool", "vcConv"] * 3
    assert [c["channels_out"] for c in layers_of(encoder)[::2]] == channels
    assert [c["nodes"] for c in layers_of(decoder)[1::2]] == list(sizes[-2::-1])
    tables = {t.name: tuple(t.dims) for t in (*encoder.graph.initializer, *decoder.graph.initializer)}
    assert len(tables) == len(encoder.graph.initializer) + len(decoder.graph.initializer)
    for k, layer in enumerate(layers_of(encoder)[::2], start=1):
        assert tables[f"encoder/conv{k}/coefficients"] == (layer["edges"], 9)
        assert tables[f"encoder/conv{k}/edges"] == (layer["edges"], 2)
        assert tables[f"encoder/conv{k}/bases"] == (9 * layer["channels_in"], layer["channels_out"])
    names = {n.name for n in (*encoder.graph.node, *decoder.graph.node)}
    for k in (1, 2, 3):
        assert {f"encoder/conv{k}/gather_neighbours", f"encoder/pool{k}/average_neighbours"} <= names
        assert {f"decoder/conv{k}/multiply_bases", f"decoder/unpool{k}+conv{k}/sum_over_neighbours"} <= names
    assert {p.key for p in encoder.metadata_props} == {"kind", "layers"}


def test_both_files_of_table_ii_are_small(levels_1331, untrained):
    model = untrained(levels_1331, (32, 64, 128), 26)
    assert encoder_onnx(model, {}).ByteSize() + decoder_onnx(model, {}).ByteSize() < 3.5e6
