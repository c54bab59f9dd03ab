"""Linearised iterative boundary reconstruction."""

from typing import Any, ClassVar

from tissuereg._base.arguments import real, whole
from tissuereg_paper.rivals.elastic import added, elastic_body, residual_of
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting


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
        self.body = elastic_body(setting)
        self._prior = self.body.given_way(self.body.control_loads(whole("n_cells", n_cells, least=1)), rigid)
        self._scale = None if energy_weight is None else 1.0 / real("energy_weight", energy_weight, above=0.0)

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the simulation and the combination that fits best; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        found = self._prior.answer(residual_of(self.body, moment), moment.seen, self._scale)
        kept = {"energy_weight": 1.0 / found.scale if found.scale > 0.0 else float("inf")}
        return Estimate(added(moment, found.displacement_mm), kept=kept)
