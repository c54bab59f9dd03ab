"""The error of a registered state that is carried on: what it adds to the spread of later frames, and when it ends.

A frame that is registered from a registered state seems surer than it is: its prior is one of small changes, and the
error of the state itself is not in it. As far as the markers do not see that error, it stays. So the variances of all
states that were carried on, one from the other, are added up. Once they add up to what a registration from the plain
simulation would state, carrying on is of no use any more, and the next frame starts from the plain simulation.
"""

from dataclasses import dataclass

from tissuereg.registration.learned.model import rms_displacement
from tissuereg.tracking.restart import SimulatedFrame


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
