"""Errors of actuators: gain, direction and offset of the motion, position of the patch."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.load import Load
from tissuereg.diagnosis.bench import Bench, State
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.diagnosis.causes.numbers import three
from tissuereg.experiment.effects import ActuatorDirection, ActuatorGain, ActuatorOffset
from tissuereg.experiment.experiment import Actuator


@dataclass(frozen=True)
class GainCause(Cause, id="actuator_gain", family="actuator", discrete=("actuator",)):
    """One actuator's motion is scaled."""

    #: Prior deviation of the gain.
    spread: float = 0.08

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each actuator that a case uses: its motion or force is multiplied by a gain."""
        for pad in present_pads(bench):
            if bench.is_elastic and pad.kind == "displacement":
                columns = bench.by(partial(_moved, pad, lambda motion: motion[None]), 1)
            else:
                changed = bench.change(ActuatorGain(actuator=pad.name, gain=1.05))
                if changed is None:
                    continue
                columns = 20.0 * changed[None]
            yield Variant(pad.name, self.spread * columns, {"actuator": pad.name})

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the one free parameter of the nonlinear fit: the gain minus one."""
        name = str(variant.settings["actuator"])
        excess = (self.spread * float(amplitudes[0]), 0.0, self.spread, 0.01)
        return free_parameters([excess], lambda x, young: (ActuatorGain(actuator=name, gain=1.0 + float(x[0])),))

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `gain` (a factor) of the named `actuator`."""
        return f"Actuator '{values['actuator']}' moves by {values['gain']:.3f} times the prescribed motion."


@dataclass(frozen=True)
class DirectionCause(Cause, id="actuator_direction", family="actuator", discrete=("actuator",)):
    """One actuator's motion has another direction."""

    #: Prior deviation of each angle, degrees.
    spread_deg: float = 3.0

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each actuator in use: its motion or force is rotated, by two angles across it."""
        for pad in present_pads(bench):
            across = _across(bench, pad)
            if bench.is_elastic and pad.kind == "displacement":
                columns = bench.by(partial(_moved, pad, partial(np.cross, np.deg2rad(across))), 2)
            else:
                turns = [ActuatorDirection(actuator=pad.name, rotation_deg=three(axis)) for axis in across]
                changes = bench.changes([[turn] for turn in turns])
                if any(change is None for change in changes):
                    continue
                columns = np.array(changes)
            yield Variant(pad.name, self.spread_deg * columns, {"actuator": pad.name, "across": across})

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return two free parameters: angles in degrees about two axes perpendicular to the motion."""
        name, across = str(variant.settings["actuator"]), np.asarray(variant.settings["across"])
        return free_parameters(
            [(self.spread_deg * float(a), 0.0, self.spread_deg, 0.5) for a in amplitudes],
            lambda x, young: (ActuatorDirection(actuator=name, rotation_deg=three(x @ across)),),
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `rotation_deg` (a vector) of an `actuator`."""
        turn = float(np.linalg.norm(np.asarray(values["rotation_deg"])))
        return f"Actuator '{values['actuator']}' moves in a direction {turn:.1f} degrees from the believed one."


@dataclass(frozen=True)
class OffsetCause(Cause, id="actuator_offset", family="actuator", discrete=("actuator", "kind")):
    """One actuator's motion has a constant offset, or its patch has another position."""

    #: Prior deviations of each offset of the motion and of each shift of the patch, mm.
    spread_mm: float = 0.7
    patch_mm: float = 2.0

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return up to two hypotheses for each actuator that a case uses: offset of its motion, or shift of its patch.

        Columns (3, size): by each offset along x, y and z, or by each of two shifts along the surface and zeros. The
        offset is tried only for prescribed displacements of a body without memory.
        """
        for pad in present_pads(bench):
            if pad.kind == "displacement" and bench.is_elastic:
                columns = bench.by(partial(_moved, pad, lambda motion: np.eye(3)), 3)
                yield Variant(f"{pad.name} motion", self.spread_mm * columns, {"actuator": pad.name, "kind": "motion"})
            tangents = _along_surface(bench, pad)
            ends = [side * self.patch_mm * axis for axis in tangents for side in (-1.0, 1.0)]
            changes = bench.changes([[ActuatorOffset(actuator=pad.name, shift_mm=three(end))] for end in ends])
            known = [change for change in changes if change is not None]
            if len(known) == len(ends):
                columns = np.array([0.5 * (known[1] - known[0]), 0.5 * (known[3] - known[2]), 0.0 * known[0]])
                settings = {"actuator": pad.name, "kind": "patch", "along": tangents}
                yield Variant(f"{pad.name} patch", columns, settings)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the offset of the motion (three parameters), or the shift along the surface (two), in mm."""
        name = str(variant.settings["actuator"])
        if variant.settings["kind"] == "motion":
            offset = [(self.spread_mm * float(a), 0.0, self.spread_mm, 0.05) for a in amplitudes]
            return free_parameters(offset, lambda x, young: (ActuatorOffset(actuator=name, offset_mm=three(x)),))
        along = np.asarray(variant.settings["along"])
        shifts = [(self.patch_mm * float(a), 0.0, self.patch_mm, 0.5 * self.patch_mm) for a in amplitudes[:2]]
        moved = free_parameters(shifts, lambda x, young: (ActuatorOffset(actuator=name, shift_mm=three(x @ along)),))
        # On the user's mesh a patch can be shifted by whole nodes only.
        return replace(moved, columns=variant.columns[:2] / self.patch_mm)

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `offset_mm` or `shift_mm` of an `actuator`."""
        size = float(np.linalg.norm(np.asarray(values["offset_mm" if "offset_mm" in values else "shift_mm"])))
        if "offset_mm" in values:
            return f"The motion of actuator '{values['actuator']}' has a constant offset of {size:.2f} mm."
        return f"The patch of actuator '{values['actuator']}' is {size:.1f} mm from its believed position."


def present_pads(bench: Bench) -> list[Actuator]:
    """Return the actuators that a case uses."""
    used = {name for case in bench.experiment.cases.values() for name in (*case.displacements, *case.applied_forces)}
    return [pad for pad in bench.experiment.actuators if pad.name in used]


def _moved(pad: Actuator, changes: Callable[[FloatArray], FloatArray], state: State) -> Sequence[Load]:
    """Return the loads of `changes` (k, 3) of the motion of a pad, which are a function of the motion (3,)."""
    return [load_of(state, pad, change) for change in changes(motion_of(state, pad))]


def motion_of(state: State, pad: Actuator) -> FloatArray:
    """Return the commanded motion of a pad in a state, (3,), mm; zero where it has none."""
    given = state.case.displacements
    return given[pad.name][state.frame] if pad.name in given else np.zeros(3)


def load_of(state: State, pad: Actuator, motion: FloatArray) -> Load:
    """Return the load that moves a pad by (3,) or (n_pad, 3), mm; one without motion where it is not present."""
    if pad.name not in state.pad_rows:
        return Load(prescribed=np.zeros((len(state.simulator.held_nodes), 3)))
    return Load(prescribed=state.moved(pad.name, motion))


def _across(bench: Bench, pad: Actuator) -> FloatArray:
    """Return two unit vectors, shape (2, 3), perpendicular to the main direction of an actuator's motion or force."""
    given = [c.displacements.get(pad.name, c.applied_forces.get(pad.name)) for c in bench.experiment.cases.values()]
    motion = np.concatenate([g for g in given if g is not None])
    return np.asarray(np.linalg.svd(motion, full_matrices=True)[2][1:])


def _along_surface(bench: Bench, pad: Actuator) -> FloatArray:
    """Return two unit vectors, shape (2, 3), that are tangential to the surface at an actuator's patch."""
    places = bench.experiment.mesh.nodes[pad.nodes]
    return np.asarray(np.linalg.svd(places - places.mean(axis=0), full_matrices=True)[2][:2])
