"""Effects on supports and weight: boundaries that slide or are detached in part, another gravity."""

from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.choices import Element
from tissuereg._base.fields import flag, number, numbers, text
from tissuereg.body.mesh import Mesh
from tissuereg.experiment.effects.base import Effect, Vector, exactly_one, refuse
from tissuereg.experiment.experiment import BodyWeight as Weight
from tissuereg.experiment.experiment import Boundary, Experiment


@dataclass(frozen=True, kw_only=True)
class _Support(Effect):
    """Base of effects on one boundary (a held patch of nodes), which the field `boundary` names."""

    repeatable: ClassVar[bool] = True
    boundary: str = text("name of the boundary")

    def fits(self, experiment: Experiment) -> None:
        """Raise ExperimentError if the experiment has no boundary of this name."""
        names = [boundary.name for boundary in experiment.boundaries]
        if self.boundary not in names:
            refuse(f"`boundary` must be one of {', '.join(names) or 'none'}", self.boundary)

    def held_by(self, experiment: Experiment) -> Boundary:
        """Return the boundary of the experiment that the field `boundary` names."""
        return next(boundary for boundary in experiment.boundaries if boundary.name == self.boundary)


@dataclass(frozen=True, kw_only=True)
class Sliding(_Support):
    """A boundary that slides on its tangent plane against springs, in kPa per mm of slip, or against friction.

    With friction it sticks until it is pulled harder than `cohesion_kpa` and `friction` times the pressure on it, by
    Coulomb's law. The pressure is that which the loads add to the given shape.
    """

    id: ClassVar[str] = "sliding"
    absolute: ClassVar[bool] = True
    spring_kpa_per_mm: float | None = number("stiffness of springs along its tangent plane", least=0.0, default=None)
    friction: float | None = number("or: coefficient of friction", least=0.0, default=None)
    cohesion_kpa: float | None = number(
        "shear stress that holds without pressure, with `friction`; 0 where left out", least=0.0, default=None
    )

    def check(self) -> None:
        """Raise an error unless one of springs and friction is given, or if a cohesion is given without friction."""
        exactly_one(self, ("spring_kpa_per_mm",), ("friction",))
        if self.cohesion_kpa is not None and self.friction is None:
            refuse("`cohesion_kpa` must come with `friction`")

    def fits(self, experiment: Experiment) -> None:
        """Raise ExperimentError if the boundary is unknown or contains no whole triangle of the surface."""
        super().fits(experiment)
        if not len(self.triangles(experiment)):
            n_nodes = len(self.held_by(experiment).nodes)
            refuse(
                f"boundary '{self.boundary}' must hold a whole triangle of the surface to slide, it has {n_nodes} nodes"
            )

    def triangles(self, experiment: Experiment) -> IntArray:
        """Return the surface triangles whose nodes all belong to the boundary, as node indices, shape (n, 3)."""
        surface = experiment.mesh.surface
        return np.asarray(surface[np.isin(surface, self.held_by(experiment).nodes).all(axis=1)])

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment unchanged: the solver reads springs or friction from the effect."""
        return experiment


@dataclass(frozen=True, kw_only=True)
class Detachment(_Support):
    """A part of a boundary is detached, and its nodes are free.

    It is either all within a ball, or a rim: seen from the boundary's centre, the part that lies farthest towards
    `azimuth_deg` (from x to y, about z), until it makes up `share` of the boundary's area.
    """

    id: ClassVar[str] = "detachment"
    centre_mm: Vector | None = numbers("centre of a ball that is detached", 3, default=None)
    radius_mm: float | None = number("its radius", above=0.0, default=None)
    azimuth_deg: float | None = number("or: direction of the detached rim, from x to y about z", default=None)
    share: float | None = number("share of the boundary's area that it makes up", above=0.0, below=1.0, default=None)

    def check(self) -> None:
        """Raise an error unless exactly one region is given completely: a ball or a rim."""
        exactly_one(self, ("centre_mm", "radius_mm"), ("azimuth_deg", "share"))

    def fits(self, experiment: Experiment) -> None:
        """Raise ExperimentError if the boundary is unknown, or the region frees none of its nodes or all held nodes."""
        super().fits(experiment)
        boundary = self.held_by(experiment)
        freed = self.freed(experiment.mesh, boundary.nodes)
        if not len(freed):
            refuse(f"the region must hold a node of boundary '{self.boundary}', which has {len(boundary.nodes)}")
        if len(freed) == len(boundary.nodes) and len(experiment.boundaries) == 1:
            refuse(f"the region must leave a part of '{self.boundary}', the one boundary, it frees all {len(freed)}")

    def freed(self, mesh: Mesh, nodes: IntArray) -> IntArray:
        """Return the detached nodes of a boundary.

        Parameters
        ----------
        mesh : Mesh
            Mesh in the reference shape.
        nodes : ndarray of int64, shape (n,)
            Node indices of the boundary.

        Returns
        -------
        ndarray of int64, shape (n_freed,)
            Indices of the nodes that are detached.
        """
        places = mesh.nodes[nodes]
        if self.centre_mm is not None and self.radius_mm is not None:
            inside = np.linalg.norm(places - np.asarray(self.centre_mm), axis=1) <= self.radius_mm
            return np.asarray(nodes[inside])
        assert self.share is not None  # `check` has seen it
        order, _, areas = self._towards(mesh, nodes)
        return np.sort(nodes[order[freeing_shares(areas) < self.share]])

    def edges(self, mesh: Mesh, nodes: IntArray) -> tuple[FloatArray, FloatArray]:
        """Return how far a detached rim must reach to pass each node of a boundary, the outermost node first.

        Parameters
        ----------
        mesh : Mesh
            Mesh in the reference shape.
        nodes : ndarray of int64, shape (n,)
            Node indices of the boundary.

        Returns
        -------
        tuple of ndarray of float64, each of shape (n,)
            Distance of each node behind the outermost one, along `azimuth_deg`, mm, never decreasing; and the share of
            the boundary's area that the node represents.
        """
        order, towards, areas = self._towards(mesh, nodes)
        return towards[order[0]] - towards[order], areas

    def _towards(self, mesh: Mesh, nodes: IntArray) -> tuple[IntArray, FloatArray, FloatArray]:
        """Return the order of a boundary's nodes from the outermost in the direction of the azimuth inwards.

        `nodes` int64 (n,): node indices of the boundary. Result: that order (n,), as positions in `nodes`; the
        coordinate (n,) of the nodes along the azimuth, mm, in the order of `nodes`; the share (n,) of the boundary's
        area that belongs to each node, in the new order.
        """
        assert self.azimuth_deg is not None  # `check` has seen it
        angle = np.deg2rad(self.azimuth_deg)
        towards = mesh.nodes[nodes] @ np.array([np.cos(angle), np.sin(angle), 0.0])
        order = np.argsort(-towards, kind="stable")
        area = node_areas(mesh, nodes)[order]
        return order, towards, area / area.sum()

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with the detached nodes removed from the boundary and from the node set ``fixed``."""
        old = self.held_by(experiment)
        kept = np.setdiff1d(old.nodes, self.freed(experiment.mesh, old.nodes))
        boundaries = tuple(
            replace(old, nodes=kept, rule=None) if boundary is old else boundary for boundary in experiment.boundaries
        )
        held = np.unique(np.concatenate([boundary.nodes for boundary in boundaries]))
        mesh = experiment.mesh.with_node_set(old.name, kept).with_node_set("fixed", held)
        return replace(experiment, boundaries=boundaries, mesh=mesh)


def freeing_shares(areas: FloatArray) -> FloatArray:
    """Return the detached share of a boundary at which each node becomes free: when half of its area is detached.

    Parameters
    ----------
    areas : ndarray of float64, shape (n,)
        Share of the boundary's area that each node represents, the outermost node first.

    Returns
    -------
    ndarray of float64, shape (n,)
        Increasing shares of the boundary's area.
    """
    return np.asarray(np.cumsum(areas) - 0.5 * areas)


def node_areas(mesh: Mesh, nodes: IntArray) -> FloatArray:
    """Return the area of surface that each node of a patch represents.

    Parameters
    ----------
    mesh : Mesh
        Mesh in the reference shape.
    nodes : ndarray of int64, shape (n,)
        Sorted node indices of the patch, all on the surface.

    Returns
    -------
    ndarray of float64, shape (n,)
        A third of the area of the patch's triangles that meet at each node, mm^2. If the patch contains no whole
        triangle, 1 for every node.
    """
    triangles = mesh.surface[np.isin(mesh.surface, nodes).all(axis=1)]
    corners = mesh.nodes[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    thirds = np.repeat(np.linalg.norm(normal, axis=1) / 6.0, 3)
    areas = np.bincount(np.searchsorted(nodes, triangles.ravel()), thirds, len(nodes)).astype(np.float64)
    return areas if areas.any() else np.ones(len(nodes))


@dataclass(frozen=True, kw_only=True)
class _Weight(Effect):
    """Base of effects that change the body's weight; a field that is None keeps what the experiment states."""

    absolute: ClassVar[bool] = True
    direction: Vector | None = numbers("where the weight points", 3, directed=True, default=None)
    g_mm_per_s2: float | None = number("acceleration", above=0.0, default=None)
    in_reference: bool | None = flag("whether the mesh already hangs in it", default=None)

    def check(self) -> None:
        """Raise an error if no field is given."""
        if self.direction is None and self.g_mm_per_s2 is None and self.in_reference is None:
            refuse("one of `direction`, `g_mm_per_s2`, `in_reference` must be given")

    def fits(self, experiment: Experiment) -> None:
        """Raise ExperimentError if neither this effect nor the experiment states a direction of gravity."""
        if experiment.gravity is None and self.direction is None:
            refuse("`direction` must be given where the experiment has no [gravity]")

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment with its weight changed by the fields that are given."""
        weight = experiment.gravity or Weight(np.asarray(self.direction), in_reference=False)
        if self.direction is not None:
            weight = replace(weight, direction=np.asarray(self.direction))
        if self.g_mm_per_s2 is not None:
            weight = replace(weight, g_mm_per_s2=self.g_mm_per_s2)
        if self.in_reference is not None:
            weight = replace(weight, in_reference=self.in_reference)
        return replace(experiment, gravity=weight)


@dataclass(frozen=True, kw_only=True)
class Gravity(_Weight):
    """A weight other than the believed one: tilted, stronger or weaker, or present where none is believed."""

    id: ClassVar[str] = "gravity"


@dataclass(frozen=True, kw_only=True)
class Reference(_Weight):
    """Another reference shape: whether the mesh already hangs in gravity."""

    id: ClassVar[str] = "reference"
    in_reference: bool | None = flag("whether the mesh already hangs in it")
