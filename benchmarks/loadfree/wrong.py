"""A wrong believed load: half its size, turned, and displaced."""

from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from loadfree.events import BODIES, Body, Event, free_surface, true_load
from tissuereg import Load

SIZE, TURN_DEGREES, MOVED_MM = 0.5, 30.0, 12.0

#: A place is taken at random among those whose distance is wrong by no more than this, mm.
SLACK_MM = 1.5


def wrong_load(body: Body, event: Event) -> Load:
    """Return a wrong believed load: every force half as large, turned by 30 degrees, 12 mm away.

    First moments turn and shrink with the forces; so does the weight.
    """
    return true_load(body, replace(event, description=wrong_description(body, event)))


def wrong_description(body: Body, event: Event) -> dict:
    """Return the description of an event by that belief."""
    rng = np.random.default_rng([2213, BODIES.index(event.body), event.number])
    contacts = [_elsewhere(body, contact, rng) for contact in event.description["contacts"]]
    weight = np.asarray(event.description["weight_mN_per_mm3"])
    return event.description | {"contacts": contacts, "weight_mN_per_mm3": SIZE * _turn(weight, rng) @ weight}


def _elsewhere(body: Body, contact: dict, rng: np.random.Generator) -> dict:
    """Return a contact with the wrong force, at another node of the free surface."""
    turn = SIZE * _turn(np.asarray(contact["force_mN"]), rng)
    normals = _nodal_normals(body)
    free = np.flatnonzero(normals @ contact["normal"] > 0.0)  # on the same side of the body
    off = np.abs(np.linalg.norm(body.mesh.nodes[free] - contact["centre"], axis=1) - MOVED_MM)
    node = free[rng.choice(np.flatnonzero(off <= max(SLACK_MM, off.min())))]
    changed = {
        "centre": body.mesh.nodes[node],
        "normal": normals[node],
        "force_mN": turn @ contact["force_mN"],
    }
    if "dipole_mN_mm" in contact:
        changed["dipole_mN_mm"] = turn @ contact["dipole_mN_mm"]
    return contact | changed


def _nodal_normals(body: Body) -> np.ndarray:
    """Return unit normals (n_nodes, 3) of the free surface, zero at other nodes and at held ones."""
    triangles, each = free_surface(body.mesh)
    normals = np.zeros((body.mesh.n_nodes, 3))
    np.add.at(normals, triangles.ravel(), np.repeat(each, 3, axis=0))
    normals[body.mesh.fixed_nodes] = 0.0
    return normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)


def _turn(force: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return a rotation (3, 3) about a random axis across a force; no force: across nothing."""
    axis = rng.normal(size=3)
    axis -= (axis @ force) * force / max(float(force @ force), 1e-300)
    return Rotation.from_rotvec(np.radians(TURN_DEGREES) * axis / np.linalg.norm(axis)).as_matrix()
