"""The closure: what its coefficients mean, and what its exported files say."""

import dataclasses

import numpy as np
import pytest
import torch

from tissuereg_training.closure_export import decoder_onnx, decoder_weights, encoder_onnx
from tissuereg_training.errors import EnsembleError, ParityError
from tissuereg_training.evaluate import codes, decoded
from tissuereg_training.kinds import Material, new_network
from tissuereg_training.losses import reconstruction
from tissuereg_training.parity import checked_parity, onnx_session
from tissuereg_training.pca import moments, pca_error, principal_components
from tissuereg_training.settings import ClosureSettings

SETTINGS = ClosureSettings(n_latent=6, n_components=20, hidden=(16, 24), encoder_hidden=(12,))


@pytest.fixture(scope="module", params=["elu", "silu"])
def model(request, block, fields):
    settings = dataclasses.replace(SETTINGS, activation=request.param)
    model, _ = new_network(Material(block.tets, [fields], moments([fields])), settings, 0)
    with torch.no_grad():
        model.log_variance_head.weight.normal_(std=0.1)
    model.finish()
    return model


def test_training_starts_at_as_many_principal_components_as_latents(block, fields):
    model, _ = new_network(Material(block.tets, [fields], moments([fields])), SETTINGS, 0)
    given = torch.from_numpy(fields)
    with torch.no_grad():
        for last in (model.mean_head, model.decoder[-1]):
            last.weight.zero_()
        mean, _ = model.encode(model.normalised(given))
        missed = (model.in_mm(model.decode(mean)) - given).norm(dim=2).mean().item()
    np.testing.assert_allclose(mean.std(dim=0, correction=0), np.ones(6), rtol=1e-3)
    about = moments([fields])
    assert missed == pytest.approx(pca_error(principal_components([fields], about, 6)[0], about.mean, fields), rel=1e-3)


def test_coefficients_there_and_back_are_the_projection_on_the_components(model, fields):
    given = torch.from_numpy(fields)
    missed = (model.in_mm(model.normalised(given)) - given).norm(dim=2).mean().item()
    about = moments([fields])
    # Few components are kept in half precision: 11 bits.
    assert missed == pytest.approx(
        pca_error(principal_components([fields], about, 20)[0], about.mean, fields), rel=1e-3
    )


def test_an_error_of_coefficients_is_the_error_of_the_field(model):
    found, wanted = torch.randn(2, 9, 20)
    apart = (model.in_mm(found) - model.in_mm(wanted)) / model.scale_mm
    # Components are orthogonal to half precision.
    assert reconstruction(found, wanted, "squared").item() == pytest.approx(apart.square().mean().item(), rel=1e-3)
    rms = apart.square().sum(dim=2).mean(dim=1).sqrt().mean().item()
    assert reconstruction(found, wanted, "rms").item() == pytest.approx(rms, rel=1e-3)


def test_onnx_says_what_torch_says(model, fields):
    apart = checked_parity(model, encoder_onnx(model, {}), decoder_onnx(model, {}), fields[:5], 0)
    # Single precision in another order of sums: some 1e-6; the limit is 1e-4.
    assert 0 < apart["encoder"] < 2e-5
    assert 0 < apart["decoder"] < 2e-5


def test_weights_that_are_not_those_of_the_files_are_refused(model, fields):
    encoder, decoder = encoder_onnx(model, {}), decoder_onnx(model, {})
    before = {name: value.clone() for name, value in model.state_dict().items()}
    with torch.no_grad():
        model.decoder[0].weight[0, 0] += 0.5
    with pytest.raises(ParityError, match="exported decoder is off by"):
        checked_parity(model, encoder, decoder, fields[:5], 0)
    model.load_state_dict(before)


def test_the_decoder_can_be_rebuilt_in_numpy_from_the_exported_arrays(model, tmp_path):
    np.savez(tmp_path / "w.npz", **decoder_weights(model))
    with np.load(tmp_path / "w.npz", allow_pickle=False) as archive:
        weights = {name: archive[name] for name in archive}
    activation = {
        "elu": lambda x: np.where(x > 0, x, np.expm1(np.minimum(x, 0))),
        "silu": lambda x: x / (1 + np.exp(-x)),
    }
    z = np.random.default_rng(0).normal(size=(3, 6)).astype(np.float32)
    y, depth = z.astype(np.float64), sum(name.startswith("layer") for name in weights) // 2
    for k in range(depth):
        y = y @ weights[f"layer{k}/weight"].astype(np.float64).T + weights[f"layer{k}/bias"]
        y = activation[str(weights["activation"])](y) if k < depth - 1 else y
    y += z @ weights["skip/weight"].astype(np.float64).T
    wanted = weights["mean_mm"] + np.einsum("bk,knx->bnx", y, weights["components_mm"].astype(np.float64))
    found = onnx_session(decoder_onnx(model, {})).run(None, {"z": z})[0]
    np.testing.assert_allclose(found, wanted, atol=1e-5 * np.abs(wanted).max())


def test_chosen_nodes_are_rows_of_the_full_decode(model):
    session = onnx_session(decoder_onnx(model, {}))
    z = torch.randn(7, 6)
    full = session.run(None, {"z": z.numpy()})[0]
    np.testing.assert_allclose(full, decoded(model, z), atol=1e-5 * np.abs(full).max())
    assert [i.name for i in session.get_overridable_initializers()] == ["nodes"]
    for nodes in ([3], [140, 2, 2, 77], range(150)):
        some = session.run(None, {"z": z.numpy(), "nodes": np.array(nodes, np.int64)})[0]
        np.testing.assert_allclose(some, full[:, nodes], atol=1e-6 * np.abs(full).max())


def test_the_encoder_takes_any_batch(model, fields):
    session = onnx_session(encoder_onnx(model, {}))
    mean, log_variance = codes(model, fields[:4])
    for rows in (slice(0, 1), slice(0, 4)):
        found = session.run(["mean", "log_variance"], {"displacement": fields[rows]})
        np.testing.assert_allclose(found[0], mean[rows], atol=1e-5)
        np.testing.assert_allclose(found[1], log_variance[rows], atol=1e-5)


def test_components_are_stored_once_a_file_and_in_half_precision(model):
    for proto in (encoder_onnx(model, {}), decoder_onnx(model, {})):
        sizes = sorted(np.prod(t.dims) for t in proto.graph.initializer)
        assert sizes[-1] == 20 * 150 * 3
        assert sizes[-2] < sizes[-1]
        assert proto.ByteSize() < 2 * 20 * 150 * 3 + 4 * 150 * 3 + 8 * 150 + 6000


def test_more_components_than_fields_are_refused(block, fields):
    few = fields[:20]
    with pytest.raises(EnsembleError, match="more than 20 training fields, got 20"):
        new_network(Material(block.tets, [few], moments([few])), SETTINGS, 0)
