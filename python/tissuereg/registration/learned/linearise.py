"""Conditioning on the markers with a non-linear decoder, which is linearised repeatedly about the posterior mean."""

from collections.abc import Callable

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.learned.components import Components
from tissuereg.registration.learned.mixture import Component, Conditioned, LinearDecoder, MixturePosterior

#: Neighbours of a point for the decoder's derivatives, in standard deviations of the training set's codes: secants over
#: the region where the posterior lies.
_STEP = 0.2

#: The search ends where the mean moves by less than this share of those standard deviations.
_NEAR = 0.05

#: Pairs of component and scale are ruled out for good by a pass that moves the mean by less than this share of them.
_CLOSE = 0.5

#: Latents (n_latent, n_columns) to displacements at markers and targets (n_columns, n_rows), mm.
Decode = Callable[[FloatArray], FloatArray]


def spread_of(kinds: Components) -> FloatArray:
    """Return the standard deviations (n_latent,), dimensionless, of latents drawn from the Gaussian mixture `kinds`."""
    centre = kinds.weights @ kinds.means
    variance = np.diagonal(kinds.covariances, axis1=1, axis2=2) + (kinds.means - centre) ** 2
    return np.asarray(np.sqrt(kinds.weights @ variance))


def linearised(decode: Decode, point: FloatArray, spread: FloatArray) -> LinearDecoder:
    """Return the decoder, linearised by central differences about a point in latent space.

    `decode` maps latents (n_latent, n_columns) to displacement components (n_columns, n_rows), in mm; `point`
    (n_latent,) is the point; `spread` (n_latent,) are standard deviations of the latents, of which a fixed share is the
    step. Cost: one decode of 2 n_latent + 1 columns.
    """
    steps = _STEP * np.diag(spread)
    columns = np.concatenate([point[:, None], point[:, None] + steps, point[:, None] - steps], axis=1)
    rows = decode(columns)
    n = len(point)
    return LinearDecoder(point, rows[0], np.asarray((rows[1 : n + 1] - rows[n + 1 :]).T / (2.0 * _STEP * spread)))


def conditioned(
    decode: Decode,
    prior: list[Component],
    observed: FloatArray,
    noise: FloatArray,
    start: FloatArray,
    spread: FloatArray,
    passes: int,
) -> tuple[MixturePosterior, LinearDecoder]:
    """Return the posterior displacement of markers and targets, and the linearised decoder from which it was computed.

    `decode` maps latents (n_latent, n_columns) to displacement components at markers, then targets, (n_columns,
    n_rows), in mm; `prior` holds the components of a Gaussian mixture; `observed` (n_obs,) are the measured
    displacements, in mm, of the first n_obs rows; `noise` (n_obs, n_obs) is the covariance of the tracker's noise, in
    mm^2; `start` (n_latent,) is where the decoder is linearised first; `spread` (n_latent,) are standard deviations of
    the training set's latents; `passes` is the largest number of linearisations. Cost: one decode of 2 n_latent + 1
    columns for each linearisation.
    """
    point, logs = start, None
    for left in reversed(range(passes)):
        model = linearised(decode, point, spread)
        found = Conditioned(prior, model, observed, noise, logs)
        moved = float(np.abs((found.mean_latents - point) / spread).max())
        if left == 0 or moved < _NEAR:
            break
        # Evidences far from the answer rule nothing out.
        point, logs = found.mean_latents, found.logs if moved < _CLOSE else None
    return found.posterior(), model
