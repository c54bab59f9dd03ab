"""Markers tested after the fit: wrong ones found, good ones kept, in a problem with few strong and many weak modes."""

import numpy as np
import pytest
from scipy.stats import chi2

from tissuereg.errors import NoiseError, ShapeError
from tissuereg.registration.learned.assimilate import gauss_newton
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.wrong_markers import drop_wrong, score_markers

N_MARKERS, N_LATENT, STD = 15, 26, 0.1
PRIOR = Gaussian(np.zeros(N_LATENT), np.eye(N_LATENT))


def event(seed):
    """Return a model that bends a little, and what is measured of a draw from its prior."""
    rng = np.random.default_rng(seed)
    straight, bent = rng.standard_normal((2, 3 * N_MARKERS, N_LATENT)) * 0.8 ** np.arange(N_LATENT)

    def predict(latents):
        return straight @ latents + 0.02 * (bent @ latents) ** 2

    truth = rng.standard_normal((N_LATENT, 1))
    return predict, predict(truth)[:, 0] + STD * rng.standard_normal(3 * N_MARKERS)


def screened(predict, observed, **options):
    def fit(kept):
        rows = (3 * kept[:, None] + np.arange(3)).ravel()
        noise = STD**2 * np.eye(len(rows))
        found = gauss_newton(lambda z: predict(z)[rows], observed[rows], noise, PRIOR)
        residual = (observed[rows] - found.predicted).reshape(-1, 3)
        return found, score_markers(residual, noise, found.absorbed)

    return drop_wrong(fit, N_MARKERS, **options)


def test_a_marker_ten_deviations_off_is_found():
    found = 0
    for run in range(60):
        predict, observed = event([1, run])
        direction = np.random.default_rng([2, run]).standard_normal(3)
        wrong = run % N_MARKERS
        observed[3 * wrong : 3 * wrong + 3] += 10 * STD * direction / np.linalg.norm(direction)
        _, dropped = screened(predict, observed)
        found += [marker for marker, _ in dropped] == [wrong]
    assert found >= 58


def test_good_markers_are_kept():
    alarms = sum(bool(screened(*event([3, run]))[1]) for run in range(300))
    # At a level of 0.005 at most 1.5 are expected.
    assert alarms <= 3


def test_two_wrong_markers_are_dropped_one_after_the_other():
    predict, observed = event(4)
    observed[6:9] += 2.0
    observed[30:33] -= 1.5
    fit, dropped = screened(predict, observed)
    assert sorted(marker for marker, _ in dropped) == [2, 10]
    assert all(p < 1e-6 for _, p in dropped)
    # The last fit is that of the others.
    assert fit.predicted.shape == (39,)
    assert [marker for marker, _ in screened(predict, observed, max_dropped=1)[1]] == [dropped[0][0]]
    assert screened(predict, observed, max_dropped=0)[1] == []


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
