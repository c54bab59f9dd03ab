"""What the next simulation starts from: how the registered state of a frame is carried to the next one.

A quasi-static body has no memory: from any first guess it finds the same equilibrium. What the markers said about the
last frame is therefore carried on by a change of the problem, or not at all:

``forces``
    The nodal forces that hold the registered shape, beyond the known loads, stay as dead loads while the actuators move.
``displacement``
    The registered shape minus the simulated one is added to the next simulation. Every simulation can do so.
``guess``
    The registered shape is the solver's first guess. The answer is that of ``reference``, found in fewer iterations.
``reference``
    Every simulation starts from the undeformed body.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.errors import ConvergenceError, LoadError
from tissuereg.tracking.physics import HoldingPhysics, Physics

#: How a registered state is carried on.
RESTARTS = ("forces", "displacement", "guess", "reference")


@dataclass(frozen=True, eq=False)
class Simulated:
    """The simulation of a frame.

    Attributes
    ----------
    field : ndarray of float64, shape (n_nodes, 3)
        Displacement from which the frame is registered, mm.
    change : ndarray of float64, shape (n_nodes, 3)
        Its change since the last frame that is due to the actuators, mm.
    plain : ndarray of float64, shape (n_nodes, 3), or None
        Displacement without anything carried on; None where it was not needed.
    """

    field: FloatArray
    change: FloatArray
    plain: FloatArray | None


@dataclass(frozen=True, eq=False)
class LastFrame:
    """The registered state of the last frame.

    Attributes
    ----------
    displacement : ndarray of float64, shape (n_nodes, 3)
        Registered, mm.
    actuator : object
        What the actuators did.
    plain : ndarray of float64, shape (n_nodes, 3), or None
        Displacement of the simulation without anything carried on, mm.
    """

    displacement: FloatArray
    actuator: Any
    plain: FloatArray | None


class Restart:
    """Simulates each frame from the registered state of the last one.

    Parameters
    ----------
    physics : Physics
        The simulation.
    how : {"forces", "displacement", "guess", "reference"}
        How the registered state is carried on. A simulation that cannot hold a shape by forces gets ``displacement``
        for ``forces``.

    Attributes
    ----------
    fallbacks : int
        Frames in which no equilibrium was found under dead loads, so that the displacement was carried on.
    """

    def __init__(self, physics: Physics, how: str) -> None:
        self._physics = physics
        self.how = "displacement" if how == "forces" and not isinstance(physics, HoldingPhysics) else how
        self.fallbacks = 0

    def simulated(self, actuator: Any, last: LastFrame | None) -> Simulated:
        """Return the simulation of a frame, given the last one.

        Parameters
        ----------
        actuator : object
            What the actuators do now.
        last : LastFrame or None
            None for a first frame.

        Returns
        -------
        Simulated
            Cost: one simulation; two where dead loads fail.

        Raises
        ------
        ConvergenceError
            If the simulation finds no equilibrium.
        """
        if self.how == "forces" and last is not None and isinstance(self._physics, HoldingPhysics):
            try:
                forces = self._physics.holding(last.displacement, last.actuator)
                field = self._physics.held_field(actuator, forces, last.displacement)
            except (ConvergenceError, LoadError):
                self.fallbacks += 1
            else:
                return Simulated(field, field - last.displacement, None)
        plain = self._plain(actuator, last)
        if last is None:
            return Simulated(plain, np.zeros_like(plain), plain)
        before = self._plain(last.actuator, last) if last.plain is None else last.plain
        carried = last.displacement - before if self.how in ("forces", "displacement") else 0.0
        return Simulated(plain + carried, plain - before, plain)

    def _plain(self, actuator: Any, last: LastFrame | None) -> FloatArray:
        start = None
        if last is not None and self.how != "reference":
            start = last.displacement if self.how == "guess" or last.plain is None else last.plain
        return self._physics.field(actuator, start=start)
