"""Simulate the events of the bench once: `python -m misuse.generate [BODY ...]` -> data/BODY.npz.

A body has 40 events: one or two local pulls or pushes with a patch of 6 to 20 mm radius (largest motion 3 to 25 mm),
own weight in any direction on top of every fourth, own weight alone in every tenth. Stored are places on the free
surface and on the held one, with the outward normal of each, and for each event the displacement of the place itself
and what a marker 1 mm off it moves in addition (its patch tilts).
"""

import sys
from pathlib import Path

import numpy as np

import tissuereg as tr
from misuse.bodies import BODIES
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ConvergenceError
from tissuereg.simulation import Simulator

DATA = Path(__file__).parent / "data"
N_EVENTS, N_PLACES, N_HELD_PLACES = 40, 160, 24
MATERIAL = tr.Material(10.0, 0.45)


def places_on(mesh, triangles, count, rng):
    """Return random places (count, 3) on triangles, by area, with their outward normals."""
    corners = mesh.nodes[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(normal, axis=1)
    rows = rng.choice(len(triangles), count, p=area / area.sum())
    weights = rng.dirichlet((1.0, 1.0, 1.0), count)
    return np.einsum("pc,pcx->px", weights, corners[rows]), normal[rows] / area[rows, None]


def contact(mesh, free, rng):
    """Return nodal forces of unit size (n_nodes, 3): a dome-shaped patch on the free surface, in a random direction."""
    centre = mesh.nodes[rng.choice(free)]
    radius = rng.uniform(6.0, 20.0)
    distance = np.linalg.norm(mesh.nodes[free] - centre, axis=1)
    shape = np.maximum(1.0 - (distance / max(radius, np.sort(distance)[4])) ** 2, 0.0)
    direction = rng.standard_normal(3)
    forces = np.zeros((mesh.n_nodes, 3))
    forces[free] = shape[:, None] * direction / np.linalg.norm(direction)
    return forces / shape.sum()


def loads(mesh, free, number, rng):
    """Return forces (n_nodes, 3) and a body force (3,) whose common size is still to be found."""
    down = rng.standard_normal(3)
    weight = 1e-4 * down / np.linalg.norm(down)
    if number % 10 == 9:
        return np.zeros((mesh.n_nodes, 3)), weight
    forces = contact(mesh, free, rng)
    if rng.random() < 0.5:
        forces += rng.uniform(0.3, 1.0) * contact(mesh, free, rng)
    pull = float(rng.uniform(0.2, 1.0) * 1e-4 * mesh.volumes.sum())
    return pull * forces, weight if number % 4 == 3 else np.zeros(3)


def field(simulator, forces, weight, goal):
    """Return the equilibrium whose largest motion is about `goal` mm, or as near to it as the solver gets."""
    factor, found = 1e-3, None
    for _ in range(8):
        try:
            tried = simulator.solve(
                tr.Load(forces=factor * forces, body_force=factor * weight), MATERIAL, threads=1, tolerance=1e-6
            ).displacement
        except ConvergenceError:
            goal *= 0.7
            factor *= 0.5
            continue
        size = np.linalg.norm(tried, axis=1).max()
        found = tried
        if abs(size - goal) < 0.15 * goal:
            break
        factor *= float(np.clip(goal / size, 0.2, 4.0 if size > 0.2 * goal else 1e6))
    return found


def make(name):
    """Simulate and store the events of one body."""
    rng = np.random.default_rng([22, sum(name.encode())])
    mesh = BODIES[name]()
    held = np.isin(mesh.surface, mesh.fixed_nodes).all(axis=1)
    free = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)
    simulator = Simulator(mesh)
    places, normals = places_on(mesh, mesh.surface[~held], N_PLACES, rng)
    glued, below = places_on(mesh, mesh.surface[held], N_HELD_PLACES, rng)
    names = tuple(str(i) for i in range(N_PLACES))
    on, off = (MarkerObservation(mesh, places + height * normals, names) for height in (0.0, 1.0))
    moved, tilted = [], []
    for number in range(N_EVENTS):
        forces, weight = loads(mesh, free, number, rng)
        u = field(simulator, forces, weight, rng.uniform(3.0, 25.0))
        at_foot = on.predict(u[on.nodes])
        moved.append(at_foot)
        tilted.append(off.predict(u[off.nodes]) - at_foot)
        print(f"{name} {number}: {np.linalg.norm(u, axis=1).max():.1f} mm", flush=True)
    DATA.mkdir(exist_ok=True)
    np.savez_compressed(
        DATA / f"{name}.npz",
        nodes_mm=mesh.nodes.astype(np.float32),
        tets=mesh.tets.astype(np.uint16),
        fixed_nodes=mesh.fixed_nodes.astype(np.uint16),
        place_mm=places.astype(np.float32),
        normal=normals.astype(np.float32),
        held_place_mm=glued.astype(np.float32),
        held_normal=below.astype(np.float32),
        displacement_mm=np.array(moved, np.float32),
        tilt=np.array(tilted, np.float32),
    )


if __name__ == "__main__":
    for body in sys.argv[1:] or BODIES:
        make(body)
