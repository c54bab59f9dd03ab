"""The five bodies: the user's mesh, the finer mesh of the data, places of markers and inner targets.

``python -m loadfree.generator.bodies FOLDER`` makes ``data/meshes/*.npz`` anew; FOLDER holds the reference problems.
The mesher's answer differs from run to run, so the meshes are stored.
"""

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import skfem

from blind.generator.shapes import Shape, boundary_triangles, half_ball, tets_from_bricks, volumes
from loadfree.generator import meshing
from loadfree.generator.places import inner_places, surface_places

DATA = Path(__file__).resolve().parent.parent / "data"
MESHES = DATA / "meshes"
PHANTOM = Path(__file__).resolve().parents[3] / "python" / "tissuereg" / "phantom" / "data"

#: Bodies in the order in which their events are made.
BODIES = ("dome", "phantom", "hole", "slab", "beam")

#: The glued base is where this coordinate is zero.
BASE_AXIS = {"dome": 2, "phantom": 2, "hole": 2, "slab": 0, "beam": 0}

#: Bodies whose data have a curved surface.
SHAPES = {"dome": Shape((60.0, 60.0, 50.0))}

N_PLACES, N_TARGETS = 160, 60


@dataclass(frozen=True)
class Stored:
    """A body as stored; lengths in mm.

    Parameters
    ----------
    nodes_mm, tets, fixed_nodes : ndarray
        The user's mesh of four-node tetrahedra and the nodes of its glued base.
    data_nodes, data_tets : ndarray
        The data's mesh, (3, n) and (4, m), as scikit-fem has them.
    pool_mm, targets_mm : ndarray, shapes (160, 3) and (60, 3)
        Places for markers on the user's surface, off its nodes and off the base; inner points.
    """

    name: str
    nodes_mm: np.ndarray
    tets: np.ndarray
    fixed_nodes: np.ndarray
    data_nodes: np.ndarray
    data_tets: np.ndarray
    pool_mm: np.ndarray
    targets_mm: np.ndarray

    def data_mesh(self, spots=()):
        """Return the data's mesh (skfem), finer under spots: pairs (centre, radius, longest edge)."""
        shape = SHAPES.get(self.name)
        mesh = meshing.refined_near(skfem.MeshTet(self.data_nodes, self.data_tets), self.axis, spots, shape)
        return mesh if shape is None else meshing.curved(mesh, self.axis, shape)

    @property
    def axis(self):
        """The axis whose zero is the plane of the glued base."""
        return BASE_AXIS[self.name]


def read(name):
    """Return a stored body."""
    with np.load(MESHES / f"{name}.npz") as stored:
        return Stored(name, **{key: stored[key] for key in stored.files})


def write(name, reference):
    """Make a body and store it."""
    (nodes, tets, fixed), (data_nodes, data_tets) = MAKERS[name](reference)
    Path("__tracked_surface.stl").unlink(missing_ok=True)  # the mesher leaves it where it runs
    rng = np.random.default_rng([2201, BODIES.index(name)])
    skin = boundary_triangles(tets)
    on_base = np.isin(skin, fixed).all(axis=1)
    gap = 0.05 * np.ptp(nodes, axis=0).max()
    MESHES.mkdir(parents=True, exist_ok=True)
    np.savez_compressed(
        MESHES / f"{name}.npz",
        nodes_mm=nodes,
        tets=tets.astype(np.int32),
        fixed_nodes=fixed.astype(np.int32),
        data_nodes=data_nodes,
        data_tets=data_tets.astype(np.int32),
        pool_mm=surface_places(nodes, skin[~on_base], nodes[fixed], gap, N_PLACES, rng),
        targets_mm=inner_places(nodes, tets, N_TARGETS, rng),
    )


def _plane(nodes, axis):
    return np.flatnonzero(np.abs(nodes[:, axis]) < 1e-6)


def _dome(reference):
    with np.load(reference / "dome_4k_pull.npz") as problem:
        user = problem["nodes_mm"], problem["tets"].astype(int), problem["fixed_nodes"].astype(int)
    corners, bricks = half_ball(8, 4, 3, turn=0.3)
    tets = tets_from_bricks(corners, bricks, np.random.default_rng(5))
    return user, (SHAPES["dome"].in_body(corners).T.copy(), tets.T.copy())


def _phantom(_):
    bodies = []
    for name in ("small-body", "small-truth"):
        with np.load(PHANTOM / f"{name}.npz") as mesh:
            bodies.append((mesh["nodes_mm"].astype(float), mesh["tets"].astype(int), mesh["fixed_nodes"].astype(int)))
    nodes, tets, _ = bodies[1]
    tets = tets.copy()
    turned = volumes(nodes, tets) < 0
    tets[turned] = tets[turned][:, [0, 1, 3, 2]]
    return bodies[0], (nodes.T.copy(), tets.T.copy())


def _hole(_):
    points, triangles = meshing.box_surface([130, 110, 60])
    dome = {
        "operation": "intersection",
        "left": meshing.ball_surface((60, 50, 45)),
        "right": (points - [65, 55, 0], triangles),
    }
    whole = {"operation": "difference", "left": dome, "right": meshing.tube_surface((-1, 2, -8), (13, -3, 52), 12)}
    meshes = [meshing.tidy(*meshing.difference(whole, share), [(2, 0.0)]) for share in (0.033, 0.048)]
    return _two(meshes, 2)


def _slab(_):
    size = (120.0, 90.0, 35.0)
    planes = [(axis, place) for axis in range(3) for place in (0.0, size[axis])]
    user = meshing.tidy(*meshing.filled(*meshing.box_surface(size), 7.0), planes)
    return _two([user, meshing.box_bricks(size, (14, 10, 5), np.random.default_rng(7))], 0)


def _beam(_):
    size = (160.0, 25.0, 25.0)
    planes = [(axis, place) for axis in range(3) for place in (0.0, size[axis])]
    user = meshing.tidy(*meshing.filled(*meshing.box_surface(size), 5.0), planes)
    return _two([user, meshing.box_bricks(size, (32, 5, 5), np.random.default_rng(8))], 0)


def _two(meshes, axis):
    """Return the user's mesh and the data's, the user's held where a coordinate is zero."""
    (nodes, tets), (data, data_tets) = meshes
    return (nodes, tets, _plane(nodes, axis)), (data.T.copy(), data_tets.T.copy())


MAKERS = {"dome": _dome, "phantom": _phantom, "hole": _hole, "slab": _slab, "beam": _beam}

if __name__ == "__main__":
    for each in BODIES:
        write(each, Path(sys.argv[1]))
        body = read(each)
        print(f"{each}: {len(body.nodes_mm)} nodes of the user, {body.data_tets.shape[1]} elements of the data")
