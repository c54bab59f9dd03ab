"""Effects on actuators: their motion, force or place differs from what the user believes."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Element
from tissuereg._base.fields import number, numbers, text
from tissuereg.body.mesh import Mesh
from tissuereg.experiment.effects.base import Effect, Vector, exactly_one, refuse, rotation_from_vector
from tissuereg.experiment.experiment import Actuator, Experiment


@dataclass(frozen=True, kw_only=True)
class _OfActuator(Effect):
    """Base of effects on one actuator, which act in all load cases in which it is present."""

    repeatable: ClassVar[bool] = True
    actuator: str = text("name of the actuator")

    def fits(self, experiment: Experiment) -> None:
        """Raise ExperimentError if the experiment has no actuator of this name."""
        names = [actuator.name for actuator in experiment.actuators]
        if self.actuator not in names:
            refuse(f"`actuator` must be one of {', '.join(names) or 'none'}", self.actuator)


@dataclass(frozen=True, kw_only=True)
class ActuatorGain(_OfActuator):
    """The actuator gives `gain` times the commanded motion or force."""

    id: ClassVar[str] = "actuator_gain"
    gain: float = number("factor on the commanded motion or force")

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with the actuator's motion (mm) or force (mN) multiplied by `gain` in all cases."""
        return _given(experiment, self.actuator, lambda values: values * self.gain)


@dataclass(frozen=True, kw_only=True)
class ActuatorDirection(_OfActuator):
    """The actuator's motion or force is turned by a rotation vector."""

    id: ClassVar[str] = "actuator_direction"
    rotation_deg: Vector = numbers("rotation vector: axis times angle, right-handed", 3)

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with the actuator's motion (mm) or force (mN) rotated in all cases."""
        turn = rotation_from_vector(self.rotation_deg)
        return _given(experiment, self.actuator, lambda values: values @ turn.T)


@dataclass(frozen=True, kw_only=True)
class ActuatorOffset(_OfActuator):
    """The actuator's motion is off by `offset_mm` in every frame; or its patch sits `shift_mm` from its place."""

    id: ClassVar[str] = "actuator_offset"
    offset_mm: Vector | None = numbers("added to its motion in every frame", 3, default=None)
    shift_mm: Vector | None = numbers("or: how far its patch lies from where it is believed", 3, default=None)

    def check(self) -> None:
        """Raise ExperimentError unless exactly one of `offset_mm` and `shift_mm` is given."""
        exactly_one(self, ("offset_mm",), ("shift_mm",))

    def fits(self, experiment: Experiment) -> None:
        """Raise ExperimentError for an unknown actuator, an offset of a force, or a patch shifted off the body."""
        super().fits(experiment)
        actuator = experiment.actuator(self.actuator)
        if self.offset_mm is not None and actuator.kind != "displacement":
            refuse("`offset_mm` must belong to a displacement actuator", f"{actuator.kind} actuator")
        if self.shift_mm is not None and not len(shifted_patch(experiment.mesh, actuator, self.shift_mm)):
            refuse(f"`shift_mm` must leave the patch of '{self.actuator}' on the body", list(self.shift_mm))

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with `offset_mm` added to the actuator's motion, or with its patch shifted."""
        if self.offset_mm is not None:
            offset = np.asarray(self.offset_mm)
            return _given(experiment, self.actuator, lambda values: values + offset)
        assert self.shift_mm is not None  # `check` has seen it
        old = experiment.actuator(self.actuator)
        new = replace(old, nodes=shifted_patch(experiment.mesh, old, self.shift_mm), rule=None)
        actuators = tuple(new if actuator is old else actuator for actuator in experiment.actuators)
        return replace(experiment, actuators=actuators, mesh=experiment.mesh.with_node_set(new.name, new.nodes))


def shifted_patch(mesh: Mesh, actuator: Actuator, shift: Vector) -> IntArray:
    """Return the surface nodes of an actuator's patch after it has been shifted.

    Parameters
    ----------
    mesh : Mesh
        Mesh in the reference shape.
    actuator : Actuator
        Actuator whose patch is shifted. If the patch is given as a sphere, its centre is shifted. Any other patch is
        shifted as an outline: a node belongs to it if, moved back by the shift, its nearest surface node belongs to the
        believed patch.
    shift : tuple of float
        Shift vector, mm.

    Returns
    -------
    ndarray of int64, shape (n,)
        Sorted node indices; empty where the patch has left the body.
    """
    rule = actuator.rule
    if rule is not None and not isinstance(rule, str) and "centre_mm" in rule:
        return mesh.surface_nodes_within(np.asarray(rule["centre_mm"]) + shift, float(rule["radius_mm"]))
    from scipy.spatial import KDTree

    surface = mesh.surface_nodes
    _, nearest = KDTree(mesh.nodes[surface]).query(mesh.nodes[surface] - np.asarray(shift))
    return surface[np.isin(surface[nearest], actuator.nodes)]


def _given(experiment: Experiment, name: str, change: Callable[[FloatArray], FloatArray]) -> Experiment:
    """Return the experiment with the commands of the actuator `name` changed in every load case that has it.

    `change`: function that takes its motion or force (n_frames, 3), in mm or mN, and returns the changed one.
    """
    cases = dict(experiment.cases)
    for title, case in cases.items():
        if name in case.displacements:
            cases[title] = replace(case, displacements={**case.displacements, name: change(case.displacements[name])})
        if name in case.applied_forces:
            forces = {**case.applied_forces, name: change(case.applied_forces[name])}
            cases[title] = replace(case, applied_forces=forces)
    return replace(experiment, cases=cases)
