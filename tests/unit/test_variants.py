"""Variants of a simulation: the same moment simulated with other values of what is uncertain, as part of a prior."""

import numpy as np
import pytest

import tissuereg as tr
from support.small_model import SMALL_MODEL
from tissuereg.baselines import EnsembleOfSimulations, Setting, VariedNetwork
from tissuereg.errors import ArgumentError, FormatError, ShapeError
from tissuereg.io.npz import write_npz
from tissuereg.registration.learned.calibration import UNRELATED, Calibration, Change, FieldErrors, Rehearsal
from tissuereg.registration.learned.components import Components
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.variants import Variants
from tissuereg.studies.rigs import Pad, Rig
from tissuereg.studies.variants import N_MODULI, STORED_KPA, YOUNG_KPA, RigVariants, read_variants

STD = 0.05


@pytest.fixture(scope="module")
def mesh():
    return tr.phantom.phantom_mesh("small")


@pytest.fixture(scope="module")
def variants(mesh):
    """Ten smooth fields about a push, zero at the base."""
    rng = np.random.default_rng(8)
    x = mesh.nodes / mesh.extent
    waves = [np.sin(x @ rng.normal(scale=3.0, size=3) + rng.uniform(0.0, 6.0)) for _ in range(10)]
    height = x[:, 2] - x[:, 2].min()
    push = height[:, None] * np.array([3.0, 0.5, -1.0])
    return push + 3.0 * height[None, :, None] * np.array(waves)[:, :, None] * rng.standard_normal((10, 1, 3))


def calibrated(mesh, change_mm, widening=1.0, pairs=True, unrelated_mm=1.0):
    """Return the small model, whose simulations are off by so much in one pattern, and hardly in their codes."""
    model = NetworkModel(SMALL_MODEL, mesh, threads=1)
    height = mesh.nodes[:, 2:] - mesh.nodes[:, 2].min()
    pattern = np.ones((1, mesh.n_nodes, 3)) * height / mesh.extent
    none = np.zeros((mesh.n_nodes, 3))
    change = Change(
        np.array([0.0, 0.3]), 1e-10 * np.eye(26)[None], FieldErrors(pattern, np.full((1, 1, 1), change_mm**2), none)
    )
    model.calibration = Calibration(
        Components(np.ones(1), np.zeros((1, 26)), 1e-10 * np.eye(26)[None]),
        FieldErrors(pattern, np.full((1, 1, 1), unrelated_mm**2), none),
        Rehearsal(np.ones(1), np.ones((1, 1))),
        change if pairs else None,
        Rehearsal(np.array([1.0, 1.5]), np.array([[0.1, 0.2], [0.3, 0.4]]), widening) if pairs else None,
    )
    return model


def places(mesh):
    """Return nodes of twelve markers, and of a target."""
    free = np.setdiff1d(np.unique(mesh.surface), mesh.fixed_nodes)
    inner = np.setdiff1d(np.arange(mesh.n_nodes), np.union1d(mesh.surface_nodes, mesh.fixed_nodes))
    return free[:: len(free) // 12][:12], int(inner[40])


def measured(mesh, variants, seed=1):
    """Return a truth among what the variants span, and noisy markers of it."""
    rng = np.random.default_rng(seed)
    shares = rng.dirichlet(np.ones(len(variants)))
    truth = variants.mean(axis=0) + np.tensordot(2.0 * (shares - shares.mean()), variants, 1)
    seen, _ = places(mesh)
    reference = mesh.nodes[seen]
    return truth, tr.Markers(reference, reference + truth[seen] + STD * rng.standard_normal((12, 3)), STD)


def closed_form(mesh, variants, markers, general_mm, scales, weights):
    """Return mean (3,) and covariance (3, 3) of the target, and the mean of all nodes, by Bayes' rule on fields."""
    seen, target = places(mesh)
    mean = variants.mean(axis=0)
    size = np.sqrt((mean**2).sum(axis=1).mean())
    height = (mesh.nodes[:, 2:] - mesh.nodes[:, 2].min()) / mesh.extent
    general = 0.5 * size * general_mm * np.ones((mesh.n_nodes, 3)) * height
    fields = np.concatenate([(variants - mean) / np.sqrt(len(variants) - 1), general[None]])
    at_markers, at_target = fields[:, seen].reshape(len(fields), -1), fields[:, target]
    innovation = (markers.displacement - mean[seen]).ravel()
    logs, means, covariances, wholes = [], [], [], []
    for scale in scales:
        total = scale**2 * at_markers.T @ at_markers + STD**2 * np.eye(36)
        gain = scale**2 * np.linalg.solve(total, at_markers.T @ at_target).T
        pull = np.linalg.solve(total, innovation)
        logs.append(-0.5 * (innovation @ pull + np.linalg.slogdet(total)[1]))
        means.append(mean[target] + gain @ innovation)
        covariances.append(scale**2 * at_target.T @ at_target - scale**2 * gain @ at_markers.T @ at_target)
        wholes.append(mean + np.tensordot(scale**2 * at_markers @ pull, fields, 1))
    shares = np.array(weights) * np.exp(np.array(logs) - max(logs))
    shares /= shares.sum()
    whole = np.tensordot(shares, wholes, 1)
    middle = shares @ np.array(means)
    off = np.array(means) - middle
    return middle, np.tensordot(shares, covariances, 1) + (off * shares[:, None]).T @ off, whole


# --- registration ---


def test_the_answer_is_bayes_rule_on_what_the_variants_and_the_model_say(mesh, variants):
    truth, markers = measured(mesh, variants)
    _, target = places(mesh)
    model = calibrated(mesh, 0.3)
    found = tr.register(
        mesh,
        markers,
        model=model,
        targets={"t": mesh.nodes[target]},
        settings=tr.RegisterSettings(threads=1),
        simulation=tr.SimulationVariants(variants),
    )
    # Factors are what the variants say, so that their probabilities add up: 0.1 + 0.3 and 0.2 + 0.4.
    middle, covariance, whole = closed_form(mesh, variants, markers, 0.3, (1.0, 1.5), (0.4, 0.6))
    at_target = found.target("t")
    np.testing.assert_allclose(at_target.mean - mesh.nodes[target], middle, atol=2e-4)
    np.testing.assert_allclose(at_target.covariance, covariance, rtol=2e-3, atol=1e-7)
    np.testing.assert_allclose(found.displacement, whole, atol=2e-3)
    assert (
        np.linalg.norm(found.displacement - truth, axis=1).mean()
        < 0.2 * np.linalg.norm(variants.mean(axis=0) - truth, axis=1).mean()
    )


def test_the_spread_of_nodes_is_that_of_targets(mesh, variants):
    _, markers = measured(mesh, variants)
    _, target = places(mesh)
    model = calibrated(mesh, 0.3, widening=2.0)
    found = tr.register(
        mesh,
        markers,
        model=model,
        targets={"t": mesh.nodes[target]},
        settings=tr.RegisterSettings(threads=1),
        simulation=tr.SimulationVariants(variants),
    )
    # Variances of three components from 64 draws: each is known to a sixth, their sum to a tenth or so.
    assert found.std[target] ** 2 == pytest.approx(np.trace(found.target("t").covariance), rel=0.45)
    _, covariance, _ = closed_form(mesh, variants, markers, 0.3, (1.0, 1.5), (0.4, 0.6))
    np.testing.assert_allclose(found.target("t").covariance, 2.0 * covariance, rtol=2e-3, atol=1e-7)


def test_the_answer_is_compared_with_the_simulation_and_starts_from_the_mean(mesh, variants):
    _, markers = measured(mesh, variants)
    _, target = places(mesh)
    how = {
        "model": calibrated(mesh, 0.3),
        "targets": {"t": mesh.nodes[target]},
        "settings": tr.RegisterSettings(threads=1),
    }
    plain = tr.register(mesh, markers, simulation=tr.SimulationVariants(variants), **how)
    assert plain.model["variants"] == 10
    assert "variants" not in tr.register(mesh, markers, simulation=variants[0], **how).model
    with_own = tr.register(mesh, markers, simulation=tr.SimulationVariants(variants, 0.5 * variants[0]), **how)
    np.testing.assert_array_equal(plain.displacement, with_own.displacement)
    at_mean, at_own = variants.mean(axis=0)[target], 0.5 * variants[0][target]
    np.testing.assert_allclose(plain.target("t").simulation - mesh.nodes[target], at_mean, atol=1e-12)
    np.testing.assert_allclose(with_own.target("t").simulation - mesh.nodes[target], at_own, atol=1e-12)


def test_a_marker_that_is_not_seen_is_predicted_from_the_variants(mesh, variants):
    truth, markers = measured(mesh, variants)
    gone = markers.measured.copy()
    gone[3] = np.nan
    found = tr.register(
        mesh,
        (markers.reference, gone),
        model=calibrated(mesh, 0.05),
        settings=tr.RegisterSettings(threads=1),
        simulation=tr.SimulationVariants(variants),
    )
    (name,) = found.unseen
    seen, _ = places(mesh)
    off = found.unseen[name].mean - markers.reference[3] - truth[seen[3]]
    assert np.linalg.norm(off) < 0.1 * np.linalg.norm(variants.mean(axis=0)[seen[3]] - truth[seen[3]])


def test_variants_of_another_event_are_ruled_out(mesh, variants):
    # Markers that the variants cannot reach: an unrelated event is more probable, and says so.
    _, markers = measured(mesh, variants)
    measured_mm = markers.reference - 30.0 * (markers.measured - markers.reference)
    model = calibrated(mesh, 0.05, unrelated_mm=500.0)
    found = tr.register(
        mesh,
        (markers.reference, measured_mm),
        model=model,
        settings=tr.RegisterSettings(threads=1),
        simulation=tr.SimulationVariants(variants),
    )
    assert any("moved against it" in reason for reason in found.trust.reasons)


def test_a_registrar_and_many_moments_take_variants(mesh, variants):
    _, markers = measured(mesh, variants)
    model = calibrated(mesh, 0.3)
    alone = tr.register(
        mesh, markers, model=model, settings=tr.RegisterSettings(threads=1), simulation=tr.SimulationVariants(variants)
    )
    again = tr.Registrar(mesh, markers, model, settings=tr.RegisterSettings(threads=1)).register(
        markers, tr.SimulationVariants(variants)
    )
    (many,) = tr.register_many(
        mesh,
        [markers],
        model=model,
        settings=tr.RegisterSettings(threads=1),
        simulation=tr.SimulationVariants(variants),
    )
    for other in (again, many):
        np.testing.assert_array_equal(other.displacement, alone.displacement)


def test_a_tracked_frame_takes_variants_from_their_own_simulations(mesh, variants):
    _, markers = measured(mesh, variants)
    model = calibrated(mesh, 0.3)
    several = [lambda share, field=field: share * field for field in variants]
    tracker = tr.Tracker(
        tr.Registrar(mesh, tr.Markers(markers.reference, std=STD), model, settings=tr.RegisterSettings(threads=1)),
        simulator=several[0],
        variants=several,
        temporal=False,
    )
    registrar = tr.Registrar(
        mesh, tr.Markers(markers.reference, std=STD), model, settings=tr.RegisterSettings(threads=1)
    )
    for number, share in enumerate((0.5, 1.0)):
        seen = markers.reference + share * markers.displacement
        found = tracker.step(seen, 0.025 * number, actuator=share)
        expected = registrar.register(seen, tr.SimulationVariants(share * variants, share * variants[0]))
        np.testing.assert_array_equal(found.displacement, expected.displacement)
    with pytest.raises(ShapeError, match="variants"):
        tr.Tracker(
            tr.Registrar(mesh, markers.reference, model, settings=tr.RegisterSettings(threads=1)),
            variants=[lambda _: variants[0][:-1]] * 4,
        ).step(markers.measured, 0.0, actuator=1.0)
    with pytest.raises(ArgumentError, match="`variants` must have a method `field` or be a function"):
        tr.Tracker(
            tr.Registrar(mesh, markers.reference, model, settings=tr.RegisterSettings(threads=1)), variants=[None] * 4
        )


@pytest.mark.parametrize(
    ("changed", "error", "said"),
    [
        ({"variants": "all"}, ShapeError, "variants"),
        ({"variants": 3}, ShapeError, "must be 4 or more simulations of one moment, got 3"),
        ({"variants": np.nan}, ShapeError, "must be finite displacements in mm; variant 2 is not"),
        ({"variants": "short"}, ShapeError, "variants"),
        ({"model": None}, ArgumentError, "a registration with a trained model; there is none"),
        ({"model": "no pairs"}, ArgumentError, "was not calibrated with pairs of simulation and truth"),
    ],
)
def test_variants_that_cannot_be_used_are_refused(mesh, variants, changed, error, said):
    _, markers = measured(mesh, variants)
    spoilt = variants.copy()
    spoilt[2, 5, 1] = np.nan
    given = {3: variants[:3], "short": variants[:, :-1]}.get(changed.get("variants"), variants)
    if isinstance(changed.get("variants"), float):
        given = spoilt
    if changed.get("variants") == "all":
        given = "all"
    models = {None: None, "no pairs": calibrated(mesh, 0.3, pairs=False)}
    model = models[changed["model"]] if "model" in changed else calibrated(mesh, 0.3)
    with pytest.raises(error, match=said):
        tr.register(
            mesh, markers, model=model, settings=tr.RegisterSettings(threads=1), simulation=tr.SimulationVariants(given)
        )


def test_components_keep_a_quarter_of_the_general_variance_and_no_factor(mesh, variants):
    model = calibrated(mesh, 0.3)
    rows = lambda fields: fields[:, :20].reshape(len(fields), -1)  # noqa: E731
    at, given = model.calibration.at(rows), Variants.of(variants, mesh.n_nodes)
    mean = rows(given.mean[None])[0]
    prior, forms = at.prior_about(np.zeros(26), 2.0, mean, given.spread.at(rows))
    plain, plain_forms = at.prior_about(np.zeros(26), 2.0, mean)
    assert forms == [(0, 0.0)]
    assert plain_forms == [(0, 0.0), (0, 0.3)]
    np.testing.assert_allclose(prior[0].weights, (1.0 - UNRELATED) * np.array([0.4, 0.6]))
    np.testing.assert_allclose(prior[0].covariance, plain[0].covariance / 4.0)
    np.testing.assert_allclose(
        prior[0].errors, plain[0].errors / 4.0 + np.cov(rows(variants), rowvar=False), rtol=1e-9, atol=1e-12
    )
    assert sum(one.weights.sum() for one in prior) == pytest.approx(1.0)


# --- methods of the comparison ---


def setting_of(mesh, markers, model=None):
    return Setting(
        mesh, np.asarray(markers.reference), np.full(12, STD), tr.Material(10.0, 0.45), model=model, threads=1
    )


def test_an_ensemble_of_simulations_is_updated_by_bayes_rule(mesh, variants):
    _, markers = measured(mesh, variants)
    found = EnsembleOfSimulations(setting_of(mesh, markers), error_mm=0.12).register(
        markers.measured, variants_mm=variants
    )
    seen, _ = places(mesh)
    mean = variants.mean(axis=0)
    fields = (variants - mean).reshape(len(variants), -1) / 3.0
    at_markers = fields.reshape(len(variants), -1, 3)[:, seen].reshape(len(variants), -1)
    total = at_markers.T @ at_markers + (STD**2 + 0.12**2) * np.eye(36)
    gain = fields.T @ np.linalg.solve(total, at_markers.T).T
    moved = mean + (gain @ (markers.displacement - mean[seen]).ravel()).reshape(mean.shape)
    variance = (fields**2).sum(axis=0) - (gain * (fields.T @ at_markers)).sum(axis=1)
    np.testing.assert_allclose(found.displacement_mm, moved, atol=1e-9)
    np.testing.assert_allclose(found.spread_mm.ravel() ** 2, variance, rtol=1e-7, atol=1e-9)


def test_the_network_with_variants_is_that_of_a_registrar(mesh, variants):
    _, markers = measured(mesh, variants)
    model = calibrated(mesh, 0.3)
    expected = tr.Registrar(mesh, markers, model, settings=tr.RegisterSettings(threads=1)).register(
        markers, tr.SimulationVariants(variants)
    )
    found = VariedNetwork(setting_of(mesh, markers, model)).register(markers.measured, variants_mm=variants)
    np.testing.assert_array_equal(found.displacement_mm, expected.displacement)
    with pytest.raises(ArgumentError, match="`variants_mm` must be given for the method 'tissuereg, network with"):
        VariedNetwork(setting_of(mesh, markers, model)).register(markers.measured, 0.0 * variants[0])


# --- variants of rigs ---


def rig_named(name):
    pad = Pad(np.array([50.0, 0.0, 20.0]), np.array([-10.0, 0.0, 0.0]), 14.0)
    none = {"marker": (2, 0, 3), "sensor": (2, 3), "inner": (2, 0, 3)}
    return Rig(
        name=name,
        scenario=1,
        seed=0,
        pads=(pad,),
        frame_s=0.025,
        motion=np.array([0.5, 1.0]),
        reference_mm=np.zeros((0, 3)),
        sensor_mm=np.zeros(3),
        inner_mm=np.zeros((0, 3)),
        shares=np.array([0.5, 1.0]),
        pad_forces=np.zeros((2, 1, 3)),
        truth={},
        **{f"{part}_levels_mm": np.zeros(shape) for part, shape in none.items()},
    )


def test_a_variant_is_taken_with_moduli_from_the_softest_to_the_stiffest():
    # Bodies that move in proportion to their push: by 1 mm and by 2 mm per 100 mN.
    pushes = np.array([[100.0, 200.0, 300.0, 400.0], [100.0, 200.0, 300.0, 400.0]])
    slopes = np.array([0.01, 0.02])
    fields = (slopes[:, None] * pushes)[:, :, None, None] * np.ones((1, 1, 2, 3))
    found = RigVariants(fields, pushes).at(100.0)
    assert found.shape == (2 * N_MODULI, 2, 3)
    for slope, of_body in zip(slopes, np.split(found[:, 0, 0], 2), strict=True):
        moduli = STORED_KPA * slope * 100.0 / of_body
        assert (moduli > YOUNG_KPA[0]).all()
        assert (moduli < YOUNG_KPA[1]).all()
        # One in each of five equal parts of the logarithm.
        parts = np.floor(N_MODULI * np.log(moduli / YOUNG_KPA[0]) / np.log(YOUNG_KPA[1] / YOUNG_KPA[0]))
        assert parts.tolist() == [0, 1, 2, 3, 4]


def test_variants_that_would_be_pressed_too_far_are_left_out():
    pushes = np.array([[100.0, 200.0, np.nan], [100.0, np.nan, np.nan]])
    fields = 0.01 * pushes[:, :, None, None] * np.ones((1, 1, 2, 3))
    found = RigVariants(fields, pushes).at(150.0)[:, 0, 0]
    # Of the first body moduli below 10 * 150 / (1.1 * 200) are missing, of the second, with one equilibrium, all.
    assert 0 < len(found) < N_MODULI
    assert found.max() <= 1.1 * 2.0 + 1e-12
    assert np.isfinite(found).all()


def test_variants_are_read_by_the_name_of_their_rig(tmp_path):
    write_npz(
        tmp_path / "scenario1-00.npz", {"push_mN": np.ones((2, 3)), "field_mm": np.ones((2, 3, 7, 3), np.float16)}
    )
    assert read_variants(tmp_path, rig_named("scenario1-00"), 7).fields_mm.shape == (2, 3, 7, 3)
    with pytest.raises(FormatError, match=r"scenario1-01\.npz"):
        read_variants(tmp_path, rig_named("scenario1-01"), 7)
    with pytest.raises(FormatError, match="field_mm"):
        read_variants(tmp_path, rig_named("scenario1-00"), 8)
