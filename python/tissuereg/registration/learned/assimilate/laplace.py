"""The most probable latents and a Gaussian about them: Gauss-Newton with a Laplace covariance.

`tissuereg-esmda` judges points and solves for steps; the model is evaluated here.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg import _core
from tissuereg._base.arguments import called, maybe, of_kind, real, whole
from tissuereg._base.arrays import FloatArray, float_array, optional_array
from tissuereg.registration.learned.assimilate.ensemble import ABSURD_MM, Assimilation, balanced_draws, noise_of
from tissuereg.registration.learned.model import Gaussian


@dataclass(frozen=True, eq=False)
class Laplace(Gaussian):
    """A Gaussian posterior of latents about the most probable ones, which are its `mean`, with a `covariance`.

    Attributes
    ----------
    root : ndarray of float64, shape (n_latent, n_latent)
        Lower triangular Cholesky factor, ``covariance = root root'``.
    predicted : ndarray of float64, shape (n_obs,)
        Predicted displacements at the mean, mm.
    absorbed : ndarray of float64, shape (n_obs, n_obs)
        Posterior covariance G P G' of the predictions, mm^2, with their derivatives G and the covariance P of the
        latents: the part of the noise that the fit has followed, see
        `tissuereg.registration.wrong_markers.score_markers`.
    misfit : float
        Data and prior terms at the mean; a chi-square of n_obs degrees of freedom if prior and noise are as stated.
    last_step : float
        Length of the next step, which was not taken, in standard deviations of the posterior.
    iterations, evaluations : int
        Number of steps taken, and number of points tried, not counting neighbours for derivatives.
    one_sided : tuple of int
        Numbers of the prior's directions in which the derivative at the mean is one-sided because the model failed on
        the other side.
    """

    root: FloatArray
    predicted: FloatArray
    absorbed: FloatArray
    misfit: float
    last_step: float
    iterations: int
    evaluations: int
    one_sided: tuple[int, ...]

    def draws(self, rng: np.random.Generator, n_members: int) -> FloatArray:
        """Return latents (n_latent, n_members) drawn from the posterior, with exact sample moments if possible."""
        return self.ensemble(rng, n_members).latents

    def ensemble(self, rng: np.random.Generator, n_members: int) -> Assimilation:
        """Return draws from the posterior as the members of an ensemble.

        Parameters
        ----------
        rng : numpy.random.Generator
            The only source of random numbers.
        n_members : int
            Number of draws. With more than ``n_latent + 1`` their mean and covariance are those of the posterior.

        Returns
        -------
        Assimilation
            The draws, of which none is counted as lost.
        """
        shape = (len(self.mean), whole("n_members", n_members))
        normals, exact = balanced_draws(rng, shape, np.empty((0, n_members)))
        return Assimilation(np.asarray(self.mean[:, None] + self.root @ normals), [], exact)


@dataclass(frozen=True)
class SearchSettings:
    """How the most probable latents are sought.

    Parameters
    ----------
    tolerance : float
        The search ends where the next step is shorter than so many standard deviations of the posterior.
    max_evaluations : int
        Largest number of points that may be tried.
    difference : float
        Distance of a point from its neighbours for derivatives, in standard deviations of the prior; 1e-2 suits a
        decoder in float32.

    Raises
    ------
    ArgumentError
        If a value is of the wrong kind or out of its range.
    """

    tolerance: float = 1e-3
    max_evaluations: int = 50
    difference: float = 1e-4

    def __post_init__(self) -> None:
        real("tolerance", self.tolerance, above=0.0)
        whole("max_evaluations", self.max_evaluations, least=1)
        real("difference", self.difference, above=0.0)


def gauss_newton(
    predict: Callable[[FloatArray], FloatArray],
    observed: FloatArray,
    noise: FloatArray | _core.Noise,
    prior: Gaussian,
    *,
    jacobian: Callable[[FloatArray], FloatArray] | None = None,
    start: FloatArray | None = None,
    settings: SearchSettings | None = None,
) -> Laplace:
    """Return the most probable latents given observations, and the Gaussian of the posterior about them.

    Parameters
    ----------
    predict : callable
        Function from latents (n_latent, n_columns) to predictions (n_obs, n_columns) in mm.
    observed : ndarray of float64, shape (n_obs,)
        Measured marker displacements in mm.
    noise : ndarray of float64, shape (n_obs, n_obs), or Noise
        Covariance C_d of the measurement about a perfect model's prediction, mm^2.
    prior : Gaussian
        Prior of the latents.
    jacobian : callable, optional
        Function from latents (n_latent,) to the derivatives (n_obs, n_latent) of the predictions, mm. By default
        central differences along the columns of the prior's Cholesky factor, one call of `predict` with 2 n_latent + 1
        columns each time.
    start : ndarray of float64, shape (n_latent,), optional
        Where the search begins; by default the prior's mean.
    settings : SearchSettings, optional
        Where the search ends, and how far the neighbours of a point for derivatives are.

    Returns
    -------
    Laplace
        The posterior. From a point at which the model fails (not finite, or beyond `ABSURD_MM`) the search steps back;
        where one neighbour of a point fails, the difference to the other is taken.

    Raises
    ------
    ConvergenceError
        If there is no minimum within `max_evaluations`; `report` has ``evaluations``, ``last_step`` and ``tolerance``.
    EnsembleError
        If the model fails at the start, or at both neighbours of a point along one direction.
    NoiseError
        If `noise` is not positive definite.
    ArgumentError
        If the prior's covariance is not positive definite, or `settings` is not a SearchSettings.
    MarkerError
        If `observed` is not finite.
    ShapeError
        If an array, or what `predict` or `jacobian` returns, has another shape.

    Notes
    -----
    Minimises ``(d - g(z))' C_d^-1 (d - g(z)) + (z - m)' C^-1 (z - m)`` over latents z, with observations d, predictions
    g(z) and the prior's mean m and covariance C, by the steps of Levenberg and Marquardt in the metric of the prior,
    undamped where the model is nearly linear; the covariance is ``(C^-1 + G' C_d^-1 G)^-1``, with the derivatives G of
    g. One minimum is found, and its regions are right as far as the model is linear over them. D. S. Oliver, A. C.
    Reynolds and N. Liu, "Inverse theory for petroleum reservoir characterization and history matching", Cambridge
    University Press, 2008, chapter 8.
    """
    called("jacobian", jacobian)
    settings = maybe("settings", settings, SearchSettings) or SearchSettings()
    observed = float_array("observed", observed, (None,))
    mean = float_array("prior.mean", of_kind("prior", prior, Gaussian).mean, (None,))
    search = _core.GaussNewton(
        mean,
        float_array("prior.covariance", prior.covariance, (len(mean), len(mean))),
        observed,
        noise_of(noise, len(observed)),
        start=optional_array("start", start, (len(mean),)),
        tolerance=settings.tolerance,
        max_evaluations=settings.max_evaluations,
        difference=settings.difference,
        largest=ABSURD_MM,
    )
    accepted = 0
    while True:
        point = search.point
        columns = point[:, None] if jacobian is not None else search.stencil
        predicted = float_array("predict(latents)", predict(columns), (len(observed), columns.shape[1]))
        here = np.ascontiguousarray(predicted[:, 0])
        taken, _, misfit, _ = search.evaluate(here)
        if not taken:
            continue
        accepted += 1
        if jacobian is not None:
            slopes = float_array("jacobian(latents)", jacobian(point), (len(observed), len(point)))
            converged, step, one_sided = search.linearise(slopes)
        else:
            converged, step, one_sided = search.linearise_by_differences(predicted)
        if converged:
            break
    mean, root, at_observations = search.posterior()
    return Laplace(
        mean=mean,
        covariance=root @ root.T,
        root=root,
        predicted=here,
        absorbed=at_observations @ at_observations.T,
        misfit=misfit,
        last_step=step,
        iterations=accepted - 1,
        evaluations=search.evaluations,
        one_sided=tuple(one_sided),
    )
