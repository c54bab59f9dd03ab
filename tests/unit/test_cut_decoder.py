"""Decoders cut down to points: the field of the whole decoder there, whatever its kind and the points."""

import numpy as np
import onnx
import pytest
from scipy import sparse

from support.networks import (
    closure_field,
    closure_tables,
    graph_closure_field,
    graph_closure_tables,
    graph_field,
    graph_tables,
)
from tissuereg.errors import ModelError
from tissuereg.phantom import phantom_mesh, shipped_model_folder
from tissuereg.registration.learned import cut as cut_module
from tissuereg.registration.learned.batches import in_batches
from tissuereg.registration.learned.cut import CutDecoder
from tissuereg.registration.learned.decoders import network_at, read_decoder
from tissuereg.registration.learned.digits import in_digits, rounded
from tissuereg.registration.learned.network import NetworkModel

#: Single precision, relative to the largest displacement.
SINGLE = 1e-5

DECODERS = {
    **{f"closure/{name}": (closure_tables, closure_field, {"activation": name}) for name in ("elu", "silu", "relu")},
    "closure/tanh": (closure_tables, closure_field, {"activation": "tanh"}),
    "closure/linear part": (closure_tables, closure_field, {"skip": True}),
    "closure/one layer and linear part": (closure_tables, closure_field, {"widths": (4, 5), "skip": True}),
    "closure/one layer": (closure_tables, closure_field, {"widths": (4, 5)}),
    "closure/few components": (closure_tables, closure_field, {"widths": (4, 30, 2)}),
    "graph/one level": (graph_tables, graph_field, {"sizes": (3, 9), "channels": (6, 3)}),
    "graph/two levels": (graph_tables, graph_field, {}),
    "graph/three levels": (graph_tables, graph_field, {"sizes": (3, 9, 50, 400), "channels": (8, 6, 4, 3)}),
    "both/one level": (graph_closure_tables, graph_closure_field, {"sizes": (3, 9), "channels": (6, 3)}),
    "both/three levels": (
        graph_closure_tables,
        graph_closure_field,
        {"sizes": (3, 9, 50, 400), "channels": (8, 6, 4, 3)},
    ),
}


@pytest.fixture(params=DECODERS)
def decoder(request, tmp_path):
    """A decoder read from its file, and its plain field of a code."""
    make, field, how = DECODERS[request.param]
    tables = make(np.random.default_rng(3), **how)
    np.savez(tmp_path / "decoder_weights.npz", **tables)
    return read_decoder(tmp_path / "decoder_weights.npz"), lambda z: field(tables, z), len(tables["mean_mm"])


@pytest.mark.parametrize("name", ["closure/linear part", "graph/three levels", "both/three levels"])
def test_every_table_may_lie_in_digits_and_large_ones_in_files_of_their_own(name, tmp_path):
    make, field, how = DECODERS[name]
    tables = make(np.random.default_rng(3), **how)
    coarse = {
        key: rounded(table, 1e-3) if table.dtype.kind == "f" and key != "scale_mm" else table
        for key, table in tables.items()
    }
    stored, beside = {}, "layer0/weight" if "layer0/weight" in tables else "conv1.edges"
    for key, table in coarse.items():
        stored |= {key: table} if table is tables[key] else in_digits(key, table)
    assert sum(key.endswith(".exponents") for key in stored) >= 4
    file = f"{beside.replace('/', '.')}.npy"
    np.save(tmp_path / file, stored.pop(beside))
    np.savez(tmp_path / "decoder_weights.npz", **stored)
    latents = np.random.default_rng(5).standard_normal((4, 3))
    for listed in (None, [file]):
        found = read_decoder(tmp_path / "decoder_weights.npz", listed).decode(latents)
        wanted = np.stack([field(coarse, z) for z in latents.T])
        np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())
    # A file that the card does not list is not read, and one that is spoilt is named.
    with pytest.raises(ModelError, match=f"must hold an array '{beside}'"):
        read_decoder(tmp_path / "decoder_weights.npz", [])
    (tmp_path / file).write_bytes(b"no array")
    with pytest.raises(ModelError, match=rf"^\S*{file} must be an array of plain numbers"):
        read_decoder(tmp_path / "decoder_weights.npz")


def points(rng, n_points, n_nodes, corners=3):
    """Barycentric rows of points, each between some nodes."""
    nodes = np.concatenate([rng.choice(n_nodes, corners, replace=False) for _ in range(n_points)])
    weights = rng.dirichlet(np.ones(corners), n_points)
    return sparse.csr_array((weights.ravel(), (np.repeat(np.arange(n_points), corners), nodes)), (n_points, n_nodes))


@pytest.mark.parametrize("which", ["a point", "few points", "every node"])
def test_a_cut_decoder_moves_its_points_as_the_whole_one_does(decoder, which):
    read, field, n_nodes = decoder
    rng = np.random.default_rng(5)
    rows = {
        "a point": points(rng, 1, n_nodes),
        "few points": points(rng, 5, n_nodes, corners=4),
        "every node": sparse.eye_array(n_nodes, format="csr"),
    }[which]
    latents = rng.standard_normal((4, 60))
    wanted = np.stack([rows @ field(z) for z in latents.T])
    moved = CutDecoder(read, rows, 1)(latents)
    assert moved.shape == (60, rows.shape[0], 3)
    np.testing.assert_allclose(moved, wanted, rtol=0, atol=SINGLE * np.abs(wanted).max())


def test_fields_from_the_tables_are_those_of_the_plain_equations(decoder):
    read, field, n_nodes = decoder
    latents = np.random.default_rng(6).standard_normal((4, 3))
    wanted = np.stack([field(z) for z in latents.T])
    off = SINGLE * np.abs(wanted).max()
    np.testing.assert_allclose(read.decode(latents), wanted, rtol=0, atol=off)
    some = np.array([n_nodes - 1, 0, 4])
    np.testing.assert_allclose(read.decode(latents, some), wanted[:, some], rtol=0, atol=off)


def test_a_change_is_the_difference_of_two_fields_with_any_number_of_threads(decoder):
    read, field, _ = decoder
    rng = np.random.default_rng(5)
    latents, code = rng.standard_normal((4, 3)), rng.standard_normal(4)
    wanted = np.stack([field(z) for z in latents.T])
    change = read.change(latents, code)
    np.testing.assert_allclose(change, wanted - field(code), rtol=0, atol=2.0 * SINGLE * np.abs(wanted).max())
    assert np.array_equal(change, read.change(latents, code, threads=3))
    assert np.array_equal(read.decode(latents), read.decode(latents, threads=3))


def test_the_file_is_a_network_by_the_rules_of_onnx(decoder):
    read, _, n_nodes = decoder
    rng = np.random.default_rng(7)
    for rows in (points(rng, 3, n_nodes), sparse.eye_array(n_nodes, format="csr")):
        file, _ = network_at(read, rows)
        model = onnx.load_from_string(file)
        onnx.checker.check_model(model, full_check=True)
        assert model.producer_name == "tissuereg"


def test_fewer_points_cost_fewer_products(tmp_path):
    tables = graph_tables(np.random.default_rng(3), sizes=(3, 9, 50, 400), channels=(8, 6, 4, 3))
    np.savez(tmp_path / "decoder_weights.npz", **tables)
    read = read_decoder(tmp_path / "decoder_weights.npz")
    few, all_nodes = points(np.random.default_rng(1), 2, 400), sparse.eye_array(400, format="csr")
    assert network_at(read, few)[1] < 0.4 * network_at(read, all_nodes)[1]


def test_threads_change_no_bit(decoder):
    read, _, n_nodes = decoder
    rows, latents = points(np.random.default_rng(1), 4, n_nodes), np.random.default_rng(2).standard_normal((4, 130))
    one, three = (CutDecoder(read, rows, threads)(latents) for threads in (1, 3))
    assert np.array_equal(one, three)


def test_the_shipped_network_is_cut_once_for_the_same_points():
    network = NetworkModel(shipped_model_folder(), phantom_mesh(), threads=2)
    rows = points(np.random.default_rng(4), 15, network.n_nodes)
    latents = np.random.default_rng(5).standard_normal((26, 40))
    whole = network.decode(latents)
    made = network.cut(rows)
    wanted = np.stack([rows @ field for field in whole])
    np.testing.assert_allclose(made(latents), wanted, rtol=0, atol=SINGLE * np.abs(whole).max())
    assert network.cut(rows.copy()) is made
    assert network.cut(points(np.random.default_rng(6), 15, network.n_nodes)) is not made


def test_weights_of_another_decoder_are_refused(monkeypatch):
    network = NetworkModel(shipped_model_folder(), phantom_mesh(), threads=1)
    network.tables.components[0] *= 1.01
    with pytest.raises(ModelError, match=r"must give the field of its decoder\.onnx to 0\.0001 of the largest"):
        network.cut(points(np.random.default_rng(4), 15, network.n_nodes))
    monkeypatch.setattr(cut_module, "TOLERANCE", 1.0)
    assert network.cut(points(np.random.default_rng(4), 15, network.n_nodes)) is not None


@pytest.mark.parametrize(
    ("make", "name", "value", "message"),
    [
        (closure_tables, "activation", np.array("gelu"), "`activation` .* one of elu, silu, relu, tanh, got 'gelu'"),
        (closure_tables, "layer1/weight", np.zeros((9, 6)), "layer1/weight"),
        (closure_tables, "layer0/bias", None, "layer0/bias"),
        (closure_tables, "components_mm", np.zeros((4, 12, 3)), "components_mm"),
        (closure_tables, "skip/weight", np.zeros((4, 5)), "skip/weight"),
        (closure_tables, "mean_mm", np.full((12, 3), np.nan), "mean_mm.* must be finite"),
        (graph_tables, "conv1.bases", np.zeros((2, 5, 5)), "conv1.bases"),
        (graph_tables, "conv2.edges", np.full((50, 2), 99), "conv2 .* must lie between nodes of 20 and 8"),
        (graph_tables, "conv2.edges", np.full((50, 2), (0, 8)), "conv2 .* must lie between nodes of 20 and 8"),
        (graph_closure_tables, "layer0/weight", np.zeros((7, 5)), "skip/weight"),
        (graph_closure_tables, "fully_connected.weight", np.zeros((18, 5)), "one number of latents, got 5 and 4"),
        (graph_tables, "levels", np.array([3, 8]), "end in 3 channels"),
        (graph_tables, "scale_mm", np.zeros(2), "scale_mm"),
    ],
)
def test_tables_that_do_not_fit_are_refused_by_name(tmp_path, make, name, value, message):
    tables = make(np.random.default_rng(0))
    if name == "conv2.edges":
        tables["conv2.coefficients"] = np.zeros((50, 2))
    tables[name] = value
    np.savez(tmp_path / "decoder_weights.npz", **{key: array for key, array in tables.items() if array is not None})
    with pytest.raises(ModelError, match=message):
        read_decoder(tmp_path / "decoder_weights.npz")


def test_weights_of_no_known_kind_are_not_cut(tmp_path):
    np.savez(tmp_path / "decoder_weights.npz", error_sizes_mm=np.ones(3))
    assert read_decoder(tmp_path / "decoder_weights.npz") is None


@pytest.mark.parametrize(
    ("members", "sizes"), [(1, [1]), (60, [60]), (61, [31, 30]), (120, [60, 60]), (130, [33, 33, 32, 32])]
)
def test_members_are_run_in_batches_even_in_number_that_do_not_depend_on_threads(members, sizes):
    latents = np.arange(2.0 * members).reshape(2, members)
    for threads in (1, 2, 3):
        seen = {}

        def run(batch, seen=seen):
            seen[float(batch[0, 0])] = len(batch)
            return batch.sum(axis=1)

        found = in_batches(run, latents, 60, threads)
        assert [seen[start] for start in sorted(seen)] == sizes
        np.testing.assert_array_equal(found, latents.sum(axis=0))
