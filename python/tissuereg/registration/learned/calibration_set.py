"""Test statistics of trial registrations, and the p-value of a registration compared with them.

A registration has a few test statistics, each larger where it looks worse. No distribution is assumed for them: events
that were not used in training were registered with correct measurements, and the p-value of a statistic is the share of
these trials in which it is at least as large. All statistics together are judged by the smallest of their p-values; its
own p-value is again the share of trials in which it is as small. Trials come in groups, one for each physics, which
count alike whatever the number of their events.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray

#: Test statistics, in the order of columns: minus the logarithm of the chance that all markers lie as far from their
#: predictions from the other markers; the same of the marker that fits the others worst, times the number of markers;
#: distance of the fitted code from the training set in standard deviations; log-odds that the simulation is of another
#: event, 0 where it is likelier of this one; log-odds that the tracker's noise is larger than stated, at least 0.
STATISTICS = ("misfit", "wrong marker", "unfamiliar", "simulation", "noise")

#: Statistics that are chances where no calibration event tells how they are distributed.
_CHANCES = (True, True, False, False, True)

#: Share of calibration events below which an answer is not trusted. Physics, numbers of markers and noises count alike
#: among them, so that the hardest set what is rare: events of any one of them are distrusted less often.
_LEVEL = 0.02

#: The same without a calibration event, of chances that a model states.
_STATED_LEVEL = 0.01

#: Power of these chances that is taken: errors of real models have heavier tails than the normal law of their moments.
_POWER = 0.5

#: Share of the events of a group, and their least number, that tell how a statistic goes on beyond the largest of them.
_TAIL_SHARE, _TAIL_FEWEST = 0.1, 5

#: An excess that is counted with those seen.
_FIRST_EXCESS = 1.0

#: Least share, so that logarithms of shares can be compared.
_LEAST = 1e-300


@dataclass(frozen=True, eq=False)
class CalibrationSet:
    """Test statistics of trial registrations with correct measurements, with which a registration is compared.

    `statistics` (n_events, 5): as `STATISTICS`; `groups` int64 (n_events,): group of each event, such as those of the
    physics that the model was trained on, and of another physics.
    """

    statistics: FloatArray
    groups: IntArray

    @classmethod
    def none(cls) -> "CalibrationSet":
        """Return a set without trials; statistics that are logarithms of chances are then taken as such, tempered."""
        return cls(np.empty((0, len(STATISTICS))), np.empty(0, np.int64))

    def beside(self, statistics: FloatArray) -> "CalibrationSet":
        """Return the same with a further group of events, statistics (n_more, 5)."""
        group = int(self.groups.max(initial=-1)) + 1
        return CalibrationSet(
            np.concatenate([self.statistics, statistics]), np.append(self.groups, np.full(len(statistics), group))
        )

    def __len__(self) -> int:
        return len(self.statistics)

    @property
    def level(self) -> float:
        """The p-value below which an answer is not trusted."""
        return _LEVEL if len(self) else _STATED_LEVEL

    def shares(self, statistics: FloatArray) -> FloatArray:
        """Return for each of statistics (5,) the share of calibration events as bad; groups count alike."""
        if not len(self):
            return np.asarray(np.where(_CHANCES, np.minimum(np.exp(-_POWER * statistics), 1.0), 1.0))
        return np.asarray(self._shares(statistics[None])[0])

    def share(self, number: int, value: float) -> float:
        """Return the share of calibration events in which the statistic with this number is as large as `value`."""
        if not len(self):
            return float(self.shares(np.full(len(STATISTICS), value))[number])
        return float(np.mean([columns[number].shares(np.array([value]))[0] for columns in self._columns]))

    def p_value(self, statistics: FloatArray) -> float:
        """Return the share of calibration events with as rare a worst statistic as (5,) ones; groups count alike."""
        if not len(self):
            return min(1.0, sum(_CHANCES) * float(self.shares(statistics).min()))
        rarest = -np.log(self.shares(statistics).min())[None]
        return float(np.mean([one.shares(rarest)[0] for one in self._rarest]))

    @property
    def _by_group(self) -> list[FloatArray]:
        """The statistics (n, 5) of each group's events."""
        return [self.statistics[self.groups == group] for group in np.unique(self.groups)]

    @cached_property
    def _columns(self) -> list[list["_Ascending"]]:
        """The sorted values of each statistic, of each group."""
        return [[_Ascending.of(column) for column in own.T] for own in self._by_group]

    @cached_property
    def _rarest(self) -> list["_Ascending"]:
        """Minus the logarithm of the least share among each event's statistics, sorted, of each group."""
        shares = (self._shares(rows, own=number) for number, rows in enumerate(self._by_group))
        return [_Ascending.of(-np.log(one.min(axis=1))) for one in shares]

    def _shares(self, rows: FloatArray, own: int = -1) -> FloatArray:
        """Return the shares (k, 5) of events as bad as `rows` (k, 5), which are those of the group `own` if not -1."""
        each = [
            [one.shares(column, among=number == own) for one, column in zip(columns, rows.T, strict=True)]
            for number, columns in enumerate(self._columns)
        ]
        return np.asarray(np.mean(each, axis=0).T)


@dataclass(frozen=True, eq=False)
class _Ascending:
    """Sorted values (n,) of one statistic in a group of trials, and their tail.

    `first`: the value above which they are the tail; `n_beyond`, `excess`: number of those, and the sum of what they
    exceed it by.
    """

    values: FloatArray
    first: float
    n_beyond: int
    excess: float

    @classmethod
    def of(cls, values: FloatArray) -> "_Ascending":
        ascending, n = np.sort(values), len(values)
        first = float(ascending[n - min(n, max(_TAIL_FEWEST, int(np.ceil(_TAIL_SHARE * n))))])
        excess = ascending[ascending > first] - first
        return cls(ascending, first, len(excess), float(excess.sum()))

    def shares(self, given: FloatArray, *, among: bool = False) -> FloatArray:
        """Return for each given value the share, in (0, 1], of values that are at least as large; both have shape (k,).

        If the given values are themselves `among` the values of this statistic, each is compared with the others;
        otherwise with all. Above `first`, in the largest tenth (at least five values), the excess over `first` is taken
        as exponential: logarithms of p-values are so if p-values are uniform, or a power of what they should be. Of k
        values with mean excess m, the share beyond an excess x is then (1 + x / (k m))^-k, because the scale is
        estimated from k values only; one value with an excess of 1 is counted with them, so that a tail is always
        defined.
        """
        own = 1 if among else 0
        # With the given one, be it among them or not.
        n, beyond = len(self.values) + 1 - own, given > self.first
        shares = (n - np.searchsorted(self.values, given, side="left")) / n
        x = given[beyond] - self.first
        k, total = max(self.n_beyond - own, 0) + 1, self.excess - own * x + _FIRST_EXCESS
        shares[beyond] = k / n * (1.0 + x / total) ** -float(k)
        return np.maximum(np.minimum(shares, 1.0), _LEAST)
