"""Algorithm 1 of the paper for many pairs at once: they share each call of the decoder.

The update is that of `tissuereg-esmda`, pair by pair. With random draws it is the paper's algorithm; with balanced ones
it is `tissuereg_paper.rivals.assimilation.assimilate`. A registration of the package makes the same steps, in
square-root form and for several ensembles at once.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray
from tissuereg.registration.learned.draws import balanced_draws, spread_factor
from tissuereg.registration.learned.model import Gaussian

#: Each inflation coefficient over the next; the paper only says that they decrease.
DECREASE = 2.0


@dataclass(frozen=True, eq=False)
class Ensembles:
    """Ensembles of many pairs after the last assimilation.

    Attributes
    ----------
    latents : ndarray of float64, shape (n_pairs, n_latent, n_members)
        The members.
    means : ndarray of float64, shape (n_steps, n_pairs, n_latent)
        Mean of the members after each assimilation.
    exact : bool
        Whether all draws were balanced, so that the spread needs no correction for a finite ensemble.
    """

    latents: FloatArray
    means: FloatArray
    exact: bool

    @property
    def spread_factor(self) -> float:
        """Factor on covariances for the finite ensemble, as `Assimilation.spread_factor`."""
        return spread_factor(self.latents.shape[2], exact=self.exact)


def assimilate_many(
    predict: Callable[[FloatArray], FloatArray],
    observed: FloatArray,
    noise: FloatArray,
    priors: Sequence[Gaussian],
    *,
    rngs: Sequence[np.random.Generator],
    n_members: int,
    n_steps: int,
    balanced: bool = False,
) -> Ensembles:
    """Return the ensembles of many pairs.

    Parameters
    ----------
    predict : callable
        Latents (n_latent, n) to predictions (n, n_obs) in mm.
    observed : ndarray of float64, shape (n_pairs, n_obs)
        Displacements of the markers, mm.
    noise : ndarray of float64, shape (n_obs, n_obs)
        Covariance C_d, mm^2.
    priors : sequence of Gaussian
        Prior of every pair.
    rngs : sequence of numpy.random.Generator
        Source of random numbers of every pair.
    n_members, n_steps : int
        N_e and N_a.
    balanced : bool
        Draw with exact sample moments where the ensemble is large enough; the paper draws at random.

    Returns
    -------
    Ensembles
        Cost: ``n_steps`` calls of `predict` with all members of all pairs.
    """
    covariance = _core.Noise.dense(noise)
    exact = balanced

    def drawn(pair: int, rows: int, anomalies: FloatArray) -> FloatArray:
        nonlocal exact
        if not balanced:
            return rngs[pair].standard_normal((rows, n_members))
        draws, whole = balanced_draws(rngs[pair], (rows, n_members), anomalies)
        exact &= whole
        return draws

    n_obs = observed.shape[1]
    none = np.empty((0, n_members))
    latents = np.stack(
        [
            prior.mean[:, None] + np.linalg.cholesky(prior.covariance) @ drawn(pair, len(prior.mean), none)
            for pair, prior in enumerate(priors)
        ]
    )
    means = []
    for alpha in _core.schedule_geometric(n_steps, DECREASE):
        together = np.concatenate(list(latents), axis=1)
        predicted = predict(together).reshape(len(priors), n_members, n_obs)
        for pair, members in enumerate(latents):
            draws = drawn(pair, n_obs, members - members.mean(axis=1, keepdims=True))
            rows = np.ascontiguousarray(predicted[pair].T)
            step = _core.Step(rows, observed[pair], covariance, draws, alpha=float(alpha), threads=1)
            latents[pair] = step.apply(np.ascontiguousarray(members))
        means.append(latents.mean(axis=2))
    return Ensembles(latents, np.stack(means), exact)
