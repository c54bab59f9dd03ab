"""An experiment on a finer mesh: small elements around its pads, and pads cut out along their rims."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissuereg._base.arguments import flag, real
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.experiment.experiment import Actuator, Experiment
from tissuereg.simulation.fine.bisection import Bisection
from tissuereg.simulation.fine.rims import (
    Rim,
    cut_along,
    outline_nodes,
    patch_nodes,
    refine_near,
    refine_round,
    rim_nodes,
)


@dataclass(frozen=True)
class FineMeshing:
    """Settings of the mesh refinement around the pads of an experiment, whose rims are the circles that bound them.

    Parameters
    ----------
    rim_edge : float
        Longest edge of an element at the rim of a pad, over the pad's radius.
    growth : float
        Increase of the allowed edge length per mm of distance from the rim, mm/mm.
    edge_share : float
        Longest edge of any element over the cube root of the body's volume.
    cut : bool
        Whether pads given by a ball are cut out of the surface along their rims; otherwise they are the nodes in the
        ball.
    """

    rim_edge: float = 0.3
    growth: float = 1.0
    edge_share: float = np.inf
    cut: bool = True

    def __post_init__(self) -> None:
        real("rim_edge", self.rim_edge, above=0.0)
        real("growth", self.growth, above=0.0)
        if not (isinstance(self.edge_share, float) and self.edge_share == np.inf):
            real("edge_share", self.edge_share, above=0.0)
        flag("cut", self.cut)


def fine_experiment(
    experiment: Experiment, meshing: FineMeshing | None = None, *, further: Sequence[Rim] = ()
) -> Experiment:
    """Return an experiment on a finer mesh.

    Parameters
    ----------
    experiment : Experiment
        The believed model (as the user states it): mesh, supports, actuators (pads), loads.
    meshing : FineMeshing, optional
        Settings of the refinement.
    further : sequence of Rim
        Further rims (circles on the surface) along which to cut the surface.

    Returns
    -------
    Experiment
        The same except for its mesh and the nodes of boundaries and actuators. Node sets are inherited: a new node
        belongs to the sets of both ends of its edge. An actuator given by a ball has all surface nodes in the ball,
        some of them exactly on its rim. Facets stay those of the given mesh, except where nodes slid along them onto a
        rim.

    Raises
    ------
    MeshError
        If a pad is so small compared with the elements that refinement does not end.
    """
    meshing = meshing or FineMeshing()
    cutter = Bisection(experiment.mesh)
    if np.isfinite(meshing.edge_share):
        longest = meshing.edge_share * float(np.cbrt(experiment.mesh.volumes.sum()))
        cutter.refine(lambda centres: np.full(len(centres), longest))
    rims = {pad.name: rim for pad in experiment.actuators if (rim := rim_of(pad)) is not None}
    cuts = [*rims.values(), *further]
    refine_round(cutter, cuts, meshing.rim_edge, meshing.growth)
    for pad in experiment.actuators:
        if pad.name not in rims:
            _refine_outline(cutter, pad, meshing)
    for rim in cuts if meshing.cut else ():
        outlines = [outline_nodes(cutter.surface, cutter.carried(group.nodes)) for group in _groups(experiment, rims)]
        others = [rim_nodes(cutter, other) for other in cuts if other is not rim]
        cut_along(cutter, rim, np.unique(np.concatenate([*outlines, *others, np.empty(0, np.int64)])))
    sets = {name: cutter.carried(nodes) for name, nodes in experiment.mesh.node_sets.items()}
    sets |= {name: patch_nodes(cutter, rim) for name, rim in rims.items()}
    mesh = Mesh(cutter.nodes, cutter.tets, sets)
    return replace(
        experiment,
        mesh=mesh,
        boundaries=tuple(replace(b, nodes=cutter.carried(b.nodes)) for b in experiment.boundaries),
        actuators=tuple(
            replace(a, nodes=sets[a.name] if a.name in rims else cutter.carried(a.nodes)) for a in experiment.actuators
        ),
    )


def rim_of(actuator: Actuator) -> Rim | None:
    """Return the rim (bounding circle) of an actuator's patch; None if the patch is not given by a ball."""
    rule: Any = actuator.rule
    if not isinstance(rule, Mapping) or "centre_mm" not in rule:
        return None
    x, y, z = (float(v) for v in rule["centre_mm"])
    return Rim((x, y, z), float(rule["radius_mm"]))


def _groups(experiment: Experiment, rims: Mapping[str, Rim]) -> list[Any]:
    """Return the boundaries of an experiment, and its actuators that are not given by a ball and so not in `rims`."""
    return [*experiment.boundaries, *(pad for pad in experiment.actuators if pad.name not in rims)]


def _refine_outline(cutter: Bisection, pad: Actuator, meshing: FineMeshing) -> None:
    """Refine the elements along the outline of a pad that is given by its nodes and not by a ball."""
    points, radius = _outline_points(cutter, cutter.carried(pad.nodes))
    if len(points):
        refine_near(cutter, points, meshing.rim_edge * radius, meshing.growth)


def _outline_points(cutter: Bisection, nodes: IntArray) -> tuple[FloatArray, float]:
    """Return points (n, 3) along the outline of a patch (ends and middles of edges), mm, and the patch's radius, mm.

    `nodes`: numbers of the patch's nodes. The radius is that of a disc of its area.
    """
    patch = cutter.surface[np.isin(cutter.surface, nodes).all(axis=1)]
    corners = cutter.nodes[patch]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    radius = float(np.sqrt(0.5 * np.linalg.norm(normal, axis=1).sum() / np.pi))
    sides = np.sort(patch[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    edges, count = np.unique(sides, axis=0, return_counts=True)
    start, end = cutter.nodes[edges[count == 1, 0]], cutter.nodes[edges[count == 1, 1]]
    return np.concatenate([start, 0.5 * (start + end), end]), radius
