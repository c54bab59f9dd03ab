"""The models that ship with the package: for the full phantom, according to their files and on fields of their kind."""

import json

import numpy as np
import pytest

from tissuereg.phantom import SHIPPED_MODELS, phantom_mesh, shipped_model_folder
from tissuereg.phantom.event import make_event
from tissuereg.registration.learned.card import card_text
from tissuereg.registration.learned.decoders import ClosureDecoder, GraphDecoder
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.simulation.solve import simulate

#: Kind, decoder, largest folder in MB, and largest motion of held nodes in mm, of each. What is held has zeros in all
#: data: components keep them, a graph network learns them.
WANTED = {
    "phantom": ("closure", ClosureDecoder, 13.0, 1e-5),
    "phantom-graph": ("graph-closure", GraphDecoder, 5.0, 1e-3),
}


@pytest.fixture(scope="module", params=SHIPPED_MODELS)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def folder(name):
    return shipped_model_folder(name)


@pytest.fixture(scope="module")
def card(folder):
    return json.loads((folder / "model.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def network(folder):
    return NetworkModel(folder, phantom_mesh(), threads=2)


def test_it_is_of_its_kind_with_26_latents_and_calibrated(name, card, network):
    kind, decoder, *_ = WANTED[name]
    assert card["kind"] == network.card["kind"] == kind
    assert isinstance(network.tables, decoder)
    assert network.n_latent == 26
    assert network.calibration.change is not None
    assert len(network.calibration.alone.calibration_set) > 500


def test_its_folder_is_small_and_holds_nothing_else(name, folder):
    files = list(folder.iterdir())
    whole = {"encoder.onnx", "decoder.onnx", "decoder_weights.npz", "calibration.npz"}
    whole |= {"model.json", "MODEL.md", "training.png"}
    assert {file.name for file in files if file.suffix != ".npy"} == whole
    assert sum(file.stat().st_size for file in files) < WANTED[name][2] * 1e6


def test_the_card_has_test_errors_below_those_of_principal_components(card, network):
    errors = card["errors_mm"]
    assert errors["train"] > 0
    assert 0 < errors["test"] <= 0.15 < errors["pca"]
    assert network.card["test_error_mm"] == errors["test"]
    assert network.card["pca26_test_error_mm"] == errors["pca"]
    assert max(card["parity"].values()) <= 1e-4


def test_the_card_is_written_with_a_row_of_a_matrix_a_line(card, folder):
    assert card_text(card) == (folder / "model.json").read_text(encoding="utf-8")
    assert card_text({"a": [[1.0, 2], []], "b": {"c": {}, "d": []}, "e": []}) == (
        '{\n "a": [\n  [1.0, 2],\n  []\n ],\n "b": {\n  "c": {},\n  "d": []\n },\n "e": []\n}\n'
    )


def test_some_nodes_equal_rows_of_the_whole(network):
    latents = np.random.default_rng(0).standard_normal((26, 60))
    nodes = np.array([7, 4200, 33])
    # Single precision: sums over another grouping of the same terms.
    np.testing.assert_allclose(network.decode(latents, nodes), network.decode(latents)[:, nodes], atol=2e-4)


def test_threads_change_no_bit(folder):
    latents = np.random.default_rng(1).standard_normal((26, 60))
    fields = [NetworkModel(folder, phantom_mesh(), threads=t).decode(latents) for t in (1, 2)]
    assert np.array_equal(fields[0], fields[1])


def test_a_simulation_is_coded_and_decoded_to_within_a_tenth_of_its_motion(network):
    event = make_event(seed=0)
    field = simulate(event.mesh, event.load, event.material).displacement
    mean, variance = network.encode(field)
    off = network.decode(mean[:, None])[0] - field
    assert np.linalg.norm(off, axis=1).mean() < 0.1 * np.linalg.norm(field, axis=1).mean()
    # Wide enough for an ensemble that is drawn from it to leave the simulation.
    assert np.median(np.sqrt(variance)) > 0.3


def test_what_is_held_stays(name, network):
    held = phantom_mesh().fixed_nodes
    fields = network.decode(np.random.default_rng(2).standard_normal((26, 60)), held)
    assert np.abs(fields).max() < WANTED[name][3]
