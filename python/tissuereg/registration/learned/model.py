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

    def errors(self, latents: FloatArray | None = None) -> FloatArray:
        """Return the expected reconstruction errors: truth minus reconstruction of fields not used in training.

        Parameters
        ----------
        latents : ndarray of float64, shape (n_latent,), optional
            Latents at which the errors are evaluated; by default the errors of a typical event are returned.

        Returns
        -------
        ndarray of float64, shape (n_fields, n_nodes, 3)
            Errors, mm.
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

    def prior(self, simulation: FloatArray | None) -> Gaussian:
        """Return the prior distribution of the latents of the true field, given a simulation.

        Parameters
        ----------
        simulation : ndarray of float64, shape (n_nodes, 3), or None
            Displacement in mm; None gives the distribution of all training fields.

        Returns
        -------
        Gaussian
            Mean and covariance of the latents.
        """
        ...


@runtime_checkable
class Anchors(Protocol):
    """A model that can be re-centred on a simulation, so that its latents describe differences from the simulation."""

    def around(self, simulation: FloatArray) -> LatentModel:
        """Return the model of differences from a simulation, a displacement (n_nodes, 3) in mm.

        At the mean of its prior it decodes to the simulation.
        """
        ...


#: Nodes from which the size of a field is estimated, to a few hundredths of it.
_SAMPLE = 400


def sampled_nodes(n_nodes: int) -> IntArray:
    """Return the numbers, ascending, of a random sample of nodes from which the size of a field is estimated."""
    return np.sort(np.random.default_rng(0).permutation(n_nodes)[:_SAMPLE])


#: Largest ratio of sizes by which errors are scaled: those of a small field do not determine those of much larger ones.
_MOST_SCALING = 3.0


class ScaledErrors:
    """Error fields of fields of known size, which can be scaled in proportion to the size of another field.

    `fields` (n_fields, n_nodes, 3) are the errors, truth minus reconstruction, in mm; `sizes` (n_fields,) are the root
    mean square displacements of the fields that were reconstructed, in mm.
    """

    def __init__(self, fields: Any, sizes: Any) -> None:
        self.fields: FloatArray = np.asarray(fields, dtype=np.float64)
        self.sizes: FloatArray = np.asarray(sizes, dtype=np.float64)

        self._squares: FloatArray | None = None

    def scale(self, size: float | None) -> FloatArray:
        """Return the factor (n_fields,) on each error for a field of root mean square `size` in mm; one for None."""
        if size is None:
            return np.ones(len(self.fields))
        return np.asarray(np.minimum(size / np.maximum(self.sizes, 1e-12), _MOST_SCALING))

    def at(self, size: float | None) -> FloatArray:
        """Return errors (n_fields, n_nodes, 3), mm, for a field of root mean square `size`, mm; unscaled for None."""
        return np.asarray(self.fields * self.scale(size)[:, None, None])

    def mean_square(self, scale: FloatArray) -> FloatArray:
        """Return the mean square length (n_nodes,), in mm^2, of the errors times their factors `scale` (n_fields,)."""
        if self._squares is None:
            self._squares = np.einsum("eni,eni->en", self.fields, self.fields)
        return np.asarray(scale**2 @ self._squares / max(1, len(scale)))


@runtime_checkable
class ScalesErrors(Protocol):
    """A model whose expected errors are given error fields, scaled to the size of the event."""

    def error_law(self, latents: FloatArray | None = None) -> tuple[ScaledErrors, FloatArray]:
        """Return error fields (with the sizes of their events) and the factors (n_fields,) by which to multiply them.

        The factors scale the errors to the field that `latents` (n_latent,) decode to; they are one for None.
        """
        ...


def mean_square(errors: FloatArray) -> FloatArray:
    """Return the mean square length (n_nodes,) of errors (n_fields, n_nodes, 3), mm^2."""
    return np.asarray(np.einsum("eni,eni->n", errors, errors) / max(1, len(errors)))


def rms_displacement(fields: FloatArray) -> FloatArray:
    """Return the root mean square node displacement (n_fields,) of fields (n_fields, n_nodes, 3), mm."""
    return np.asarray(np.sqrt(np.mean(np.sum(fields**2, axis=2), axis=1)))


def error_covariance(rows: FloatArray) -> FloatArray:
    """Return the covariance of reconstruction errors about zero.

    `rows` (n_fields, n_components): errors in mm, one row per field. Result: (n_components, n_components), mm^2; not
    centred, so that a constant error is included.

    Notes
    -----
    With fewer fields than components the sample covariance is singular, and spurious correlations would let the data
    cancel the error. Off-diagonal terms are shrunk by the weight of Ledoit and Wolf's target for a sample of this size,
    ``1 / (1 + n_components / n_fields)``; the diagonal is kept.
    """
    if len(rows) == 0:
        return np.zeros((rows.shape[1], rows.shape[1]))
    covariance = rows.T @ rows / len(rows)
    keep = 1.0 / (1.0 + rows.shape[1] / len(rows))
    return np.asarray(keep * covariance + (1.0 - keep) * np.diag(np.diag(covariance)))
