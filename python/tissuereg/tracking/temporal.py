r"""The temporal prior: a filter in time that combines the registration of a frame with those of the frames before.

A frame is the measurement of one moment. Its answer, the registered displacements, is the truth plus two errors: one
that changes slowly, from model and prior, which consecutive frames share, and one that is new in each frame, from the
tracker's noise. Averaging consecutive answers removes the second, and only the second. How far to average depends on
how much the body moves between frames beyond what the simulation says. With x_t the answer of frame t, s_t the filtered
one and d_t the simulated change since the last frame,

    truth_t - truth_{t-1} = d_t + N(0, W r dt + k^2 d^2),    x_t = truth_t + shared error + N(0, W c_t),
    s_t = s_{t-1} + d_t + g_t (x_t - s_{t-1} - d_t),    0 <= g_t <= 1,

with the scalar gain of Kalman's filter. c_t grows as markers are lost: a frame with few of them counts less. A
simulated change may be off by a share k of itself, in frame after frame; d is its root mean square at the markers.
The rate of motion r and the size W of the noise are unknown: filters for many rates run side by side, and each counts
by how well it has predicted the last frames (R. G. Brown and P. Y. C. Hwang, Introduction to Random Signals and
Applied Kalman Filtering, 1992, section 9.3). A rate too small shows in innovations that keep their sign, one too
large in innovations that change it. Rates do not count by their probability alone, but by what it costs to miss them:
the squared lag behind a motion grows with its rate, so each counts by probability times rate. Until the frames show
that the body stands still, they count for themselves.

On a body that is still, d_t = 0 and every filtered answer is a weighted mean of answers of single frames, with weights
that are not negative and add up to one.
"""

from dataclasses import dataclass, field

import numpy as np

from tissuereg._base.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class FilterRules:
    """Settings of the filters that run side by side, one for each trial rate of motion, and learn from frames.

    `rates` (n_rates,): trial rates, variance of a second's unpredicted motion over that of a frame's noise, 1/s;
    `change_off`: relative error of a simulated change; `memory`: factor on past innovations in each frame; `together`:
    number of components that count as one independent number, since neighbouring places move together; `stated`: number
    of frames as which the stated noise counts in the estimate of the noise; `lost`: probability below which a filter
    goes on from the mean of all.
    """

    # Rates of motion that are tried: variance of a second's unpredicted motion over that of a frame's noise, 1/s.
    rates: FloatArray = field(default_factory=lambda: 10.0 ** np.arange(-2.0, 7.0))
    change_off: float = 0.5  # share by which a simulated change may be off
    memory: float = 0.8  # factor on the record of past innovations in each frame: about five are remembered
    together: float = 3.0  # registered places move together: so many components count as one independent number
    stated: float = 0.5  # so many frames does the tracker's stated noise count as in the estimate of the noise
    lost: float = 1e-6  # a filter less probable than this is of no use: it goes on from the mean of all


FILTER = FilterRules()


@dataclass(eq=False)
class TemporalPrior:
    """Filters for all trial rates of motion on one stream of registered displacements.

    `variance`: of the tracker's noise as stated, mm^2, a first guess of that of the registered displacements; `gain`:
    mean gain of the last frame, 0 to 1, where 1 means that this frame alone counts.
    """

    variance: float  # stated, of the tracker's noise, mm^2: a first guess of that of an answer's noise
    gain: float = 1.0  # mean gain of the last frame: 1 = this frame alone
    _states: FloatArray | None = field(default=None, repr=False)
    _spread: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    _squares: FloatArray = field(default_factory=lambda: np.zeros_like(FILTER.rates), repr=False)
    _logs: FloatArray = field(default_factory=lambda: np.zeros_like(FILTER.rates), repr=False)
    _count: float = 0.0
    _per_frame: float = 1.0

    def updated(
        self, answer: FloatArray, change: FloatArray, elapsed: float, relative: float, scored: slice
    ) -> FloatArray:
        """Return the filtered displacements of a frame, (n_values,), in mm.

        `answer` (n_values,): registered displacement of everything that is filtered, mm; `change` (n_values,): its
        simulated change since the last frame, mm; `elapsed`: time since then, s; `relative`: variance of this answer's
        noise over that of a frame with all markers; `scored`: slice of the values, near the data, whose innovations
        tell the rate of motion. Cost: three passes over an array (n_rates, n_values).
        """
        if self._states is None:
            self._states = np.tile(answer, (len(FILTER.rates), 1))
            self._spread = np.full(len(FILTER.rates), relative)
            self.gain = 1.0
            return answer
        off = FILTER.change_off**2 * float(np.mean(change[scored] ** 2)) / self.variance
        before = self._spread + FILTER.rates * elapsed + off
        total = before + relative
        gains = before / total
        # (n_rates, n_values), in place: the fields of all nodes are among them.
        self._states += change
        innovations = answer - self._states
        self._weigh(innovations[:, scored], total)
        innovations *= gains[:, None]
        self._states += innovations
        self._spread = gains * relative
        weights = self.weights
        self.gain = float(weights @ gains)
        filtered = weights @ self._states
        lost = weights < FILTER.lost
        self._states[lost] = filtered
        self._spread[lost] = weights @ self._spread
        return np.asarray(filtered)

    @property
    def weights(self) -> FloatArray:
        """Weight of each trial rate of motion, (n_rates,), adding up to one: its probability times the rate."""
        stated = FILTER.stated * max(self._per_frame, 1.0)
        logs = -0.5 * (self._logs + (self._count + stated) * np.log(self._squares + stated * self.variance))
        weights = FILTER.rates * np.exp(logs - logs.max())
        return np.asarray(weights / weights.sum())

    def _weigh(self, innovations: FloatArray, total: FloatArray) -> None:
        """Score the filters of all trial rates by a frame: record its innovations (n_rates, n_scored), mm.

        `total` (n_rates,): variance of the innovations under each rate, over that of the noise.
        """
        self._per_frame = innovations.shape[1] / FILTER.together
        self._squares = FILTER.memory * self._squares + (innovations**2).sum(axis=1) / total / FILTER.together
        self._logs = FILTER.memory * self._logs + self._per_frame * np.log(total)
        self._count = FILTER.memory * self._count + self._per_frame
