"""Methods of the markers alone, told of the simulation: they carry on what it leaves at the markers."""

from typing import Any, ClassVar

import numpy as np

from tissuereg.body.observe import MarkerObservation
from tissuereg_paper.rivals.copy import MeanOfMarkers
from tissuereg_paper.rivals.rigid import Rigid
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting
from tissuereg_paper.rivals.spline import Spline


class _About(Rival):
    """The simulation, and a method of markers alone for what it leaves at them.

    A method of markers alone does not know what pushes the body, and is not hard to beat where a simulation does. That
    a registration is worth its model shows in a comparison with the same simple method about the same simulation.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"simulation"})

    def __init__(self, setting: Setting, alone: Rival) -> None:
        super().__init__(setting)
        self._alone = alone
        names = setting.markers(np.full_like(setting.reference_mm, np.nan)).names
        self._observed = MarkerObservation(setting.mesh, setting.reference_mm, names)

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the simulation and what the method makes of the rest; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        simulation = moment.start_mm
        rest = moment.measured_mm - self._observed.predict(simulation[self._observed.nodes])
        return Estimate(simulation + self._alone.register(rest).displacement_mm)


class MeanAbout(_About):
    """The simulation, moved by the mean of what it leaves at the markers; see `MeanOfMarkers`."""

    name: ClassVar[str] = "simulation + mean of the markers"

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting, MeanOfMarkers(setting))


class RigidAbout(_About):
    """The simulation, and the best rigid motion of what it leaves at the markers; see `Rigid`."""

    name: ClassVar[str] = "simulation + rigid"

    def __init__(self, setting: Setting) -> None:
        super().__init__(setting, Rigid(setting))


class SplineAbout(_About):
    """The simulation, and a thin-plate spline of what it leaves at the markers; see `Spline`.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    smoothing : float
        As of `Spline`.
    """

    name: ClassVar[str] = "simulation + thin-plate spline"

    def __init__(self, setting: Setting, *, smoothing: float = 1e5) -> None:
        super().__init__(setting, Spline(setting, smoothing=smoothing))
