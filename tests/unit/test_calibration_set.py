"""Honest events as a yardstick: rates of false alarms, and signs that none of them shows."""

import numpy as np
import pytest

from support.mixtures import decoder
from tissuereg.registration.learned.calibrate import _regions
from tissuereg.registration.learned.calibration_set import STATISTICS, CalibrationSet
from tissuereg.registration.learned.mixture import Component, Evidence, LinearDecoder
from tissuereg.registration.learned.smoother import Screening
from tissuereg.registration.learned.spread_law import squared_radius
from tissuereg.registration.learned.statistics import statistics_of


def drawn(n_events, rng, heavier=1.0):
    """Return statistics of events: exponential ones that share a part, one of them mostly zero."""
    common = 0.5 * rng.exponential(size=(n_events, 1))
    signs = common + heavier * rng.exponential(size=(n_events, 5))
    signs[:, 3] = np.maximum(signs[:, 3] - 4.0, 0.0)
    return signs


@pytest.mark.parametrize("n_events", [136, 1000])
def test_one_in_fifty_honest_events_raises_an_alarm_whatever_their_number(n_events):
    rng = np.random.default_rng(0)
    rates = []
    for _ in range(30):
        honest = CalibrationSet.none().beside(drawn(n_events, rng))
        rates.append(np.mean([honest.p_value(signs) < honest.level for signs in drawn(200, rng)]))
    # The rate of one yardstick of n events varies by sqrt(0.02 / n), up to 1.2 %; the mean of 30, of 200 asked each, by
    # 0.3 %: three standard errors.
    assert abs(np.mean(rates) - 0.02) < 0.009


def test_p_values_of_honest_events_are_uniform():
    rng = np.random.default_rng(1)
    honest = CalibrationSet.none().beside(drawn(2000, rng))
    p = np.sort([honest.p_value(signs) for signs in drawn(400, rng)])
    # Kolmogorov's 1 % point, of both samples.
    assert np.abs(p - (np.arange(400) + 0.5) / 400).max() < 1.63 * np.sqrt(1 / 400 + 1 / 2000)


def test_groups_count_alike_whatever_their_size():
    rng = np.random.default_rng(2)
    known, foreign = drawn(500, rng), drawn(200, rng, heavier=2.0)
    alone, only = CalibrationSet.none().beside(known), CalibrationSet.none().beside(foreign)
    both = alone.beside(foreign)
    assert np.array_equal(np.unique(both.groups), [0, 1])
    signs = np.array([9.0, 1.0, 1.0, 0.0, 1.0])
    assert alone.p_value(signs) < 0.01 < both.p_value(signs) < only.p_value(signs)
    np.testing.assert_allclose(both.shares(signs), 0.5 * (alone.shares(signs) + only.shares(signs)))
    assert [both.share(number, sign) for number, sign in enumerate(signs)] == list(both.shares(signs))
    # An event of either physics, as likely of one as of the other, alarms once in fifty.
    asked = np.concatenate([drawn(1000, rng), drawn(1000, rng, heavier=2.0)])
    rates = [np.mean([both.p_value(one) < both.level for one in part]) for part in np.split(asked, 2)]
    assert rates[0] < 0.01 < rates[1] < 0.06
    assert abs(np.mean(rates) - 0.02) < 0.01


def test_shares_go_on_beyond_the_largest_honest_value():
    honest = CalibrationSet.none().beside(np.tile(np.random.default_rng(3).exponential(size=(3000, 1)), 5))
    asked = np.linspace(0.0, 12.0, 40)
    shares = np.array([honest.shares(np.full(5, one))[0] for one in asked])
    assert (np.diff(shares) <= 0).all()
    # The scale of the tail is known from 300 values, to 6 %: 0.6 in the logarithm at 10 beyond; three standard errors.
    np.testing.assert_allclose(np.log(shares), -asked, atol=1.9)
    equal = CalibrationSet.none().beside(np.zeros((12, 5)))
    assert equal.shares(np.zeros(5))[0] == 1.0
    assert equal.shares(np.full(5, 3.0))[0] < 0.1


def test_without_honest_events_roots_of_chances_are_taken_for_shares():
    honest = CalibrationSet.none()
    # Distances from the training set and odds of another event are no chances: they say nothing.
    np.testing.assert_allclose(
        honest.shares(np.array([6.0, -1.0, 8.0, 20.0, 4.0])), [np.exp(-3.0), 1.0, 1.0, 1.0, np.exp(-2.0)]
    )
    assert [honest.share(number, 6.0) for number in (0, 2)] == [pytest.approx(np.exp(-3.0)), 1.0]
    assert honest.level < honest.beside(np.ones((9, 5))).level
    # The rarest of three (Bonferroni).
    assert honest.p_value(np.array([6.0, 1.0, 8.0, 0.0, 0.0])) == pytest.approx(3.0 * np.exp(-3.0))
    assert honest.p_value(np.array([0.1, -1.0, 8.0, 20.0, 0.0])) == 1.0


# --- signs ---


@pytest.fixture
def gaussian():
    rng = np.random.default_rng(4)
    slopes, errors = rng.standard_normal((15, 4)), rng.standard_normal((15, 18))
    one = Component(np.ones(1), np.ones(1), np.zeros(4), np.diag([1.0, 2.0, 0.5, 1.0]), 0.05 * errors @ errors.T)
    return one, LinearDecoder(np.zeros(4), rng.standard_normal(15), slopes), 0.04 * np.eye(12), rng


class Nowhere:
    """A calibration for which all codes are equally familiar."""

    def distance(self, code):
        return 0.0


def test_markers_of_another_event_than_the_simulated_one_show_it(gaussian):
    one, linear, noise, rng = gaussian
    about = Component(np.array([0.98]), np.ones(1), np.array([3.0, 0, 0, 0]), 0.01 * np.eye(4), 0.1 * one.errors)
    other = Component(np.array([0.02]), np.ones(1), one.mean, one.covariance, one.errors)
    found = {}
    for name, latents in (("own", [3.1, 0, 0, 0]), ("another", [-1.0, 1.5, 0, 0])):
        observed = linear.at[:12] + linear.slopes[:12] @ np.array(latents) + 0.2 * rng.standard_normal(12)
        prior = [about, other]
        screening = Screening.of(decoder(linear), prior, observed, noise, np.zeros(4), np.ones(4), simulated=True)
        found[name] = statistics_of(Nowhere(), prior, screening, observed, noise, 1).row
    simulation = STATISTICS.index("simulation")
    assert found["own"][simulation] == 0.0
    assert found["another"][simulation] > 10.0
    honest = CalibrationSet.none().beside(drawn(200, np.random.default_rng(5)) * [1, 1, 1, 0, 1])
    assert honest.p_value(found["another"]) < 0.01


def test_about_a_simulation_one_linearisation_is_left_out_and_markers_are_compared_at_once(gaussian):
    one, linear, noise, rng = gaussian
    observed, calls = rng.standard_normal(12), []

    def decode(latents):
        calls.append(latents.shape[1])
        return decoder(linear)(latents)

    for simulated, rounds in ((False, 3), (True, 2)):
        calls.clear()
        found = Screening.of(decode, [one], observed, noise, np.zeros(4), np.ones(4), simulated=simulated)
        assert len(calls) == rounds
        assert found.first.misfits.shape[1] == (4 if simulated else 0)
        assert found.under([one], observed, noise).first.misfits.shape == found.first.misfits.shape


def test_about_a_simulation_a_wrong_marker_is_told_by_slopes_that_it_did_not_bend():
    def decode(latents):
        # Three markers follow the second latent; the last moves by the product of both.
        rows = np.zeros((latents.shape[1], 12))
        rows[:, [0, 3, 6]] = latents[1][:, None]
        rows[:, 9] = latents[0] * latents[1]
        return rows

    one = Component(np.array([0.98]), np.ones(1), np.zeros(2), np.eye(2), 1e-4 * np.eye(12))
    noise = np.diag(np.repeat([0.3, 0.3, 0.3, 0.1], 3) ** 2)
    prior = [one, Component(np.array([0.02]), one.scales, one.mean, one.covariance, one.errors)]
    observed = decode(np.array([[0.5], [0.1]]))[0]
    observed[9] += 1.5
    screening = Screening.of(decode, prior, observed, noise, np.zeros(2), np.ones(2), simulated=True)
    _, about_answer = Evidence.of(prior, screening.linear, observed, noise, compared="every").chances()
    shown = statistics_of(Nowhere(), prior, screening, observed, noise, 1)
    assert np.argmax(shown.marker_rows) == 3
    # Where it pulled the decoder to, it looks far likelier.
    assert shown.marker_rows[3] + np.log(4.0) > 5.0 - np.log(about_answer[3])


def test_noise_that_is_larger_than_stated_shows_and_smaller_noise_does_not(gaussian):
    one, linear, noise, rng = gaussian
    small = Component(one.weights, one.scales, one.mean, one.covariance, 0.1 * one.errors)
    found = {}
    for factor in (0.3, 1.0, 10.0):
        error = np.linalg.cholesky(small.errors[:12, :12]) @ rng.standard_normal(12)
        observed = linear.at[:12] + linear.slopes[:12] @ rng.standard_normal(4) + error
        observed += factor * 0.2 * rng.standard_normal(12)
        screening = Screening.of(decoder(linear), [small], observed, noise, np.zeros(4), np.ones(4))
        found[factor] = statistics_of(Nowhere(), [small], screening, observed, noise, 1).row[STATISTICS.index("noise")]
    assert found[0.3] == found[1.0] == 0.0
    # The odds of the likeliest of two factors, less what Markov's bound pays for either.
    larger = [Evidence.of([small], screening.linear, observed, f**2 * noise).logs[0] for f in (1.0, 3.0, 10.0)]
    assert found[10.0] == pytest.approx(max(larger[1:]) - larger[0] - np.log(2.0))
    assert found[10.0] > 3.0


# --- regions ---


@pytest.mark.parametrize("dof", [3.0, 8.0, None])
def test_regions_hold_their_share_of_points_about_their_means(dof):
    rng = np.random.default_rng(6)
    points = rng.standard_normal((40_000, 3))
    if dof is not None:
        points *= np.sqrt(dof / rng.chisquare(dof, (40_000, 1)))
    squares = np.sum(points**2, axis=1)
    widening, tail = _regions(squares)
    assert (tail is None or tail > 30.0) if dof is None else tail == pytest.approx(dof, rel=0.15)
    # Binomial: standard error 0.25 %, four of them.
    for share in (0.5, 0.8, 0.9, 0.95, 0.99):
        assert np.mean(squares / widening <= squared_radius(share, tail)) == pytest.approx(share, abs=0.01)
    assert squared_radius(0.9, tail) == pytest.approx(squared_radius(0.9, None))
