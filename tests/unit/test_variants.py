"""Variants of a simulation: the same moment simulated with other values of what is uncertain, as part of a prior."""

from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.varied import STD, calibrated, drawn, measured, places
from tissuereg.errors import ArgumentError, ShapeError
from tissuereg.registration.learned.calibration import BESIDE_VARIANTS, UNRELATED, Rehearsal
from tissuereg.registration.learned.variants import Variants


@pytest.fixture(scope="module")
def mesh():
    return tr.phantom.phantom_mesh("small")


@pytest.fixture(scope="module")
def variants(mesh):
    return drawn(mesh)


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
    # What the trials widen is the quarter of the general variance that stays: 1 + (2 - 1) / 4.
    np.testing.assert_allclose(found.target("t").covariance, 1.25 * covariance, rtol=2e-3, atol=1e-7)


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


def test_the_law_of_targets_beside_variants_is_that_of_the_share_that_stays(mesh):
    model = calibrated(mesh, 0.3, widening=3.0)
    known = model.calibration
    model.calibration = replace(known, anchored=replace(known.anchored, tail=4.0))
    at = model.calibration.at(lambda fields: fields[:, :20].reshape(len(fields), -1))
    varied = at.rehearsal(anchored=True, varied=True)
    assert (varied.widening, varied.tail) == (1.5, 16.0)
    assert varied.calibration_set is at.rehearsal(anchored=True).calibration_set
    assert (at.rehearsal(anchored=True).widening, at.rehearsal(anchored=True).tail) == (3.0, 4.0)
    # Trials without a simulation say nothing of changes from one.
    assert at.rehearsal(anchored=False, varied=True) is known.alone
    # A Gaussian law stays one, and covariances that rehearsals left as they are stay, too.
    plain = Rehearsal(np.ones(1), np.ones((1, 1))).beside_variants
    assert (plain.widening, plain.tail) == (1.0, None)


@pytest.mark.parametrize(("share", "widening", "tail"), [(1.0, 3.0, 4.0), (0.0, 1.0, None)])
def test_that_law_is_all_of_the_trials_where_all_stays_and_a_gaussian_where_nothing_does(
    monkeypatch, share, widening, tail
):
    monkeypatch.setattr("tissuereg.registration.learned.calibration.BESIDE_VARIANTS", share)
    law = Rehearsal(np.ones(1), np.ones((1, 1)), 3.0, 4.0).beside_variants
    assert (law.widening, law.tail) == (widening, tail)


def test_targets_have_that_law(mesh, variants):
    _, markers = measured(mesh, variants)
    _, target = places(mesh)
    model = calibrated(mesh, 0.3)
    known = model.calibration
    model.calibration = replace(known, anchored=replace(known.anchored, tail=3.0))
    how = {"targets": {"t": mesh.nodes[target]}, "settings": tr.RegisterSettings(threads=1)}
    varied = tr.register(mesh, markers, model=model, simulation=tr.SimulationVariants(variants), **how)
    plain = tr.register(mesh, markers, model=model, simulation=variants.mean(axis=0), **how)
    assert varied.target("t").tail == 3.0 / BESIDE_VARIANTS
    assert plain.target("t").tail == 3.0
