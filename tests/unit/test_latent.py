"""Principal components as a latent model."""

import numpy as np
import pytest

from tissuereg.errors import EnsembleError
from tissuereg.registration.learned.pca import PcaModel


def fields_of_rank(rank, n_fields, n_nodes=30, seed=0):
    rng = np.random.default_rng(seed)
    shapes = rng.standard_normal((rank, n_nodes, 3)) * np.geomspace(3.0, 0.3, rank)[:, None, None]
    return np.einsum("er,rnx->enx", rng.standard_normal((n_fields, rank)), shapes)


def test_fields_of_low_rank_are_reconstructed_exactly():
    fields = fields_of_rank(4, 60)
    model = PcaModel.fit(fields[10:], fields[:10], centre=np.zeros((30, 3)), n_latent=26, card={})
    assert model.n_latent == 4
    assert model.card["test_error_mm"] < 1e-12


def test_latents_of_the_training_fields_have_unit_second_moment():
    fields = fields_of_rank(5, 80)
    model = PcaModel.fit(fields, fields[:0], centre=np.zeros((30, 3)), n_latent=5, card={})
    latents = np.stack([model.encode(field) for field in fields], axis=1)
    np.testing.assert_allclose(latents @ latents.T / 80, np.eye(5), atol=1e-10)


def test_decoding_some_nodes_equals_rows_of_the_whole():
    fields = fields_of_rank(6, 40)
    model = PcaModel.fit(fields, fields[:0], centre=np.ones((30, 3)), n_latent=3, card={})
    latents = np.random.default_rng(1).standard_normal((3, 7))
    nodes = np.array([4, 1, 22])
    np.testing.assert_allclose(model.decode(latents, nodes), model.decode(latents)[:, nodes], atol=1e-13)


def test_the_first_component_is_the_direction_of_most_motion():
    fields = fields_of_rank(6, 400)
    model = PcaModel.fit(fields, fields[:0], centre=np.zeros((30, 3)), n_latent=6, card={})
    sizes = np.linalg.norm(model.components.reshape(6, -1), axis=1)
    assert (np.diff(sizes) <= 1e-12).all()


def test_one_field_is_no_prior():
    with pytest.raises(EnsembleError, match="at least two simulated fields, got 1"):
        PcaModel.fit(np.zeros((1, 3, 3)), np.zeros((0, 3, 3)), centre=np.zeros((3, 3)), n_latent=2, card={})
