"""The interface of a latent model (a decoder from few latents to displacement fields) for registration."""

from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Gaussian:
    """A Gaussian distribution of latents.

    Attributes
    ----------
    mean : ndarray of float64, shape (n_latent,)
        Mean, dimensionless.
    covariance : ndarray of float64, shape (n_latent, n_latent)
        Covariance, symmetric, positive definite, dimensionless.
    """

    mean: FloatArray
    covariance: FloatArray


class LatentModel(Protocol):
    """A low-dimensional family of displacement fields on one mesh, with a prior of its latents and expected errors."""

    @property
    def n_latent(self) -> int:
        """Number of latents."""
        ...

    @property
    def n_nodes(self) -> int:
        """Number of mesh nodes."""
        ...

    @property
    def card(self) -> dict[str, Any]:
        """Entry `model` of a result: facts `kind`, `source`, `members`, `test_error_mm`, `pca26_test_error_mm`."""
        ...

    def errors(self) -> FloatArray:
        """Return the reconstruction errors of fields not used in training: truth minus reconstruction.

        Returns
        -------
        ndarray of float64, shape (n_fields, n_nodes, 3)
            Errors of typical events, mm.
        """
        ...

    def decode(self, latents: FloatArray, nodes: IntArray | None = None) -> FloatArray:
        """Return the displacement fields of latents.

        Parameters
        ----------
        latents : ndarray of float64, shape (n_latent, n_members)
            One column per member, dimensionless.
        nodes : ndarray of int64, shape (k,), optional
            Numbers of the nodes to decode; by default all.

        Returns
        -------
        ndarray of float64, shape (n_members, k, 3)
            Displacements, mm.
        """
        ...

    def prior(self) -> Gaussian:
        """Return the distribution of the latents of all training fields."""
        ...


class Anchored(LatentModel, Protocol):
    """A model of differences from a simulation."""

    @property
    def code(self) -> FloatArray:
        """Latents (n_latent,) that decode to the simulation."""
        ...


@runtime_checkable
class Anchors(Protocol):
    """A model that can be re-centred on a simulation, so that its latents describe differences from the simulation."""

    def around(self, simulation: FloatArray) -> "Anchored":
        """Return the model of differences from a simulation, a displacement (n_nodes, 3) in mm."""
        ...


def rms_displacement(fields: FloatArray) -> FloatArray:
    """Return the root mean square node displacement (n_fields,) of fields (n_fields, n_nodes, 3), mm."""
    return np.asarray(np.sqrt(np.mean(np.sum(fields**2, axis=2), axis=1)))
