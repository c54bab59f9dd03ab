"""The model that ships with the package: for the full phantom, according to its files and on fields of its own kind."""

import json

import numpy as np
import pytest

from tissuereg.phantom import phantom_mesh, shipped_model_folder
from tissuereg.phantom.event import make_event
from tissuereg.registration.learned.card import card_text
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.simulation.solve import simulate

FOLDER = shipped_model_folder()
CARD = json.loads((FOLDER / "model.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def network():
    return NetworkModel(FOLDER, phantom_mesh(), threads=2)


def test_it_is_a_closure_of_principal_components_with_26_latents(network):
    assert CARD["kind"] == network.card["kind"] == "closure"
    assert network.n_latent == 26
    with np.load(FOLDER / "decoder_weights.npz") as weights:
        assert weights["mean_mm"].shape == (network.n_nodes, 3)
        assert "components_mm" not in weights
    assert np.load(FOLDER / "components_mm.npy").shape == (CARD["n_components"], network.n_nodes, 3)


def test_its_folder_is_smaller_than_20_mb_and_holds_nothing_else():
    files = list(FOLDER.iterdir())
    networks = {"encoder.onnx", "decoder.onnx", "decoder_weights.npz", "components_mm.npy", "calibration.npz"}
    assert {file.name for file in files} == networks | {"model.json", "MODEL.md", "training.png"}
    assert sum(file.stat().st_size for file in files) < 20_000_000


def test_the_card_has_test_errors_below_those_of_principal_components(network):
    errors = CARD["errors_mm"]
    assert errors["train"] > 0
    assert 0 < errors["test"] < errors["pca"]
    assert network.card["test_error_mm"] == errors["test"]
    assert network.card["pca26_test_error_mm"] == errors["pca"]
    assert max(CARD["parity"].values()) <= 1e-4


def test_the_card_is_written_with_a_row_of_a_matrix_a_line():
    assert card_text(CARD) == (FOLDER / "model.json").read_text(encoding="utf-8")
    assert card_text({"a": [[1.0, 2], []], "b": {"c": {}, "d": []}, "e": []}) == (
        '{\n "a": [\n  [1.0, 2],\n  []\n ],\n "b": {\n  "c": {},\n  "d": []\n },\n "e": []\n}\n'
    )


def test_some_nodes_equal_rows_of_the_whole(network):
    latents = np.random.default_rng(0).standard_normal((26, 60))
    nodes = np.array([7, 4200, 33])
    # Single precision: sums over another grouping of the same terms.
    np.testing.assert_allclose(network.decode(latents, nodes), network.decode(latents)[:, nodes], atol=2e-4)


def test_threads_change_no_bit():
    latents = np.random.default_rng(1).standard_normal((26, 60))
    fields = [NetworkModel(FOLDER, phantom_mesh(), threads=t).decode(latents) for t in (1, 2)]
    assert np.array_equal(fields[0], fields[1])


def test_a_simulation_is_coded_and_decoded_to_within_a_tenth_of_its_motion(network):
    event = make_event(seed=0)
    field = simulate(event.mesh, event.load, event.material).displacement
    mean, variance = network.encode(field)
    off = network.decode(mean[:, None])[0] - field
    assert np.linalg.norm(off, axis=1).mean() < 0.1 * np.linalg.norm(field, axis=1).mean()
    assert (variance > 0).all()


def test_what_is_held_stays(network):
    held = phantom_mesh().fixed_nodes
    fields = network.decode(np.random.default_rng(2).standard_normal((26, 60)), held)
    # Every member of its data has zeros there.
    assert np.abs(fields).max() < 1e-5
