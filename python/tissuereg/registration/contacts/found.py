"""Contacts on which posterior samples agree: position, size, force and probability."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg._base.shown import short_repr
from tissuereg.registration.contacts.fit import ContactFit
from tissuereg.registration.contacts.settings import ReportSettings

#: Share of the posterior draws that may disagree where it is known whether a contact pulls or pushes.
_DOUBTED = 0.05


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
        Share of posterior samples that have a contact somewhere there, 0 to 1; `place_std_mm` says how far that is.
    place_std_mm : float
        Root mean square distance of the contact's place from the centre, mm: over the posterior samples, and over the
        patch of each, anywhere on which a smaller contact does nearly the same.
    pull_probability : float
        Share of posterior draws with a contact there in which it pulls, along the outward normal, 0 to 1.
    """

    centre_mm: FloatArray
    radius_mm: float
    direction: FloatArray
    size_mm: float
    force_mN: float  # noqa: N815 (the unit's name)
    probability: float
    place_std_mm: float = 0.0
    pull_probability: float = 0.5

    __repr__ = short_repr

    @property
    def sense(self) -> str:
        """Word for what it does, "pull" or "push" where nearly all draws agree, else "pull or push"."""
        if min(self.pull_probability, 1.0 - self.pull_probability) > _DOUBTED:
            return "pull or push"
        return "pull" if self.pull_probability > 0.5 else "push"

    def to_json(self) -> dict[str, Any]:
        """Return the fields as a dict of plain numbers and lists, with the units in the keys."""
        return {
            "centre_mm": self.centre_mm.tolist(),
            "radius_mm": self.radius_mm,
            "direction": self.direction.tolist(),
            "size_mm": self.size_mm,
            "force_mN": self.force_mN,
            "probability": self.probability,
            "place_std_mm": self.place_std_mm,
            "pull_probability": self.pull_probability,
        }


def find_contacts(fit: ContactFit, settings: ReportSettings, drawn: FloatArray) -> tuple[FoundContact, ...]:
    """Return the contacts on which the posterior samples of a fit agree, the most probable first.

    `fit`: the fit with its samples; `settings`: how many contacts, and from which probability on, are listed; `drawn`
    (n_samples, n_columns): coefficients of the causes drawn from the posterior, one draw a sample, mm. Patches of all
    samples are clustered around the most frequent one; a cluster is one contact.
    """
    slots = np.asarray(fit.samples[0])[:, :, 0]
    left = slots >= 0
    found: list[FoundContact] = []
    while len(found) < settings.most_contacts and left.any():
        contact, taken = _next(fit, slots, left, drawn)
        left &= ~taken
        if contact.probability < settings.least_probability:
            break
        if contact.force_mN > 0.0:
            found.append(contact)
    return tuple(sorted(found, key=lambda contact: -contact.probability))


def _next(fit: ContactFit, slots: Any, left: BoolArray, drawn: FloatArray) -> tuple[FoundContact, BoolArray]:
    """Return the contact around the most frequent patch among samples that remain, and which of them belong to it.

    `fit`: the fit; `slots` int64 (n_samples, n_slots): patch of each contact of each sample, -1 for none; `left` bool,
    same shape: which of them belong to no found contact yet; `drawn`: as in `find_contacts`. Second
    result: bool, same shape.
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
    apart = ((patches.centres[members] - centre) ** 2).sum(axis=1) + 0.5 * patches.radii[members] ** 2
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
        float(np.sqrt(weights @ apart)),
        _pulls(patches.normals, slots, taken, drawn),
    ), taken


def _pulls(normals: FloatArray, slots: Any, taken: BoolArray, drawn: FloatArray) -> float:
    """Return the share of the samples with a contact in `taken` whose drawn coefficients there point outwards.

    `normals` (n_patches, 3): outward normals; `slots`, `taken` (n_samples, n_slots): as in `_next`; `drawn`: as in
    `find_contacts`.
    """
    patch = np.where(taken, slots, 0)
    along = (drawn[:, : 3 * len(normals)].reshape(len(drawn), -1, 3) * normals).sum(axis=2)
    outward = np.where(taken, np.take_along_axis(along, patch, axis=1), 0.0).sum(axis=1)
    return float((outward[taken.any(axis=1)] > 0.0).mean())


def _force(fit: ContactFit, centre: FloatArray, radius: float) -> FloatArray:
    """Return the total force (3,), mN, of the estimated load on nodes near a contact, in the body's frame.

    They lie within 1.2 times `radius`, mm, of `centre` (3,), mm.
    """
    columns = fit.columns
    within = np.linalg.norm(columns.body.mesh.nodes - centre, axis=1) <= 1.2 * radius
    loads = columns.load(fit.state.coefficients)
    forces = np.asarray(loads.forces)[: columns.body.mesh.n_nodes]
    return np.asarray(forces[within].sum(axis=0))
