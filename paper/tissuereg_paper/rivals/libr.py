"""Linearised iterative boundary reconstruction."""

from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arguments import real, whole
from tissuereg.registration.contacts.elastic import ElasticBody
from tissuereg.registration.contacts.patches import surface_of_nodes
from tissuereg.registration.contacts.places import gathered
from tissuereg.registration.linear_prior import LinearPrior
from tissuereg_paper.rivals.elastic import added, believed, residual_of
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting


class ControlledBody(ElasticBody):
    """A body at rest on whose surface unit loads act, cell by cell."""

    def control_loads(self, n_cells: int) -> LinearPrior:
        """Return the prior of the displacement field by unit loads on cells of the surface, weighted by strain energy.

        ``P = F E^-1 F'`` with the responses F to the loads and their strain energies E: of all combinations of loads
        those with the least strain energy are the most likely. `n_cells`: number of cells, into which the free nodes of
        the surface are gathered; at most one per node.
        """
        areas, _ = surface_of_nodes(self.mesh)
        cell = gathered(self.mesh.nodes[self._free], areas[self._free], whole("n_cells", n_cells, least=1))
        count = int(cell.max()) + 1
        share = areas[self._free] / np.bincount(cell, areas[self._free])[cell]
        forces = np.zeros((3 * count, self._at_markers.shape[1], 3))
        for axis in range(3):
            forces[3 * cell + axis, self._free, axis] = share
        responses = self._linearised.responses(forces)
        flat = responses.reshape(3 * count, -1)
        energies = forces.reshape(3 * count, -1) @ flat.T
        moved = responses[:, : self.mesh.n_nodes]
        seen = self.seen(moved)
        best = np.linalg.solve(0.5 * (energies + energies.T), seen)
        return LinearPrior(seen.T @ best, np.einsum("lnx,lo->nxo", moved, best, optimize=True), self._std)


class Libr(Rival):
    r"""Responses to unit loads on cells of the surface, combined so that they fit the markers at little strain energy.

    Of the coefficients b of the responses F (made once), ``|C (x + F b) - d|^2 / std^2 + w b' E b`` is minimised, with
    the simulation x (zero without one) and the strain energies E of the responses.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    n_cells : int
        Cells of the free surface, each with loads along three axes; the paper takes 45 control points.
    energy_weight : float, optional
        The weight w, per mN mm. By default the one of the highest evidence at each moment.
    rigid : float
        Variance of the markers by rigid motions of the whole body over that by the loads.

    Notes
    -----
    J. S. Heiselman, W. R. Jarnagin and M. I. Miga, "Intraoperative correction of liver deformation using sparse surface
    and vascular features via linearized iterative boundary reconstruction", IEEE Transactions on Medical Imaging 39,
    2223-2234, 2020. The body's rigid motion is among the unknowns there, too. Markers have known counterparts here and
    turns are small, so that no iterations are needed: the minimum is found in closed form.
    """

    name: ClassVar[str] = "LIBR"

    def __init__(
        self, setting: Setting, *, n_cells: int = 30, energy_weight: float | None = None, rigid: float = 1.0
    ) -> None:
        super().__init__(setting)
        self.body = ControlledBody(**believed(setting))
        self._prior = self.body.given_way(self.body.control_loads(n_cells), rigid)
        self._scale = None if energy_weight is None else 1.0 / real("energy_weight", energy_weight, above=0.0)

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the simulation and the combination that fits best; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        found = self._prior.answer(residual_of(self.body, moment), moment.seen, self._scale)
        kept = {"energy_weight": 1.0 / found.scale if found.scale > 0.0 else float("inf")}
        return Estimate(added(moment, found.displacement_mm), kept=kept)
