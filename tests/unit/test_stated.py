"""What an uncalibrated model says of itself: events drawn from it are its oracle; and a marker without the others."""

import numpy as np
import pytest
from scipy.stats import chi2

import tissuereg as tr
from support.meshes import block
from support.small_model import SMALL_MODEL
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.card import read_card
from tissuereg.registration.learned.mixture import Component, Evidence, LinearDecoder
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.pca import PcaModel
from tissuereg.registration.learned.smoother import Screening
from tissuereg.registration.learned.stated import stated

N_LATENT, N_MARKERS, N_TARGETS, STD_MM = 4, 8, 4, 0.05


@pytest.fixture(scope="module")
def mesh():
    return block(cells=(4, 4, 5))


def smooth_fields(mesh, n_fields, size, seed):
    """Return random smooth fields, zero at the held nodes, of about some size in mm."""
    rng = np.random.default_rng(seed)
    x = mesh.nodes / mesh.extent
    waves = np.array([np.sin(x @ rng.normal(scale=3.0, size=3) + rng.uniform(0, 6.0)) for _ in range(n_fields)])
    held = (x[:, 2] - x[:, 2].min())[None, :, None]
    return size * held * waves[:, :, None] * rng.standard_normal((n_fields, 1, 3))


@pytest.fixture(scope="module")
def model(mesh):
    return PcaModel(
        smooth_fields(mesh, 1, 1.0, 0)[0], smooth_fields(mesh, N_LATENT, 3.0, 1), smooth_fields(mesh, 30, 0.3, 2), {}
    )


def drawn(model, scale, rng):
    """Return an event whose latents and error are drawn from what the model states, at a scale, mm."""
    errors = stated(model.prior(), model.errors()).errors
    root = np.linalg.cholesky(errors.covariances[0])
    own = np.tensordot(root @ rng.standard_normal(len(root)), errors.basis, 1)
    own = own + errors.rest * rng.standard_normal(errors.rest.shape)
    return model.decode(scale * rng.standard_normal((N_LATENT, 1)))[0] + scale * own


@pytest.fixture(scope="module")
def registered(mesh, model):
    """Return a function of a field in mm, a simulation or None, and a generator of noise, that registers it."""
    rng = np.random.default_rng(3)
    surface = np.unique(mesh.surface)
    free, inner = np.setdiff1d(surface, mesh.fixed_nodes), np.setdiff1d(np.arange(mesh.n_nodes), surface)
    nodes, targets = rng.choice(free, N_MARKERS, replace=False), rng.choice(inner, N_TARGETS, replace=False)
    registrar = tr.Registrar(
        mesh,
        tr.Markers(mesh.nodes[nodes], std=STD_MM),
        model,
        {f"T{node}": mesh.nodes[node] for node in targets},
        settings=tr.RegisterSettings(threads=1, smoother=tr.SmootherSettings(n_members=20, n_steps=2)),
    )

    def register(field, simulation=None, noise=None):
        rng = np.random.default_rng(0) if noise is None else noise
        measured = mesh.nodes[nodes] + field[nodes] + STD_MM * rng.standard_normal((N_MARKERS, 3))
        return registrar.register(measured, simulation)

    return register, targets


def test_regions_of_events_that_are_drawn_from_what_is_stated_hold_their_share(mesh, model, registered):
    register, targets = registered
    law = stated(model.prior(), model.errors()).alone
    rng = np.random.default_rng(4)
    inside = []
    for _ in range(150):
        truth = drawn(model, rng.choice(law.scales, p=law.scale_weights[0]), rng)
        result = register(truth, noise=rng)
        off = np.array([result.target(f"T{t}").mean - mesh.nodes[t] - truth[t] for t in targets])
        covariances = np.array([result.target(f"T{t}").covariance for t in targets])
        inside.append(np.einsum("ti,ti->t", off, np.linalg.solve(covariances, off[..., None])[..., 0]))
    # Targets of one event are alike: binomial of 150 events, standard error 2.4 %, three of them.
    assert (np.array(inside) <= chi2.ppf(0.9, 3)).mean() == pytest.approx(0.9, abs=0.075)


def test_regions_grow_with_the_event_and_a_larger_one_is_no_misfit(mesh, model, registered):
    register, targets = registered
    rng = np.random.default_rng(5)
    sizes, ok = [], []
    for scale in (0.5, 1.0, 4.0):
        found = [register(drawn(model, scale, rng), noise=rng) for _ in range(12)]
        sizes.append(np.mean([np.sqrt(np.trace(one.target(f"T{t}").covariance)) for one in found for t in targets]))
        ok.append(np.mean([one.trust.p_value > 0.01 for one in found]))
    # Of one scale, regions would be alike whatever was measured.
    assert sizes[0] < 0.8 * sizes[1] < 0.4 * sizes[2]
    assert min(ok) > 0.8


def test_without_pairs_a_simulation_is_but_where_the_answer_starts(mesh, model, registered):
    register, targets = registered
    truth = drawn(model, 1.0, np.random.default_rng(6))
    alone, about = register(truth), register(truth, 0.8 * truth)
    np.testing.assert_array_equal(about.displacement, alone.displacement)
    np.testing.assert_array_equal(about.std, alone.std)
    assert about.trust.p_value == alone.trust.p_value
    name = f"T{targets[0]}"
    np.testing.assert_array_equal(about.target(name).covariance, alone.target(name).covariance)
    # Only what is compared with it differs.
    assert alone.target(name).simulation is None
    np.testing.assert_allclose(about.target(name).simulation, mesh.nodes[targets[0]] + 0.8 * truth[targets[0]])
    assert about.markers.before_rms_mm < 0.5 * alone.markers.before_rms_mm


def rows_of(fields):
    return fields.reshape(len(fields), 3 * fields.shape[1])


def test_second_moments_of_errors_keep_their_diagonal_and_are_positive_definite():
    errors = np.random.default_rng(7).standard_normal((8, 7, 3)) + 0.5
    found = stated(Gaussian(np.zeros(2), np.eye(2)), errors).at(rows_of).errors.covariances
    assert found.shape == (1, 21, 21)
    np.testing.assert_allclose(np.diag(found[0]), rows_of(errors**2).mean(axis=0), rtol=1e-12)
    assert np.linalg.eigvalsh(found[0]).min() > 0.0
    # What eight fields say of the correlations of two places is mostly chance.
    sample = rows_of(errors).T @ rows_of(errors) / 8
    share = found[0][0, 1:] / sample[0, 1:]
    np.testing.assert_allclose(share, share[0], rtol=1e-10)
    assert 0.0 < share[0] < 0.3
    # Of many fields they are taken as they are; no field, no error.
    many = np.random.default_rng(8).standard_normal((5000, 7, 3))
    found = stated(Gaussian(np.zeros(2), np.eye(2)), many).at(rows_of).errors.covariances[0]
    np.testing.assert_allclose(found, rows_of(many).T @ rows_of(many) / 5000, atol=0.01)
    none = stated(Gaussian(np.zeros(2), np.eye(2)), many[:0]).at(rows_of).errors.covariances
    np.testing.assert_array_equal(none, np.zeros((1, 21, 21)))


def test_with_pairs_the_prior_lies_about_the_simulation_in_proportion_to_its_size():
    rng = np.random.default_rng(9)
    family, mismatch = Gaussian(rng.standard_normal(3), 2.0 * np.eye(3)), 0.04 * np.eye(3)
    errors, changed = rng.standard_normal((6, 4, 3)), 0.1 * rng.standard_normal((9, 4, 3))
    code, simulated = rng.standard_normal(3), rng.standard_normal(12)
    known = stated(family, errors, mismatch, changed).at(rows_of)
    for size in (2.0, 5.0):
        prior, forms = known.prior_about(code, size, simulated)
        assert forms == [(0, 0.0)]
        about, unrelated = prior
        np.testing.assert_array_equal(about.mean, code)
        np.testing.assert_allclose(about.covariance, size**2 * mismatch, rtol=1e-12)
        np.testing.assert_allclose(
            np.diag(about.errors), size**2 * rows_of(changed**2).mean(axis=0), rtol=1e-12, atol=1e-15
        )
        np.testing.assert_array_equal(unrelated.mean, family.mean)
        np.testing.assert_array_equal(unrelated.covariance, family.covariance)
        assert about.weights.sum() + unrelated.weights.sum() == pytest.approx(1.0)
        assert unrelated.weights.sum() < 0.1 * about.weights.sum()
    # Without pairs a simulation changes no prior.
    plain = stated(family, errors).at(rows_of)
    (one,), forms = plain.prior_about(code, 2.0, simulated)
    assert forms == []
    np.testing.assert_array_equal(one.mean, family.mean)
    assert one.weights.sum() == pytest.approx(1.0)


def test_a_network_states_what_its_card_and_its_weights_say():
    model = NetworkModel(SMALL_MODEL, phantom_mesh("small"))
    known, found = read_card(SMALL_MODEL)["prior"], model.calibration
    np.testing.assert_array_equal(found.kinds.means, [known["mean"]])
    np.testing.assert_array_equal(found.kinds.covariances, [known["covariance"]])
    np.testing.assert_array_equal(found.change.covariances, [known["relative_mismatch_covariance"]])
    np.testing.assert_array_equal(found.errors.basis, model.errors())
    assert not len(found.alone.calibration_set) + len(found.anchored.calibration_set)
    # Over the size of the simulation, and not: the same for codes and for what the decoder misses.
    with np.load(SMALL_MODEL / "decoder_weights.npz") as weights:
        ratio = found.change.errors.basis.std() / np.float64(weights["change_error_fields_mm"]).std()
    squared = np.trace(known["relative_mismatch_covariance"]) / np.trace(known["mismatch_covariance"])
    assert ratio**2 == pytest.approx(squared, rel=1e-6)


# --- the chance of a marker, the decoder linear about the answer without it ---


def test_with_a_linear_decoder_the_chance_is_that_of_all_markers_at_once():
    rng = np.random.default_rng(10)
    prior = [
        Component(weights, np.array([0.5, 2.0]), rng.standard_normal(3), np.eye(3), 0.02 * np.eye(18))
        for weights in (np.array([0.4, 0.2]), np.array([0.3, 0.1]))
    ]
    linear = LinearDecoder(np.zeros(3), rng.standard_normal(18), rng.standard_normal((18, 3)))
    observed, noise = rng.standard_normal(15), 0.09 * np.eye(15)
    screening = Screening.of(
        lambda latents: linear.at + (linear.slopes @ latents).T, prior, observed, noise, np.zeros(3), np.ones(3)
    )
    _, every = Evidence.of(prior, linear, observed, noise, compared="every").chances()
    for marker in range(5):
        assert screening.chance_of(marker, prior, observed, noise) == pytest.approx(every[marker], rel=1e-5)


def test_a_wrong_marker_that_bends_the_decoder_to_itself_is_found_without_it():
    def decode(latents):
        # Three markers follow the second latent; the last moves by the product of both.
        rows = np.zeros((latents.shape[1], 12))
        rows[:, [0, 3, 6]] = latents[1][:, None]
        rows[:, 9] = latents[0] * latents[1]
        return rows

    one = Component(np.ones(1), np.ones(1), np.zeros(2), np.eye(2), 1e-4 * np.eye(12))
    noise = np.diag(np.repeat([0.3, 0.3, 0.3, 0.1], 3) ** 2)
    observed = decode(np.array([[0.5], [0.1]]))[0]
    observed[9] += 1.5
    screening = Screening.of(decode, [one], observed, noise, np.zeros(2), np.ones(2))
    _, about_all = Evidence.of([one], screening.linear, observed, noise, compared="every").chances()
    chances = [screening.chance_of(marker, [one], observed, noise) for marker in range(4)]
    # The answer with it lies where the first latent moves the marker as far as it likes.
    assert about_all[3] > 1e-3
    assert chances[3] < 1e-6
    assert min(chances[:3]) > 0.5
