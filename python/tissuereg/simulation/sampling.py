"""Random loads (events) on a body: surface patches pulled or pushed, flat plates pressed in, and body forces.

An event is drawn in two steps. First its *shape*: one to three patches of the free surface, each with a direction, or a
plate, and a share of body force; or a body force alone. Then its *size*, a factor in mN: the load is scaled so that in
the linear solution the largest node displacement has a wanted value. The linear solutions of all events come from one
cheap pass of nearly unloaded solves. Patches near the support and far from it therefore deform the body by similar
amounts.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh, free_triangles
from tissuereg.errors import EnsembleError
from tissuereg.simulation.settings import DATA_SET
from tissuereg.simulation.solve import Simulator


@dataclass(frozen=True)
class EventSettings:
    """Ranges and probabilities from which random loads (events) on a body are drawn.

    Parameters
    ----------
    n_patches : tuple of int
        Smallest and largest number of loaded surface patches of an event.
    radius_share : tuple of float
        Smallest and largest radius of a patch or plate, as a share of the body's largest extent.
    body_force_share : float
        Probability that an event with patches or a plate has a body force as well.
    plate_share : float
        Probability that an event presses in a plate (a flat disc) instead of loading patches.
    gravity_share : float
        Probability that an event consists of a body force alone.
    """

    n_patches: tuple[int, int] = (1, 3)
    radius_share: tuple[float, float] = (0.08, 0.33)
    body_force_share: float = 0.6
    plate_share: float = 0.0
    gravity_share: float = 0.0


class EventSampler:
    """Generator of random loads (events) on one body.

    `mesh`: undeformed body with its held nodes; `settings`: ranges and probabilities of the events, with defaults if
    None; `held_nodes` (n_held,): numbers of the nodes whose boundary triangles are not loaded, by default the node set
    ``fixed`` (a triangle is left out if all three of its nodes are held). Raises `MeshError` if the whole surface is
    held, so that nothing could be loaded.
    """

    def __init__(self, mesh: Mesh, settings: EventSettings | None = None, held_nodes: Any = None) -> None:
        self.mesh = mesh
        self.settings = settings or EventSettings()
        free = free_triangles(mesh, mesh.fixed_nodes if held_nodes is None else held_nodes)
        corners = mesh.nodes[mesh.surface]
        normal = 0.5 * np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        self._triangles = mesh.surface[free]
        self._centres = corners.mean(axis=1)[free]
        self._areas = np.linalg.norm(normal, axis=1)[free]
        self._normals = normal[free] / self._areas[:, None]
        self._volume = float(mesh.volumes.sum())

    def draw(self, rng: np.random.Generator) -> "Event":
        """Return one random event of unit size: a load that still has to be multiplied by a size in mN.

        Per mN of size, each patch has a total force of 0.3 to 1 mN and a plate one of 1 mN; a body force has a total of
        1 mN where it acts alone and of up to 1.5 mN beside them. `rng`: source of random numbers.
        """
        settings = self.settings
        other = settings.plate_share + settings.gravity_share
        kind = rng.random() if other > 0.0 else 1.0
        if kind < settings.gravity_share:
            return Event((), _direction(rng) / self._volume)
        if kind < other:
            plate = self._plate(rng)
            return Event((self.pressed(plate),), self._body_force(rng), (), plate)
        patches: list[Loaded] = []
        drawn: list[Patch] = []
        for _ in range(int(rng.integers(settings.n_patches[0], settings.n_patches[1] + 1))):
            row, radius = self._place(rng)
            centre = self._centres[row]
            rows = np.flatnonzero(np.linalg.norm(self._centres - centre, axis=1) <= radius)
            direction = _direction(rng) * rng.uniform(0.3, 1.0)
            patches.append((self._triangles[rows], direction / self._areas[rows].sum()))
            drawn.append(Patch(centre, radius, direction))
        return Event(tuple(patches), self._body_force(rng), tuple(drawn))

    def pressed(self, plate: "Plate") -> "Loaded":
        """Return the triangles (n, 3) that a plate presses, as node numbers, and the traction (n, 3) in kPa on each.

        The total force is 1 mN. The pressure is that of an elastic foundation: it grows with the depth by which the
        plate overlaps the undeformed surface (K. L. Johnson, Contact Mechanics, 1985, section 4.3); no contact problem
        is solved.
        """
        along = (self._centres - plate.centre) @ plate.direction
        across = np.linalg.norm(self._centres - plate.centre - np.outer(along, plate.direction), axis=1)
        meets = (across <= plate.radius) & (self._normals @ plate.direction < 0.0) & (along <= plate.radius)
        overlap = np.where(meets, along[meets].min(initial=np.inf) + plate.depth - along, 0.0)
        rows = np.flatnonzero(overlap > 0.0)
        share = overlap[rows] / (overlap[rows] * self._areas[rows]).sum()
        return self._triangles[rows], np.outer(share, plate.direction)

    def _plate(self, rng: np.random.Generator) -> "Plate":
        row, radius = self._place(rng)
        tilted = -self._normals[row] + 0.5 * rng.uniform() * _direction(rng)
        depth = radius * rng.uniform(*DATA_SET.depth_share)
        return Plate(self._centres[row], radius, np.asarray(tilted / np.linalg.norm(tilted)), depth)

    def _place(self, rng: np.random.Generator) -> tuple[int, float]:
        """Return the row of a random triangle in the list of free boundary triangles, and a random radius in mm.

        The probability of a triangle is proportional to its area.
        """
        row = int(rng.choice(len(self._areas), p=self._areas / self._areas.sum()))
        return row, self.mesh.extent * rng.uniform(*self.settings.radius_share)

    def _body_force(self, rng: np.random.Generator) -> FloatArray:
        """Return a random body force, shape (3,), in mN/mm^3 per mN of an event's size; zero if the event has none."""
        if rng.random() < self.settings.body_force_share:
            return np.asarray(_direction(rng) * rng.uniform(0.0, 1.5) / self._volume)
        return np.zeros(3)

    def columns(self, events: Sequence["Event"], sizes: FloatArray) -> dict[str, FloatArray]:
        """Return the drawn parameters of events as a table: a dict of arrays with one row per event.

        `events`: events from `draw`; `sizes` (n_events,): factor in mN by which each is multiplied. Result:
        ``patch_centre_mm`` (n_events, p, 3), ``patch_radius_mm`` (n_events, p) and ``patch_force_mN`` (n_events, p, 3),
        where p is the largest number of patches, with NaN where an event has fewer; ``body_force_mN_per_mm3``
        (n_events, 3); and, if plates can be drawn, ``plate_centre_mm`` and ``plate_force_mN`` (n_events, 3),
        ``plate_radius_mm`` and ``plate_depth_mm`` (n_events,), with NaN where an event has no plate.
        """
        shape = (len(events), self.settings.n_patches[1])
        centre, force = np.full((*shape, 3), np.nan), np.full((*shape, 3), np.nan)
        radius = np.full(shape, np.nan)
        for row, (event, size) in enumerate(zip(events, sizes, strict=True)):
            for column, patch in enumerate(event.drawn):
                centre[row, column], radius[row, column] = patch.centre, patch.radius
                force[row, column] = size * patch.force
        weight = np.array([size * event.body_force for event, size in zip(events, sizes, strict=True)])
        columns = {
            "patch_centre_mm": centre,
            "patch_radius_mm": radius,
            "patch_force_mN": force,
            "body_force_mN_per_mm3": weight.reshape(-1, 3),
        }
        if self.settings.plate_share == 0.0:
            return columns
        none = Plate(np.full(3, np.nan), np.nan, np.full(3, np.nan), np.nan)
        plates = [event.plate or none for event in events]
        pushes = [size * plate.direction for plate, size in zip(plates, sizes, strict=True)]
        return columns | {
            "plate_centre_mm": np.array([plate.centre for plate in plates]).reshape(-1, 3),
            "plate_radius_mm": np.array([plate.radius for plate in plates]),
            "plate_depth_mm": np.array([plate.depth for plate in plates]),
            "plate_force_mN": np.array(pushes).reshape(-1, 3),
        }


@dataclass(frozen=True, eq=False)
class Patch:
    """A round part of the surface on which a random load acts.

    `centre` (3,): centre in mm; `radius`: radius in mm; `force` (3,): total force on the patch in mN per mN of the
    event's size.
    """

    centre: FloatArray
    radius: float
    force: FloatArray


@dataclass(frozen=True, eq=False)
class Plate:
    """A rigid flat disc that is pressed into the surface.

    `centre` (3,): centre in mm; `radius`: radius in mm; `direction` (3,): unit vector along which it is pressed in;
    `depth`: depth in mm by which the disc overlaps the undeformed surface at the place that it meets first.
    """

    centre: FloatArray
    radius: float
    direction: FloatArray
    depth: float


#: Triangles, and the traction on all or on each of them, kPa per mN of the event's size.
Loaded = tuple[IntArray, FloatArray]


@dataclass(frozen=True, eq=False)
class Event:
    """A random load of unit size, to be multiplied by a size in mN.

    `patches`: loaded parts of the surface, each a pair of boundary triangles (k, 3), as node numbers, and the traction
    on them, (3,) for all or (k, 3), in kPa per mN of size; `body_force` (3,): mN/mm^3 per mN of size; `drawn`: the
    random patches as drawn, empty for other events; `plate`: the random plate as drawn, None for other events. The last
    two only serve as a record.
    """

    patches: tuple[Loaded, ...]
    body_force: FloatArray
    drawn: tuple[Patch, ...] = ()
    plate: Plate | None = None

    def load(self, simulator: Simulator, scale: float, base: Load | None = None) -> Load:
        """Return the event, multiplied by a size, as a load of body force and tractions, added to another load.

        `simulator`: body under the load; not used, since tractions become nodal forces only in the solve; `scale`: size
        of the event in mN; `base`: load that acts in addition, none by default. Result: where several patches share a
        triangle, their tractions are added up.
        """
        base = base or Load()
        body_force = scale * self.body_force + (0.0 if base.body_force is None else np.asarray(base.body_force))
        if not self.patches:
            return Load(base.forces, body_force, base.prescribed, base.traction)
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
        return Load(base.forces, body_force, base.prescribed, (triangles, traction))


def linear_answers(
    simulator: Simulator, events: Sequence[Event], material: Material, *, threads: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Return each event's displacement in the linear limit, scaled to a maximum of 1 mm, and the event size for it.

    `simulator`: the analysed body; `events`: loads of unit size; `material`: material of the body; `threads`: threads
    to use; 0 takes all cores. Result: `displacement` (n_events, n_nodes, 3), in mm, whose largest node displacement is
    1 mm; `scale` (n_events,), sizes in mN that give it. Both are 0 for an event without equilibrium.

    Notes
    -----
    Solved by the nonlinear solver under loads that move the body by about 1e-4 of its extent, so that the solution is
    linear to about 1e-4; cost: a few back-substitutions per event.
    """
    extent = simulator.mesh.extent
    force_per_mm = float(np.median(material.young_array)) * extent  # stiffness of a cube of this size, mN/mm
    scale = np.full(len(events), force_per_mm * DATA_SET.small * extent)
    loads = [event.load(simulator, s) for event, s in zip(events, scale, strict=True)]
    found = simulator.solve_many(loads, [material] * len(events), tolerance=1e-4, threads=threads)
    largest = np.linalg.norm(found.displacement, axis=2).max(axis=1)
    lost = ~np.isfinite(largest) | (largest <= 0)
    largest[lost] = np.inf  # such an event gets no load and is counted as failed by its size 0
    displacement = np.where(lost[:, None, None], 0.0, found.displacement) / largest[:, None, None]
    return displacement, scale / largest


def random_changes(
    mesh: Mesh,
    material: Material,
    *,
    largest_mm: float,
    n_events: int,
    rng: np.random.Generator,
    held_nodes: Any = None,
    threads: int = 0,
) -> FloatArray:
    """Return displacement fields of the body under random loads, linear about the undeformed shape, in mm.

    `mesh`: undeformed body; `material`: material of the body; `largest_mm`: median of the largest node displacement of
    a field, mm, about which the sizes are log-normal; `n_events`: number of loads drawn; `rng`: source of places,
    directions and sizes; `held_nodes` (n_held,): numbers of the nodes that do not move, by default the node set
    ``fixed``; `threads`: threads to use; 0 takes all cores. Result: (n, n_nodes, 3), one field per load that has an
    equilibrium. Cost: one nearly linear solve per load. Raises `MeshError` or `SupportError` if no part of the surface
    is free, or the body can move freely; `EnsembleError` if fewer than half of the loads, or fewer than four, have an
    equilibrium.
    """
    simulator = Simulator(mesh, held_nodes=held_nodes)
    sampler = EventSampler(mesh, held_nodes=held_nodes)
    fields, scale = linear_answers(simulator, [sampler.draw(rng) for _ in range(n_events)], material, threads=threads)
    fields = fields[scale > 0.0]
    if len(fields) < max(4, n_events // 2):
        message = f"half of {n_events} events or more must find an equilibrium, {len(fields)} did"
        raise EnsembleError(message, where="n_events")
    fields *= largest_mm * np.exp(DATA_SET.size_log_std * rng.standard_normal(len(fields)))[:, None, None]
    return fields


def _direction(rng: np.random.Generator) -> FloatArray:
    vector = rng.standard_normal(3)
    return np.asarray(vector / np.linalg.norm(vector))
