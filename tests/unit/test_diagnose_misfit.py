"""The battery of statistics that distinguishes a residual from noise."""

import numpy as np
import pytest

from support.rigs import rig
from tissuereg.diagnosis.answer import verdict_of
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.nulls import Battery, Misfit, smooth_subspaces
from tissuereg.diagnosis.run import _explains_enough
from tissuereg.diagnosis.signals import SignalLayout

N_NULLS = 300


@pytest.fixture(scope="module")
def subspaces():
    experiment = rig()
    layout = SignalLayout(experiment)
    bench = Bench(experiment, layout)
    noise = Noise(np.full(len(layout.marker_names), 0.01), 0.0, 0.0, 0.0, 1.0, 2.0, True)
    return layout, smooth_subspaces(layout, bench.base, bench.extent, noise)


@pytest.fixture(scope="module")
def nulls(subspaces):
    layout, _ = subspaces
    return np.random.default_rng(4).standard_normal((N_NULLS, layout.size))


def test_rows_of_a_subspace_are_orthonormal(subspaces):
    _, bases = subspaces
    assert len(bases) > 5
    for basis in bases:
        assert np.allclose(basis @ basis.T, np.eye(len(basis)), atol=1e-9)


def test_noise_is_a_misfit_as_rarely_as_its_p_value_says(subspaces, nulls):
    layout, bases = subspaces
    battery = Battery(layout, bases)
    drawn = np.random.default_rng(5).standard_normal((300, layout.size))
    p = np.array([battery.judge(one, one, nulls).p for one in drawn])
    # 3 expected; more than 11 in one of 10,000 runs.
    assert (p < 0.01).sum() <= 11
    assert 0.3 < np.median(p) < 0.7


def test_a_small_smooth_residual_in_phase_with_the_load_is_detected(subspaces, nulls):
    layout, bases = subspaces
    noise = np.random.default_rng(6).standard_normal(layout.size)
    pattern = bases[0].sum(axis=0) / np.sqrt(len(bases[0]))
    found = [Battery(layout, some).judge(noise, noise + 7.0 * pattern, nulls).p for some in (bases, [])]
    assert found[0] < 0.01
    # All sums of squares together are large enough to hide it.
    assert found[1] > 0.03


def test_the_explained_share_is_that_of_the_excess_over_noise(subspaces, nulls):
    layout, bases = subspaces
    battery = Battery(layout, bases)
    noise = np.random.default_rng(7).standard_normal(layout.size)
    pattern = bases[0][0]
    misfit = battery.judge(noise + 100.0 * pattern, noise + 80.0 * pattern, nulls)
    assert misfit.p < 1e-6
    assert misfit.explained == pytest.approx(1.0 - 0.8**2, abs=0.05)
    # What noise alone leaves is no misfit.
    half = battery.judge(noise + 30.0 * pattern, noise + 15.0 * pattern, nulls)
    assert half.explained == pytest.approx(0.75, abs=0.1)
    # Here it is less of the sum, of which louder noise is a part, than of the pattern, where it is 0.78.
    louder = battery.judge(1.2 * noise + 20.0 * pattern, 1.2 * noise + 10.0 * pattern, nulls)
    assert louder.explained == pytest.approx(0.63, abs=0.03)
    # What a model adds it does not explain, nor what other data, quiet by chance, make up for in the sum of all.
    few = 0.9 * noise
    assert battery.judge(few, few + 80.0 * pattern, nulls).explained <= 0.0
    for scale in (0.9, 1.0):
        left = battery.judge(scale * noise + 12.0 * pattern, scale * noise + 11.0 * pattern, nulls)
        assert left.explained < 0.3


@pytest.mark.parametrize(("p", "explained", "named"), [(0.02, 0.0, True), (0.005, 0.6, True), (0.005, 0.4, False)])
def test_findings_with_a_misfit_are_named_where_they_explain_half_of_it(p, explained, named):
    assert _explains_enough(Misfit(p, explained)) == named


def test_a_diagnosis_with_withdrawn_findings_is_never_consistent():
    assert verdict_of([], 0.3, withdrawn=False) == "consistent"
    assert verdict_of([], 0.3, withdrawn=True) == "unexplained"
    assert verdict_of([], 0.003, withdrawn=False) == "unexplained"
