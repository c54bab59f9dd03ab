"""The answer to "can I trust this?" under known misfits."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from tissuereg.registration.trust import judge, judge_by_rehearsal, lone_motion

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


@pytest.mark.parametrize(("chance", "trusted"), [(0.02, True), (0.005, False)])
def test_a_misfit_takes_trust_below_a_chance_of_one_percent(chance, trusted):
    trust = verdict(np.zeros((8, 3)), prior_misfit=float(chi2.isf(chance, 24)))
    assert trust.p_value == pytest.approx(chance)
    assert trust.ok == trusted


@pytest.mark.parametrize(("share", "trusted"), [(2.0, True), (0.5, False)])
def test_one_percent_is_shared_out_among_markers(share, trusted):
    residual = np.zeros((8, 3))
    # What the fit has absorbed leaves 0.8 of the noise.
    residual[5, 0] = 0.1 * np.sqrt(0.8 * chi2.isf(share * 0.01 / 8, 3))
    trust = verdict(residual)
    assert trust.ok == trusted
    assert all(reason.startswith("wrong marker: P5 ") for reason in trust.reasons)


@pytest.mark.parametrize(("alone", "near", "said"), [(15.0, 40.0, True), (7.0, 40.0, False), (15.0, 5.0, False)])
def test_a_large_motion_that_one_marker_alone_reports_is_said_unless_a_neighbour_can_confirm_it(alone, near, said):
    places = np.array([[0.0, 0.0, 0.0], [near, 0.0, 0.0], [0.0, 60.0, 0.0], [50.0, 50.0, 0.0]])
    moved, std = np.array([alone, 2.0, 0.5, 1.0]), np.full(4, 0.1)
    found = lone_motion(("A", "B", "C", "D"), places, moved, std, 100.0)
    assert [reason[:13] for reason in found] == (["lone motion: "] if said else [])
    assert lone_motion(("A", "B", "C", "D"), places, moved, 20.0 * std, 100.0) == []
    assert lone_motion(("A",), places[:1], moved[:1], std[:1], 100.0) == []


def test_components_that_were_not_seen_are_no_observations():
    # A camera sees two of three components: p-values are those of what it saw.
    rng = np.random.default_rng(3)
    p = []
    for _ in range(400):
        residual = 0.1 * rng.standard_normal((8, 3))
        residual[:, 2] = np.nan
        trust = verdict(residual)
        assert trust.n_obs == 16
        p.append(trust.p_value)
    assert np.abs(np.sort(p) - (np.arange(400) + 0.5) / 400).max() < 1.63 / np.sqrt(400)
    # A marker of one component is wrong if that component is.
    one = np.full((8, 3), np.nan)
    one[:, 0] = 0.0
    limit = float(chi2.isf(0.01 / 8, 1))
    for share, trusted in ((0.9, True), (1.1, False)):
        # The posterior takes a fifth of the noise.
        one[4, 0] = 0.1 * np.sqrt(0.8 * share * limit)
        assert verdict(one).ok == trusted


def test_one_marker_alone_is_not_trusted_unless_points_are_there():
    noise = 0.01 * np.eye(3)
    alone = judge(("P0",), np.zeros((1, 3)), noise, 0.2 * noise, 0.0, 0.8, [])
    assert not alone.ok
    assert alone.reasons[0].startswith("few markers: P0 ")
    assert judge(("P0",), np.zeros((1, 3)), noise, 0.2 * noise, 0.0, 0.8, [], (40.0, 40)).ok


def test_an_answer_of_no_marker_is_not_trusted_unless_points_are_there():
    none, nothing = np.empty((0, 0)), np.empty((0, 3))
    trust = judge((), nothing, none, none, 0.0, 0.8, [])
    assert trust.reasons == ["few markers: none was used"]
    assert (trust.ok, trust.p_value) == (False, 1.0)
    assert judge((), nothing, none, none, 0.0, 0.8, [], (40.0, 40)).ok
    shown = SimpleNamespace(row=np.zeros(4), marker_rows=np.empty(0), marker_misfits=np.empty(0))
    assert judge_by_rehearsal((), nothing, none, Events(), shown, 0.8, []).reasons == ["few markers: none was used"]


class Events:
    """Honest events of which a share of exp(-sign) looks as bad, and of all signs together four times the least."""

    level = 0.01

    def shares(self, signs):
        return np.exp(-np.asarray(signs))

    def share(self, number, sign):
        return float(np.exp(-sign))

    def p_value(self, signs):
        return float(4.0 * self.shares(signs).min())


class Strict(Events):
    """The same, with fewer false alarms."""

    level = 0.001


def compared(misfit=0.5, markers=None, distance=1.0, unrelated=0.0, noise=1.0, min_det_f=0.8, notes=(), events=None):
    """Return the verdict on signs, given as shares of honest events that look as bad."""
    markers = np.ones(8) if markers is None else markers
    signs = -np.log([misfit, markers.min(), distance, np.exp(-unrelated), noise])
    noise = 0.01 * np.eye(24)
    shown = SimpleNamespace(row=signs, marker_rows=-np.log(markers), marker_misfits=np.full(8, 9.0))
    return judge_by_rehearsal(NAMES, np.zeros((8, 3)), noise, events or Events(), shown, min_det_f, list(notes))


def test_what_honest_events_show_as_well_is_trusted():
    trust = compared(misfit=0.003)
    assert trust.ok
    assert trust.p_value == pytest.approx(0.012)


@pytest.mark.parametrize(
    ("given", "kind"),
    [
        ({"misfit": 0.002}, "misfit"),
        ({"distance": 0.002}, "unfamiliar"),
        ({"unrelated": 7.0}, "simulation"),
        ({"noise": 0.002}, "noise"),
        ({"min_det_f": -0.1}, "inverted tets"),
        ({"notes": ["simulation: another"]}, "simulation"),
    ],
)
def test_what_honest_events_do_not_show_is_a_reason(given, kind):
    assert [reason.split(":")[0] for reason in compared(**given).reasons] == [kind]


def test_the_events_say_below_which_share_an_answer_is_not_trusted():
    assert not compared(misfit=0.002).ok
    assert compared(misfit=0.002, events=Strict()).ok
    assert not compared(misfit=0.0002, events=Strict()).ok


def test_markers_that_are_rarer_than_in_honest_events_are_named():
    for share, trusted in ((0.0026, True), (0.0024, False)):
        markers = np.ones(8)
        markers[[2, 5]] = share
        trust = compared(markers=markers)
        assert trust.ok is trusted
        named = [reason.split()[2] for reason in trust.reasons if reason.startswith("wrong marker: ")]
        assert named == ([] if trusted else ["P2", "P5"])
