"""A linear residual: what the simulation lacks at the markers, as a linear function of what it says there."""

from collections import deque
from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arguments import real, whole
from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.registration.linear_prior import most_probable
from tissuereg_paper.rivals.elastic import LinearElastic, residual_of
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting


class LinearResidual(Rival):
    r"""A Jacobian from the input to the residual, by windowed least squares with forgetting.

    The input x of a moment are the simulated displacements of all markers: whatever the actuators do reaches the body
    as these. The residual of a marker is ``r = J x`` with the Jacobian of the least

        sum_i  w^i |r_i - J x_i|^2 / std^2  +  |J|^2 / q^2

    over the last moments, i moments ago, in which the marker was seen; q^2, the variance expected of an entry of J, is
    the residuals' mean square beyond the noise over the inputs' sum of squares in the window. So a marker that was lost
    still has its residual predicted, and noise is averaged over the window. The method knows nothing between markers;
    its residuals, each with the variance of its prediction, are carried to the nodes by linear elasticity
    (`LinearElastic`) about the simulation.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    window : int
        Moments that are kept: with the default memory, the others have less than a twentieth of the weight.
    memory_s : float
        Time after which the weight of a moment has fallen to 1/e, s: ``w = exp(-frame_s / memory_s)``. By default a
        quarter of a second, in which a push changes little; ten moments at 40 Hz.

    Notes
    -----
    After C. Wang et al., "Offline-online learning of deformation model for cable manipulation with graph neural
    networks", IEEE Robotics and Automation Letters 7, 5544-5551, 2022, where all of a cable is seen and nothing has to
    be carried on.
    """

    name: ClassVar[str] = "linear residual"
    needs: ClassVar[frozenset[str]] = frozenset({"simulation"})
    remembers: ClassVar[bool] = True

    def __init__(self, setting: Setting, *, window: int = 30, memory_s: float = 0.25) -> None:
        super().__init__(setting)
        self._elastic = LinearElastic(setting)
        self._forgetting = float(np.exp(-setting.frame_s / real("memory_s", memory_s, above=0.0, unit="s")))
        self._window: deque[tuple[FloatArray, FloatArray]] = deque(maxlen=whole("window", window, least=1))

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the simulation and the residual carried to the nodes; see `Rival.register`.

        Notes
        -----
        Kept: ``residual_mm`` (n_markers, 3), predicted at all markers, and ``residual_std_mm`` (n_markers,).
        """
        moment = self.moment(measured_mm, simulation_mm)
        body = self._elastic.body
        simulated = body.observed.predict(moment.start_mm[body.observed.nodes])
        residual = np.full_like(simulated, np.nan)
        residual[moment.seen] = residual_of(body, moment)
        self._window.append((simulated.ravel(), residual))
        predicted, std = self._predicted()
        known = np.flatnonzero(std > 0.0)
        change = np.zeros_like(moment.start_mm)
        if len(known):
            change = most_probable(self._elastic.priors, predicted[known], known, std[known])[1].displacement_mm
        return Estimate(moment.start_mm + change, kept={"residual_mm": predicted, "residual_std_mm": std})

    def _predicted(self) -> tuple[FloatArray, FloatArray]:
        """Return the residual (n_markers, 3) of every marker at the last moment, and its standard deviation."""
        inputs = np.stack([one[0] for one in self._window])
        residuals = np.stack([one[1] for one in self._window])
        weights: FloatArray = np.asarray(self._forgetting ** np.arange(len(inputs), dtype=np.float64)[::-1])
        noise = self.setting.std_mm**2
        seen: BoolArray = np.asarray(np.isfinite(residuals).all(axis=2))
        gram = self._ratio(inputs, residuals, seen, weights) * (inputs @ inputs.T)
        predicted, variance = np.zeros(residuals.shape[1:]), np.full(len(noise), gram[-1, -1])
        for marker in np.flatnonzero(seen.any(axis=0)):
            own = np.flatnonzero(seen[:, marker])
            covariance = gram[np.ix_(own, own)] + np.diag(noise[marker] / weights[own])
            gain = np.linalg.solve(covariance, gram[own, -1])
            predicted[marker] = gain @ residuals[own, marker]
            variance[marker] -= gain @ gram[own, -1]
        return predicted, np.sqrt(np.maximum(variance, 0.0))

    def _ratio(self, inputs: FloatArray, residuals: FloatArray, seen: BoolArray, weights: FloatArray) -> float:
        """Return q^2, the variance expected of an entry of the Jacobian."""
        squares = np.where(seen, np.nan_to_num(residuals**2).sum(axis=2) / 3.0 - self.setting.std_mm**2, 0.0)
        of_residuals = max(float(weights @ squares.sum(axis=1)) / float(weights @ seen.sum(axis=1)), 0.0)
        of_inputs = float(weights @ (inputs**2).sum(axis=1)) / float(weights.sum())
        return of_residuals / of_inputs if of_inputs > 0.0 else 0.0
