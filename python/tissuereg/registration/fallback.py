"""Linear elastic estimate of the shape of a body, for the case that a registration cannot be trusted.

The estimate is the simulated displacement, or the body at rest, plus the change of the linearised body that explains
the markers best. The change is caused by surface forces of least strain energy, or by smooth tractions, whichever is
more probable (`tissuereg.registration.contacts.elastic`). No change is made that the markers do not require, so that
the estimate stays close to the simulation. It has no confidence regions.
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
    """Linear elastic estimator of the shape of one body at any moment; the body is linearised once, at rest.

    `body`: the linearised body with its markers; `targets`: inner points whose places are estimated.
    """

    body: ElasticBody
    targets: TargetObservation

    @classmethod
    def of(
        cls, mesh: Mesh, material: Material, places: Markers, targets: TargetObservation, threads: int
    ) -> "ElasticFallback":
        """Return the linear elastic estimator of a body, linearised at rest.

        `mesh`: undeformed body; `material`: its material; `places`: markers, of which reference places and noise in mm
        are used; `targets`: inner points; `threads`: threads to use; 0 takes all cores. Raises `SupportError` if the
        body can move freely.

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
        """Return the estimated displacement of the body and places of the targets at one moment, in mm.

        `markers`: reference and measured places, mm; `used`: names of the markers that a registration accepted; of
        these, only markers measured in all three coordinates count; `simulation` (n_nodes, 3) or None: simulated
        displacement to which the estimate is added, mm; None for the body at rest. Result: None if no marker is left.
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
