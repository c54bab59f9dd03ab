"""Markers tested after the fit of a linear Gaussian model: wrong ones found, good ones kept, scores in closed form."""

import numpy as np
import pytest
from scipy.stats import chi2

from tissuereg.errors import NoiseError, ShapeError
from tissuereg.registration.wrong_markers import most_wrong, score_markers

N_MARKERS, N_LATENT, STD, LEVEL = 15, 26, 0.1, 0.005
N_OBS = 3 * N_MARKERS


def event(seed):
    """Return the slopes of a model with few strong and many weak modes, and what is measured of a draw from N(0, I)."""
    rng = np.random.default_rng(seed)
    slopes = rng.standard_normal((N_OBS, N_LATENT)) * 0.8 ** np.arange(N_LATENT)
    return slopes, slopes @ rng.standard_normal(N_LATENT) + STD * rng.standard_normal(N_OBS)


def scored(slopes, observed):
    """Return the scores of the markers about the posterior mean, which is in closed form."""
    noise = STD**2 * np.eye(len(observed))
    covariance = np.linalg.inv(np.eye(N_LATENT) + slopes.T @ slopes / STD**2)
    residual = observed - slopes @ (covariance @ slopes.T @ observed / STD**2)
    return score_markers(residual.reshape(-1, 3), noise, slopes @ covariance @ slopes.T)


def test_a_score_is_the_misfit_to_the_prediction_from_all_others():
    slopes, observed = event(0)
    observed[6:9] += 0.4
    found = scored(slopes, observed)
    total = slopes @ slopes.T + STD**2 * np.eye(N_OBS)
    for marker in range(N_MARKERS):
        own = np.arange(3 * marker, 3 * marker + 3)
        others = np.setdiff1d(np.arange(N_OBS), own)
        gain = np.linalg.solve(total[np.ix_(others, others)], total[np.ix_(others, own)]).T
        left = observed[own] - gain @ observed[others]
        misfit = left @ np.linalg.solve(total[np.ix_(own, own)] - gain @ total[np.ix_(others, own)], left)
        assert found.chi_square[marker] == pytest.approx(misfit, rel=1e-7)
        assert found.p_value[marker] == pytest.approx(chi2.sf(misfit, 3), rel=1e-6)
    assert np.argmax(found.chi_square) == 2


def test_a_marker_ten_deviations_off_is_found():
    found = 0
    for run in range(60):
        slopes, observed = event([1, run])
        direction = np.random.default_rng([2, run]).standard_normal(3)
        wrong = run % N_MARKERS
        observed[3 * wrong : 3 * wrong + 3] += 10 * STD * direction / np.linalg.norm(direction)
        found += scored(slopes, observed).wrong(LEVEL)[:1] == [wrong]
    assert found >= 58


def test_good_markers_are_kept():
    alarms = sum(bool(scored(*event([3, run])).wrong(LEVEL)) for run in range(300))
    # At a level of 0.005 at most 1.5 are expected.
    assert alarms <= 4


def test_the_worst_marker_comes_first_and_the_level_is_shared_out():
    slopes, observed = event(4)
    observed[6:9] += 2.0
    observed[30:33] -= 1.5
    found = scored(slopes, observed)
    wrong = found.wrong(LEVEL)
    assert {2, 10} <= set(wrong)
    assert (np.diff(found.p_value[wrong]) >= 0.0).all()
    assert sorted(wrong) == np.flatnonzero(found.p_value < LEVEL / N_MARKERS).tolist()


@pytest.mark.parametrize(("n_markers", "most"), [(1, 0), (2, 0), (3, 1), (4, 1), (15, 7), (16, 7)])
def test_fewer_than_half_of_the_markers_can_be_told_to_be_wrong(n_markers, most):
    assert most_wrong(n_markers) == most


def test_scores_and_chances_are_those_of_the_residuals_own_covariance():
    rng = np.random.default_rng(5)
    root = rng.standard_normal((6, 6))
    noise = root @ root.T + np.eye(6)
    absorbed = 0.3 * noise
    residual = rng.standard_normal((2, 3))
    residual[1, 2] = np.nan
    scores = score_markers(residual, noise, absorbed)
    for marker, rows in enumerate(([0, 1, 2], [3, 4])):
        seen = np.arange(5)
        inverse = np.linalg.inv(noise[np.ix_(seen, seen)])
        weighted = (inverse @ residual.ravel()[seen])[rows]
        # The fit has left 0.7 of the noise everywhere.
        wanted = weighted @ np.linalg.solve(0.7 * inverse[np.ix_(rows, rows)], weighted)
        assert scores.chi_square[marker] == pytest.approx(wanted, rel=1e-11)
        assert scores.n_obs[marker] == len(rows)
        assert scores.p_value[marker] == pytest.approx(chi2.sf(wanted, len(rows)), rel=1e-10)
    np.testing.assert_allclose(scores.leverage, 0.3, rtol=1e-12)


def test_a_marker_that_was_not_seen_is_neither_wrong_nor_counted():
    residual = np.full((3, 3), np.nan)
    residual[0] = 0.0
    # A chance of 0.004: below 0.01 over two markers, not over three.
    residual[1] = (np.sqrt(chi2.isf(0.004, 3)), 0.0, 0.0)
    scores = score_markers(residual, np.eye(9), np.zeros((9, 9)))
    assert scores.wrong(0.01) == [1]
    assert (scores.p_value[2], scores.n_obs[2]) == (1.0, 0)
    nothing = score_markers(np.full((2, 3), np.nan), np.eye(6), np.zeros((6, 6)))
    assert nothing.wrong(0.5) == []


def test_wrong_arrays_are_refused():
    with pytest.raises(ShapeError, match=r"`noise` must have shape \(6, 6\)"):
        score_markers(np.zeros((2, 3)), np.eye(5), np.zeros((6, 6)))
    with pytest.raises(NoiseError, match="fails at pivot 3"):
        score_markers(np.zeros((2, 3)), np.diag([1.0, 1, 1, -1, 1, 1]), np.zeros((6, 6)))
