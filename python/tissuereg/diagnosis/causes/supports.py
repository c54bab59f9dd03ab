"""Supports: one that slides, on tangential springs or with friction, and one that has detached from its rim inwards."""

import itertools
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Mixture, Values, Variant, free_parameters
from tissuereg.diagnosis.causes.numbers import logistic, logit
from tissuereg.experiment.effects import Detachment, Sliding
from tissuereg.experiment.effects.supports import freeing_shares, node_areas


@dataclass(frozen=True)
class SlidingCause(Cause, id="sliding", family="support", discrete=("boundary", "kind"), constant=False):
    """A boundary on tangential springs, or one that slips where the tangential stress exceeds friction."""

    #: Compliances of springs, times modulus over extent, at which changes are simulated.
    compliances: tuple[float, ...] = (0.03, 0.3)
    #: Coefficient of friction, and cohesions over the modulus, at which changes are simulated.
    coefficient: float = 0.3
    cohesions: tuple[float, ...] = (0.03, 0.1)

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return four hypotheses for each support that is not believed to slide: two of springs, two of friction."""
        taken = {getattr(effect, "boundary", None) for effect in bench.experiment.effects if effect.id == self.id}
        for boundary in bench.experiment.boundaries:
            name = boundary.name
            if name in taken or not len(Sliding(boundary=name, spring_kpa_per_mm=1.0).triangles(bench.experiment)):
                continue
            own = [("springs", size, _springs(bench, name, size, bench.young)) for size in self.compliances]
            own += [("friction", c, _friction(name, self.coefficient, c * bench.young)) for c in self.cohesions]
            tried = [
                (f"{name} {kind} {size:g}", effect, {"boundary": name, "kind": kind, "size": size})
                for kind, size, effect in own
            ]
            yield from self.simulated(bench, tried)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the logarithm of the compliance of springs, or the logarithms of friction coefficient and cohesion.

        The compliance is Young's modulus over spring stiffness and extent of the body, the cohesion over the modulus.
        """
        name, size = str(variant.settings["boundary"]), float(variant.settings["size"])
        more = float(np.clip(amplitudes[0], 0.1, 10.0))
        if variant.settings["kind"] == "springs":
            return free_parameters(
                [(np.log(size * more), np.log(0.1), 1.5, 0.1)],
                lambda x, young: (_springs(bench, name, float(np.exp(x[0])), young),),
            )
        # A smaller cohesion slips more.
        cohesion, likely = size / np.sqrt(more), np.log(self.coefficient)
        return free_parameters(
            [(likely, likely, 0.7, 0.1), (np.log(cohesion), np.log(0.05), 1.0, 0.1)],
            lambda x, young: (_friction(name, float(np.exp(x[0])), float(np.exp(x[1])) * young),),
        )

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted springs or friction of a `boundary`."""
        name = f"Boundary '{values['boundary']}'"
        if "friction" in values:
            friction = f"coefficient {values['friction']:.2g}, cohesion {values['cohesion_kpa']:.2g} kPa"
            return f"{name} slips against friction ({friction})."
        return f"{name} slides, as if on springs of {values['spring_kpa_per_mm']:.2g} kPa/mm."


def _springs(bench: Bench, boundary: str, compliance: float, young: float) -> Sliding:
    return Sliding(boundary=boundary, spring_kpa_per_mm=young / (compliance * bench.extent))


def _friction(boundary: str, coefficient: float, cohesion: float) -> Sliding:
    return Sliding(boundary=boundary, friction=coefficient, cohesion_kpa=cohesion)


@dataclass(frozen=True)
class DetachmentCause(Cause, id="detachment", family="support", discrete=("boundary", "azimuth"), constant=False):
    """A part of a boundary, from its rim in one direction, is free."""

    #: Share of the boundary's area and number of directions: small shares need more, to cover the whole rim.
    directions: tuple[tuple[float, int], ...] = ((0.012, 16), (0.04, 8), (0.15, 8))
    #: Least share.
    least_share: float = 0.002
    #: Rotations in degrees from the likeliest direction, and shares, at which a fit may start.
    turns_deg: tuple[float, ...] = (-22.5, -11.25, 0.0, 11.25, 22.5)
    starts: tuple[float, ...] = (0.006, 0.015, 0.035, 0.08, 0.2)
    #: Number of depths at which the detached area is tabulated.
    depths: int = 200

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return one hypothesis for each support, direction of the detached rim and detached share of the area."""
        azimuths = [(share, 360.0 * turn / count) for share, count in self.directions for turn in range(count)]
        tried = []
        for boundary, (share, azimuth) in itertools.product(bench.experiment.boundaries, azimuths):
            settings = {"boundary": boundary.name, "azimuth": azimuth, "share": share}
            effect = Detachment(boundary=boundary.name, azimuth_deg=azimuth, share=share)
            tried.append((f"{boundary.name} {azimuth:.0f} deg {share:g}", effect, settings))
        return self.simulated(bench, tried)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return two free parameters: direction of the rim (degrees from x to y) and logit of the detached share.

        A node is free or held, so that simulations change in jumps: the prediction is interpolated between the two
        whose edges lie at the nodes next to the detachment's edge.
        """
        name = str(variant.settings["boundary"])
        share, azimuth = float(variant.settings["share"]), float(variant.settings["azimuth"])
        boundary = Detachment(boundary=name, azimuth_deg=azimuth, share=share).held_by(bench.experiment)
        width = float(np.sqrt(node_areas(bench.experiment.mesh, boundary.nodes).mean()))
        # The change grows faster than the detached area.
        start = logit(share * float(np.clip(amplitudes[0], 0.1, 4.0)) ** 0.5, self.least_share)

        def effect(azimuth: float, share: float) -> Detachment:
            return Detachment(boundary=name, azimuth_deg=azimuth, share=share)

        def between(x: FloatArray, young: float) -> Mixture:
            places, areas = effect(float(x[0]), logistic(x[1])).edges(bench.experiment.mesh, boundary.nodes)
            # Each node's area is spread over its width, so that the edge moves continuously as the share grows.
            depths = np.linspace(-0.5 * width, places[-1] + 0.5 * width, self.depths)
            covered = np.clip((depths[:, None] - places) / width + 0.5, 0.0, 1.0) @ areas
            edge = float(np.interp(logistic(x[1]), covered, depths))
            places = np.concatenate([[-0.5 * width], places])
            shares = np.concatenate([[0.0], freeing_shares(areas), [1.0]])
            n_free = min(int((places <= edge).sum()), len(places) - 1) - 1
            more = (edge - places[n_free]) / max(float(places[n_free + 1] - places[n_free]), 1e-12)
            more = float(np.clip(more, 0.0, 1.0))
            # Midway to the share at which the next node would be free.
            freed = [(effect(float(x[0]), 0.5 * float(shares[n] + shares[n + 1])),) for n in (n_free, n_free + 1)]
            return [(1.0 - more, freed[0] if n_free else ()), (more, freed[1])]

        found = free_parameters(
            [(azimuth, azimuth, 60.0, 5.0), (start, logit(0.08), 1.5, 0.2)],
            lambda x, young: (effect(float(x[0]), logistic(x[1])),),
        )
        turns, shares = azimuth + np.array(self.turns_deg), [logit(share, self.least_share) for share in self.starts]
        return replace(found, between=between, starts=np.array([*itertools.product(turns, shares)]))

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted `share` and `azimuth_deg` on a `boundary`."""
        part = f"{100 * values['share']:.0f} % of boundary '{values['boundary']}'"
        return f"About {part} has detached, on the side at {values['azimuth_deg']:.0f} degrees."
