"""The closure with a graph network: where it starts, what its parts add, and what its exported files say."""

import numpy as np
import pytest
import torch
from conftest import make_workplace, smooth_fields

from tissuereg_training.closure_export import encoder_onnx
from tissuereg_training.errors import EnsembleError
from tissuereg_training.evaluate import decoded, mean_error
from tissuereg_training.graph_closure_export import decoder_onnx, decoder_weights
from tissuereg_training.kinds import Material, new_network
from tissuereg_training.layers import VertexConv, swapped
from tissuereg_training.onnx_graph import narrowest
from tissuereg_training.parity import checked_parity, onnx_session
from tissuereg_training.pca import moments
from tissuereg_training.settings import ClosureSettings, GraphClosureSettings

SIZES = {"n_latent": 6, "n_components": 20, "hidden": (16, 24), "encoder_hidden": (12,)}
SETTINGS = GraphClosureSettings(channels=(5, 8), n_bases=3, **SIZES)


@pytest.fixture(scope="module")
def start(block, fields):
    return lambda settings: new_network(Material(block.tets, [fields], moments([fields])), settings, 0)


@pytest.fixture(scope="module")
def model(start):
    model, _ = start(SETTINGS)
    with torch.no_grad():
        model.graph_layers()[-1].bases.mul_(50.0)
        for layer in model.graph_layers():
            layer.bias.normal_()
        model.log_variance_head.weight.normal_(std=0.1)
    model.finish()
    return model


def test_it_starts_at_the_closure_of_the_same_sizes(start, fields):
    model, line = start(SETTINGS)
    closure, _ = start(ClosureSettings(**SIZES))
    closure.load_state_dict({name: model.state_dict()[name] for name in closure.state_dict()})
    z = torch.randn(7, 6)
    apart = decoded(model, z) - decoded(closure, z)
    assert 0 < np.abs(apart).max() < 0.2 * float(model.scale_mm)
    with torch.no_grad(), model.graph_switched_off():
        alone = model.in_mm(model.decode(z)).numpy()
        np.testing.assert_allclose(alone, decoded(closure, z), atol=1e-5 * np.abs(alone).max())
        given = torch.from_numpy(fields)
        for found, wanted in zip(
            model.encode(model.normalised(given)), closure.encode(closure.normalised(given)), strict=True
        ):
            torch.testing.assert_close(found, wanted, rtol=1e-4, atol=1e-4)
    assert "6 > 16 > 24 > 20" in line
    assert "nodes 150 >" in line


def test_the_graph_network_is_the_difference_that_switching_it_off_makes(model, fields):
    z = torch.randn(5, 6)
    with torch.no_grad():
        both = model.decode(z)
        with model.graph_switched_off():
            alone = model.decode(z)
        torch.testing.assert_close(both - alone, model.graph_field(z), rtol=1e-4, atol=1e-4)
        with pytest.raises(ZeroDivisionError), model.graph_switched_off():
            raise ZeroDivisionError
        assert torch.equal(model.decode(z), both)
    assert (both - alone).abs().max() > 0.1


@pytest.mark.parametrize(("n_in", "n_out"), [(3, 5), (5, 3), (3, 20), (20, 3)])
@pytest.mark.parametrize("finer", [False, True])
def test_a_convolution_between_levels_equals_the_formula_edge_by_edge(model, n_in, n_out, finer):
    pools, (n_fine, n_coarse, _) = model.levels.pools[0], model.levels.sizes
    edges, n, n_sources = (swapped(pools), n_fine, n_coarse) if finer else (pools, n_coarse, n_fine)
    conv, batch = VertexConv(edges, n, n_in, n_out, 4, n_sources), 2
    torch.nn.init.normal_(conv.bias)
    table, coefficients = conv.edge_table()
    assert np.array_equal(table, edges)
    x = torch.randn(n_sources, batch * n_in)
    kernels = torch.einsum("em,mio->eio", torch.from_numpy(coefficients), conv.bases)
    per_edge = torch.einsum("ebi,eio->ebo", x.view(n_sources, batch, n_in)[table[:, 1]], kernels)
    y = torch.zeros(n, batch, n_out).index_add(0, torch.from_numpy(table[:, 0].copy()), per_edge) + conv.bias
    torch.testing.assert_close(conv(x), y.reshape(n, -1), rtol=1e-4, atol=1e-5)


def test_every_part_learns(start, fields):
    model, _ = start(SETTINGS)
    x = model.normalised(torch.from_numpy(fields[:8]))
    mean, log_variance = model.encode(x)
    ((model.decode(mean + log_variance) - x) ** 2).mean().backward()
    assert all(one.grad is not None and one.grad.abs().max() > 0 for one in model.parameters())


def test_onnx_says_what_torch_says(model, fields):
    apart = checked_parity(model, encoder_onnx(model, {}), decoder_onnx(model, {}), fields[:5], 0)
    # Single precision in another order of sums: some 1e-6; the limit is 1e-4.
    assert 0 < apart["encoder"] < 2e-5
    assert 0 < apart["decoder"] < 2e-5


def test_chosen_nodes_are_rows_of_the_full_decode(model):
    session = onnx_session(decoder_onnx(model, {}))
    z = torch.randn(7, 6)
    full = session.run(None, {"z": z.numpy()})[0]
    np.testing.assert_allclose(full, decoded(model, z), atol=1e-5 * np.abs(full).max())
    for nodes in ([3], [140, 2, 2, 77], range(150)):
        some = session.run(None, {"z": z.numpy(), "nodes": np.array(nodes, np.int64)})[0]
        np.testing.assert_allclose(some, full[:, nodes], atol=1e-6 * np.abs(full).max())


def test_the_decoder_can_be_rebuilt_in_numpy_from_the_exported_arrays(model, tmp_path):
    np.savez(tmp_path / "w.npz", **decoder_weights(model))
    with np.load(tmp_path / "w.npz", allow_pickle=False) as archive:
        weights = {name: archive[name] for name in archive}
    exact = {"mean_mm", "scale_mm"}
    assert {k for k, table in weights.items() if table.dtype.kind == "f" and table.dtype != np.float16} == exact
    w = {k: table.astype(np.float64) if table.dtype.kind == "f" else table for k, table in weights.items()}
    silu = lambda x: x / (1 + np.exp(-x))  # noqa: E731
    z = np.random.default_rng(0).normal(size=(3, 6)).astype(np.float32)
    y = silu(silu(z @ w["layer0/weight"].T + w["layer0/bias"]) @ w["layer1/weight"].T + w["layer1/bias"])
    y = y @ w["layer2/weight"].T + w["layer2/bias"] + z @ w["skip/weight"].T
    wanted = w["mean_mm"] + np.einsum("bk,knx->bnx", y, w["components_mm"])
    h = (z @ w["fully_connected.weight"].T + w["fully_connected.bias"]).reshape(3, w["levels"][0], -1)
    for k in (1, 2):
        node, coarse = w[f"conv{k}.edges"].T
        kernels = np.einsum("em,mio->eio", w[f"conv{k}.coefficients"], w[f"conv{k}.bases"])
        finer = np.zeros((3, w["levels"][k], kernels.shape[2])) + w[f"conv{k}.bias"]
        np.add.at(finer, (slice(None), node), np.einsum("bei,eio->beo", h[:, coarse], kernels))
        h = silu(finer) if k == 1 else finer
    wanted += w["scale_mm"] * h
    found = onnx_session(decoder_onnx(model, {})).run(None, {"z": z})[0]
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_every_large_table_is_stored_in_half_precision_and_edges_in_few_bits(model):
    for proto in (encoder_onnx(model, {}), decoder_onnx(model, {})):
        for table in proto.graph.initializer:
            name, size = table.name.split("/", 1)[-1], np.prod(table.dims)
            assert name in {"mean_mm", "nodes"} or len(table.raw_data) <= 2 * size or size < 10, name
    assert narrowest(np.array([[0, 255]])).dtype == np.uint8
    assert narrowest(np.array([[0, 256]])).dtype == np.uint16


def test_more_components_than_fields_are_refused(block, fields):
    with pytest.raises(EnsembleError, match="more than 20 training fields, got 20"):
        new_network(Material(block.tets, [fields[:20]], moments([fields[:20]])), SETTINGS, 0)


RECIPE = """
seed = 3
[train]
kind = "graph-closure"
epochs = 60
batch = 16
n_latent = 6
n_components = 8
hidden = [32]
encoder_hidden = [32]
channels = [8, 16]
n_bases = 4
learning_rate = 5e-3
error_fields = 5
"""


def test_it_is_trained_and_its_card_tells_what_the_graph_network_is_worth(tmp_path):
    place = make_workplace(tmp_path, n_members=200, recipe=RECIPE)
    assert place.train() == 0
    from test_pipeline import FILES, model_card, session

    card, folder = model_card(place), place.folder / "model"
    assert sorted(p.name for p in folder.iterdir()) == FILES
    assert (card["kind"], card["n_components"], card["channels"], card["levels"][0]) == (
        "graph-closure",
        8,
        [8, 16],
        150,
    )
    errors = card["errors_mm"]
    assert errors["test"] < errors["pca"]
    assert card["test_mm_without_graph"] > 1.02 * errors["test"]
    page = (folder / "MODEL.md").read_text()
    assert f"| test split, graph network switched off | {card['test_mm_without_graph']:.4f} |" in page
    assert "6 > 32 > 8, silu. Levels 150 >" in page
    fields = smooth_fields(place.block, 200, 1)
    mean = session(folder / "encoder.onnx").run(["mean"], {"displacement": fields})[0]
    found = session(folder / "decoder.onnx").run(None, {"z": mean})[0]
    measured = np.linalg.norm(fields - found, axis=2).mean()
    assert measured == pytest.approx(0.8 * errors["train"] + 0.1 * (errors["valid"] + errors["test"]), rel=1e-4)
    with np.load(folder / "decoder_weights.npz") as weights:
        assert weights["error_fields_mm"].shape == weights["change_error_fields_mm"].shape == (5, 150, 3)


def test_the_error_measured_with_the_graph_network_off_is_that_of_the_closure(model, fields):
    with model.graph_switched_off():
        off = mean_error(model, fields)
    assert off != pytest.approx(mean_error(model, fields), rel=0.01)
