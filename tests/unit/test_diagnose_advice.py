"""Which action would distinguish tied causes, and by how much given noise and nuisance parameters."""

from dataclasses import replace

import numpy as np
import pytest

from support.targets import finding_of, part, target_of
from tissuereg.diagnosis.advice import _actions, _prediction, _separability, advise
from tissuereg.diagnosis.candidates import Candidate
from tissuereg.diagnosis.fit import fit
from tissuereg.diagnosis.search import Step
from tissuereg.experiment.effects import Poisson


@pytest.fixture(scope="module")
def target():
    return target_of(Poisson(poisson=0.3))


@pytest.fixture(scope="module")
def fits(target):
    return {name: fit(target, [part(target, name)]) for name in ("poisson", "scale")}


def apart(target, action, one, other):
    return _separability(target, action, one, *(_prediction(target, fitted, action) for fitted in (one, other)))


def tied(*names):
    return finding_of(names, probability=0.6, log_bayes_factor=9.0)


def step_of(target, fits, found):
    candidates = [Candidate(name, one, one.log_evidence, target) for name, one in fits.items()]
    return Step({}, candidates, next(c for c in candidates if c.id == found), None)


def test_the_action_that_separates_the_tied_causes_best_is_advised(target, fits):
    advice = advise(target, [step_of(target, fits, "poisson")], [tied("poisson", "scale")])
    assert advice["separates"] == [["poisson", "scale"]]
    each = []
    for words, action in _actions(target.bench.experiment):
        each.append((apart(target, action, fits["poisson"], fits["scale"]), words))
    assert (advice["separability"], advice["action"]) == max(each)
    # Frame, modulus and forces explain some of it.
    one, other = (_prediction(target, fits[name], action) for name in ("poisson", "scale"))
    plain = np.linalg.norm((one - other) / np.where(np.arange(len(one)) < 9 * 18, 0.01, 2.0))
    assert 0.0 < each[-1][0] < plain


@pytest.mark.parametrize("scales", [True, False])
def test_a_difference_within_the_uncertainty_of_the_modulus_does_not_separate(target, fits, scales, monkeypatch):
    # Known to a third: forces that differ by as much are many noise deviations apart.
    one = replace(fits["poisson"], covariance=np.diag([0.35**2, 1e-4]))
    stiffer = replace(one, x=one.x + np.array([0.35, 0.0]))
    _, action = _actions(target.bench.experiment)[0]
    monkeypatch.setattr(target.bench, "scales_forces", scales)
    assert apart(target, action, one, stiffer) < 2.0
    surer = replace(one, covariance=np.diag([1e-8, 1e-4]))
    assert apart(target, action, surer, stiffer) > 20.0


def test_members_of_a_group_are_compared_with_the_finding_of_their_own_round(target, fits):
    both = fit(target, [part(target, "poisson"), part(target, "latency")])
    later = {"latency": both, "scale": fit(target, [part(target, "poisson"), part(target, "scale")])}
    steps = [step_of(target, fits, "poisson"), step_of(target, later, "latency")]
    findings = [tied("poisson", "scale"), tied("latency", "scale")]
    advice = advise(target, steps, findings)
    assert advice["separates"] == [["poisson", "scale"], ["latency", "scale"]]
    action = dict(_actions(target.bench.experiment))[advice["action"]]
    each = [
        apart(target, action, fits["poisson"], fits["scale"]),
        apart(target, action, later["latency"], later["scale"]),
    ]
    assert advice["separability"] == min(each)


def test_nothing_is_advised_where_nothing_is_tied(target, fits):
    assert advise(target, [step_of(target, fits, "poisson")], [tied("poisson")]) is None
