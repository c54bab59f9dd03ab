"""Honest events, and how improbable a registration looks beside them.

A registration shows a few signs, each larger where it looks worse. No law of theirs is assumed: events that the model
never saw were registered, and the share of these that look as bad is the p-value. An event looks as bad as its worst
sign, so that the p-value of all signs together is again a share of honest events.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray

#: Signs, in the order of columns: minus the logarithm of the chance of the innovation; the same of the marker that fits
#: the others worst, times the number of markers; distance of the fitted code from the training set in standard
#: deviations; log-odds that the simulation is of another event, 0 where it is likelier of this one.
SIGNS = ("misfit", "wrong marker", "unfamiliar", "simulation")

#: Share of the events of a group, and their least number, that tell how a sign goes on beyond the largest of them.
_TAIL_SHARE, _TAIL_FEWEST = 0.1, 5

#: An excess that is counted with those seen.
_FIRST_EXCESS = 1.0

#: Least share, so that logarithms of shares can be compared.
_LEAST = 1e-300


@dataclass(frozen=True, eq=False)
class CalibrationSet:
    """Signs of honest events.

    Attributes
    ----------
    signs : ndarray of float64, shape (n_events, 4)
        As `SIGNS`.
    groups : ndarray of int64, shape (n_events,)
        Group of each event, such as those of the physics that the model was trained on, and of another physics.
    """

    signs: FloatArray
    groups: IntArray

    @classmethod
    def none(cls) -> "CalibrationSet":
        """Return no events: chances are then taken as they are."""
        return cls(np.empty((0, len(SIGNS))), np.empty(0, np.int64))

    def beside(self, signs: FloatArray) -> "CalibrationSet":
        """Return the same with a further group of events, signs (n_more, 4)."""
        group = int(self.groups.max(initial=-1)) + 1
        return CalibrationSet(np.concatenate([self.signs, signs]), np.append(self.groups, np.full(len(signs), group)))

    def __len__(self) -> int:
        return len(self.signs)

    def shares(self, signs: FloatArray) -> FloatArray:
        """Return for each of signs (4,) the share of honest events that look as bad, in the group that looks worst."""
        if not len(self):
            return np.asarray(np.where([True, True, False, False], np.exp(-signs), 1.0))
        return np.asarray(np.max([group.shares(signs) for group in self._groups], axis=0))

    def p_value(self, signs: FloatArray) -> float:
        """Return the share of honest events whose worst sign is as rare as that of signs (4,), in the worst group."""
        if not len(self):
            return float(np.exp(-signs[0]))
        return max(group.p_value(signs) for group in self._groups)

    @cached_property
    def _groups(self) -> list["_Group"]:
        return [_Group.of(self.signs[self.groups == group]) for group in np.unique(self.groups)]


@dataclass(frozen=True, eq=False)
class _Group:
    """Signs of the events of one group, each column ascending, and minus the logarithm of the share of the rarest."""

    columns: list["_Ascending"]
    rarest: "_Ascending"

    @classmethod
    def of(cls, signs: FloatArray) -> "_Group":
        columns = [_Ascending.of(column) for column in signs.T]
        # Of every event among the others, as one that is asked is compared with others than itself.
        shares = np.array([one.shares(column, among=True) for one, column in zip(columns, signs.T, strict=True)])
        return cls(columns, _Ascending.of(-np.log(shares.min(axis=0))))

    def shares(self, signs: FloatArray) -> FloatArray:
        return np.array([float(one.shares(sign[None])[0]) for one, sign in zip(self.columns, signs, strict=True)])

    def p_value(self, signs: FloatArray) -> float:
        return float(self.rarest.shares(-np.log(self.shares(signs).min())[None])[0])


@dataclass(frozen=True, eq=False)
class _Ascending:
    """Values (n,), ascending, and where their tail begins."""

    values: FloatArray
    first: float

    @classmethod
    def of(cls, values: FloatArray) -> "_Ascending":
        ascending, n = np.sort(values), len(values)
        return cls(ascending, float(ascending[n - min(n, max(_TAIL_FEWEST, int(np.ceil(_TAIL_SHARE * n))))]))

    def shares(self, given: FloatArray, *, among: bool = False) -> FloatArray:
        """Return the shares, in (0, 1], of values that are at least as large as given ones.

        Given ones are values themselves if they are `among` them; they are then compared with the others.

        Above the tenth that is largest, where values are few, their excess is taken as exponential: logarithms of
        chances are so if chances are uniform, or a power of what they should be. Of k values with mean excess m, the
        share beyond an excess x is then (1 + x / (k m))^-k, the scale being known from k values only; one value of 1 is
        counted with them, so that a tail is known before there is any.
        """
        own = 1 if among else 0
        # With the given one, be it among them or not.
        n, beyond = len(self.values) + 1 - own, given > self.first
        shares = (n - np.searchsorted(self.values, given, side="left")) / n
        excess = self.values[self.values > self.first] - self.first
        x = given[beyond] - self.first
        k, total = max(len(excess) - own, 0) + 1, excess.sum() - own * x + _FIRST_EXCESS
        shares[beyond] = k / n * (1.0 + x / total) ** -float(k)
        return np.asarray(np.clip(shares, _LEAST, 1.0))
