"""Spread against error over many runs, at targets that were not observed: a statistical test with fixed seeds."""

import numpy as np
import pytest
from scipy.stats import chi2

from tissuereg.registration.learned.model import Gaussian
from tissuereg_paper.rivals.assimilation import AssimilationSettings, StepOptions, assimilate

N_LATENT, N_MARKERS, N_TARGETS, N_EVENTS, N_MEMBERS = 6, 5, 4, 400, 60


class Body:
    """Markers and targets that move with the latents, slightly bent, as a decoder's do."""

    def __init__(self):
        rng = np.random.default_rng(11)
        self.markers = rng.standard_normal((3 * N_MARKERS, N_LATENT))
        self.targets = rng.standard_normal((3 * N_TARGETS, N_LATENT))
        root = rng.standard_normal((N_LATENT, N_LATENT))
        self.prior = Gaussian(rng.standard_normal(N_LATENT), root @ root.T / N_LATENT + 0.2 * np.eye(N_LATENT))
        shared = rng.standard_normal((3 * N_MARKERS, 2))
        self.noise = np.diag(rng.uniform(0.3, 1.0, 3 * N_MARKERS)) + 0.2 * shared @ shared.T

    @staticmethod
    def bent(displacements):
        return displacements + 0.01 * displacements**2


class Scores:
    """Coverage, CRPS and ranks of the truth, one entry an event and target or coordinate."""

    def __init__(self, body, noise_scale, **settings):
        rng = np.random.default_rng(23)
        covered, crps, sharpness, ranks = [], [], [], []
        prior_root, noise_root = np.linalg.cholesky(body.prior.covariance), np.linalg.cholesky(body.noise)
        for _ in range(N_EVENTS):
            truth = body.prior.mean + prior_root @ rng.standard_normal(N_LATENT)
            observed = body.bent(body.markers @ truth) + noise_root @ rng.standard_normal(3 * N_MARKERS)
            found = assimilate(
                lambda z: body.bent(body.markers @ z),
                observed,
                noise_scale * body.noise,
                body.prior,
                rng=rng,
                settings=AssimilationSettings(n_members=N_MEMBERS, threads=1, **settings),
            )
            members = body.bent(body.targets @ found.latents)
            at = body.bent(body.targets @ truth)
            mean = members.mean(axis=1)
            for target in range(N_TARGETS):
                rows = slice(3 * target, 3 * target + 3)
                covariance = np.cov(members[rows]) * found.spread_factor
                off = at[rows] - mean[rows]
                covered.append(off @ np.linalg.solve(covariance, off) <= chi2.ppf(0.9, 3))
            pairs = np.abs(members[:, :, None] - members[:, None, :]).mean(axis=(1, 2))
            crps.append((np.abs(members - at[:, None]).mean(axis=1) - pairs / 2).mean())
            sharpness.append((pairs / 2).mean())
            ranks.append((members < at[:, None]).sum(axis=1))
        self.coverage = float(np.mean(covered))
        self.crps, self.sharpness = float(np.mean(crps)), float(np.mean(sharpness))
        # Coordinates of one event depend on each other: one of them each event is independent of the others.
        chosen = np.array(ranks)[np.arange(N_EVENTS), np.arange(N_EVENTS) % (3 * N_TARGETS)]
        self.histogram = np.histogram(chosen, bins=10, range=(0, N_MEMBERS + 1))[0]

    @property
    def flatness(self):
        """Chi-square of the rank histogram with nine degrees of freedom."""
        wanted = N_EVENTS / len(self.histogram)
        return float(((self.histogram - wanted) ** 2 / wanted).sum())


@pytest.fixture(scope="module")
def body():
    return Body()


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"options": StepOptions(form="square_root")},
    ],
    ids=["stochastic", "square-root"],
)
def test_regions_at_targets_hold_what_they_promise(body, settings):
    scores = Scores(body, 1.0, **settings)
    # 1600 targets in 400 independent events: standard error at most 1.5 %, and the model is not quite linear.
    assert 0.86 <= scores.coverage <= 0.94
    # Of a calibrated ensemble the mean CRPS is half the mean distance of two members; standard error 2 %.
    assert scores.crps == pytest.approx(scores.sharpness, rel=0.08)
    # One in a thousand flat histograms is less flat.
    assert scores.flatness < chi2.ppf(0.999, 9)


def test_the_scores_see_a_noise_stated_too_small_or_too_large(body):
    small, large = Scores(body, 0.25), Scores(body, 4.0)
    assert small.coverage < 0.86
    assert large.coverage > 0.94
    assert small.crps > 1.2 * small.sharpness
    assert large.crps < 0.8 * large.sharpness
    for scores in (small, large):
        assert scores.flatness > chi2.ppf(0.999, 9)
