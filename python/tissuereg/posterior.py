"""Moments of the posterior ensemble at nodes, markers and targets, the model's own error included."""

from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.assimilate import Assimilation
from tissuereg.latent.model import LatentModel, error_covariance
from tissuereg.observe import MarkerObservation, TargetObservation

#: Members decoded to full fields at once.
_BATCH = 50


@dataclass(frozen=True, eq=False)
class Posterior:
    """Moments of the posterior ensemble; lengths in mm.

    Attributes
    ----------
    displacement : ndarray of float64, shape (n_nodes, 3)
        Decoded from the mean of the latents.
    std : ndarray of float64, shape (n_nodes,)
        Root of the trace of a node's covariance.
    markers : MarkerObservation
        Attachment of the markers to the mesh.
    marker_mean : ndarray of float64, shape (n_markers, 3)
        Displacement of every marker, seen or not.
    marker_covariance : ndarray of float64, shape (3 n_markers, 3 n_markers)
        Of the ensemble alone.
    marker_error : ndarray of float64, shape (n_markers, 3, 3)
        Covariance of the model's own error.
    target_mean : ndarray of float64, shape (n_targets, 3)
        Displacement of every target.
    target_covariance : ndarray of float64, shape (n_targets, 3, 3)
        Ensemble and the model's own error.
    """

    displacement: FloatArray
    std: FloatArray
    markers: MarkerObservation
    marker_mean: FloatArray
    marker_covariance: FloatArray
    marker_error: FloatArray
    target_mean: FloatArray
    target_covariance: FloatArray

    @classmethod
    def of(
        cls,
        model: LatentModel,
        ensemble: Assimilation,
        markers: MarkerObservation,
        targets: TargetObservation,
    ) -> "Posterior":
        """Return the moments of an ensemble.

        Parameters
        ----------
        model : LatentModel
            Its decoder.
        ensemble : Assimilation
            Posterior latents.
        markers : MarkerObservation
            Markers, seen or not.
        targets : TargetObservation
            Inner points.

        Returns
        -------
        Posterior
            Cost: one full decode per member, in batches.
        """
        latents, factor = ensemble.latents, ensemble.spread_factor
        displacement = model.decode(ensemble.mean[:, None])[0]
        square = np.zeros(model.n_nodes)
        total = np.zeros((model.n_nodes, 3))
        seen, held = [], []
        for first in range(0, latents.shape[1], _BATCH):
            fields = model.decode(latents[:, first : first + _BATCH])
            away = fields - displacement
            square += np.einsum("eni,eni->n", away, away)
            total += away.sum(axis=0)
            seen.append(markers.predict(fields[:, markers.nodes]))
            held.append(targets.predict(fields[:, targets.nodes]))
        n = latents.shape[1]
        variance = factor * np.maximum(square - np.einsum("ni,ni->n", total, total) / n, 0.0) / (n - 1)
        own = model.errors(ensemble.mean)
        variance += np.mean(np.einsum("eni,eni->en", own, own), axis=0) if len(own) else 0.0
        at_markers, at_targets = np.concatenate(seen), np.concatenate(held)
        error_at_targets = _own_errors(targets.predict(own[:, targets.nodes]))
        return cls(
            displacement,
            np.sqrt(variance),
            markers,
            at_markers.mean(axis=0),
            factor * np.atleast_2d(np.cov(at_markers.reshape(n, -1), rowvar=False)),
            _own_errors(markers.predict(own[:, markers.nodes])),
            at_targets.mean(axis=0),
            np.array([factor * np.cov(at_targets[:, t], rowvar=False) for t in range(at_targets.shape[1])]).reshape(
                -1, 3, 3
            )
            + error_at_targets,
        )


def _own_errors(errors: FloatArray) -> FloatArray:
    """Return the covariance (n_points, 3, 3) of errors (n_fields, n_points, 3)."""
    return np.array([error_covariance(errors[:, p]) for p in range(errors.shape[1])]).reshape(-1, 3, 3)
