"""The answer to "can I trust this?" under known misfits."""

import numpy as np

from tissuereg.trust import judge

NAMES = tuple(f"P{i}" for i in range(8))


def verdict(residual, prior_misfit=0.0, min_det_f=0.8, notes=()):
    noise = 0.01 * np.eye(24)
    return judge(NAMES, residual, noise, 0.2 * noise, prior_misfit, min_det_f, list(notes))


def test_residuals_like_the_noise_are_trusted():
    residual = 0.1 * np.random.default_rng(0).standard_normal((8, 3))
    trust = verdict(residual)
    assert trust.ok
    assert trust.p_value > 0.05
    assert trust.n_obs == 24


def test_a_wrong_marker_is_named():
    residual = 0.09 * np.random.default_rng(1).standard_normal((8, 3))
    residual[5] += (0.7, 0.0, 0.0)
    trust = verdict(residual)
    assert not trust.ok
    assert any(reason.startswith("wrong marker: P5 ") for reason in trust.reasons)


def test_a_misfit_of_the_whole_gives_a_small_p_value():
    trust = verdict(0.1 * np.ones((8, 3)), prior_misfit=60.0)
    assert trust.p_value < 1e-4
    assert trust.reasons[0].startswith("misfit: ")


def test_inverted_tets_speak_against_the_result():
    trust = verdict(np.zeros((8, 3)), min_det_f=-0.1)
    assert not trust.ok
    assert trust.reasons[0].startswith("inverted tets: ")


def test_p_values_of_pure_noise_are_uniform():
    rng = np.random.default_rng(2)
    p = np.array([verdict(0.1 * rng.standard_normal((8, 3))).p_value for _ in range(400)])
    # Largest distance from uniform: the 1 % point of Kolmogorov's law is 1.63 / sqrt(n).
    assert np.abs(np.sort(p) - (np.arange(400) + 0.5) / 400).max() < 1.63 / np.sqrt(400)
