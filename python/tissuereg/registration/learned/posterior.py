"""Moments of the posterior ensemble at nodes, markers and targets, with the model's own error included."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.registration.learned.assimilate import Assimilation
from tissuereg.registration.learned.model import error_covariance
from tissuereg.registration.learned.points import ErrorsAt, PointsAround
from tissuereg.registration.learned.repair import repaired

#: Members decoded to full fields at once.
_BATCH = 50


@dataclass(frozen=True, eq=False)
class Posterior:
    """Moments of the posterior ensemble; lengths in mm.

    `displacement` (n_nodes, 3): displacement decoded from the mean of the latents; inverted tetrahedra are mended
    (`tissuereg.registration.learned.repair`); `ratios` (n_tets,): volume ratio of every tetrahedron, deformed over
    undeformed; `marker_mean` (n_markers, 3): mean displacement of every marker, seen or not; `marker_covariance` (3
    n_markers, 3 n_markers): covariance of the markers' displacement in the ensemble alone, mm^2; `marker_error`
    (n_markers, 3, 3): covariance of the model's own error at every marker, mm^2; `target_mean` (n_targets, 3): mean
    displacement of every target; `target_covariance` (n_targets, 3, 3): covariance of every target's displacement: that
    in the ensemble plus that of the model's own error, mm^2; `std`: returns the root of the trace of every node's
    covariance, (n_nodes,), in mm. Cost: one full decode per member.
    """

    displacement: FloatArray
    ratios: FloatArray
    marker_mean: FloatArray
    marker_covariance: FloatArray
    marker_error: FloatArray
    target_mean: FloatArray
    target_covariance: FloatArray
    std: Callable[[], FloatArray]

    @classmethod
    def of(cls, mesh: Mesh, model: PointsAround, ensemble: Assimilation) -> "Posterior":
        """Return the moments of an ensemble.

        `mesh` is the undeformed body; `model` is the latent model at markers and targets; `ensemble` holds the
        posterior latents. Cost: all members are decoded at markers and targets, and their mean in full.
        """
        factor, mean = ensemble.spread_factor, ensemble.mean
        moved = model.decode(ensemble.latents)
        at_markers, at_targets = model.markers(moved), model.targets(moved)
        displacement, ratios = repaired(mesh, model.latent.decode(mean[:, None])[0])
        own = model.errors(mean)
        n = len(moved)
        return cls(
            displacement,
            ratios,
            at_markers.mean(axis=0),
            factor * np.atleast_2d(np.cov(at_markers.reshape(n, -1), rowvar=False)),
            _own_errors(own.markers),
            at_targets.mean(axis=0),
            factor * _covariances(at_targets) + _own_errors(own.targets),
            lambda: _std(model, ensemble, displacement, own),
        )


def _std(model: PointsAround, ensemble: Assimilation, displacement: FloatArray, own: ErrorsAt) -> FloatArray:
    """Return the root (n_nodes,), in mm, of the trace of every node's covariance, the model's own error included.

    `displacement` (n_nodes, 3) is the mean, in mm; `own` holds the model's own errors.
    """
    latents = ensemble.latents
    square, total = np.zeros(len(displacement)), np.zeros(displacement.shape)
    for first in range(0, latents.shape[1], _BATCH):
        away = model.latent.decode(latents[:, first : first + _BATCH]) - displacement
        square += np.einsum("eni,eni->n", away, away)
        total += away.sum(axis=0)
    n = latents.shape[1]
    variance = ensemble.spread_factor * np.maximum(square - np.einsum("ni,ni->n", total, total) / n, 0.0) / (n - 1)
    return np.asarray(np.sqrt(variance + own.nodes()))


def _covariances(moved: FloatArray) -> FloatArray:
    """Return each point's covariance (n_points, 3, 3), in mm^2, over displacements (n_members, n_points, 3) in mm."""
    away = moved - moved.mean(axis=0)
    return np.asarray(np.einsum("epi,epj->pij", away, away) / (len(moved) - 1))


def _own_errors(errors: FloatArray) -> FloatArray:
    """Return the covariance about zero (n_points, 3, 3), in mm^2, of errors (n_fields, n_points, 3) in mm."""
    return np.array([error_covariance(errors[:, p]) for p in range(errors.shape[1])]).reshape(-1, 3, 3)
