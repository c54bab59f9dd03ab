"""The temporal prior: how far the frames before count."""

import numpy as np
import pytest

from tissuereg.tracking.temporal import TemporalPrior

N, STD, FRAME_S = 45, 0.1, 0.025
SCORED = slice(0, N)


def filtered(answers, changes=None, elapsed=FRAME_S, relative=1.0, prior=None):
    """Return the filtered answers of a stream, and the gain of each."""
    prior = prior or TemporalPrior(STD**2)
    changes = np.zeros_like(answers) if changes is None else changes
    found, gains = [], []
    for answer, change in zip(answers, changes, strict=True):
        found.append(prior.updated(answer, change, elapsed, relative, SCORED))
        gains.append(prior.gain)
    return np.array(found), np.array(gains)


def noise(seed, count, std=STD):
    return std * np.random.default_rng(seed).standard_normal((count, N))


@pytest.mark.parametrize("seed", range(10))
def test_on_a_still_body_no_frame_after_the_first_is_worse_than_alone(seed):
    answers = noise(seed, 40)
    found, gains = filtered(answers)
    squares = (found**2).mean(axis=1)
    assert squares[1:].max() < (answers**2).mean()
    # The mean of n frames has a variance of 1 / n; with unknown rates a third of the way to it is well within reach.
    assert squares[-10:].mean() < STD**2 / 8
    assert ((gains > 0.0) & (gains <= 1.0)).all()


def test_what_all_frames_share_is_not_touched():
    # Kalman's filter is linear, and its gains depend on innovations alone, in which a constant cancels.
    answers = noise(0, 20)
    shifted = filtered(answers + 3.0)[0] - filtered(answers)[0]
    # Rounding.
    assert np.allclose(shifted, 3.0, rtol=0.0, atol=1e-12)


def test_a_simulated_motion_much_smaller_than_the_noise_is_no_motion():
    answers, changes = noise(1, 20), 0.01 * noise(2, 20)
    still, gains = filtered(answers)
    found, same = filtered(answers + np.cumsum(changes, axis=0), changes)
    # A change of a hundredth of the noise adds 2.5e-5 to the variance of a frame.
    assert np.allclose(gains, same, rtol=0.0, atol=1e-3)
    assert np.allclose(found, still + np.cumsum(changes, axis=0), rtol=0.0, atol=1e-2 * STD)


def test_a_simulated_change_is_doubted_by_a_part_of_itself_at_once():
    steps = 5.0 * STD * np.ones((2, N))
    moving, still = (filtered(np.cumsum(changes, axis=0) + noise(4, 2), changes)[1] for changes in (steps, 0.0 * steps))
    # Half of five deviations has a variance of 6.25 times the noise's; so has every rate a gain of 7.25 / 8.25 or more.
    assert moving[1] >= 7.25 / 8.25
    assert still[1] < 0.8


def test_a_simulation_that_is_off_by_a_part_of_every_change_leaves_no_lag():
    steps = 5.0 * STD * np.ones((30, N))
    path, answers = np.cumsum(1.25 * steps, axis=0), noise(3, 30)
    found, _ = filtered(path + answers, steps)
    lag = (found - path)[10:].mean()
    # With a gain of 0.86 that follows from half of a change of five deviations, 0.2 of the part that is missing.
    assert abs(lag) < 0.3 * STD


def test_a_body_that_moves_much_more_than_the_noise_is_followed_at_once():
    path = np.cumsum(20.0 * STD * np.random.default_rng(3).standard_normal((30, N)), axis=0)
    found, gains = filtered(path + noise(4, 30))
    assert gains[1:].min() > 0.8
    # The noise alone, and what is left of the motion with a gain of 0.95.
    assert np.sqrt(((found - path)[5:] ** 2).mean()) < 1.5 * STD


@pytest.mark.parametrize("seed", range(10))
def test_a_body_that_moves_from_its_first_frame_on_is_followed_in_the_second(seed):
    # Five deviations a frame, not simulated. With noise and rate known the gain is 26 / 27; at 0.9 half a deviation of
    # the motion is left behind, less than the noise.
    steps = 5.0 * STD * np.random.default_rng(seed).standard_normal((2, N))
    _, gains = filtered(np.cumsum(steps, axis=0) + noise(100 + seed, 2))
    assert gains[1] > 0.9


def test_a_slow_drift_is_followed_with_less_error_than_frame_by_frame():
    # A tenth of the noise a frame, always in the same direction: each frame alone hardly shows it.
    path = 0.1 * STD * np.arange(60)[:, None] * np.ones(N)
    answers = path + noise(5, 60)
    found, _ = filtered(answers)
    assert ((found - path)[10:] ** 2).mean() < ((answers - path)[10:] ** 2).mean()


def test_after_a_motion_frames_are_averaged_again():
    path = np.cumsum(np.r_[np.ones(15), np.zeros(45)][:, None] * np.ones(N), axis=0)
    found, gains = filtered(path + noise(6, 60))
    assert gains[5:15].min() > 0.8
    assert gains[-10:].max() < 0.3
    assert ((found - path)[-10:] ** 2).mean() < STD**2 / 4


def test_a_frame_after_a_jump_is_its_own():
    path = np.r_[np.zeros(20), np.full(5, 30.0 * STD)][:, None] * np.ones(N)
    found, gains = filtered(path + noise(7, 25))
    assert gains[20] > 0.9
    assert np.sqrt(((found - path)[20:] ** 2).mean()) < 2.0 * STD


def test_a_late_frame_counts_more():
    gains = []
    for elapsed in (FRAME_S, 10.0 * FRAME_S, 1000.0 * FRAME_S):
        prior = TemporalPrior(STD**2)
        filtered(noise(8, 20), prior=prior)
        prior.updated(noise(9, 1)[0], np.zeros(N), elapsed, 1.0, SCORED)
        gains.append(prior.gain)
    assert gains[0] < gains[1] < gains[2]


def test_a_frame_with_few_markers_counts_less():
    gains = []
    for relative in (1.0, 5.0):
        prior = TemporalPrior(STD**2)
        filtered(noise(10, 10), prior=prior)
        prior.updated(noise(11, 1)[0], np.zeros(N), FRAME_S, relative, SCORED)
        gains.append(prior.gain)
    assert gains[1] < 0.5 * gains[0]


def test_the_stated_noise_is_a_first_guess_only():
    # The true noise is a fifth and five times the stated one: the gains end alike.
    ends = [filtered(noise(12, 40, factor * STD))[1][-5:].mean() for factor in (0.2, 5.0)]
    assert max(ends) < 0.3
