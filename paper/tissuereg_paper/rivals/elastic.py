"""Linear elasticity about the simulation, or about rest: the markers' compliance, made once."""

from typing import Any, ClassVar

import numpy as np

from tissuereg import Body
from tissuereg._base.arguments import flag
from tissuereg._base.arrays import FloatArray
from tissuereg.registration.contacts.elastic import ElasticBody
from tissuereg.registration.linear_prior import LinearPrior, most_probable
from tissuereg_paper.rivals.rival import Estimate, Moment, Rival, Setting


def elastic_body(setting: Setting) -> ElasticBody:
    """Return the body of a setting, linearised at rest with the elements that the package's own registration takes."""
    return ElasticBody(**believed(setting))


def believed(setting: Setting) -> dict[str, Any]:
    """Return the arguments of `ElasticBody` for a setting."""
    return {
        "mesh": setting.mesh,
        "material": setting.material,
        "markers": setting.markers(np.full_like(setting.reference_mm, np.nan)),
        "element": Body(setting.mesh, setting.material).fitting_element,
        "threads": setting.threads,
    }


def residual_of(body: ElasticBody, moment: Moment) -> FloatArray:
    """Return what the seen markers' displacements (n_seen, 3) have in excess of the simulation's, mm."""
    return body.residual(moment.displacement_mm, moment.seen, moment.simulation_mm)


def added(moment: Moment, change: FloatArray) -> FloatArray:
    """Return the simulation of a moment, if there is one, with a change (n_nodes, 3) added, mm."""
    return change if moment.simulation_mm is None else moment.simulation_mm + change


class LinearElastic(Rival):
    r"""Forces on the surface of the linearised body that explain what the simulation leaves at the markers.

    The displacement is ``x + K^-1 f`` with the simulation x (zero without one), the stiffness K of the undeformed body
    and forces f that minimise ``|C (x + K^-1 f) - d|^2 / std^2`` plus a penalty. With the strain energy as penalty the
    answer needs the markers' compliance ``C K^-1 C'`` alone, and the forces act at the markers; with independent loads
    on overlapping patches of the surface they are smooth tractions, and what it needs is of the same size.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    smooth : bool
        Whether smooth tractions on patches of several radii are tried beside the strain energy. The penalty's weight,
        and which of the penalties it is, are those of the highest evidence at each moment.
    rigid : float
        Variance of the markers by rigid motions of the whole body over that by elasticity: a base may give.

    Notes
    -----
    Cost of a moment: products of the size of markers and of one field, a solve for each new set of markers seen
    apart. After Z. Yang, R. Simon, K. Merrell and C. A. Linte, "Boundary constraint-free biomechanical model-based
    surface matching for intraoperative liver deformation correction", arXiv:2403.09964, 2024, which has no held base
    and finds correspondences as well.
    """

    name: ClassVar[str] = "linear elastic"

    def __init__(self, setting: Setting, *, smooth: bool = True, rigid: float = 1.0) -> None:
        super().__init__(setting)
        self.body = elastic_body(setting)
        self.priors: dict[str, LinearPrior] = self.body.priors(flag("smooth", smooth), rigid)

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the simulation and the most probable linear change; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        name, found = most_probable(self.priors, residual_of(self.body, moment), moment.seen)
        kept = {"prior": name, "scale": found.scale, "log_evidence": found.log_evidence}
        return Estimate(added(moment, found.displacement_mm), kept=kept)
