"""What the next simulation starts from: how the registered state of a frame is carried to the next one.

A quasi-static body has no memory: from any first guess it finds the same equilibrium. What the last frame's markers
showed is therefore carried on by a change of the problem, or not at all:

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

#: How a registered state is carried on.
RESTARTS = ("forces", "displacement", "guess", "reference")


@dataclass(frozen=True, eq=False)
class SimulatedFrame:
    """The simulation of a frame.

    `field` (n_nodes, 3): displacement from which the frame is registered, mm; `change` (n_nodes, 3): its change since
    the last frame that is due to the actuators, mm; `plain` (n_nodes, 3): displacement with nothing carried on, mm;
    `carried`: whether a registered state was carried on.
    """

    field: FloatArray
    change: FloatArray
    plain: FloatArray
    carried: bool


@dataclass(eq=False)
class _CarriedState:
    """The registered state that is carried on: its shape, its simulation with nothing carried on, what holds it."""

    displacement: FloatArray
    actuator: Any
    plain: FloatArray
    forces: FloatArray | None = None


class Restart:
    """Simulates each frame from a registered state.

    `physics`: the simulation; `how` {"forces", "displacement", "guess", "reference"}: how the registered state is
    carried on. A simulation that cannot hold a shape by forces gets ``displacement`` for ``forces``; `noise_mm`:
    standard deviation of the tracker's noise. Another state is carried on once the simulation has moved farther than
    this (root mean square over nodes) from the one before. `fallbacks`: frames in which the body lost its equilibrium
    under dead loads, so that the displacement was carried on.

    Notes
    -----
    Dead loads do not follow the body, and they press where the registered shape is rough: a body that is bent far may
    buckle under them. The simulated change is therefore compared with that of the simulation with nothing carried on,
    and given up if they differ by more than the latter.

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
        """Forget all frames."""
        self._carried: _CarriedState | None = None
        self._origin: FloatArray | None = None
        self._last_field: FloatArray | None = None
        self._last_shape: FloatArray | None = None
        self._last_plain: FloatArray | None = None
        self._plain_before: FloatArray | None = None

    def simulated(self, actuator: Any) -> SimulatedFrame:
        """Return the simulation of the next frame; nothing is remembered of it before `registered`.

        `actuator`: what the actuators do. Cost: one simulation; with ``forces`` two. Raises `ConvergenceError`
        if the simulation finds no equilibrium.
        """
        start = {"reference": None, "guess": self._last_shape}.get(self.how, self._expected_plain())
        plain = self._physics.field(actuator, start=start)
        field = plain if self._carried is None else self._carried_on(self._carried, actuator, plain)
        before = field if self._last_field is None else self._last_field
        return SimulatedFrame(field, field - before, plain, self._carried is not None)

    def registered(self, simulated: SimulatedFrame, displacement: FloatArray, actuator: Any) -> bool:
        """Remember a frame.

        `simulated`: its simulation; `displacement` (n_nodes, 3): registered, mm; `actuator`: what the actuators did.
        Result: whether this frame's registered state is carried on from now on.
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
        """Carry nothing on to the next frame."""
        self._carried = None
        self._origin = self._last_field = self._last_plain

    def _expected_plain(self) -> FloatArray | None:
        """Return a first guess with nothing carried on: the actuators move on as they did."""
        if self._last_plain is None or self._plain_before is None:
            return self._last_plain
        return 2.0 * self._last_plain - self._plain_before

    def _expected(self, carried: _CarriedState, plain: FloatArray) -> FloatArray:
        """Return a first guess from a registered state: it changes as the simulation with nothing carried on does."""
        if self._last_field is None or self._last_plain is None:
            return np.asarray(carried.displacement + plain - carried.plain)
        return np.asarray(self._last_field + plain - self._last_plain)

    def _carried_on(self, carried: _CarriedState, actuator: Any, plain: FloatArray) -> FloatArray:
        """Return the simulation from a registered state, given the one with nothing carried on."""
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


def _rms(field: FloatArray) -> float:
    """Return the root mean square displacement of a field (n_nodes, 3)."""
    return float(rms_displacement(field[None])[0])
