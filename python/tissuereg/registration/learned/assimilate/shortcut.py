"""Predictions of an ensemble that are computed at a few steps only, and extrapolated by regression in between."""

from collections.abc import Callable
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, float_array


class Between:
    """Predictions of an ensemble that are computed at some calls, and extrapolated linearly in latents at the others.

    The slope is the regression of the last computed predictions on their latents, which a step of the smoother uses,
    too. It neglects the curvature of the model between two computations.

    Parameters
    ----------
    predict : callable
        Function from latents (n_latent, n_members) to predictions (n_obs, n_members), mm.
    computed : set of int
        Numbers of the calls, counted from 1, in which `predict` is called.
    latents, predicted : ndarray of float64, shape (n_latent, n_members) and (n_obs, n_members)
        Members whose predictions are known, and these predictions, mm.

    Attributes
    ----------
    n_calls, n_computed : int
        Number of calls so far, and of those in which `predict` was called.
    """

    def __init__(
        self,
        predict: Callable[[FloatArray], FloatArray],
        computed: set[int],
        latents: FloatArray,
        predicted: FloatArray,
    ) -> None:
        self._predict, self._computed = predict, computed
        self._latents, self._predicted = latents, predicted
        self._slope: FloatArray | None = None
        self.n_calls, self.n_computed = 0, 0

    def __call__(self, latents: Any) -> FloatArray:
        """Return predictions (n_obs, n_members), in mm, of latents (n_latent, n_members).

        They are computed also where the number of members has changed since the last call.
        """
        latents = float_array("latents", latents, (len(self._latents), None))
        self.n_calls += 1
        if self.n_calls in self._computed or latents.shape != self._latents.shape:
            self.n_computed += 1
            self._latents, self._predicted, self._slope = latents, self._predict(latents), None
            return self._predicted
        if self._slope is None:
            away = self._latents - self._latents.mean(axis=1, keepdims=True)
            moments = away @ self._predicted.T
            self._slope = np.linalg.lstsq(away @ away.T, moments, rcond=1e-12)[0].T
        return np.asarray(self._predicted + self._slope @ (latents - self._latents))
