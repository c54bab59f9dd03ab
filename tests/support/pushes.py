"""A slab pushed at one patch of the dictionary, and its markers."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

import tissuereg as tr
from support.meshes import block
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.contacts.body import ContactBody
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.registration.contacts.supports import Supports

#: Settings of solves that are subtracted from each other.
TIGHT = {"tolerance": 1e-12, "method": "newton"}

#: Material of the body.
MATERIAL = tr.Material(8.0, 0.4)

NOTHING = {"forces": None, "body_force": None, "prescribed": None}

#: Elements of the truth and of registrations of it: other elements would have another stiffness.
ELEMENT = "tet4"

#: How far the patch is pushed, mm.
PUSH = np.array([1.0, 0.5, -4.0])


@lru_cache
def body(held: str = "sure") -> ContactBody:
    """Return a slab of 405 nodes, held at the base for sure, perhaps, half for sure (``"partly"``), or not at all."""
    mesh = block((60.0, 60.0, 24.0), (8, 8, 4))
    if held == "partly":
        fixed = mesh.fixed_nodes
        perhaps = fixed[mesh.nodes[fixed, 0] > 30.0]
        mesh = mesh.with_node_set("fixed", np.setdiff1d(fixed, perhaps)).with_node_set("perhaps_fixed", perhaps)
    return ContactBody.of(mesh, Supports.of(mesh, "sure" if held == "partly" else held))


def columns_of(held: str = "sure", believed=None) -> Columns:
    """Return the columns of the body under a believed load."""
    return Columns.of(body(held), MATERIAL, {**NOTHING, **(believed or {})}, ContactSettings())


@dataclass(frozen=True, eq=False)
class Push:
    """One patch pushed: the truth and its markers."""

    mesh: tr.Mesh
    patch: int
    centre: np.ndarray
    radius: float
    force: np.ndarray
    displacement: np.ndarray
    nodes: np.ndarray

    def markers(self, std: float = 0.03, *, seed: int = 0, off: float = 0.0) -> tr.Markers:
        """Return the markers with noise, those on the top `off` mm above it."""
        reference = self.mesh.nodes[self.nodes].copy()
        reference[:, 2] += off * (reference[:, 2] == 24.0)
        observed = MarkerObservation.of(self.mesh, tr.Markers(reference, reference))
        moved = observed.predict(self.displacement[observed.nodes])
        noise = std * np.random.default_rng(seed).standard_normal(reference.shape)
        return tr.Markers(reference, reference + moved + noise, std)

    def limit(self, markers: tr.Markers) -> float:
        """Return the allowed rms distance of registered markers, mm: noise of the tracker, and 2 % of their motion."""
        moved = np.linalg.norm(markers.displacement, axis=1)
        return 1.5 * float(np.sqrt(3.0 * np.mean(markers.std**2 + (0.02 * moved) ** 2)))

    def errors(self, result) -> np.ndarray:
        """Return the error of every node, mm."""
        return np.linalg.norm(result.displacement - self.displacement, axis=1)


@lru_cache
def push() -> Push:
    """Return a push on the top, away from its middle, with 16 markers on the top and the sides."""
    columns = columns_of()
    mesh, patches = columns.body.mesh, columns.body.patches
    top = np.flatnonzero(patches.normals[:, 2] > 0.9)
    wanted = np.abs(patches.centres[top] - [22.0, 37.0, 24.0]).sum(axis=1) + 20.0 * np.abs(patches.level[top] - 1)
    patch = int(top[np.argmin(wanted)])
    coefficients = np.zeros(columns.n_columns)
    coefficients[3 * patch : 3 * patch + 3] = PUSH
    load = columns.load(coefficients)
    found = columns.body.simulator.solve(load, MATERIAL, tolerance=1e-10)
    surface = mesh.surface_nodes[mesh.nodes[mesh.surface_nodes, 2] > 6.0]
    # Four near the push, twelve anywhere.
    gaps = np.linalg.norm(mesh.nodes[surface] - patches.centres[patch], axis=1)
    near = surface[np.argsort(np.abs(gaps - patches.radii[patch]))[:4]]
    others = np.random.default_rng(4).choice(np.setdiff1d(surface, near), 12, replace=False)
    nodes = np.sort(np.concatenate([near, others]))
    force = np.asarray(load.forces).sum(axis=0)
    return Push(mesh, patch, patches.centres[patch], float(patches.radii[patch]), force, found.displacement, nodes)
