"""The ES-MDA loop for any model: draw, predict, compare, update; Algorithm 1 of the paper, lines 3 to 10.

`tissuereg-esmda` computes the update; random numbers are drawn here, from a generator that the caller passes in.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissuereg import _core
from tissuereg._base.arguments import called, check_choice, check_running, maybe, of_kind, real, whole
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg.errors import ArgumentError, EnsembleError, ScheduleError, ShapeError
from tissuereg.registration.learned.draws import ABSURD_MM, balanced_draws, spread_factor
from tissuereg.registration.learned.model import Gaussian

#: Schedules that have a name.
SCHEDULES = ("geometric",)

#: Forms of a step.
FORMS = ("stochastic", "square_root")

#: Factorisations of a stochastic step.
FACTORISATIONS = ("auto", "cholesky", "qr", "svd")


@dataclass(frozen=True, eq=False)
class StepOptions:
    """How one update of the ensemble is made; an option that would have no effect beside the others is refused.

    Attributes
    ----------
    form : {"stochastic", "square_root"}
        Perturbed observations, or a deterministic transform (ETKF) without draws.
    factorisation : {"auto", "cholesky", "qr", "svd"}
        Factorisation in the stochastic form; it changes rounding only.

    Raises
    ------
    ArgumentError
        If an option is out of its range, or does not go with another one.
    """

    form: str = "stochastic"
    factorisation: str = "auto"

    def __post_init__(self) -> None:
        check_choice("form", self.form, FORMS, ArgumentError)
        check_choice("factorisation", self.factorisation, FACTORISATIONS, ArgumentError)
        if self.factorisation != "auto" and self.form == "square_root":
            message = "`factorisation` must be auto in the square-root form: it takes singular values"
            raise ArgumentError(message, where="factorisation")

    def update(
        self,
        latents: FloatArray,
        predicted: FloatArray,
        observed: FloatArray,
        noise: _core.Noise,
        draws: FloatArray,
        *,
        alpha: float,
        threads: int = 0,
    ) -> FloatArray:
        """Return the latents of the ensemble after one update.

        Parameters
        ----------
        latents : ndarray of float64, shape (n_latent, n_members)
            Members before the step, dimensionless.
        predicted : ndarray of float64, shape (n_obs, n_members)
            Marker displacements that they predict, mm.
        observed : ndarray of float64, shape (n_obs,)
            Measured displacements, mm.
        noise : Noise
            Covariance C_d of the measurements, factored, mm^2.
        draws : ndarray of float64, shape (n_obs, n_members)
            Standard normals, by which observations are perturbed; not read in the square-root form.
        alpha : float
            Inflation coefficient: the factor on C_d in this step.
        threads : int
            Threads of the update; 0 takes all cores.

        Returns
        -------
        ndarray of float64, shape (n_latent, n_members)
            Members after the step.
        """
        if self.form == "square_root":
            step = _core.Step.square_root(predicted, observed, noise, alpha=alpha, threads=threads)
        else:
            step = _core.Step(
                predicted, observed, noise, draws, alpha=alpha, threads=threads, factorisation=self.factorisation
            )
        return step.apply(latents)


@dataclass(frozen=True, eq=False)
class Assimilation:
    """A posterior ensemble of latents.

    Attributes
    ----------
    latents : ndarray of float64, shape (n_latent, n_members)
        Members that survived, dimensionless.
    dropped : list of (int, str)
        Number of each member that was lost, among those of the first ensemble, with the reason.
    exact_draws : bool
        Whether the draws had exact sample moments (`balanced_draws`); otherwise the spread of a small ensemble is too
        narrow.
    alphas : tuple of float
        Inflation coefficients (factors on the covariance of the noise) of the steps made; their inverses sum to one.
    """

    latents: FloatArray
    dropped: list[tuple[int, str]]
    exact_draws: bool
    alphas: tuple[float, ...] = ()

    @property
    def mean(self) -> FloatArray:
        """Mean (n_latent,) of the ensemble's latents, dimensionless."""
        return np.asarray(self.latents.mean(axis=1))

    @property
    def spread_factor(self) -> float:
        """Factor on covariances of the ensemble that corrects for its finite size (`spread_factor`)."""
        return spread_factor(self.latents.shape[1], exact=self.exact_draws)


@dataclass(frozen=True, eq=False)
class FirstEnsemble:
    """An ensemble of latents drawn from a prior, with its predictions where they are known.

    Attributes
    ----------
    latents : ndarray of float64, shape (n_latent, n_members)
        Draws, one column for each member.
    exact : bool
        Whether their sample mean and covariance are those of the prior (`balanced_draws`).
    predicted : ndarray of float64, shape (n_obs, n_members), or None
        Marker displacements that the draws predict, mm; None if they are not known.
    """

    latents: FloatArray
    exact: bool
    predicted: FloatArray | None = None

    @classmethod
    def of(cls, prior: Gaussian, rng: np.random.Generator, n_members: int) -> "FirstEnsemble":
        """Return `n_members` draws from a prior; raise ArgumentError if its covariance is not positive definite."""
        return cls.about(prior, *balanced_draws(rng, (len(prior.mean), n_members), np.empty((0, n_members))))

    @classmethod
    def about(cls, prior: Gaussian, draws: FloatArray, exact: bool) -> "FirstEnsemble":
        """Return the ensemble with the mean and covariance of a prior from standard normal draws (n_latent, n_members).

        `exact` says whether the sample mean and covariance of the draws are exact.
        """
        return cls(np.asarray(prior.mean[:, None] + _root_of(prior) @ draws), exact)


@dataclass(frozen=True, eq=False)
class AssimilationSettings:
    """Ensemble size, inflation schedule and steps of an assimilation by ES-MDA.

    Parameters
    ----------
    n_members, n_steps : int
        Ensemble size N_e and number of assimilations N_a of a geometric schedule.
    schedule : {"geometric"} or sequence of float
        Inflation coefficients: each `decrease` times smaller than the one before, or the coefficients themselves.
    decrease : float
        Ratio of each inflation coefficient to the next in a geometric schedule, in which their inverses sum to one.
    options : StepOptions
        Form and factorisation of a step.
    min_members : int
        Least number of surviving members; with fewer than this, or than two, an error is raised.
    threads : int
        Threads of the update, 0 for all cores; the result does not depend on it.

    Raises
    ------
    ScheduleError
        If `schedule` is no known word, or the inverses of its coefficients do not sum to one.
    ArgumentError, ShapeError
        If another value is of the wrong kind or out of its range.
    """

    n_members: int = 200
    n_steps: int = 5
    schedule: str | Sequence[float] = "geometric"
    decrease: float = 2.0
    options: StepOptions = field(default_factory=StepOptions)
    min_members: int = 20
    threads: int = 0

    def __post_init__(self) -> None:
        check_running(threads=self.threads)
        whole("n_members", self.n_members, least=1)
        whole("min_members", self.min_members)
        of_kind("options", self.options, StepOptions)
        self.coefficients()

    def coefficients(self) -> tuple[float, ...]:
        """Return the inflation coefficients (factors on the noise's covariance) of all steps; inverses sum to one."""
        if not isinstance(self.schedule, str):
            return tuple(map(float, _core.check_schedule(float_array("schedule", self.schedule, (None,)))))
        check_choice("schedule", self.schedule, SCHEDULES, ScheduleError)
        whole("n_steps", self.n_steps, least=1, error=ScheduleError)
        real("decrease", self.decrease, above=0.0, error=ScheduleError)
        return tuple(map(float, _core.schedule_geometric(self.n_steps, self.decrease)))


def assimilate(
    predict: Callable[[FloatArray], FloatArray],
    observed: FloatArray,
    noise: FloatArray | _core.Noise,
    prior: Gaussian,
    *,
    rng: np.random.Generator,
    settings: AssimilationSettings | None = None,
    perturbations: Callable[[int, tuple[int, int]], FloatArray] | None = None,
    first: FirstEnsemble | None = None,
) -> Assimilation:
    """Return the posterior ensemble of the latents given observations.

    Parameters
    ----------
    predict : callable
        Function from latents (n_latent, n_members) to predictions (n_obs, n_members) in mm; float32 is converted.
    observed : ndarray of float64, shape (n_obs,)
        Measured marker displacements in mm.
    noise : ndarray of float64, shape (n_obs, n_obs), or Noise
        Covariance C_d of the measurement about a perfect model's prediction, mm^2.
    prior : Gaussian
        Prior of the latents.
    rng : numpy.random.Generator
        The only source of random numbers.
    settings : AssimilationSettings, optional
        Ensemble size, inflation schedule and steps.
    perturbations : callable, optional
        Function from step number (from 0) and shape (n_obs, n_members) to standard normal draws of that shape, in place
        of `balanced_draws`; stochastic form only.
    first : FirstEnsemble, optional
        Draws from the prior, in place of `n_members` made here; with their predictions the first step decodes nothing.

    Returns
    -------
    Assimilation
        The ensemble after the last update.

    Raises
    ------
    EnsembleError
        If fewer than `min_members` members survive.
    NoiseError
        If `noise` is not positive definite.
    MarkerError
        If `observed` is not finite.
    ShapeError
        If an array, or what `predict` or `perturbations` returns, has another shape.
    ArgumentError
        If another argument is of the wrong kind or out of its range, or the prior's covariance is not positive
        definite.

    Notes
    -----
    Each step adds ``C_zy (C_yy + a C_d)^-1 (d + sqrt(a) C_d^1/2 e - y)`` to each member's latents z, with its
    prediction y, ensemble covariances C_zy and C_yy, observations d, inflation coefficient a and normal draws e: A. A.
    Emerick and A. C. Reynolds, "Ensemble smoother with multiple data assimilation", Computers & Geosciences 55, 3-15,
    2013, doi:10.1016/j.cageo.2012.03.011.
    """
    observed = float_array("observed", observed, (None,))
    covariance = noise_of(noise, len(observed))
    of_kind("prior", prior, Gaussian)
    of_kind("rng", rng, np.random.Generator)
    settings = maybe("settings", settings, AssimilationSettings) or AssimilationSettings()
    options, fewest = settings.options, max(settings.min_members, 2)
    called("perturbations", perturbations)
    if perturbations is not None and options.form == "square_root":
        message = "`perturbations` must be None in the square-root form, which draws none"
        raise ArgumentError(message, where="perturbations")
    alphas = settings.coefficients()
    first = maybe("first", first, FirstEnsemble) or FirstEnsemble.of(prior, rng, settings.n_members)
    latents, balanced, known = (
        float_array("first.latents", first.latents, (len(prior.mean), None)),
        first.exact,
        first.predicted,
    )
    n_members = latents.shape[1]
    members = np.arange(n_members)
    dropped: list[tuple[int, str]] = []
    for step, alpha in enumerate(alphas):
        given, known = predict(latents) if known is None else known, None
        predicted = float_array("predict(latents)", given, (len(observed), latents.shape[1]))
        kept, lost = _core.screen_members(predicted, ABSURD_MM)
        dropped += [(int(members[index]), reason) for index, reason in lost]
        if len(kept) < fewest:
            message = f"at least {fewest} ensemble members must survive, {len(kept)} of {n_members} are left"
            raise EnsembleError(message, dropped=dropped)
        members, latents, predicted = (
            members[kept],
            np.ascontiguousarray(latents[:, kept]),
            np.ascontiguousarray(predicted[:, kept]),
        )
        if options.form == "square_root":
            draws, exact = np.empty((0, len(kept))), True
        elif perturbations is None:
            draws, exact = balanced_draws(rng, predicted.shape, latents - latents.mean(axis=1, keepdims=True))
        else:
            wanted = (predicted.shape[0], predicted.shape[1])
            draws, exact = float_array("perturbations", perturbations(step, wanted), wanted), False
        balanced &= exact
        latents = options.update(latents, predicted, observed, covariance, draws, alpha=alpha, threads=settings.threads)
    return Assimilation(latents, dropped, balanced, alphas)


def noise_of(noise: FloatArray | _core.Noise, n_obs: int) -> _core.Noise:
    """Return the covariance (n_obs, n_obs) of the noise, in mm^2, factored; raise ShapeError if it has another size."""
    if isinstance(noise, _core.Noise):
        if noise.n_obs != n_obs:
            message = f"`noise` must be that of {n_obs} observations, got {noise.n_obs}"
            raise ShapeError(message, where="noise")
        return noise
    return _core.Noise.dense(float_array("noise", noise, (n_obs, n_obs)))


def _root_of(prior: Gaussian) -> FloatArray:
    try:
        return np.asarray(np.linalg.cholesky(prior.covariance))
    except np.linalg.LinAlgError as error:
        message = "the covariance of `prior` must be positive definite; it has no Cholesky factor"
        raise ArgumentError(message, where="prior") from error
