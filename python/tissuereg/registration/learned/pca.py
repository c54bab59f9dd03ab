"""Principal components as a latent model: the baseline for the network, and a model that is fitted to given fields."""

from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import EnsembleError
from tissuereg.registration.learned.calibration import Calibration
from tissuereg.registration.learned.model import Gaussian


class PcaModel:
    """A latent model of principal components: ``field = centre + sum_q components[q] * z[q]``, with z ~ N(0, I).

    `centre` (n_nodes, 3) is the field at z = 0, in mm; `components` (n_latent, n_nodes, 3) are the components, each
    times its standard deviation, in mm; `error_fields` (n_fields, n_nodes, 3) are truth minus reconstruction of fields
    not used in the fit, in mm; `card` holds the facts for the entry `model` of a result.
    """

    def __init__(
        self,
        centre: FloatArray,
        components: FloatArray,
        error_fields: FloatArray,
        card: dict[str, Any],
    ) -> None:
        self.centre = centre
        self.components = components
        self.error_fields = error_fields
        self.card = card
        self.calibration: Calibration | None = None

    @classmethod
    def fit(
        cls,
        fields: FloatArray,
        held_out: FloatArray,
        *,
        centre: FloatArray,
        n_latent: int,
        card: dict[str, Any],
    ) -> "PcaModel":
        """Return the model of the leading principal components of `fields` about `centre`.

        `fields` (n_members, n_nodes, 3) are displacements in mm; `held_out` (n_test, n_nodes, 3) are fields from which
        the reconstruction error is measured, in mm; `centre` (n_nodes, 3) is the field at z = 0, about which second
        moments are taken, in mm; `n_latent` is the number of components, of which there are fewer if the fields span
        less; `card` holds facts to which `test_error_mm`, the mean Euclidean error of the held-out fields, is added.
        Raises `EnsembleError` if fewer than two fields are given.

        Notes
        -----
        Cost: one eigenvalue problem of size n_members.
        """
        if len(fields) < 2:
            message = f"a prior needs at least two simulated fields, got {len(fields)}"
            raise EnsembleError(message, where="fields")
        rows = (fields - centre).reshape(len(fields), -1)
        values, vectors = np.linalg.eigh(rows @ rows.T / len(rows))
        order = np.argsort(values)[::-1][:n_latent]
        order = order[values[order] > 1e-12 * max(values.max(), 1e-300)]
        # Scaled eigenvectors of the members' Gram matrix give the components with their standard deviation.
        components = vectors[:, order].T @ rows / np.sqrt(len(rows))
        largest = np.abs(components).argmax(axis=1)
        components *= np.sign(components[np.arange(len(components)), largest])[:, None]
        model = cls(centre, components.reshape(-1, *centre.shape), np.empty((0, *centre.shape)), dict(card))
        if len(held_out):
            latents = np.stack([model.encode(field) for field in held_out], axis=1)
            model.error_fields = held_out - model.decode(latents)
            model.card["test_error_mm"] = float(np.linalg.norm(model.error_fields, axis=2).mean())
        return model

    @property
    def n_latent(self) -> int:
        """Number of latents."""
        return len(self.components)

    @property
    def n_nodes(self) -> int:
        """Number of mesh nodes."""
        return len(self.centre)

    def encode(self, field: FloatArray) -> FloatArray:
        """Return the latents of the least-squares reconstruction of a field.

        `field` (n_nodes, 3): displacement in mm. Result: (n_latent,), dimensionless.
        """
        rows = self.components.reshape(self.n_latent, -1)
        return np.asarray((rows @ (field - self.centre).ravel()) / np.einsum("ij,ij->i", rows, rows))

    def codes(self, fields: FloatArray) -> FloatArray:
        """Return the latents (n_fields, n_latent) of least-squares fits to fields (n_fields, n_nodes, 3) in mm."""
        rows = self.components.reshape(self.n_latent, -1)
        away = (np.asarray(fields, np.float64) - self.centre).reshape(len(fields), -1)
        return np.asarray((away @ rows.T) / np.einsum("ij,ij->i", rows, rows))

    def decode(self, latents: FloatArray, nodes: IntArray | None = None) -> FloatArray:
        """Return displacement fields (n_members, k, 3), mm, of latents (n_latent, n_members), at nodes (k,) or all."""
        rows = self.components if nodes is None else self.components[:, nodes]
        centre = self.centre if nodes is None else self.centre[nodes]
        flat = latents.T @ rows.reshape(self.n_latent, -1)
        return np.asarray(centre + flat.reshape(latents.shape[1], *centre.shape))

    def errors(self) -> FloatArray:
        """Return the reconstruction errors (n_fields, n_nodes, 3), in mm, of fields not used in the fit."""
        return self.error_fields

    def prior(self) -> Gaussian:
        """Return the unit Gaussian of the latents."""
        return Gaussian(np.zeros(self.n_latent), np.eye(self.n_latent))
