"""Which action would tell tied causes apart, and by how much beside what is uncertain anyway."""

from dataclasses import replace

import numpy as np
import pytest

from support.targets import part, target_of
from tissuereg.diagnose.advice import _actions, _apart, _said, advise
from tissuereg.diagnose.answer import Finding
from tissuereg.diagnose.candidates import Candidate
from tissuereg.diagnose.fit import fit
from tissuereg.diagnose.search import Step
from tissuereg.effects import Poisson


@pytest.fixture(scope="module")
def target():
    return target_of(Poisson(poisson=0.3))


@pytest.fixture(scope="module")
def fits(target):
    return {name: fit(target, [part(target, name)]) for name in ("poisson", "scale")}


def tied(*names):
    return Finding(names[0], names, 0.6, 9.0, 6.0, {}, {}, {}, "")


def step_of(target, fits, found):
    candidates = [Candidate(name, one, one.log_evidence, target) for name, one in fits.items()]
    return Step({}, candidates, next(c for c in candidates if c.id == found), None)


def test_the_action_that_tells_the_tied_causes_best_apart_is_advised(target, fits):
    advice = advise(target, [step_of(target, fits, "poisson")], [tied("poisson", "scale")])
    assert advice["separates"] == [["poisson", "scale"]]
    each = []
    for action in _actions(target.bench.experiment):
        one, other = (_said(target, fits[name], action) for name in ("poisson", "scale"))
        each.append((_apart(target, action, one, other, fits["poisson"]), action.words))
    assert (advice["separability"], advice["action"]) == max(each)
    # Frame, modulus and forces take some of it.
    plain = np.linalg.norm((one - other) / np.where(np.arange(len(one)) < 9 * 18, 0.01, 2.0))
    assert 0.0 < each[-1][0] < plain


def test_what_a_modulus_known_so_well_may_change_tells_nothing(target, fits):
    one = fits["poisson"]
    stiffer = replace(one, x=one.x + np.array([np.sqrt(one.covariance[0, 0]), 0.0]))
    action = _actions(target.bench.experiment)[0]
    assert _apart(target, action, _said(target, one, action), _said(target, stiffer, action), one) < 1.0


def test_nothing_is_advised_where_nothing_is_tied(target, fits):
    assert advise(target, [step_of(target, fits, "poisson")], [tied("poisson")]) is None
