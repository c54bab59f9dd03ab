"""The archive of true events: ``data/<body>.npz``, five bodies of forty events."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np

from tissuereg import Load, Mesh

DATA = Path(__file__).parent / "data"
BODIES = ("dome", "phantom", "hole", "slab", "beam")
KINDS = ("traction", "bonded", "sliding", "two", "gravity")

#: Halves by the events' numbers: one to develop on, one that is looked at when all is done.
HALVES = {"dev": (0,), "test": (1,), "both": (0, 1)}


@dataclass(frozen=True, eq=False)
class Body:
    """What a user has of a body, and where markers and targets may be.

    Attributes
    ----------
    name : str
    mesh : Mesh
        Four-node tetrahedra, mm; its set ``fixed`` is the glued base.
    pool : ndarray of float64, shape (n_places, 3)
        Places for markers on the free surface, off nodes, mm.
    targets : ndarray of float64, shape (n_targets, 3)
        Inner points, mm.
    events : tuple of Event
        True events by number.
    """

    name: str
    mesh: Mesh
    pool: np.ndarray
    targets: np.ndarray
    events: tuple


@dataclass(frozen=True, eq=False)
class Event:
    """What truly happened.

    Attributes
    ----------
    body : str
    number : int
    description : dict
        Kind, contacts, model difference, seed: see ``generator/events.py``.
    nodes, pool, targets : ndarray of float64, shape (n, 3)
        True displacements in mm at the user's nodes, the pool and the targets.
    """

    body: str
    number: int
    description: dict
    nodes: np.ndarray
    pool: np.ndarray
    targets: np.ndarray

    @property
    def kind(self) -> str:
        """What acts: see `KINDS`."""
        return self.description["kind"]

    @property
    def centres(self) -> np.ndarray:
        """Centres of the contacts (k, 3), mm."""
        return np.array([contact["centre"] for contact in self.description["contacts"]])


@cache
def read_body(name: str) -> Body:
    """Return a body of the archive with its events."""
    with np.load(DATA / f"{name}.npz") as stored:
        mesh = Mesh(stored["nodes_mm"], stored["tets"], {"fixed": stored["fixed_nodes"]})
        return Body(name, mesh, stored["pool_mm"], stored["targets_mm"], read_events(stored, name))


@cache
def read_set(name: str, of: str) -> Body:
    """Return a body of the archive with the events of a further set, ``supports`` or ``inner``."""
    with np.load(DATA / f"{of}.npz") as stored:
        return replace(read_body(name), events=read_events(stored, name, f"{name}_"))


def read_events(stored: Mapping, name: str, prefix: str = "") -> tuple[Event, ...]:
    """Return a body's events from an open archive whose keys begin with a prefix."""
    descriptions = [json.loads(text) for text in stored[f"{prefix}told"]]
    fields = [stored[f"{prefix}{key}"] * float(stored["step_mm"]) for key in ("nodes", "pool", "targets")]
    return tuple(Event(name, t["event"], t, *arrays) for t, *arrays in zip(descriptions, *fields, strict=True))


def events_of(body: Body, half: str) -> list[Event]:
    """Return the events of one half, or of both."""
    return [event for event in body.events if event.number % 2 in HALVES[half]]


def true_load(body: Body, event: Event) -> Load:
    """Return what a user would believe who knew it all: contacts as smooth dead tractions, and the weight.

    Every contact becomes a traction on the user's nodes: a parabola about its true centre times a linear function, so
    that its total force and its first moments (a pad also turns what it is glued to) are the true ones. Forces are
    those at the believed modulus; the weight is what it is. Events whose archive holds no first moments (numbers 0 to
    10) have them zero about the middle of the patch.
    """
    mesh, description = body.mesh, event.description
    forces = np.zeros((mesh.n_nodes, 3))
    triangles, normals = free_surface(mesh)
    for contact in description["contacts"]:
        spot = _patch(mesh, triangles, normals, contact)
        forces += _spread(spot / spot.sum(), mesh.nodes - np.asarray(contact["centre"]), contact)
    weight = np.asarray(description["weight_mN_per_mm3"])
    return Load(forces=forces, body_force=weight if weight.any() else None)


def free_surface(mesh: Mesh) -> tuple[np.ndarray, np.ndarray]:
    """Return the triangles (n, 3) off the base and their outward normals, as long as their area, mm^2."""
    triangles = mesh.surface[~np.isin(mesh.surface, mesh.fixed_nodes).all(axis=1)]
    corners = mesh.nodes[triangles]
    return triangles, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2


def _spread(spot: np.ndarray, arms: np.ndarray, contact: dict) -> np.ndarray:
    """Return nodal forces (n, 3), `spot` times a linear function of the arms, with a contact's force and moments."""
    force = np.asarray(contact["force_mN"])
    middle = spot @ arms
    arms = arms - middle
    if "dipole_mN_mm" not in contact:
        return spot[:, None] * force
    dipole = np.asarray(contact["dipole_mN_mm"]) - np.outer(force, middle)
    # Across a nearly flat patch there is no arm: that direction is left out.
    slope = dipole @ np.linalg.pinv(arms.T @ (spot[:, None] * arms), rcond=0.05, hermitian=True)
    return spot[:, None] * (force + arms @ slope.T)


def _patch(mesh: Mesh, triangles: np.ndarray, normals: np.ndarray, contact: dict) -> np.ndarray:
    """Return nodal weights (n_nodes,) of a parabola about a contact's centre, wider until it holds three nodes."""
    facing = normals @ np.asarray(contact["normal"]) > 0.3 * np.linalg.norm(normals, axis=1)
    area = np.zeros(mesh.n_nodes)
    np.add.at(area, triangles[facing].ravel(), np.repeat(np.linalg.norm(normals[facing], axis=1) / 3, 3))
    area[mesh.fixed_nodes] = 0.0
    off = np.linalg.norm(mesh.nodes - np.asarray(contact["centre"]), axis=1)
    radius = float(np.sqrt(np.prod(contact["radii"])))
    while True:
        spot = area * np.clip(1.0 - (off / radius) ** 2, 0.0, None)
        if np.count_nonzero(spot) >= 3:
            return spot
        radius *= 1.2
