"""The battery of statistics that distinguishes a residual from noise."""

from types import SimpleNamespace

import numpy as np
import pytest

from support.rigs import rig
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.nulls import Battery, Misfit, smooth_subspaces
from tissuereg.diagnosis.proof import HeldOut
from tissuereg.diagnosis.run import _explains_enough, _verdict
from tissuereg.diagnosis.search import Step
from tissuereg.diagnosis.settings import DEFAULT
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


def test_the_explained_share_is_that_of_the_largest_statistic(subspaces, nulls):
    layout, bases = subspaces
    battery = Battery(layout, bases)
    noise = np.random.default_rng(7).standard_normal(layout.size)
    pattern = bases[0][0]
    misfit = battery.judge(noise + 100.0 * pattern, noise + 80.0 * pattern, nulls)
    assert misfit.p < 1e-6
    assert misfit.explained_there == pytest.approx(1.0 - 0.8**2, abs=0.03)
    assert misfit.explained == pytest.approx(1.0 - 0.8**2, abs=0.05)
    # What was added by a model was not explained.
    assert battery.judge(noise, noise + 80.0 * pattern, nulls).explained_there <= 0.0


def searched(gain=50.0, over_generic=10.0, over_others=10.0):
    """Return a search with one cause found, whose proof beats its rivals by so many nats."""
    proof = HeldOut(("a",), np.array([[0.0], [20.0], [20.0 - over_generic], [0.0]]), np.empty((4, 0)))
    found = SimpleNamespace(id="latency", gain=gain)
    rivals = 20.0 - min(over_generic, over_others)
    return SimpleNamespace(steps=[Step({}, [], found, proof, proof, rivals), Step({}, [], None, None)])


@pytest.mark.parametrize(
    ("p", "of_all", "there", "named"),
    [(0.02, 0.0, 0.0, True), (0.005, 0.9, 0.8, True), (0.005, 1.0, 0.3, False), (0.005, 0.4, 0.8, False)],
)
def test_findings_with_a_misfit_are_named_where_they_explain_half_of_all_and_of_the_worst(p, of_all, there, named):
    assert _explains_enough(Misfit(p, of_all, there), searched()) == named


@pytest.mark.parametrize(
    ("search", "of_all", "named"),
    [
        (searched(gain=2.0 * DEFAULT.search.clear), 0.99, True),
        (searched(gain=2.0 * DEFAULT.search.clear), 0.4, False),
        (searched(gain=0.9 * DEFAULT.search.clear), 0.99, False),
        (searched(gain=2.0 * DEFAULT.search.clear, over_generic=-1.0), 0.99, False),
        (searched(gain=2.0 * DEFAULT.search.clear, over_others=-1.0), 0.99, False),
    ],
)
def test_a_finding_far_ahead_of_its_rivals_is_named_despite_a_misfit(search, of_all, named):
    assert _explains_enough(Misfit(1e-9, of_all, 0.1), search) == named


def test_a_diagnosis_with_withdrawn_findings_is_never_consistent():
    assert _verdict([], 0.3, withdrawn=False) == "consistent"
    assert _verdict([], 0.3, withdrawn=True) == "unexplained"
    assert _verdict([], 0.003, withdrawn=False) == "unexplained"
