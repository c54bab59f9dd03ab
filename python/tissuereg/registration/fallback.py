"""Where a body is by linear elasticity alone: the answer that is left where a registration is not to be trusted.

It is the simulation, or the body at rest, and the change of the linearised body that explains the markers best: forces
on the surface of least strain energy, or smooth tractions, whichever is more probable
(`tissuereg.registration.contacts.elastic`).
A change that no marker asks for is not made, so that the answer stays close to the simulation. It has no regions.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.markers import Markers
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import TargetObservation
from tissuereg.registration.body import fitting_element
from tissuereg.registration.contacts.elastic import ElasticBody
from tissuereg.registration.linear_prior import LinearPrior, most_probable
from tissuereg.registration.result import Fallback

#: Bodies of more nodes get none: their registration itself fills the memory.
LARGEST = 50_000


@dataclass(frozen=True, eq=False)
class ElasticFallback:
    """A body with markers and targets, linearised at rest. `body`: with the markers; `targets`: inner points."""

    body: ElasticBody
    targets: TargetObservation

    @classmethod
    def of(
        cls, mesh: Mesh, material: Material, places: Markers, targets: TargetObservation, threads: int
    ) -> "ElasticFallback":
        """Return the fallback of a body.

        Raises `SupportError` if the body can move freely.

        Notes
        -----
        Cost: a factorisation, and a few right-hand sides for each coordinate of a marker.
        """
        element = fitting_element(mesh, material)
        return cls(ElasticBody(mesh, material, places, element=element, threads=threads), targets)

    @cached_property
    def _priors(self) -> dict[str, LinearPrior]:
        return self.body.priors()

    def about(self, markers: Markers, used: tuple[str, ...], simulation: FloatArray | None) -> Fallback | None:
        """Return where the body is at one moment.

        `used`: those that a registration found fit to be used; of them whole places count; `simulation` (n_nodes, 3) or
        None: displacement by a simulation, mm. Result: None if no marker is left.
        """
        whole = np.isfinite(markers.measured).all(axis=1) & np.isin(markers.names, used)
        seen = np.flatnonzero(whole)
        if not len(seen):
            return None
        residual = self.body.residual(markers.displacement[seen], seen, simulation)
        _, found = most_probable(self._priors, residual, seen, markers.std[seen])
        moved = found.displacement_mm if simulation is None else simulation + found.displacement_mm
        places = self.targets.reference + self.targets.predict(moved[self.targets.nodes])
        return Fallback(moved, dict(zip(self.targets.names, places, strict=True)))
