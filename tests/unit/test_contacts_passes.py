"""The loop over passes: which one counts, and when it ends."""

from types import SimpleNamespace

import pytest

from tissuereg._base.clock import Clock
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts.fit import Passes, _Pass
from tissuereg.registration.contacts.settings import ContactSettings


def passes_with(monkeypatch, residuals):
    """Passes that end with these residuals, one after the other; None is a limit point of the load."""
    found = iter(residuals)

    def one_pass(self, moment, samples):
        residual = next(found)
        if residual is None:
            message = "no tangent"
            raise ConvergenceError(message)
        return _Pass(residual, samples, None, residual, 0.0, 0.0)

    monkeypatch.setattr(Passes, "_one_pass", one_pass)
    observed = SimpleNamespace(rematches=False)
    return Passes(None, observed, None, ContactSettings(), None, 1, Clock())


def test_the_pass_with_the_smallest_residual_counts_not_the_last(monkeypatch):
    passes = passes_with(monkeypatch, [9.0, 4.0, 6.0, 7.0])
    closest, residuals = passes._approach("start", None, 4)
    assert closest.state == 4.0
    assert residuals == [9.0, 4.0, 6.0, 7.0]


def test_a_limit_point_ends_the_passes_with_the_best_so_far(monkeypatch):
    closest, residuals = passes_with(monkeypatch, [9.0, 5.0, 8.0, None])._approach("start", None, 8)
    assert (closest.state, residuals) == (5.0, [9.0, 5.0, 8.0])
    with pytest.raises(ConvergenceError):
        passes_with(monkeypatch, [None])._approach("start", None, 8)
