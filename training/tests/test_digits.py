"""Large tables in digits: what is rounded, how far, and that nothing is lost between rounding and file."""

import numpy as np
import pytest
import torch

from tissuereg_training.digits import (
    COMPONENTS_MM,
    ERROR_STEP,
    LARGE,
    WEIGHT_STEP,
    rounded,
    rounded_rows,
    split,
    stored,
)
from tissuereg_training.errors import ParityError
from tissuereg_training.kinds import KINDS, Material, new_network
from tissuereg_training.parity import checked_parity
from tissuereg_training.pca import moments
from tissuereg_training.settings import ClosureSettings, GraphClosureSettings


def joined(digits, exponents):
    """Return the table of digits, as the module's page defines it."""
    places = 2.0 ** (exponents.astype(float) + 8 * np.arange(len(digits))[:, None])
    return (places.reshape(*places.shape, *(1,) * (digits.ndim - 2)) * digits).sum(axis=0)


@pytest.fixture
def table():
    """Rows of very different size, 300 numbers each, one of them zero."""
    rows = (
        torch.randn(200, 100, 3, generator=torch.Generator().manual_seed(0)) * torch.logspace(-4, 3, 200)[:, None, None]
    )
    rows[7] = 0.0
    return rows


def test_rounding_errs_by_half_a_step_at_most_and_the_step_is_the_power_of_two_next_to_the_wanted(table):
    step = torch.full((200,), 0.1)
    found = rounded(table, step)
    assert (found - table).abs().max() <= 0.5 * 0.125  # 0.1 lies between 1/16 and 1/8, nearer to 1/8 as a power
    numbers = found[150].flatten() / 0.125
    assert (numbers == numbers.round()).all()
    assert (numbers.round() % 2 == 1).any()


def test_a_row_whose_largest_number_needs_a_third_digit_gets_larger_steps(table):
    found = rounded(table, torch.full((200,), 1e-3))
    assert (found - table).abs().amax(dim=(1, 2))[-1] > 1e-3
    digits, _ = split(found.numpy())
    assert len(digits) == 2


@pytest.mark.parametrize("share", [WEIGHT_STEP, ERROR_STEP])
def test_what_is_rounded_is_stored_whole(table, share):
    found = rounded_rows(table, share).numpy()
    parts = stored("t", found)
    assert set(parts) == {"t", "t.exponents"}
    assert parts["t"].dtype == parts["t.exponents"].dtype == np.int8
    np.testing.assert_array_equal(joined(parts["t"], parts["t.exponents"]), found)
    assert parts["t.exponents"][7] == 0  # of the row of zeros, in all precisions
    # A step's variance is a twelfth of its square; the step lies within a factor of the root of two of the wanted.
    off = np.sqrt(
        ((found - table.numpy()) ** 2).mean(axis=(1, 2)) / np.maximum((table.numpy() ** 2).mean(axis=(1, 2)), 1e-30)
    )
    wanted = share / np.sqrt(12)
    assert off.max() < 1.5 * wanted
    assert np.median(off) > 0.6 * wanted


def test_small_tables_and_those_that_digits_do_not_hold_are_stored_in_half_precision(table):
    few = rounded_rows(table[:60], WEIGHT_STEP)
    assert few.numel() < LARGE
    assert stored("t", few.numpy())["t"].dtype == np.float16
    np.testing.assert_array_equal(stored("t", few.numpy())["t"], few.numpy())
    assert split(table.numpy()) is None  # 24 bits a number
    with pytest.raises(ParityError, match="must be rounded before it is stored"):
        stored("t", table.numpy())


def test_digits_reach_from_the_least_to_the_largest_two_of_them_hold():
    most = 127 * 256 + 127
    numbers = np.resize(np.array([most, -most, 127, 128, -128, -129, 0, 1], np.float32), (2, LARGE))
    for array, n_digits in ((numbers, 2), (np.clip(numbers, -128, 127), 1)):
        digits, exponents = split(array * np.float32(0.25))
        assert len(digits) == n_digits
        assert (exponents == -2).all()
        np.testing.assert_array_equal(joined(digits, exponents), 0.25 * array)
    assert split(np.resize(np.array([most + 2, 1], np.float32), (2, LARGE))) is None


SIZES = {"n_latent": 6, "n_components": 20, "hidden": (16, 24), "encoder_hidden": (12,)}
SETTINGS = [ClosureSettings(**SIZES), GraphClosureSettings(channels=(5, 8), n_bases=3, **SIZES)]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: settings.kind)
def test_a_network_in_digits_says_what_torch_says(settings, block, fields, monkeypatch):
    monkeypatch.setattr("tissuereg_training.digits.LARGE", 50)
    model, _ = new_network(Material(block.tets, [fields], moments([fields])), settings, 0)
    with torch.no_grad():
        model.decoder[0].weight[3] = 0.0
    model.finish()
    kind = KINDS[settings.kind]
    encoder, decoder = kind.encoder_onnx(model, {}), kind.decoder_onnx(model, {})
    for network in (encoder, decoder):
        assert sum(one.name.endswith("/digits") for one in network.graph.initializer) >= 3
    assert max(checked_parity(model, encoder, decoder, fields[:5], 0).values()) < 2e-5
    weights = kind.decoder_weights(model)
    for name, table in model.named_buffers():
        if name == "components_mm":
            np.testing.assert_array_equal(joined(weights[name], weights[f"{name}.exponents"]), table)


def test_components_are_rounded_so_that_fields_err_by_what_is_stated(block, fields, monkeypatch):
    about = moments([fields])
    exact, _ = new_network(Material(block.tets, [fields], about), SETTINGS[0], 0)
    monkeypatch.setattr("tissuereg_training.digits.LARGE", 50)
    model, _ = new_network(Material(block.tets, [fields], about), SETTINGS[0], 0)
    with torch.no_grad():
        coefficients = exact.normalised(torch.from_numpy(fields))
        off = model.in_mm(coefficients) - exact.in_mm(coefficients)
    # Powers of two next to the wanted steps; and the other one is in half precision, itself off by some micrometres.
    assert off.square().sum(dim=2).mean().sqrt().item() == pytest.approx(COMPONENTS_MM, rel=0.5)
