"""A Kalman filter of places and velocities whose covariance is held in vibration modes."""

import numpy as np

from tissuereg._base.arrays import FloatArray


class ModalFilter:
    r"""Covariance of the amplitudes of modes and of their velocities, and the gain of a measurement.

    Let a body take steps of implicit Euler about its rest, ``G = (M + dt^2 K)^-1 M``:

        x' = G (x + dt v) + dt^2 G M^-1 f,      v' = (x' - x) / dt,

    with random nodal forces ``f``, drawn anew every step. In modes ``x = Phi a`` with ``Phi' M Phi = 1`` and
    ``Phi' K Phi = omega^2`` everything is diagonal, ``g = 1 / (1 + dt^2 omega^2)``:

        F = [[g, dt g], [(g - 1) / dt, g]],      Q = s^2 [[dt^4 g^2, dt^3 g^2], [dt^3 g^2, dt^2 g^2]].

    The forces are white over the mass (covariance ``s^2 M``), so that every mode is pushed alike and noise moves
    the body as elasticity has it: slow modes far, fast ones hardly.

    Parameters
    ----------
    squares : ndarray of float64, shape (n_modes,)
        Squared angular frequencies, 1/s^2.
    dt : float
        Time between moments, s.
    force_std : float
        Standard deviation ``s`` of the force on a mode, mm sqrt(kg) / s^2.

    Attributes
    ----------
    covariance : ndarray of float64, shape (2 n_modes, 2 n_modes)
        Of the amplitudes, mm sqrt(kg), then of their velocities.

    Notes
    -----
    A step costs some products of matrices of this size; 5 ms for 100 modes. With as many modes as the body has free
    components the gain is that of the full matrices.
    """

    def __init__(self, squares: FloatArray, dt: float, force_std: float) -> None:
        n = len(squares)
        damping = 1.0 / (1.0 + dt * dt * squares)
        self.n_modes = n
        self._transition: FloatArray = np.zeros((2 * n, 2 * n))
        own = np.arange(n)
        self._transition[own, own] = damping
        self._transition[own, n + own] = dt * damping
        self._transition[n + own, own] = (damping - 1.0) / dt
        self._transition[n + own, n + own] = damping
        reach = np.zeros((2 * n, n))
        reach[own, own] = dt * dt * damping
        reach[n + own, own] = dt * damping
        self._noise: FloatArray = force_std**2 * (reach @ reach.T)
        self.covariance: FloatArray = np.zeros((2 * n, 2 * n))

    def predict(self) -> None:
        """Let one step pass: ``P <- F P F' + Q``."""
        self.covariance = self._transition @ self.covariance @ self._transition.T + self._noise

    def update(
        self, sensitivity: FloatArray, variance: FloatArray, innovation: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Take in a measurement of the places.

        Parameters
        ----------
        sensitivity : ndarray of float64, shape (n_obs, n_modes)
            Measured components over amplitudes, ``H Phi``.
        variance : ndarray of float64, shape (n_obs,)
            Of the noise of each component, mm^2.
        innovation : ndarray of float64, shape (n_obs,)
            Measured minus predicted, mm.

        Returns
        -------
        tuple of ndarray of float64, each of shape (n_modes,)
            Correction of the amplitudes and of their velocities.
        """
        across = self.covariance[:, : self.n_modes] @ sensitivity.T
        total = sensitivity @ across[: self.n_modes] + np.diag(variance)
        gain = np.linalg.solve(total, across.T).T
        left = self.covariance - gain @ across.T
        self.covariance = 0.5 * (left + left.T)
        correction = gain @ innovation
        return correction[: self.n_modes], correction[self.n_modes :]
