"""Whitening of residuals by the noise covariance, with or without a generic misfit.

The generic misfit is a Gaussian process in strain, progress and rate, common to all curves of a mode, whose standard
deviation is `share` times the stress. In the eigenvectors U of its covariance, whitened by the noise, with eigenvalues
Lambda, the whitening for any share is a division:

    C(share) = L U (1 + share^2 Lambda) U^T L^T,      L L^T = noise
"""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.diagnosis.material.data import Data
from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings


@dataclass(frozen=True, eq=False)
class Weights:
    """Whitening of measured stresses, for any size of a generic misfit (a smooth Gaussian process).

    With noise covariance ``L L^T`` and generic covariance G, ``L^-1 G L^-T = U Lambda U^T``, an eigendecomposition.

    Attributes
    ----------
    whitener : ndarray of float64, shape (n, n)
        ``U^T L^-1``, 1/kPa.
    spectrum : ndarray of float64, shape (n,)
        Diagonal of ``Lambda``.
    """

    whitener: FloatArray
    spectrum: FloatArray

    def whitened(self, residual: FloatArray, share: float = 0.0) -> FloatArray:
        """Return whitened residuals.

        Parameters
        ----------
        residual : ndarray of float64, shape (n,) or (n, k)
            Measured minus modelled stresses, kPa.
        share : float
            Size of the generic misfit over the stress.

        Returns
        -------
        ndarray of float64, of that shape
            Residuals over their standard deviations and without correlation, dimensionless.
        """
        turned = self.whitener @ residual
        size = np.sqrt(1.0 + share**2 * self.spectrum)
        return np.asarray(turned / (size if turned.ndim == 1 else size[:, None]))

    def log_size(self, share: float) -> float:
        """Return half the log of the determinant of noise plus generic covariance (size `share`) over that of noise."""
        return 0.5 * float(np.log1p(share**2 * self.spectrum).sum())


def weights_of(noise: FloatArray, generic: FloatArray) -> Weights:
    """Return the whitening for a noise covariance and the covariance of a generic misfit.

    `noise`, `generic` (n, n): kPa^2; `generic` for a misfit of size 1 over the stress. It costs one Cholesky factor and
    one eigenvalue problem.
    """
    factor = np.linalg.cholesky(noise)
    inverse = np.linalg.inv(factor)
    spectrum, vectors = np.linalg.eigh(inverse @ generic @ inverse.T)
    return Weights(vectors.T @ inverse, np.maximum(spectrum, 0.0))


def generic_covariance(data: Data, settings: MaterialSettings = DEFAULT.material) -> FloatArray:
    """Return the covariance, shape (n, n), kPa^2, of a generic misfit of size 1 over the stress at the n rows."""

    def near(values: FloatArray, length: float) -> FloatArray:
        return np.asarray(np.exp(-0.5 * ((values[:, None] - values[None, :]) / length) ** 2))

    modes = np.array(data.modes)
    path = 0.7 * near(data.arc, settings.misfit_arc) + 0.3 * near(data.arc, settings.misfit_short_arc)
    alike = near(data.strain, settings.misfit_strain) * path * near(data.log_rate, settings.misfit_rate)
    alike = (1.0 - settings.rough) * alike * (modes[:, None] == modes[None, :]) + settings.rough * np.eye(len(modes))
    return np.asarray(np.outer(data.level, data.level) * alike)


def patched(
    noise: FloatArray, generic: FloatArray, share: float, known: IntArray, left_out: IntArray, residual: FloatArray
) -> FloatArray:
    """Return the posterior mean of a generic misfit at some rows, given the residual at others.

    `noise`, `generic` (n, n): covariances, kPa^2; `share`: size of the misfit over the stress; `known`, `left_out`:
    indices of the rows with and without a residual; `residual` (n_known,): measured minus modelled there, kPa. Result:
    (n_left_out,), to be added to the model, kPa.
    """
    own = noise[np.ix_(known, known)] + share**2 * generic[np.ix_(known, known)]
    across = share**2 * generic[np.ix_(left_out, known)]
    return np.asarray(across @ np.linalg.solve(own, residual))


def block(matrix: FloatArray, rows: IntArray) -> FloatArray:
    """Return the submatrix (k, k) of the rows and columns with the indices `rows` (k,)."""
    return np.asarray(matrix[np.ix_(rows, rows)])
