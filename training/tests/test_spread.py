import dataclasses

import numpy as np
import pytest
import torch
from conftest import make_block, smooth_fields

from tissuereg_training.errors import DivergenceError
from tissuereg_training.evaluate import codes
from tissuereg_training.kinds import Material, new_network
from tissuereg_training.losses import reconstruction
from tissuereg_training.pca import moments
from tissuereg_training.settings import ClosureSettings, GraphClosureSettings, GraphSettings
from tissuereg_training.spread import fit_spread

GRAPH = GraphSettings(epochs=2, batch=8, n_latent=4, channels=(4, 8), spread_epochs=3)
CLOSURE = ClosureSettings(
    epochs=2, batch=8, n_latent=4, n_components=10, hidden=(16, 16), encoder_hidden=(16,), spread_epochs=60
)
GRAPH_CLOSURE = GraphClosureSettings(
    epochs=2, batch=8, n_latent=4, n_components=10, hidden=(16,), encoder_hidden=(16,), channels=(4, 8), spread_epochs=3
)


@pytest.fixture(scope="module")
def block():
    return make_block(4, 4, 4)


@pytest.fixture(scope="module")
def fields(block):
    return smooth_fields(block, 60, 1)


@pytest.fixture
def start(block, fields):
    parts = [fields]

    def make(settings):
        return new_network(Material(block.tets, parts, moments(parts)), settings, 0)[0]

    return make


@pytest.mark.parametrize("settings", [GRAPH, CLOSURE, GRAPH_CLOSURE], ids=lambda each: each.kind)
def test_means_and_decoder_stay_bit_for_bit_and_the_same_seed_gives_the_same_spread(start, fields, settings):
    model, again = start(settings), start(settings)
    before = codes(model, fields)
    decoded = model.decode(before[0]).detach().clone()
    history = fit_spread(model, [fields], settings, seed=3)
    after = codes(model, fields)
    if settings is GRAPH:  # a closure's weights are rounded when it is finished
        assert torch.equal(after[0], before[0])
        assert torch.equal(model.decode(after[0]), decoded)
    assert not torch.equal(after[1], before[1])
    assert len(history) == settings.spread_epochs
    assert all(one.requires_grad for one in model.parameters())
    fit_spread(again, [fields], settings, seed=3)
    assert torch.equal(codes(again, fields)[1], after[1])


def test_of_a_linear_decoder_the_spread_is_the_minimum_of_the_loss(start, fields):
    settings = dataclasses.replace(CLOSURE, spread_weight=0.2, spread_epochs=150)
    model = start(settings)
    # The decoder is its linear part alone, so the formula is exact but for the curvature of the square root.
    with torch.no_grad():
        for layer in model.decoder_layers():
            layer.weight.zero_()
            layer.bias.zero_()
    fit_spread(model, [fields], settings, seed=3)
    mean, log_variance = codes(model, fields)
    slopes = model.decoder_skip.weight.detach().numpy().T  # (n_latent, n_components)
    squares = 3.0 * (slopes**2).mean(axis=1)
    x = model.normalised(torch.from_numpy(fields))
    missed = reconstruction(model.decode(mean), x, "rms").item()
    s = np.ones(4)
    for _ in range(500):
        size = np.sqrt(missed**2 + s @ squares)
        s = 0.5 * s + 0.5 / (1.0 + squares / (settings.spread_weight * size))
    found = log_variance.exp().mean(dim=0).numpy()
    np.testing.assert_allclose(found, s, rtol=0.2)
    # A weight that is ten times smaller gives a narrower distribution.
    narrow = start(settings)
    fit_spread(narrow, [fields], dataclasses.replace(settings, spread_weight=0.02), seed=3)
    assert (codes(narrow, fields)[1].mean(dim=0) < log_variance.mean(dim=0)).all()


def test_a_loss_that_is_not_finite_is_said(start, fields):
    model = start(CLOSURE)
    with torch.no_grad():
        model.decoder_skip.weight.fill_(float("nan"))
    with pytest.raises(DivergenceError, match="second stage"):
        fit_spread(model, [fields], CLOSURE, seed=0)
