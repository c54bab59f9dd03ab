"""Advice on markers: the greedy choice against the closed form of a linear-Gaussian case."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.errors import EnsembleError, MarkerError

STD = 0.3
TARGETS = {"deep": (11.0, 9.0, 13.0), "side": (22.0, 5.0, 25.0)}


@pytest.fixture(scope="module")
def body():
    return block(cells=(3, 2, 4))


@pytest.fixture(scope="module")
def fields(body):
    """Fields of a Gaussian law: ten smooth modes with normal amplitudes."""
    rng = np.random.default_rng(3)
    x = body.nodes / 40.0
    shapes = [np.sin((x @ rng.normal(size=3))[:, None] + rng.normal(size=3)) * x[:, 2:] for _ in range(10)]
    return np.einsum("mk,knx->mnx", rng.normal(size=(60, 10)), shapes)


def places_of(body):
    free = np.setdiff1d(body.surface_nodes, body.fixed_nodes)
    return free, body.nodes[free]


def left(body, fields, markers):
    """Return the covariance (6, 6) that nodes as markers leave the targets: the closed form, whole matrices."""
    weights = _weights(body)
    away = (fields - fields.mean(axis=0)) / np.sqrt(len(fields) - 1)
    wanted = np.einsum("tn,mnx->txm", weights, away).reshape(-1, len(fields))
    seen = away[:, markers].reshape(len(fields), -1).T
    gain = wanted @ seen.T @ np.linalg.inv(seen @ seen.T + STD**2 * np.eye(len(seen)))
    return wanted @ wanted.T - gain @ seen @ wanted.T


def _weights(body):
    """Return barycentric weights (2, n_nodes) of the targets."""
    weights = np.zeros((len(TARGETS), body.n_nodes))
    for row, point in zip(weights, TARGETS.values(), strict=True):
        for tet in body.tets:
            share = np.linalg.solve(np.vstack([body.nodes[tet].T, np.ones(4)]), np.append(point, 1.0))
            if share.min() > -1e-12:
                row[tet] = share
                break
    return weights


def test_every_pick_leaves_the_least_variance_of_all_candidates_by_the_closed_form(body, fields):
    free, places = places_of(body)
    advice = tr.advise_markers(body, fields, TARGETS, n=3, std=STD)
    for count in range(1, 4):
        before = free[advice.chosen[: count - 1]]
        traces = [np.trace(left(body, fields, [*before, node])) for node in free]
        assert traces[advice.chosen[count - 1]] == pytest.approx(min(traces), rel=1e-9)
    np.testing.assert_array_equal(advice.places_mm, places[advice.chosen])


def test_the_expected_errors_are_those_of_the_closed_form_after_each_pick(body, fields):
    free, _ = places_of(body)
    advice = tr.advise_markers(body, fields, TARGETS, n=4, std=STD)
    for count, found in enumerate(advice.expected_mm):
        variances = np.diag(left(body, fields, free[advice.chosen[:count]])).reshape(2, 3).sum(axis=1)
        # Rounding of twelve downdates of variances that are up to 1e3 times as large as what is left.
        np.testing.assert_allclose(found, np.sqrt(variances), rtol=1e-9)


def test_markers_that_are_placed_count_like_those_that_were_picked(body, fields):
    all_at_once = tr.advise_markers(body, fields, TARGETS, n=4, std=STD)
    then = tr.advise_markers(body, fields, TARGETS, n=2, std=STD, placed_mm=all_at_once.places_mm[:2])
    np.testing.assert_array_equal(then.chosen, all_at_once.chosen[2:])
    np.testing.assert_allclose(then.expected_mm, all_at_once.expected_mm[2:], rtol=1e-9)  # another order of downdates


def test_the_choice_does_not_depend_on_the_order_of_candidates(body, fields):
    _, places = places_of(body)
    turned = tr.advise_markers(body, fields, TARGETS, n=3, std=STD, candidates_mm=places[::-1])
    np.testing.assert_array_equal(
        turned.places_mm, tr.advise_markers(body, fields, TARGETS, n=3, std=STD, candidates_mm=places).places_mm
    )


def test_chosen_markers_lie_as_far_apart_as_was_asked(body, fields):
    picked = tr.advise_markers(body, fields, TARGETS, n=4, std=STD, apart_mm=15.0).places_mm
    gaps = np.linalg.norm(picked[:, None] - picked, axis=2) + 99.0 * np.eye(4)
    assert gaps.min() >= 15.0


def test_more_markers_than_fit_so_far_apart_are_refused(body, fields):
    with pytest.raises(MarkerError, match="must find candidates 60 mm apart, only 1 did"):
        tr.advise_markers(body, fields, TARGETS, n=4, std=STD, apart_mm=60.0)


def test_an_ensemble_smaller_than_the_measurement_is_refused(body, fields):
    with pytest.raises(EnsembleError, match="more than 61 members for 20 markers, got 60"):
        tr.advise_markers(body, fields, TARGETS, n=20, std=STD)


def test_advice_changes_nothing_that_it_is_given(body, fields):
    before = fields.copy()
    tr.advise_markers(body, fields, TARGETS, n=2, std=STD)
    np.testing.assert_array_equal(fields, before)
