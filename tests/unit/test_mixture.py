"""Kinds of events, and Bayes' rule under a mixture of them, against closed forms and heavy-tailed events."""

import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2, multivariate_normal

from support.meshes import block
from support.mixtures import closed_form, decoder
from support.small_model import SMALL_MODEL
from tissuereg.errors import FormatError, ModelError, NoiseError
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.calibrate import RehearsalSettings, _folds, calibrate, field_errors
from tissuereg.registration.learned.calibration import Calibration, FieldErrors, Rehearsal
from tissuereg.registration.learned.calibration_file import write_calibration
from tissuereg.registration.learned.components import Components
from tissuereg.registration.learned.mixture import Component, Evidence, LinearDecoder, log_noise_odds
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.pca import PcaModel
from tissuereg.registration.learned.smoother import Screening, normals, smooth
from tissuereg.registration.settings import SmootherSettings


def spread_matrix(size, rng):
    root = rng.standard_normal((size, size + 3))
    return root @ root.T / size


def one_component(rng, n_latent=4, n_rows=9, scales=(1.0,)):
    scales = np.array(scales)
    return Component(
        np.full(len(scales), 1.0 / len(scales)),
        scales,
        rng.standard_normal(n_latent),
        spread_matrix(n_latent, rng),
        0.3 * spread_matrix(n_rows, rng),
    )


def answer(prior, linear, observed, noise):
    """Return the posterior of all pairs by ES-MDA with a linear decoder."""
    every, n_latent = np.arange(sum(len(one.scales) for one in prior)), len(linear.point)
    draws, alphas = normals(0, n_latent, 30), SmootherSettings().alphas()
    return smooth(decoder(linear), prior, every, observed, noise, draws, alphas)


def test_kinds_of_very_different_size_are_told_apart():
    rng = np.random.default_rng(0)
    small, large = 0.05 * rng.standard_normal((600, 5)), 3.0 * rng.standard_normal((300, 5))
    kinds = Components.fit(np.concatenate([small, large]), 2, seed=0)
    order = np.argsort(np.trace(kinds.covariances, axis1=1, axis2=2))
    # A share of 900 codes is exact to 1.6 %, a variance of 300 x 5 numbers to 3.7 %; three standard errors.
    np.testing.assert_allclose(kinds.weights[order], [2 / 3, 1 / 3], atol=0.05)
    np.testing.assert_allclose(np.trace(kinds.covariances[order[1]]) / 5, 9.0, rtol=0.12)
    assert kinds.shares(small[:50])[:, order[0]].min() > 0.9


def test_one_component_gives_the_conditional_of_its_joint_gaussian():
    rng = np.random.default_rng(1)
    one, slopes, at = one_component(rng), rng.standard_normal((9, 4)), rng.standard_normal(9)
    point, observed, noise = rng.standard_normal(4), rng.standard_normal(5), 0.2 * spread_matrix(5, rng)
    found = answer([one], LinearDecoder(point, at, slopes), observed, noise)
    joint = slopes @ one.covariance @ slopes.T + one.errors
    total = joint[:5, :5] + noise
    prior = at + slopes @ (one.mean - point)
    gain = np.linalg.solve(total, joint[:5]).T
    np.testing.assert_allclose(found.mean, prior + gain @ (observed - prior[:5]), atol=1e-9)
    np.testing.assert_allclose(found.covariance, joint - gain @ total @ gain.T, atol=1e-9)


def test_a_mixture_is_that_of_brute_force_on_a_grid():
    # One latent, one marker, one target, no error: p(z | y) on a fine grid.
    parts = [
        Component(np.array([0.7, 0.1]), np.array([0.5, 2.0]), np.array([-1.0]), np.array([[0.5]]), np.zeros((2, 2))),
        Component(np.array([0.1, 0.1]), np.array([0.5, 2.0]), np.array([2.0]), np.array([[1.5]]), np.zeros((2, 2))),
    ]
    observed, noise = np.array([1.2]), np.array([[0.09]])
    found = answer(parts, LinearDecoder(np.zeros(1), np.zeros(2), np.array([[1.0], [2.0]])), observed, noise)
    z = np.linspace(-15.0, 15.0, 60_001)
    density = np.zeros_like(z)
    for one in parts:
        for weight, scale in zip(one.weights, one.scales, strict=True):
            variance = scale**2 * one.covariance[0, 0]
            density += weight * np.exp(-0.5 * (z - one.mean[0]) ** 2 / variance) / np.sqrt(variance)
    density *= np.exp(-0.5 * (z - observed[0]) ** 2 / noise[0, 0])
    density /= density.sum()
    mean = 2.0 * density @ z
    assert found.mean[1] == pytest.approx(mean, abs=1e-6)
    assert found.covariance[1, 1] == pytest.approx(4.0 * density @ (z - mean / 2.0) ** 2, rel=1e-6)


def test_lost_members_are_numbered_through_all_pairs():
    rng = np.random.default_rng(12)
    prior = [one_component(rng), one_component(rng)]
    draws, decoded = normals(0, 4, 30), LinearDecoder(np.zeros(4), np.zeros(9), rng.standard_normal((9, 4)))

    def spoilt(latents):
        rows = decoder(decoded)(latents)
        if latents.shape[1] == 60:
            rows[[7, 40]] = np.nan
        return rows

    alphas = SmootherSettings().alphas()
    found = smooth(spoilt, prior, np.arange(2), np.zeros(5), 0.2 * np.eye(5), draws, alphas, threads=2)
    assert [number for number, _ in found.dropped] == [7, 40]
    assert [pair.latents.shape[1] for pair in found.pairs] == [29, 29]


def test_an_error_that_markers_see_is_taken_out_of_the_target():
    # The decoder knows nothing; marker and target share their error.
    one = Component(np.ones(1), np.ones(1), np.zeros(1), np.full((1, 1), 1e-12), np.array([[1.0, 0.9], [0.9, 1.0]]))
    found = answer(
        [one], LinearDecoder(np.zeros(1), np.zeros(2), np.zeros((2, 1))), np.array([2.0]), np.array([[1e-8]])
    )
    assert found.mean[1] == pytest.approx(1.8, abs=1e-6)
    assert found.covariance[1, 1] == pytest.approx(1.0 - 0.81, abs=1e-6)


def test_a_quiet_event_gets_small_regions_and_a_large_one_large_regions():
    rng = np.random.default_rng(2)
    one, slopes = one_component(rng, 4, 15, (0.1, 0.3, 1.0, 3.0)), rng.standard_normal((15, 4))
    linear = LinearDecoder(one.mean, np.zeros(15), slopes)
    noise = 1e-4 * np.eye(12)
    root = np.linalg.cholesky(slopes @ one.covariance @ slopes.T + one.errors)[:12]
    drawn = root @ rng.standard_normal(15)
    sizes = [np.trace(answer([one], linear, scale * drawn, noise).covariance[12:, 12:]) for scale in (0.1, 1.0, 3.0)]
    assert sizes[0] < 0.1 * sizes[1] < 0.5 * sizes[2]


def mixture_of_two(rng):
    """Return two kinds of events with three scales each, a decoder and noise of four markers, and draws of markers."""
    prior = [one_component(rng, 4, 15, (0.3, 1.0, 2.5)) for _ in range(2)]
    linear, noise = LinearDecoder(prior[0].mean, np.zeros(15), rng.standard_normal((15, 4))), 0.1 * np.eye(12)

    def draw():
        one, scale = prior[rng.integers(2)], rng.choice([0.3, 1.0, 2.5])
        covariance = scale**2 * (linear.slopes @ one.covariance @ linear.slopes.T + one.errors)[:12, :12] + noise
        centre = (linear.slopes @ (one.mean - linear.point))[:12]
        return centre + np.linalg.cholesky(covariance) @ rng.standard_normal(12)

    return prior, linear, noise, draw


def test_a_marker_is_predicted_from_the_others_alone_under_every_pair():
    prior, linear, noise, draw = mixture_of_two(np.random.default_rng(3))
    observed = draw()
    observed[3:6] += 20.0
    found, chances = Evidence.of(prior, linear, observed, noise, compared="every").chances()
    for marker in range(4):
        own = np.arange(3 * marker, 3 * marker + 3)
        others = np.setdiff1d(np.arange(12), own)
        weights, misfits = [], []
        for one in prior:
            for weight, scale in zip(one.weights, one.scales, strict=True):
                total = scale**2 * (linear.slopes @ one.covariance @ linear.slopes.T + one.errors)[:12, :12] + noise
                off = observed - linear.at[:12] - linear.slopes[:12] @ (one.mean - linear.point)
                gain = np.linalg.solve(total[np.ix_(others, others)], total[np.ix_(others, own)]).T
                covariance = total[np.ix_(own, own)] - gain @ total[np.ix_(others, own)]
                left = off[own] - gain @ off[others]
                weights.append(
                    weight * multivariate_normal.pdf(off[others], np.zeros(9), total[np.ix_(others, others)])
                )
                misfits.append(left @ np.linalg.solve(covariance, left))
        weights = np.array(weights) / np.sum(weights)
        assert found[marker] == pytest.approx(weights @ misfits, rel=1e-8)
        assert chances[marker] == pytest.approx(weights @ chi2.sf(misfits, 3), rel=1e-6)
    assert np.argmin(chances) == 1


def test_chances_of_a_marker_among_draws_from_the_prior_are_uniform():
    prior, linear, noise, draw = mixture_of_two(np.random.default_rng(4))
    drawn = (Evidence.of(prior, linear, draw(), noise, compared="every") for _ in range(400))
    p = np.sort([one.chances()[1][2] for one in drawn])
    # Largest distance from uniform: the 1 % point of Kolmogorov's law is 1.63 / sqrt(n).
    assert np.abs(p - (np.arange(400) + 0.5) / 400).max() < 1.63 / np.sqrt(400)


def test_noise_that_is_larger_than_stated_has_the_larger_evidence():
    rng = np.random.default_rng(5)
    one, slopes = one_component(rng, 4, 30, (0.3, 1.0, 2.5)), rng.standard_normal((30, 4))
    # A decoder that is nearly exact: what it cannot explain is noise.
    one = replace(one, errors=1e-6 * one.errors)
    linear, noise = LinearDecoder(one.mean, np.zeros(30), slopes), 0.1 * np.eye(30)

    def odds(std):
        drawn = slopes @ np.linalg.cholesky(one.covariance) @ rng.standard_normal(4)
        observed = drawn + std * np.sqrt(0.1) * rng.standard_normal(30)
        return log_noise_odds(Evidence.of([one], linear, observed, noise), noise)

    right, threefold, tenfold = ([odds(std) for _ in range(200)] for std in (1.0, 3.0, 10.0))
    assert min(threefold) > 5.0
    assert min(tenfold) > max(threefold)
    # Markov: a ratio above x has a chance of at most 1 / x under the stated noise, for each factor.
    assert (np.array(right) > np.log(2 * 20.0)).mean() <= 0.05
    assert np.median(right) < -5.0


def test_the_evidence_of_a_pair_is_that_of_its_innovations_gaussian():
    rng = np.random.default_rng(7)
    prior = [one_component(rng, scales=(0.5, 1.0, 2.0)) for _ in range(3)]
    linear = LinearDecoder(rng.standard_normal(4), rng.standard_normal(9), rng.standard_normal((9, 4)))
    observed, noise = rng.standard_normal(6), 0.2 * spread_matrix(6, rng)
    found, oracle = Evidence.of(prior, linear, observed, noise), closed_form(prior, linear, observed, noise)
    assert (found.component.tolist(), found.scale.tolist()) == ([0] * 3 + [1] * 3 + [2] * 3, [0.5, 1.0, 2.0] * 3)
    # Up to a constant: that of a Gaussian of six numbers.
    np.testing.assert_allclose(found.logs, oracle.logs + 3.0 * np.log(2.0 * np.pi), atol=1e-10)
    np.testing.assert_allclose(found.pulls, oracle.pulls, atol=1e-10)
    of_scales = np.logaddexp.reduce(found.logs.reshape(3, 3), axis=1)
    np.testing.assert_allclose(found.of_components, of_scales, atol=1e-12)
    # Pairs of less than 1e-4 of the most probable one are left out of the mean.
    np.testing.assert_allclose(found.mean_latents, oracle.mean_latents, atol=1e-2)


def test_a_pair_without_probability_counts_for_nothing():
    rng = np.random.default_rng(6)
    prior = [one_component(rng, scales=(0.5, 1.0)) for _ in range(2)]
    linear = LinearDecoder(np.zeros(4), np.zeros(9), rng.standard_normal((9, 4)))
    observed, noise = rng.standard_normal(6), 0.1 * np.eye(6)
    without = [prior[0], replace(prior[1], weights=np.zeros(2))]
    both = [Evidence.of(one, linear, observed, noise, compared="every") for one in (without, prior[:1])]
    np.testing.assert_allclose(both[0].mean_latents, both[1].mean_latents, rtol=1e-12)
    np.testing.assert_allclose(both[0].chances(), both[1].chances(), rtol=1e-12)


def test_a_noise_that_is_no_covariance_is_refused():
    rng = np.random.default_rng(4)
    one = one_component(rng)
    with pytest.raises(NoiseError, match="positive definite"):
        Evidence.of([one], LinearDecoder(one.mean, np.zeros(9), np.zeros((9, 4))), np.zeros(6), -100.0 * np.eye(6))


def test_a_screening_finds_the_latent_of_a_curved_decoder():
    def decode(latents):
        return np.stack([np.sinh(latents[0]), latents[0] ** 3], axis=1)

    one = Component(np.ones(1), np.ones(1), np.zeros(1), np.eye(1), np.zeros((2, 2)))
    exact = decode(np.array([[0.8]]))[0]
    given = ([one], exact[:1], np.array([[1e-8]]), np.zeros(1), np.ones(1))
    found = Screening.of(decode, *given)
    # Draws of 0.2 standard deviations are in the mean 0.04 / 2 of the second derivative off their centre's field.
    assert found.found.mean_latents[0] == pytest.approx(0.8, abs=0.02 * np.tanh(0.8))
    assert found.linear.point[0] == pytest.approx(0.8, abs=0.02)
    # What no marker has moved is linear about the start.
    assert found.first.model.point.tolist() == [0.0]
    once = Screening.of(decode, *given, rounds=1)
    assert abs(once.found.mean_latents[0] - 0.8) > 0.05
    assert once.first is once.found
    assert not found.first.misfits.size


def heavy_tailed(mesh, n_fields, seed):
    """Return fields of six smooth shapes, their sizes over a factor of ten hundred, with errors of other shapes."""
    rng = np.random.default_rng(9)
    waves = rng.uniform(0.02, 0.09, (16, 3))
    phases = rng.uniform(0.0, 6.3, (16, 3))
    shapes = np.sin((mesh.nodes @ waves.T)[:, :, None] + phases).transpose(1, 0, 2) * (mesh.nodes[:, 2:] / 40.0)
    shapes[6:] *= 0.15
    rng = np.random.default_rng(seed)
    size = np.exp(1.5 * rng.standard_normal((n_fields, 1)))
    return np.einsum("er,rnx->enx", size * rng.standard_normal((n_fields, 16)), shapes)


@pytest.fixture(scope="module")
def calibrated():
    mesh = block(cells=(5, 4, 6))
    fields = heavy_tailed(mesh, 1200, 0)
    model = PcaModel.fit(fields[:700], fields[:0], centre=np.zeros((mesh.n_nodes, 3)), n_latent=6, card={})
    settings = RehearsalSettings(n_markers=8, n_targets=6, std=0.05, n_events=150)
    return mesh, model, calibrate(model, mesh, model.codes(fields[:700]), fields[700:], n_kinds=3, settings=settings)


def test_a_rehearsed_truth_is_a_change_from_its_simulation_whatever_the_decoder_misses(calibrated):
    mesh, model, _ = calibrated
    rng = np.random.default_rng(9)
    # Simulations far outside what six components can represent; truths differ from them by what they can.
    simulations = 3.0 * rng.standard_normal((60, mesh.n_nodes, 3))
    truths = simulations + model.decode(0.3 * rng.standard_normal((6, 60)))
    settings = RehearsalSettings(n_markers=8, n_targets=6, std=0.05, n_events=20, n_repeats=1)
    fields = heavy_tailed(mesh, 60, 8)
    made = calibrate(model, mesh, model.codes(fields), fields, [(simulations, truths)], n_kinds=1, settings=settings)
    # Regions of a change that the decoder knows are about as wide as they are stated.
    assert made.anchored.widening < 4.0


def test_of_which_kind_a_change_is_and_how_far_its_factor_is_off_pairs_tell(calibrated):
    mesh, model, _ = calibrated
    rng = np.random.default_rng(3)
    latents = rng.standard_normal((6, 80))
    latents[:2] = 0.0
    simulations = model.decode(latents)
    # Half of the pairs differ by a factor alone, half in the first two latents alone, of which simulations have none.
    few = np.zeros((6, 40))
    few[:2] = 0.3 * rng.standard_normal((2, 40))
    pairs = [
        (simulations[:40], simulations[:40] * (1.0 + 0.3 * rng.standard_normal((40, 1, 1)))),
        (simulations[40:], simulations[40:] + model.decode(few)),
    ]
    settings = RehearsalSettings(n_markers=8, n_targets=6, std=0.01, n_events=20, n_repeats=1)
    fields = heavy_tailed(mesh, 60, 8)
    made = calibrate(model, mesh, model.codes(fields), fields, pairs, n_kinds=1, settings=settings)
    by_factor, by_code = (np.diag(one) for one in made.change.covariances)
    # A factor is no change of code; the other kind has no change of the last four. What a kind borrows is one in 41.
    assert by_factor.max() < 0.1 * by_code[:2].min()
    assert by_code[2:].max() < 0.1 * by_code[:2].min()
    weights = made.anchored.scale_weights
    assert weights.shape == (2 * len(made.change.factors), len(made.anchored.scales))
    of_kind = weights.reshape(2, len(made.change.factors), -1).sum(axis=2)
    # A standard deviation of 0.3 is a variance of 0.1; of 40 pairs few are nearer to none.
    assert of_kind[0, 2:].sum() > 0.6 * of_kind[0].sum()
    assert weights.sum() == pytest.approx(1.0)
    # Honest events of each kind are a group: how few may look worse is counted in the one that looks worst.
    assert np.bincount(made.anchored.calibration_set.groups).tolist() == [40, 40, 40, 40]


def test_regions_of_heavy_tailed_events_hold_their_share_of_targets(calibrated):
    mesh, model, calibration = calibrated
    import tissuereg as tr

    model.calibration = calibration
    rng = np.random.default_rng(5)
    surface = mesh.nodes[np.setdiff1d(np.unique(mesh.surface), mesh.fixed_nodes)]
    inside, n_events = [], 150
    for field in heavy_tailed(mesh, n_events, 6):
        chosen = rng.choice(len(surface), 8, replace=False)
        reference = surface[chosen]
        near = [int(np.argmin(np.linalg.norm(mesh.nodes - place, axis=1))) for place in reference]
        target = int(rng.choice(np.setdiff1d(np.arange(mesh.n_nodes), np.unique(mesh.surface))))
        result = tr.register(
            mesh,
            tr.Markers(reference, reference + field[near] + 0.05 * rng.standard_normal((8, 3)), std=0.05),
            model=model,
            targets={"t": mesh.nodes[target]},
            settings=tr.RegisterSettings(threads=1, smoother=tr.SmootherSettings(n_members=40, n_steps=2)),
        )
        found = result.target("t")
        off = found.mean - mesh.nodes[target] - field[target]
        inside.append(off @ np.linalg.solve(found.covariance, off) <= 6.2514)
    # Binomial: standard error 2.4 %, three of them, and one for the widening, itself from 150 rehearsals.
    assert abs(np.mean(inside) - 0.9) < 0.10


def test_a_calibration_is_the_same_after_it_was_written_and_read(calibrated, tmp_path):
    mesh, _, calibration = calibrated
    np.savez(tmp_path / "calibration.npz", **calibration.save())
    again = Calibration.read(tmp_path / "calibration.npz", 6, mesh.n_nodes)
    np.testing.assert_array_equal(again.kinds.covariances, calibration.kinds.covariances)
    # The file has them in single precision.
    single = calibration.alone.calibration_set.statistics.astype(np.float32)
    np.testing.assert_array_equal(again.alone.calibration_set.statistics, single)
    np.testing.assert_array_equal(again.alone.calibration_set.groups, calibration.alone.calibration_set.groups)
    assert again.alone.tail == calibration.alone.tail
    # Patterns are kept in steps of 0.4 of their root mean square, or the power of two next to that; covariances singly.
    off, size = (
        np.sqrt((one**2).mean(axis=(1, 2)))
        for one in (again.errors.basis - calibration.errors.basis, calibration.errors.basis)
    )
    assert (off < 0.4 / np.sqrt(12) * np.sqrt(2.0) * 1.2 * size).all()
    np.testing.assert_allclose(
        again.errors.covariances,
        calibration.errors.covariances,
        rtol=1e-6,
        atol=1e-7 * np.abs(calibration.errors.covariances).max(),
    )
    assert again.anchored is None
    with pytest.raises(FormatError, match="kind_means"):
        Calibration.read(tmp_path / "calibration.npz", 7, mesh.n_nodes)
    np.savez(tmp_path / "older.npz", **{k: v for k, v in calibration.save().items() if k != "version"})
    with pytest.raises(FormatError, match="version 5, got 1; `tissuereg calibrate"):
        Calibration.read(tmp_path / "older.npz", 6, mesh.n_nodes)


def test_fields_are_projected_on_patterns_that_rounding_left_not_quite_orthogonal():
    rng = np.random.default_rng(0)
    patterns = rng.standard_normal((3, 20, 3))
    errors = FieldErrors(patterns, np.eye(3)[None], np.zeros((20, 3)))
    inside = np.tensordot(rng.standard_normal((4, 3)), patterns, 1)
    np.testing.assert_allclose(errors.project(inside), inside, atol=1e-10)
    any_ = rng.standard_normal((4, 20, 3))
    left = any_ - errors.project(any_)
    np.testing.assert_allclose(np.einsum("pnx,fnx->pf", patterns, left), 0.0, atol=1e-10)


def test_patterns_without_their_covariances_are_refused_before_anything_of_their_square_is_made(calibrated, tmp_path):
    mesh, _, calibration = calibrated
    many = 250_000  # their square would take 60 GB
    arrays = calibration.save()
    arrays["error_patterns"] = np.broadcast_to(np.int8(0), (1, many, mesh.n_nodes, 3))
    arrays["error_patterns.exponents"] = np.zeros(many, np.int8)
    np.savez_compressed(tmp_path / "c.npz", **arrays)
    with pytest.raises(FormatError, match="error_covariances"):
        Calibration.read(tmp_path / "c.npz", 6, mesh.n_nodes)


def test_a_calibration_in_a_models_folder_is_used_and_one_that_was_altered_is_refused(tmp_path):
    folder = tmp_path / "model"
    shutil.copytree(SMALL_MODEL, folder)
    mesh = phantom_mesh("small")
    # Until then the model's own statements: nothing was rehearsed.
    assert not len(NetworkModel(folder, mesh).calibration.alone.calibration_set)
    n = mesh.n_nodes
    kinds = Components(np.ones(1), np.zeros((1, 26)), np.eye(26)[None])
    errors = FieldErrors(np.ones((2, n, 3)), np.eye(2)[None], np.zeros((n, 3)))
    write_calibration(folder, Calibration(kinds, errors, Rehearsal(np.ones(1), np.ones((1, 1)))))
    read = NetworkModel(folder, mesh).calibration
    np.testing.assert_array_equal(read.errors.basis, errors.basis)
    assert read.change is None
    # The folder's calibration can be left aside.
    assert NetworkModel(folder, mesh, calibrated=False).calibration.change is not None
    content = bytearray((folder / "calibration.npz").read_bytes())
    content[len(content) // 2] ^= 1
    (folder / "calibration.npz").write_bytes(content)
    with pytest.raises(ModelError, match="must be the file its card describes"):
        NetworkModel(folder, mesh)


def test_covariances_of_errors_are_those_of_the_fields_of_a_kind():
    rng = np.random.default_rng(7)
    small, large = 0.1 * rng.standard_normal((400, 4, 3)), rng.standard_normal((400, 4, 3))
    shares = np.repeat(np.eye(2), 400, axis=0)
    found = (
        field_errors(np.concatenate([small, large]), shares, 12)
        .at(lambda fields: fields.reshape(len(fields), -1))
        .covariances
    )
    # 400 x 12 numbers of variance 0.01 and 1: exact to 2 %; a twentieth is borrowed from both, in the size of each.
    assert np.trace(found[0]) / 12 == pytest.approx(0.01, rel=0.15)
    assert np.trace(found[1]) / 12 == pytest.approx(1.0, rel=0.10)


def test_parts_of_rehearsals_are_runs_of_each_kind_and_hold_every_event_once():
    kind = np.repeat([0, 1], [10, 43])
    parts = _folds(kind)
    assert sorted(np.concatenate([own for own, _ in parts])) == list(range(53))
    for own, others in parts:
        assert sorted([*own, *others]) == list(range(53))
        for number, count in ((0, 2), (1, 43 / 5)):
            rows = own[kind[own] == number]
            assert abs(len(rows) - count) < 1.0
            assert (np.diff(rows) == 1).all()
    ((own, others),) = _folds(np.zeros(1, int))
    assert own.tolist() == others.tolist() == [0]
