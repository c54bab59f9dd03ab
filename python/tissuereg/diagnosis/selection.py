"""The selection of causes, of bodies and of material tests alike.

Causes are accepted one after another; each is exchanged for a rival that explains clearly more; those that then fail
their tests, in the model of all causes, are taken out one at a time.
"""

from collections.abc import Mapping
from typing import Protocol, TypeVar

from tissuereg.diagnosis.answer import PossibleCause


class WithCauses(Protocol):
    """A fitted model with the causes found so far."""

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the causes, in their order."""


_K = TypeVar("_K", bound=WithCauses)


class Models(Protocol[_K]):
    """The models that data are compared with, and the tests of their causes."""

    def grown(self, known: _K) -> _K:
        """Return the model with one more cause, or two, that pass their tests; without one where none does."""

    def exchanged(self, known: _K) -> _K:
        """Return the model with causes exchanged for others that explain clearly more."""

    def tested(self, known: _K) -> tuple[_K, Mapping[int, PossibleCause]]:
        """Return the model with the evidence of every cause beside all others, and those that fail, by their number."""

    def without(self, known: _K, part: int, failed: PossibleCause) -> _K:
        """Return the model without a cause that failed, given by its number, or one that needs no further test."""


def selected(models: Models[_K], none: _K, most: int) -> _K:
    """Return the model with the causes that the data show, `most` at most; `none`: the one without any."""
    known = none
    while len(known.ids) < most:
        before, known = known, models.grown(known)
        if len(known.ids) == len(before.ids):
            break
    if len(known.ids) > 1:
        known = models.exchanged(known)
    while True:
        known, failed = models.tested(known)
        if not failed:
            return known
        # The one whose removal costs the least evidence: the others may pass without it.
        part = min(failed, key=lambda number: failed[number].log_bayes_factor)
        known = models.without(known, part, failed[part])
