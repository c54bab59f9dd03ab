r"""Random events on a body: surface patches pulled or pushed, and body forces in random directions.

An event is drawn in two steps. First its *shape*: one to three patches of the free surface, each with a direction, and
a share of body force. Then its *size*: the load is scaled so that in the linear solution the largest node displacement
has a wanted value. The linear solutions of all events come from one cheap pass of nearly unloaded solves. Patches near
the support and far from it therefore deform the body by similar amounts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.errors import MeshError
from tissuereg.load import Load
from tissuereg.material import Material
from tissuereg.mesh import Mesh
from tissuereg.simulate.solve import Simulator

#: Size of the first, nearly linear pass, as a share of the body's extent.
_SMALL = 1e-4


@dataclass(frozen=True)
class EventSettings:
    """Settings of random events.

    Parameters
    ----------
    n_patches : tuple of int
        Smallest and largest number of patches of an event.
    radius_share : tuple of float
        Smallest and largest patch radius as a share of the body's largest extent.
    body_force_share : float
        Probability that an event has a body force as well.
    """

    n_patches: tuple[int, int] = (1, 3)
    radius_share: tuple[float, float] = (0.08, 0.33)
    body_force_share: float = 0.6


class EventSampler:
    """Draws random events on one body.

    Parameters
    ----------
    mesh : Mesh
        Reference shape with its held nodes.
    settings : EventSettings
        Settings of the events.
    held_nodes : ndarray of int64, optional
        Nodes that patches avoid; by default the node set ``fixed``.

    Raises
    ------
    MeshError
        If the whole surface is held, so that nothing could be loaded.
    """

    def __init__(self, mesh: Mesh, settings: EventSettings | None = None, held_nodes: Any = None) -> None:
        self.mesh = mesh
        self.settings = settings or EventSettings()
        held = np.zeros(mesh.n_nodes, dtype=bool)
        held[mesh.fixed_nodes if held_nodes is None else held_nodes] = True
        corners = mesh.nodes[mesh.surface]
        free = ~held[mesh.surface].all(axis=1)
        if not free.any():
            message = "the body must have a free surface to load; every boundary triangle is held"
            raise MeshError(message, where="fixed")
        normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._triangles = mesh.surface[free]
        self._centres = corners.mean(axis=1)[free]
        self._areas = np.linalg.norm(normal, axis=1)[free]
        self._volume = float(mesh.volumes.sum())

    def draw(self, rng: np.random.Generator) -> "Event":
        """Return one event of unit total force (1 mN a patch, 1 mN for the body force).

        Parameters
        ----------
        rng : numpy.random.Generator
            Source of random numbers.

        Returns
        -------
        Event
            Shape of the load, not yet scaled.
        """
        settings = self.settings
        patches, drawn = [], []
        for _ in range(int(rng.integers(settings.n_patches[0], settings.n_patches[1] + 1))):
            centre = self._centres[rng.choice(len(self._areas), p=self._areas / self._areas.sum())]
            radius = self.mesh.extent * rng.uniform(*settings.radius_share)
            rows = np.flatnonzero(np.linalg.norm(self._centres - centre, axis=1) <= radius)
            direction = _direction(rng) * rng.uniform(0.3, 1.0)
            patches.append((self._triangles[rows], direction / self._areas[rows].sum()))
            drawn.append(Patch(centre, radius, direction))
        body_force = np.zeros(3)
        if rng.random() < settings.body_force_share:
            body_force = _direction(rng) * rng.uniform(0.0, 1.5) / self._volume
        return Event(tuple(patches), body_force, tuple(drawn))

    def columns(self, events: Sequence["Event"], sizes: FloatArray) -> dict[str, FloatArray]:
        """Return a table of events with their sizes.

        Parameters
        ----------
        events : sequence of Event
            As drawn.
        sizes : ndarray of float64, shape (n_events,)
            Their sizes in mN.

        Returns
        -------
        dict of str to ndarray
            ``patch_centre_mm`` (n_events, p, 3), ``patch_radius_mm`` (n_events, p), ``patch_force_mN`` (n_events, p, 3)
            with p the largest number of patches, NaN where an event has fewer; ``body_force_mN_per_mm3`` (n_events, 3).
        """
        shape = (len(events), self.settings.n_patches[1])
        centre, force = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan)
        radius = np.full(shape, np.nan)
        for row, (event, size) in enumerate(zip(events, sizes, strict=True)):
            for column, patch in enumerate(event.drawn):
                centre[row, column], radius[row, column] = patch.centre, patch.radius
                force[row, column] = size * patch.force
        weight = np.array([size * event.body_force for event, size in zip(events, sizes, strict=True)])
        return {
            "patch_centre_mm": centre,
            "patch_radius_mm": radius,
            "patch_force_mN": force,
            "body_force_mN_per_mm3": weight.reshape(-1, 3),
        }


@dataclass(frozen=True, eq=False)
class Patch:
    """A loaded part of the surface: centre and radius in mm, total force of an event of unit size in mN."""

    centre: FloatArray
    radius: float
    force: FloatArray


@dataclass(frozen=True, eq=False)
class Event:
    """A random load of unit size: patches (triangles, traction in kPa a unit) and a body force (mN/mm^3 a unit).

    `drawn` says of each patch where it was drawn; other makers of events leave it empty.
    """

    patches: tuple[tuple[Any, FloatArray], ...]
    body_force: FloatArray
    drawn: tuple[Patch, ...] = ()

    def load(self, simulator: Simulator, scale: float, base: Load | None = None) -> Load:
        """Return the event as a load of a given size on top of another load.

        Parameters
        ----------
        simulator : Simulator
            Body on which tractions become nodal forces.
        scale : float
            Size of the event in mN.
        base : Load, optional
            Load that acts in addition.

        Returns
        -------
        Load
            Tractions added up where patches share a triangle.
        """
        base = base or Load()
        triangles = np.concatenate([t for t, _ in self.patches])
        traction = np.concatenate([np.broadcast_to(scale * p, (len(t), 3)) for t, p in self.patches])
        if base.traction is not None:
            base_triangles = np.asarray(base.traction[0])
            base_traction = np.broadcast_to(np.asarray(base.traction[1], np.float64), base_triangles.shape)
            triangles = np.concatenate([base_triangles, triangles])
            traction = np.concatenate([base_traction, traction])
        _, first, facet = np.unique(np.sort(triangles, axis=1), axis=0, return_index=True, return_inverse=True)
        total = np.zeros((len(first), 3))
        np.add.at(total, facet.reshape(-1), traction)
        triangles, traction = triangles[first], total
        body_force = scale * self.body_force + (0.0 if base.body_force is None else np.asarray(base.body_force))
        return Load(base.forces, body_force, base.prescribed, (triangles, traction))


def linear_answers(
    simulator: Simulator, events: Sequence[Event], material: Material, *, threads: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return each event's linear displacement, scaled to a largest node displacement of 1 mm, and its size for that.

    Parameters
    ----------
    simulator : Simulator
        Analysed body.
    events : sequence of Event
        Unit events.
    material : Material
        Material of the body.
    threads : int
        Threads to use; 0 takes all cores.

    Returns
    -------
    displacement : ndarray of float64, shape (n_events, n_nodes, 3)
        mm, largest node displacement 1 mm.
    scale : ndarray of float64, shape (n_events,)
        mN that give it.

    Notes
    -----
    Solved by the nonlinear solver under loads that move the body by about 1e-4 of its extent, so that the solution
    is linear to about 1e-4; cost: a few back-substitutions per event.
    """
    extent = simulator.mesh.extent
    force_per_mm = float(np.median(material.young_array)) * extent  # stiffness of a cube of this size, mN/mm
    scale = np.full(len(events), force_per_mm * _SMALL * extent)
    loads = [event.load(simulator, s) for event, s in zip(events, scale, strict=True)]
    found = simulator.solve_many(loads, [material] * len(events), tolerance=1e-4, threads=threads)
    largest = np.linalg.norm(found.displacement, axis=2).max(axis=1)
    lost = ~np.isfinite(largest) | (largest <= 0)
    largest[lost] = np.inf  # such an event gets no load and is counted as failed by its size 0
    displacement = np.where(lost[:, None, None], 0.0, found.displacement) / largest[:, None, None]
    return displacement, scale / largest


def _direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))
