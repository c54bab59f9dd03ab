import copy
import dataclasses

import numpy as np
import pytest
import torch
from conftest import make_block, smooth_fields, split_of

from tissuereg_training.checkpoint import Checkpoint
from tissuereg_training.data import check_split
from tissuereg_training.errors import CheckpointError, DivergenceError, EnsembleError
from tissuereg_training.evaluate import code_spread, codes, mean_error, measured_prior
from tissuereg_training.fit import fit, stalled
from tissuereg_training.kinds import Material, new_network
from tissuereg_training.losses import kl_divergence, kl_share, one_cycle, reconstruction
from tissuereg_training.pca import moments, pca_error, principal_components
from tissuereg_training.settings import ClosureSettings, GraphClosureSettings, GraphSettings

SETTINGS = GraphSettings(epochs=6, batch=8, n_latent=4, channels=(4, 8), kl_weight=1e-3)
CLOSURE = ClosureSettings(
    epochs=6, batch=8, n_latent=4, n_components=10, hidden=(16, 16), encoder_hidden=(16,), kl_weight=1e-3
)
GRAPH_CLOSURE = GraphClosureSettings(
    epochs=6, batch=8, n_latent=4, n_components=10, hidden=(16,), encoder_hidden=(16,), channels=(4, 8), kl_weight=1e-3
)
ALL = pytest.mark.parametrize("settings", [SETTINGS, CLOSURE, GRAPH_CLOSURE], ids=lambda each: each.kind)


class StopError(Exception):
    pass


@pytest.fixture(scope="module")
def block():
    return make_block(4, 4, 4)


@pytest.fixture(scope="module")
def fields(block):
    return smooth_fields(block, 60, 1)


@pytest.fixture
def start(block, fields):
    split = split_of(60, 0)
    parts = [fields[split.train]]

    def make(settings=SETTINGS):
        return new_network(Material(block.tets, parts, moments(parts)), settings, 0)[0], split

    return make


@ALL
def test_a_resumed_training_equals_an_uninterrupted_one(start, fields, tmp_path, monkeypatch, settings):
    settings = dataclasses.replace(settings, mixing=0.5)
    whole, split = start(settings)
    state = fit(whole, [fields[split.train]], fields[split.valid], settings, seed=7)

    killed, _ = start(settings)
    checkpoint = Checkpoint(tmp_path / "c", "same")
    save = Checkpoint.save

    def save_and_stop(self, model, optimiser, state):
        save(self, model, optimiser, state)
        if state.epoch == 4:
            raise StopError

    monkeypatch.setattr(Checkpoint, "save", save_and_stop)
    with pytest.raises(StopError):
        fit(killed, [fields[split.train]], fields[split.valid], settings, seed=7, checkpoint=checkpoint)
    monkeypatch.undo()
    resumed, _ = start(settings)
    again = fit(resumed, [fields[split.train]], fields[split.valid], settings, seed=7, checkpoint=checkpoint)

    assert (again.epoch, again.best_epoch) == (state.epoch, state.best_epoch) == (6, state.best_epoch)
    for a, b in zip(whole.parameters(), resumed.parameters(), strict=True):
        torch.testing.assert_close(a, b, rtol=0, atol=0)  # the same bits
    assert [r["valid_mm"] for r in again.history] == [r["valid_mm"] for r in state.history]


def test_checkpoints_of_another_run_or_spoilt_ones_are_refused(start, fields, tmp_path):
    model, split = start()
    settings = dataclasses.replace(SETTINGS, epochs=1)
    fit(model, [fields[split.train]], fields[split.valid], settings, seed=0, checkpoint=Checkpoint(tmp_path, "mine"))
    with pytest.raises(CheckpointError, match="another run's"):
        fit(
            model,
            [fields[split.train]],
            fields[split.valid],
            settings,
            seed=0,
            checkpoint=Checkpoint(tmp_path, "yours"),
        )
    (tmp_path / "last.pt").write_bytes(b"spoilt")
    with pytest.raises(CheckpointError, match="whole checkpoint"):
        fit(
            model, [fields[split.train]], fields[split.valid], settings, seed=0, checkpoint=Checkpoint(tmp_path, "mine")
        )


@ALL
def test_the_best_validation_epoch_after_the_warm_up_is_kept(start, fields, settings):
    model, split = start(settings)
    state = fit(model, [fields[split.train]], fields[split.valid], settings, seed=0)
    allowed = {r["epoch"]: r["valid_mm"] for r in state.history if kl_share(int(r["epoch"]) - 1, 6, 0.3) == 1.0}
    assert state.best_epoch == min(allowed, key=allowed.get)
    assert min(allowed) == 2
    # A finished closure has small weights in half precision: 11 bits.
    near = 1e-6 if model.kind == "gnn-vae" else 1e-3
    assert mean_error(model, fields[split.valid]) == pytest.approx(allowed[state.best_epoch], rel=near)


def test_a_training_that_gets_no_better_ends_after_its_patience_also_when_it_is_resumed(
    start, fields, tmp_path, monkeypatch
):
    settings = dataclasses.replace(CLOSURE, epochs=20, kl_warmup=0.1, patience=3)
    errors = [9.0, 5.0, 4.0, 6.0, 6.0, 6.0, 1.0]  # the first two epochs warm up; the best of the others is the third
    monkeypatch.setattr("tissuereg_training.fit.mean_error", lambda *_: errors[len(seen)])
    seen = []
    save = Checkpoint.save

    def count(self, model, optimiser, state):
        seen.append(state.epoch)
        save(self, model, optimiser, state)

    monkeypatch.setattr(Checkpoint, "save", count)
    for _ in range(2):
        model, split = start(settings)
        parts, valid = [fields[split.train]], fields[split.valid]
        state = fit(model, parts, valid, settings, seed=0, checkpoint=Checkpoint(tmp_path, "mine"))
        assert (state.epoch, state.best_epoch, state.best_error) == (6, 3, 4.0)
    assert seen == [1, 2, 3, 4, 5, 6]
    assert stalled(state, settings)
    assert not stalled(state, dataclasses.replace(settings, patience=0))


@ALL
def test_the_same_seed_gives_the_same_network_and_another_seed_another(start, fields, settings):
    ends = []
    for seed in (0, 0, 1):
        model, split = start(settings)
        fit(model, [fields[split.train]], fields[split.valid], dataclasses.replace(settings, epochs=2), seed=seed)
        ends.append(torch.cat([p.detach().ravel() for p in model.parameters()]))
    assert torch.equal(ends[0], ends[1])
    assert not torch.equal(ends[0], ends[2])


def test_a_loss_that_leaves_the_finite_numbers_is_reported(start, fields):
    model, split = start()
    with torch.no_grad():
        model.fully_connected.bias[0] = torch.nan
    with pytest.raises(DivergenceError, match="loss must stay finite"):
        fit(model, [fields[split.train]], fields[split.valid], SETTINGS, seed=0)


def test_equal_fields_are_refused(fields):
    with pytest.raises(DivergenceError, match="all the same"):
        moments([np.repeat(fields[:1], 40, axis=0)])


def test_moments_of_parts_are_those_of_the_whole(fields):
    found = moments([fields[:7], fields[7:8], fields[8:]])
    assert found.n_fields == 60
    np.testing.assert_allclose(found.mean, fields.mean(axis=0, dtype=np.float64), atol=1e-12)
    assert found.scale == pytest.approx(np.sqrt(np.mean((fields - found.mean) ** 2)), rel=1e-12)


def test_a_field_is_not_centred_on_itself(start, fields):
    model, _ = start()
    shift = np.array([5.0, 0.0, 0.0], np.float32)
    there, moved = (codes(model, fields[:3] + s)[0] for s in (0.0 * shift, shift))
    assert (there - moved).abs().max() > 1e-3
    x = model.normalised(torch.from_numpy(fields[:3] + shift)) - model.normalised(torch.from_numpy(fields[:3]))
    torch.testing.assert_close(x[..., 0], torch.full((3, 64), 5.0) / model.scale_mm, rtol=1e-4, atol=1e-4)


def test_kl_draws_the_codes_towards_the_unit_gaussian(start, fields):
    ends = {}
    for weight in (1e-6, 1e-2):
        settings = dataclasses.replace(SETTINGS, kl_weight=weight, kl_warmup=0.0, epochs=250)
        model, split = start(settings)
        history = fit(model, [fields[split.train]], fields[split.valid], settings, seed=0).history
        spread = code_spread(model, fields[split.train], 0)
        ends[weight] = (history[-1]["kl"], spread["aggregate_std_mean"])
    assert ends[1e-2][0] < 0.6 * ends[1e-6][0]
    # Means and variances together have the prior's spread, though the means alone have not.
    assert ends[1e-2][1] == pytest.approx(1.0, abs=0.15)


def test_kl_is_that_of_two_gaussians_and_zero_at_the_prior():
    assert kl_divergence(torch.zeros(2, 3), torch.zeros(2, 3)).tolist() == [0, 0, 0]
    mean, log_variance = torch.tensor([[0.7]]), torch.tensor([[-1.2]])
    q = torch.distributions.Normal(mean, torch.exp(0.5 * log_variance))
    wanted = torch.distributions.kl_divergence(q, torch.distributions.Normal(0.0, 1.0))
    torch.testing.assert_close(kl_divergence(mean, log_variance), wanted.ravel())


def test_schedules_start_low_peak_once_and_end_at_nothing():
    rates = np.array([one_cycle(s, 200, 2e-3, 0.3) for s in range(200)])
    assert rates.max() == pytest.approx(2e-3, rel=1e-3)
    assert 55 <= rates.argmax() <= 65
    assert rates[0] == pytest.approx(8e-5)
    assert rates[-1] < 1e-6
    assert (np.diff(np.sign(np.diff(rates))) != 0).sum() == 1
    assert [kl_share(e, 10, 0.4) for e in (0, 1, 2, 4, 9)] == [0.0, 0.25, 0.5, 1.0, 1.0]
    assert one_cycle(0, 1, 2e-3, 0.3) > 0
    assert kl_share(0, 10, 0.0) == kl_share(0, 1, 0.3) == kl_share(9, 10, 0.99) == 1.0


def test_reconstruction_terms_are_what_they_are_called():
    found, wanted = torch.zeros(1, 2, 3), torch.tensor([[[3.0, 0.0, 4.0], [0.0, 0.0, 0.0]]])
    assert reconstruction(found, wanted, "distance").item() == pytest.approx(2.5, abs=1e-3)
    assert reconstruction(found, wanted, "squared").item() == pytest.approx(25 / 6)


def test_mismatch_is_measured_about_zero_and_replaced_by_the_spread_where_there_are_no_pairs(start, fields):
    model, split = start()
    simulated, true = fields[:9], fields[20:29]
    prior = measured_prior(model, fields[split.train], simulated, true)
    apart = (codes(model, true)[0] - codes(model, simulated)[0]).numpy()
    np.testing.assert_allclose(prior["mismatch_covariance"], apart.T @ apart / 9, rtol=1e-4, atol=1e-7)
    mean, log_variance = codes(model, fields[split.train])
    wanted = np.cov(mean.numpy().T) + np.diag(np.exp(log_variance.numpy()).mean(axis=0))
    np.testing.assert_allclose(prior["covariance"], wanted, rtol=1e-4, atol=1e-6)
    alone = measured_prior(model, fields[split.train], simulated[:0], true[:0])
    assert alone["mismatch_covariance"] == alone["covariance"]
    assert alone["mismatch_pairs"] == 0


def test_components_are_those_of_the_singular_value_decomposition_in_whatever_parts_the_fields_come():
    rng = np.random.default_rng(0)
    fields = (rng.normal(size=(300, 60)) * 0.9 ** np.arange(60) + 2.0).reshape(300, 20, 3).astype(np.float32)
    about = moments([fields])
    _, _, v = np.linalg.svd((fields - about.mean).reshape(300, -1), full_matrices=False)
    found = principal_components([fields[:150], fields[150:]], about, 5)[0].reshape(5, -1)
    # Single precision, and passes that end when the variance gains less than 1e-7: angles of its root.
    np.testing.assert_allclose(np.abs(found @ v[:5].T), np.eye(5), atol=2e-3)
    np.testing.assert_allclose(found @ found.T, np.eye(5), atol=1e-5)
    assert (found[np.arange(5), np.abs(found).argmax(axis=1)] > 0).all()


def test_components_reconstruct_what_they_span_and_miss_what_they_do_not():
    rng = np.random.default_rng(0)
    low = (rng.normal(size=(30, 3)) @ rng.normal(size=(3, 60)) + 2.0).reshape(30, 20, 3).astype(np.float32)
    about = moments([low[:20]])
    assert pca_error(principal_components([low[:20]], about, 3)[0], about.mean, low[20:]) < 1e-5
    still = np.linalg.norm(low[20:] - about.mean, axis=2).mean()
    assert pca_error(np.empty((0, 20, 3), np.float32), about.mean, low[20:]) == pytest.approx(still)
    # 20 fields about their mean span 19 directions: more cannot be found.
    assert principal_components([low[:20]], about, 50)[0].shape == (20, 20, 3)


def test_too_small_a_split_is_refused():
    check_split(split_of(300, 4), 26)
    for n in (5, 32):
        with pytest.raises(EnsembleError, match=f"got {n} members"):
            check_split(split_of(n, 0), 26)


def test_a_start_depends_on_the_seed_alone(start):
    torch.manual_seed(1)
    first = copy.deepcopy(start()[0].state_dict())
    torch.manual_seed(2)
    for name, value in start()[0].state_dict().items():
        assert torch.equal(value, first[name])


def test_a_checkpoint_of_table_ii_is_known_by_the_keys_that_it_was_begun_with():
    begun_with = {
        "epochs", "batch", "learning_rate", "rise", "loss", "kl_weight", "kl_warmup", "mixing", "n_latent", "channels",
        "n_bases", "coarse_edges", "gradient_limit",
    }  # fmt: skip
    assert set(GraphSettings().identity()) == begun_with
    assert set(GraphSettings(patience=3).identity()) == begun_with | {"patience"}
    assert ClosureSettings().identity()["kind"] == "closure"
    assert GraphClosureSettings(error_fields=3, spread_epochs=9).identity() == GraphClosureSettings().identity()
