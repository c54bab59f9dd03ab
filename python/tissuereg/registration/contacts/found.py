"""Contacts on which posterior samples agree: position, size, force and probability."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.registration.contacts.fit import ContactFit
from tissuereg.registration.contacts.settings import ReportSettings


@dataclass(frozen=True, eq=False)
class FoundContact:
    """One place where the body is probably pushed or pulled.

    Attributes
    ----------
    centre_mm : ndarray of float64, shape (3,)
        Centre of the contact on the undeformed surface, in the body's frame, mm.
    radius_mm : float
        Mean radius of its patches (round parts of the surface), mm.
    direction : ndarray of float64, shape (3,)
        Unit vector of the force on the registered body, in the tracker's frame.
    size_mm : float
        Length of the displacement of the surface node nearest to the centre, without the body's rigid motion, mm.
    force_mN : float
        Size of the force at the believed Young's modulus, mN.
    probability : float
        Share of posterior samples that have a contact there, 0 to 1.
    """

    centre_mm: FloatArray
    radius_mm: float
    direction: FloatArray
    size_mm: float
    force_mN: float  # noqa: N815 (the unit's name)
    probability: float

    def to_json(self) -> dict[str, Any]:
        """Return the fields as a dict of plain numbers and lists, with the units in the keys."""
        return {
            "centre_mm": self.centre_mm.tolist(),
            "radius_mm": self.radius_mm,
            "direction": self.direction.tolist(),
            "size_mm": self.size_mm,
            "force_mN": self.force_mN,
            "probability": self.probability,
        }


def find_contacts(fit: ContactFit, settings: ReportSettings) -> tuple[FoundContact, ...]:
    """Return the contacts on which the posterior samples of a fit agree, the most probable first.

    `fit`: the fit with its samples; `settings`: how many contacts, and from which probability on, are listed. Patches
    of all samples are clustered around the most frequent one; a cluster is one contact.
    """
    slots = np.asarray(fit.samples[0])[:, :, 0]
    left = slots >= 0
    found: list[FoundContact] = []
    while len(found) < settings.most_contacts and left.any():
        contact, taken = _next(fit, slots, left)
        left &= ~taken
        if contact.probability < settings.least_probability:
            break
        if contact.force_mN > 0.0:
            found.append(contact)
    return tuple(sorted(found, key=lambda contact: -contact.probability))


def _next(fit: ContactFit, slots: Any, left: BoolArray) -> tuple[FoundContact, BoolArray]:
    """Return the contact around the most frequent patch among samples that remain, and which of them belong to it.

    `fit`: the fit; `slots` int64 (n_samples, n_slots): patch of each contact of each sample, -1 for none; `left` bool,
    same shape: which of them belong to no found contact yet. Second result: bool, same shape.
    """
    patches = fit.columns.body.patches
    count = np.bincount(slots[left], minlength=patches.n_patches)
    # Nearby patches are the same contact: weigh each by all within its radius.
    occurring = np.flatnonzero(count)
    gaps = np.linalg.norm(patches.centres[occurring][:, None] - patches.centres[occurring][None], axis=2)
    reach = np.maximum(patches.radii[occurring][:, None], patches.radii[occurring][None])
    near = gaps <= reach
    members = occurring[near[np.argmax(near @ count[occurring])]]
    taken = left & np.isin(slots, members)
    weights = count[members] / count[members].sum()
    centre = weights @ patches.centres[members]
    radius = float(weights @ patches.radii[members])
    force = fit.state.frame.rotation @ _force(fit, centre, radius)
    size = float(np.linalg.norm(force))
    nodes = fit.columns.body.mesh.surface_nodes
    node = nodes[np.argmin(np.linalg.norm(fit.columns.body.mesh.nodes[nodes] - centre, axis=1))]
    return FoundContact(
        centre,
        radius,
        force / max(size, 1e-300),
        float(np.linalg.norm(fit.state.displacement[node])),
        size,
        float(taken.any(axis=1).mean()),
    ), taken


def _force(fit: ContactFit, centre: FloatArray, radius: float) -> FloatArray:
    """Return the total force (3,), mN, of the estimated load on nodes near a contact, in the body's frame.

    They lie within 1.2 times `radius`, mm, of `centre` (3,), mm.
    """
    columns = fit.columns
    within = np.linalg.norm(columns.body.mesh.nodes - centre, axis=1) <= 1.2 * radius
    loads = columns.load(fit.state.coefficients)
    forces = np.asarray(loads.forces)[: columns.body.mesh.n_nodes]
    return np.asarray(forces[within].sum(axis=0))
