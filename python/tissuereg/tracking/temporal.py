r"""The temporal prior: what the frames before say about this one, and how the error of a carried state grows.

The answer of a frame is the truth plus two errors: one that changes slowly, from model and prior, which consecutive
frames share, and one that is new in each frame, from the tracker's noise. Averaging consecutive answers removes the
second, and only the second. How far to average depends on how much the body moves between frames beyond what the
simulation says. With x_t the answer of frame t, s_t the filtered one and d_t the simulated change since the last frame,

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
from tissuereg.registration.learned.model import rms_displacement
from tissuereg.tracking.restart import SimulatedFrame


@dataclass(frozen=True)
class FilterRules:
    """How the filters of all rates learn from frames.

    Attributes
    ----------
    change_off : float
        Share by which a simulated change may be off.
    memory : float
        Each frame, the record of past innovations counts by this factor: about five frames are remembered.
    together : float
        Registered places move together: so many of their components count as one independent number.
    stated : float
        So many frames does the stated noise of the tracker count as in the estimate of the noise.
    lost : float
        A filter less probable than this is of no use any more: it goes on from the mean of all.
    """

    change_off: float = 0.5
    memory: float = 0.8
    together: float = 3.0
    stated: float = 0.5
    lost: float = 1e-6


FILTER = FilterRules()


#: Rates of motion that are tried: variance of a second's unpredicted motion over that of a frame's noise, 1/s.
RATES = 10.0 ** np.arange(-2.0, 7.0)


@dataclass(eq=False)
class TemporalPrior:
    """Filters for all rates of motion on one stream of answers.

    `variance`: stated variance of the tracker's noise, mm^2: a first guess of that of an answer's noise. `gain`: mean
    gain of the last frame: 1 = this frame alone.
    """

    variance: float
    gain: float = 1.0
    _states: FloatArray | None = field(default=None, repr=False)
    _spread: FloatArray = field(default_factory=lambda: np.zeros(0), repr=False)
    _squares: FloatArray = field(default_factory=lambda: np.zeros_like(RATES), repr=False)
    _logs: FloatArray = field(default_factory=lambda: np.zeros_like(RATES), repr=False)
    _count: float = 0.0
    _per_frame: float = 1.0

    def updated(
        self, answer: FloatArray, change: FloatArray, elapsed: float, relative: float, scored: slice
    ) -> FloatArray:
        """Return the filtered answer of a frame.

        `answer` (n_values,): registered displacement of everything that is filtered, mm; `change` (n_values,): its
        simulated change since the last frame, mm; `elapsed`: time since the last frame, s; `relative`: variance of the
        noise of this frame's answer over that of a frame with all markers; `scored`: the values whose innovations
        count: those near the data. Result: (n_values,), mm. Cost: three passes over an array (n_rates, n_values).
        """
        if self._states is None:
            self._states = np.tile(answer, (len(RATES), 1))
            self._spread = np.full(len(RATES), relative)
            self.gain = 1.0
            return answer
        off = FILTER.change_off**2 * float(np.mean(change[scored] ** 2)) / self.variance
        before = self._spread + RATES * elapsed + off
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
        """How much each of `RATES` counts: probability times rate, adding up to one, shape (n_rates,)."""
        stated = FILTER.stated * max(self._per_frame, 1.0)
        logs = -0.5 * (self._logs + (self._count + stated) * np.log(self._squares + stated * self.variance))
        weights = RATES * np.exp(logs - logs.max())
        return np.asarray(weights / weights.sum())

    def _weigh(self, innovations: FloatArray, total: FloatArray) -> None:
        """Add the innovations (n_rates, n_scored) of a frame to the record, with their variances over the noise's."""
        self._per_frame = innovations.shape[1] / FILTER.together
        self._squares = FILTER.memory * self._squares + (innovations**2).sum(axis=1) / total / FILTER.together
        self._logs = FILTER.memory * self._logs + self._per_frame * np.log(total)
        self._count = FILTER.memory * self._count + self._per_frame


@dataclass(eq=False)
class Lineage:
    """The variance that was carried on since the last frame that started from the plain simulation.

    `noise_mm`: standard deviation of the tracker's noise: the least size of an event.
    """

    noise_mm: float
    _carried: float = 0.0
    _plain: float = 0.0
    _size_mm: float = 0.0

    def widening(self, variance: float, simulated: SimulatedFrame | None) -> float:
        """Return the factor on the covariances of a frame.

        `variance`: what its own registration states, mm^2; `simulated`: its simulation.
        """
        if simulated is None:
            return 1.0
        if not simulated.carried:
            self._carried, self._plain, self._size_mm = 0.0, variance, self._size(simulated)
        return 1.0 + self._carried / variance

    def goes_on(self, variance: float, simulated: SimulatedFrame) -> bool:
        """Return whether a frame whose state is to be carried on is still of use; its variance is added.

        The variance of a registration from the plain simulation is that of the last one, in proportion to the squared
        size of the event.
        """
        self._carried += variance
        growth = max(1.0, self._size(simulated) / self._size_mm) ** 2
        return self._carried <= growth * self._plain

    def _size(self, simulated: SimulatedFrame) -> float:
        return max(self.noise_mm, float(rms_displacement(simulated.plain[None])[0]))
