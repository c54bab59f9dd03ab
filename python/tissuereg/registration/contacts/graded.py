r"""A stiffness that changes across the body, estimated from the markers before contacts are sampled.

Gels, scars and organs with a capsule are softer on one side. The logarithm of Young's modulus is then modelled as that
of the material plus a function that is linear across the body,

    ln E = ln E_0 + sum_a g_a xi_a,      xi_a from -1 to 1 along principal axis a, g_a ~ N(0, s^2).

The rates g maximise the evidence (`tissuereg.registration.contacts.evidence`); fitting stiffness and loads
alternately would oscillate.
"""

from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.registration.contacts.evidence import log_evidence
from tissuereg.registration.contacts.fit import Passes
from tissuereg.registration.contacts.state import RigidMotion

#: Values of `stiffness`.
STIFFNESS = ("believed", "graded")


@dataclass(frozen=True, eq=False)
class Grading:
    """An estimated stiffness that changes along the body: ln E = ln E0 + g . xi at each tet, with Young's modulus E.

    `material`: material with one Young's modulus per tet; `rates` (3,): g, the change of the logarithm from the middle
    of the body to its end along each principal axis; `std` (3,): standard deviations of g; `profiles` (3, n_tets): xi,
    the coordinate of the middle of every tet along each principal axis, from -1 to 1.
    """

    material: Material
    rates: FloatArray
    std: FloatArray
    profiles: FloatArray


def profiles_of(mesh: Mesh) -> FloatArray:
    """Return the coordinates (3, n_tets) of the tets' centroids along the principal axes, -1 to 1 across the body."""
    centred = mesh.nodes - mesh.nodes.mean(axis=0)
    axes = np.linalg.eigh(centred.T @ centred)[1]
    along = mesh.nodes @ axes
    middle, half = 0.5 * (along.max(axis=0) + along.min(axis=0)), 0.5 * np.ptp(along, axis=0)
    return np.asarray(((mesh.nodes[mesh.tets].mean(axis=1) @ axes - middle) / half).T)


def grade(passes: Passes, frame: RigidMotion) -> Grading:
    """Return the stiffness that changes linearly across the body and has the highest evidence times prior.

    `passes`: holds the body, its causes, data and believed material, and counts the work; `frame`: initial rigid motion
    from the body's frame to the tracker's. Cost: about twenty evaluations of the evidence.
    """
    trial = _Trial(passes, frame, profiles_of(passes.columns.body.mesh))
    prior = passes.settings.graded_log_std
    best, value = np.zeros(3), trial.log_evidence(np.zeros(3))
    search = passes.settings.evidence
    std, step = np.full(3, prior), search.first_step * prior
    while step >= search.last_step * prior:
        for axis in range(3):
            best, value, std[axis] = _along(trial, best, value, axis, step)
        step *= 0.5
    return Grading(trial.material(best), best, std, trial.profiles)


@dataclass(frozen=True, eq=False)
class _Trial:
    """Evidence of the data as a function of how the stiffness changes across the body.

    `passes`: the fit, with body, data and believed material; `frame`: initial rigid motion to the tracker's frame;
    `profiles` (3, n_tets): coordinates of the tets along the principal axes, from -1 to 1.
    """

    passes: Passes
    frame: RigidMotion
    profiles: FloatArray

    def material(self, rates: FloatArray) -> Material:
        """Return the material at `rates` (3,) of change of ln E, with Young's modulus E, along the principal axes."""
        return self.passes.material.scaled(np.exp(rates @ self.profiles))

    def log_evidence(self, rates: FloatArray) -> float:
        """Return the logarithm of evidence times prior, up to a constant, for rates of change of the stiffness.

        `rates` (3,): change of ln E from the middle of the body to its end along each principal axis.
        """
        material = self.material(rates)
        trial = replace(self.passes, material=material, columns=self.passes.columns.made_of(material))
        prior = -0.5 * float(np.sum((rates / trial.settings.graded_log_std) ** 2))
        return log_evidence(trial, self.frame) + prior


def _along(trial: _Trial, best: FloatArray, value: float, axis: int, step: float) -> tuple[FloatArray, float, float]:
    """Return the best rates (3,) when one of them is varied, their log evidence, and that rate's standard deviation.

    A rate is the change of ln E (Young's modulus) from the middle of the body to its end along a principal axis.
    `trial`: evaluates the evidence; `best` (3,): rates to start from; `value`: their log evidence; `axis`: which rate
    is varied, 0 to 2; `step`: first step of the search.
    """
    limit = trial.passes.settings.graded_log_std
    found = [(0.0, value)]
    found += [(side, trial.log_evidence(best + side * np.eye(3)[axis])) for side in (-step, step)]
    curvature = (found[1][1] + found[2][1] - 2.0 * value) / step**2
    slope = (found[2][1] - found[1][1]) / (2.0 * step)
    if curvature < 0.0:
        top = float(np.clip(-slope / curvature, -2.0 * step, 2.0 * step))
        found.append((top, trial.log_evidence(best + top * np.eye(3)[axis])))
    shift, highest = max(found, key=lambda one: one[1])
    std = min(limit, float(1.0 / np.sqrt(max(-curvature, 1e-12))))
    return best + shift * np.eye(3)[axis], highest, std


__all__ = ["Grading", "grade", "profiles_of"]
