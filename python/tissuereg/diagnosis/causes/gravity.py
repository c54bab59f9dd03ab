"""Weight: gravity of another direction or size than believed, or left out, and the shape that the mesh has under it."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.load import Load
from tissuereg.body.material import GRAVITY_MM_PER_S2
from tissuereg.diagnosis.bench import Bench, State
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant, free_parameters
from tissuereg.diagnosis.causes.numbers import three
from tissuereg.experiment.effects import Effect, Gravity, Reference
from tissuereg.simulation.sensitivity import Cause as Moved
from tissuereg.simulation.sensitivity import Linearised
from tissuereg.simulation.solve import Simulator


@dataclass(frozen=True)
class GravityCause(Cause, id="gravity", family="rest", absolute=True):
    """Three components of the body's weight."""

    #: Prior deviation of each component, over standard gravity, without and with a believed weight.
    unknown: float = 0.6
    known: float = 0.2

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis, with columns (3, size) by the components of the body's weight; none without answer."""
        spread = self.unknown if bench.experiment.gravity is None else self.known
        if bench.is_elastic:
            columns = self._by_tangents(bench)
        else:
            changes = [bench.change(_effect(_believed(bench) + 0.05 * axis)) for axis in np.eye(3)]
            if any(change is None for change in changes):
                return []
            columns = np.array(changes) / 0.05
        return [Variant("weight", spread * columns, {"spread": spread})]

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return three free parameters: the components of the gravity vector over standard gravity."""
        spread, believed = float(variant.settings["spread"]), _believed(bench)
        return free_parameters(
            [(float(b + spread * a), float(b), spread, 0.02) for a, b in zip(amplitudes, believed, strict=True)],
            lambda x, young: (_effect(x),),
            lambda x, young: {
                "direction": (x / np.linalg.norm(x)).tolist(),
                "g_mm_per_s2": float(np.linalg.norm(x)) * GRAVITY_MM_PER_S2,
            },
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `direction` (3,) and `g_mm_per_s2`."""
        axis, over = ", ".join(f"{x:.2f}" for x in values["direction"]), values["g_mm_per_s2"] / GRAVITY_MM_PER_S2
        return f"Gravity acts along ({axis}) with {over:.2g} g, unlike in the simulation."

    def _by_tangents(self, bench: Bench) -> FloatArray:
        """Return the derivatives (3, size) by the weight along each axis, over standard gravity, in mm and mN."""
        worked, weight, threads = bench.tangents.worked, bench.tangents.worked.gravity, bench.predictor.threads
        unit = [worked.material.weight(axis) for axis in np.eye(3)]
        free = Simulator(worked.mesh, element=bench.predictor.element)
        pull = np.zeros(3) if weight is None else worked.material.weight(weight.direction, weight.g_mm_per_s2)
        rest = Load(body_force=pull)
        # Pads are attached to the shape that has sagged under the weight, so that they move with it.
        standing = free.solve(rest, worked.material, threads=threads).all_displacement
        tangent = Linearised(free, rest, worked.material, standing, threads=threads)
        sag = tangent.derivatives([Load(body_force=force) for force in unit]).displacement

        def direction(state: State) -> Sequence[Moved]:
            loads = []
            for axis in range(3):
                prescribed = np.zeros((len(state.simulator.held_nodes), 3))
                for rows in state.pad_rows.values():
                    prescribed[rows] = sag[axis, state.simulator.held_nodes[rows]]
                loads.append(Load(body_force=unit[axis], prescribed=prescribed))
            return loads

        return bench.by(direction, 3)


def _believed(bench: Bench) -> FloatArray:
    weight = bench.experiment.gravity
    if weight is None:
        return np.zeros(3)
    towards = np.asarray(weight.direction, np.float64)
    return np.asarray(towards / np.linalg.norm(towards) * (weight.g_mm_per_s2 / GRAVITY_MM_PER_S2))


def _effect(over_standard: FloatArray) -> Effect:
    size = max(float(np.linalg.norm(over_standard)), 1e-6)
    towards = over_standard / size if np.any(over_standard) else np.array([0.0, 0.0, -1.0])
    return Gravity(direction=three(towards), g_mm_per_s2=size * GRAVITY_MM_PER_S2)


class ReferenceCause(Cause, id="reference", family="rest", absolute=True):
    """Whether the mesh is already deformed by the believed gravity."""

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis, the opposite of what is believed; none where no gravity is believed."""
        weight = bench.experiment.gravity
        if weight is None:
            return
        hangs = not weight.in_reference
        changed = bench.change(Reference(in_reference=hangs))
        if changed is not None:
            yield Variant("hangs" if hangs else "does not hang", changed[None], {"hangs": hangs}, fixed=True)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return no free parameters (k = 0): the effect is the opposite of what is believed about the mesh."""
        opposite = Reference(in_reference=bool(variant.settings["hangs"]))
        return free_parameters([], lambda x, young: (opposite,))

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `in_reference` (a bool)."""
        how = "is already deformed by gravity" if values["in_reference"] else "is the shape without gravity"
        return f"The mesh {how}, contrary to what is believed."
