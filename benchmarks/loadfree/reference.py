"""The reference problems: half ellipsoids pulled or pushed at one patch, solved by other solvers on the same mesh.

Their files are next to the repository (``../shared/reference``). Places of markers and targets are drawn here.
"""

from functools import cache

import numpy as np

from loadfree import wrong
from loadfree.archive import REPOSITORY
from loadfree.bench import Bench
from loadfree.events import Body, Event, free_surface
from loadfree.rivals import Answer, Case, none, registered, rigid, spline
from tissuereg import Material, Mesh

FOLDER = REPOSITORY.parent / "shared" / "reference"
PROBLEMS = ("dome_4k_pull", "dome_4k_push", "dome_4k_pull_nu049", "dome_20k_pull")

#: Draws of markers and noise of each problem.
N_DRAWS = 2

#: Places for markers and targets of each body; markers are at least this share of the extent above the base.
N_POOL, N_TARGETS, ABOVE = 160, 60, 0.05


@cache
def read_reference(name: str) -> Body:
    """Return a reference problem as a body whose events differ by their markers and noise alone."""
    with np.load(FOLDER / f"{name}.npz") as stored:
        nodes, truth, forces = stored["nodes_mm"], stored["displacement_mm"], stored["forces_mN"]
        mesh = Mesh(nodes, stored["tets"], {"fixed": stored["fixed_nodes"]})
        poisson = float(stored["poisson"])
    rng = np.random.default_rng([2213, PROBLEMS.index(name)])
    base = nodes[mesh.fixed_nodes, 2].max()
    high = (nodes[mesh.surface, 2] > base + ABOVE * mesh.extent).all(axis=1)
    pool, at_pool = _inside(rng, mesh.surface[high], nodes, truth, N_POOL)
    targets, at_targets = _inside(rng, mesh.tets, nodes, truth, N_TARGETS)
    description = {
        "kind": "traction",
        "contacts": [_contact(mesh, forces)],
        "weight_mN_per_mm3": [0.0, 0.0, 0.0],
        "difference": None,
        "largest_mm": float(np.linalg.norm(truth, axis=1).max()),
        "poisson": poisson,
    }
    # The bodies of the bench seed markers and noise; these domes stand at its dome's place.
    events = tuple(Event("dome", n, {**description, "event": n}, truth, at_pool, at_targets) for n in range(N_DRAWS))
    return Body(name, mesh, pool, targets, events)


def _contact(mesh: Mesh, forces: np.ndarray) -> dict:
    """Return a dead load on a patch in the form of the bench's contacts."""
    size = np.linalg.norm(forces, axis=1)
    centre = size @ mesh.nodes / size.sum()
    triangles, normals = free_surface(mesh)
    normal = normals[np.isin(triangles, np.flatnonzero(size)).all(axis=1)].sum(axis=0)
    radius = float(np.linalg.norm(mesh.nodes[size > 0.0] - centre, axis=1).max())
    return {
        "centre": centre.tolist(),
        "normal": (normal / np.linalg.norm(normal)).tolist(),
        "force_mN": forces.sum(axis=0).tolist(),
        "radii": [radius, radius],
    }


def _inside(
    rng: np.random.Generator, cells: np.ndarray, nodes: np.ndarray, truth: np.ndarray, count: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return random places (count, 3) inside different cells, and how they move."""
    chosen = cells[rng.choice(len(cells), count, replace=False)]
    weights = rng.dirichlet(np.full(cells.shape[1], 2.0), count)
    return tuple(np.einsum("pc,pcx->px", weights, values[chosen]) for values in (nodes, truth))


def contacts(case: Case) -> Answer:
    """Register with an unknown load, with the problem's Poisson's ratio and elements."""
    return _registered(case)


def wrong_load(case: Case) -> Answer:
    """Register with a wrong believed load: half as large, turned by 30 degrees, 12 mm from its true place."""
    return _registered(case, load=wrong.wrong_load(case.body, case.event))


def _registered(case: Case, **options) -> Answer:
    return registered(case, material=Material(10.0, case.event.description["poisson"]), element="tet4", **options)


REFERENCE = Bench(
    "reference-",
    PROBLEMS,
    read_reference,
    {"contacts": contacts, "wrong_load": wrong_load, "rigid": rigid, "spline": spline, "none": none},
    ("contacts", "wrong_load", "rigid", "spline", "none"),
    ("spread", "random", "near"),
)
