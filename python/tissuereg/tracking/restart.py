"""The start of the next simulation: how a registered state is carried on to the next frame, and for how long.

A frame is the measurement of one moment. A quasi-static body has no memory: from any first guess it finds the same
equilibrium. The correction that the markers of the last frame required is therefore carried on by a change of the
problem, or not at all:

``forces``
    The nodal forces that hold the registered shape, beside the known loads, stay as dead loads while the actuators
    move.
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

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ConvergenceError, LoadError
from tissuereg.registration.learned.model import rms_displacement
from tissuereg.tracking.physics import HoldingPhysics, Physics


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """The simulation of one frame (the measurement of one moment); displacements (n_nodes, 3) in mm.

    `field`: the simulation, started from an earlier registered state if that is carried on; `change`: how it differs
    from that of the frame before, because the actuators moved; `plain`: the simulation with nothing carried on;
    `carried`: whether a registered state was carried on.
    """

    field: FloatArray  # from which the frame is registered
    change: FloatArray  # since the last frame, due to the actuators
    plain: FloatArray  # with nothing carried on
    carried: bool  # whether a registered state was carried on


@dataclass(eq=False)
class _CarriedState:
    """The registered state from which the next frame is simulated.

    `displacement` (n_nodes, 3): registered, mm; `actuator`: state of the actuators in that frame; `plain` (n_nodes, 3):
    simulation of that frame with nothing carried on, mm; `forces` (n_nodes, 3): nodal forces, mN, that hold the
    registered shape beside the known load, or None before they are computed.
    """

    displacement: FloatArray
    actuator: Any
    plain: FloatArray
    forces: FloatArray | None = None


class Restart:
    """Simulator of one frame after another, each from an earlier registered state.

    `physics`: the simulation; `how`: way in which a registered state is carried on, "forces" (as the nodal loads that
    hold it), "displacement" (added to the next simulation), "guess" (as a first guess) or "reference" (not at all);
    `noise_mm`: standard deviation of the tracker's noise, mm.

    ``forces`` is ``displacement`` where the simulation cannot hold a shape by forces. A newer state is carried on once
    the simulation has moved farther than the noise, by its root mean square over nodes, from the one before.
    `fallbacks` counts the frames in which the body lost its equilibrium under dead loads, so that the displacement was
    carried on.

    Dead loads do not follow the body, and they press where the registered shape is rough: a body that is bent far may
    buckle under them. The simulated change is therefore compared with that of the simulation with nothing carried on,
    and is replaced by it if they differ by more than the latter.

    While the actuators stand still, so does the simulation: a start that followed each registered state would count the
    same markers again in every frame, until the prior does not count any more.
    """

    def __init__(self, physics: Physics, how: str, noise_mm: float) -> None:
        self._physics = physics
        self._noise_mm = noise_mm
        self.how = "displacement" if how == "forces" and not isinstance(physics, HoldingPhysics) else how
        self.fallbacks = 0
        self.reset()

    def reset(self) -> None:
        """Forget all frames, so that the next one is a first one."""
        self._carried: _CarriedState | None = None
        self._origin: FloatArray | None = None
        self._last_field: FloatArray | None = None
        self._last_shape: FloatArray | None = None
        self._last_plain: FloatArray | None = None
        self._plain_before: FloatArray | None = None

    def simulated(self, actuator: Any) -> SimulatedFrame:
        """Return the simulation of the next frame; nothing is remembered of it before `registered`.

        `actuator`: state of the actuators, as the simulation takes it. Cost: one simulation, with ``forces`` two;
        raises ConvergenceError if it finds no equilibrium.
        """
        start = {"reference": None, "guess": self._last_shape}.get(self.how, self._expected_plain())
        plain = self._physics.field(actuator, start=start)
        field = plain if self._carried is None else self._carried_on(self._carried, actuator, plain)
        before = field if self._last_field is None else self._last_field
        return SimulatedFrame(field, field - before, plain, self._carried is not None)

    def registered(self, simulated: SimulatedFrame, displacement: FloatArray, actuator: Any) -> bool:
        """Remember a registered frame, and return whether its registered state is carried on from now on.

        `simulated`: simulation of the frame; `displacement` (n_nodes, 3): registered, mm; `actuator`: state of the
        actuators.
        """
        self._plain_before = self._last_plain
        self._last_field, self._last_shape, self._last_plain = simulated.field, displacement, simulated.plain
        self._origin = simulated.field if self._origin is None else self._origin
        moved = _rms(simulated.field - self._origin)
        moved_on = self.how in ("forces", "displacement") and moved > self._noise_mm
        if moved_on:
            self._carried = _CarriedState(displacement, actuator, simulated.plain)
            self._origin = self._last_field = displacement
        return moved_on

    def renew(self) -> None:
        """Carry no registered state on to the next frame, so that its simulation is the plain one."""
        self._carried = None
        self._origin = self._last_field = self._last_plain

    def _expected_plain(self) -> FloatArray | None:
        """Return a first guess (n_nodes, 3), mm, of the next simulation with nothing carried on; None at first.

        It is extrapolated from the last two frames: the actuators move on as they did.
        """
        if self._last_plain is None or self._plain_before is None:
            return self._last_plain
        return 2.0 * self._last_plain - self._plain_before

    def _expected(self, carried: _CarriedState, plain: FloatArray) -> FloatArray:
        """Return a first guess (n_nodes, 3), mm, of the next simulation from the registered state `carried`.

        It changes as the simulation with nothing carried on, `plain` (n_nodes, 3), mm, does.
        """
        if self._last_field is None or self._last_plain is None:
            return np.asarray(carried.displacement + plain - carried.plain)
        return np.asarray(self._last_field + plain - self._last_plain)

    def _carried_on(self, carried: _CarriedState, actuator: Any, plain: FloatArray) -> FloatArray:
        """Return the simulated displacement (n_nodes, 3), mm, that starts from the registered state `carried`.

        `plain` (n_nodes, 3): simulation with nothing carried on, mm; `actuator`: state of the actuators.
        """
        moved = plain - carried.plain
        if self.how == "forces" and isinstance(self._physics, HoldingPhysics):
            try:
                if carried.forces is None:
                    carried.forces = self._physics.holding(carried.displacement, carried.actuator)
                held = self._physics.held_field(actuator, carried.forces, self._expected(carried, plain))
            except (ConvergenceError, LoadError):
                held = None
            if held is not None and _rms(held - carried.displacement - moved) <= max(self._noise_mm, _rms(moved)):
                return held
            self.fallbacks += 1
        return np.asarray(carried.displacement + moved)


@dataclass(eq=False)
class Lineage:
    """Sum of the variances of the registered states that were carried on one from the other; it ends this chain.

    The plain simulation is one that starts from no registered state; `noise_mm`: standard deviation of the tracker's
    noise, mm.

    A frame that is registered from a registered state seems surer than it is: its prior is one of small changes, and
    the error of the state itself is not in it. As far as the markers do not measure that error, it stays. So the
    variances of all states that were carried on, one from the other, are added up. Once they add up to what a
    registration from the plain simulation would state, carrying on has no use any more, and the next frame starts from
    the plain simulation.
    """

    noise_mm: float  # standard deviation of the tracker's noise: the least size of an event
    _carried: float = 0.0
    _plain: float = 0.0
    _size_mm: float = 0.0

    def widening(self, variance: float, simulated: SimulatedFrame | None) -> float:
        """Return the factor, at least 1, on a frame's covariances, given the variance that its registration states.

        `variance`: of a target's coordinate, mm^2; `simulated`: simulation of the frame, or None without one: the
        factor is then 1.
        """
        if simulated is None:
            return 1.0
        if not simulated.carried:
            self._carried, self._plain, self._size_mm = 0.0, variance, self._size(simulated)
        return 1.0 + self._carried / variance

    def goes_on(self, variance: float, simulated: SimulatedFrame) -> bool:
        """Return whether it is still of use to carry on the state of this frame, and add its variance to the sum.

        `variance`: of a target's coordinate by the frame's registration, mm^2; `simulated`: simulation of the frame.
        The variance of a registration from the plain simulation is that of the last one, in proportion to the squared
        size of the displacement.
        """
        self._carried += variance
        growth = max(1.0, self._size(simulated) / self._size_mm) ** 2
        return self._carried <= growth * self._plain

    def _size(self, simulated: SimulatedFrame) -> float:
        return max(self.noise_mm, _rms(simulated.plain))


def _rms(field: FloatArray) -> float:
    """Return the root mean square displacement of the nodes in a field (n_nodes, 3), in mm."""
    return float(rms_displacement(field[None])[0])
