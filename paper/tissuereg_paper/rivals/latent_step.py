"""One update of an ensemble of latents a moment: the ensemble smoother, and the ensemble Kalman filter over time."""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from tissuereg import Markers
from tissuereg._base.arguments import flag, real, whole
from tissuereg._base.arrays import FloatArray
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.registration.learned.assimilate import (
    Assimilation,
    AssimilationSettings,
    FirstEnsemble,
    assimilate,
    balanced_draws,
)
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.points import PointModel, PointsAround
from tissuereg.registration.learned.posterior import Posterior
from tissuereg.registration.learned.widen import stated
from tissuereg_paper.rivals.rival import Estimate, Moment, Rival, Setting


class _OneUpdate(Rival):
    """An ensemble of the latents of the setting's model, updated by all markers of a moment in one step.

    Prior of a moment, noise, and the answer from the posterior ensemble are those of the package's own registration
    with a model that was not calibrated; see `tissuereg.registration.learned.widen.stated` and
    `tissuereg.registration.learned.posterior`.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"model"})

    def __init__(self, setting: Setting, *, n_members: int = 100, spread: bool = False) -> None:
        super().__init__(setting)
        self._n_members = whole("n_members", n_members, least=2)
        self._spread = flag("spread", spread)
        observed = MarkerObservation(setting.mesh, setting.reference_mm, self._markers_of(setting.reference_mm).names)
        assert setting.model is not None  # `Rival` has seen it
        self._points = PointModel(setting.model, observed, TargetObservation(setting.mesh, {}))
        self._n_moments = 0

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the decoded mean of the ensemble; see `Rival.register`.

        Raises
        ------
        EnsembleError
            If too few members survive.

        Notes
        -----
        Kept: ``widened``, the factor on the prior's covariance; ``latents``, the ensemble (n_latent, n_members).
        """
        moment = self.moment(measured_mm, simulation_mm)
        rng = np.random.default_rng([self.setting.seed, 13, self._n_moments])
        self._n_moments += 1
        model = self._points.around(moment.simulation_mm)
        drawn = FirstEnsemble.of(model.prior, rng, self._n_members)
        centre, moved = model.first(drawn.latents)
        believed = stated(
            model,
            self._markers_of(moment.measured_mm),
            moment.seen,
            drawn.latents,
            _rows(model, moved, moment),
            model.markers(centre)[moment.seen].ravel(),
        )
        found = assimilate(
            lambda latents: _rows(model, model.decode(latents), moment),
            moment.displacement_mm.ravel(),
            believed.noise,
            believed.prior,
            rng=rng,
            settings=AssimilationSettings(
                schedule=[1.0], min_members=max(2, self._n_members // 5), threads=self.setting.threads
            ),
            first=self._forecast(believed.prior, rng),
        )
        self._remember(believed.prior, found)
        posterior = Posterior.of(self.setting.mesh, model, found)
        spread = np.repeat(posterior.std()[:, None] / np.sqrt(3.0), 3, axis=1) if self._spread else None
        return Estimate(posterior.displacement, spread, {"widened": believed.factor, "latents": found.latents})

    def _markers_of(self, measured_mm: FloatArray) -> Markers:
        return self.setting.markers(measured_mm)

    @abstractmethod
    def _forecast(self, prior: Gaussian, rng: np.random.Generator) -> FirstEnsemble:
        """Return the ensemble before the update."""

    def _remember(self, prior: Gaussian, found: Assimilation) -> None:
        """Keep what the next moment needs."""


class OneStepSmoother(_OneUpdate):
    r"""The ensemble smoother in the latent space: Algorithm 1 of the paper with one assimilation, ``N_a = 1``.

    ``z += C_zy (C_yy + C_d)^-1 (d + C_d^1/2 e - y)`` of an ensemble drawn about the code of the simulation, each moment
    by itself. Of a linear decoder it is the exact posterior, and more assimilations change nothing.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs, with a model.
    n_members : int
        Ensemble size; the paper takes 100.
    spread : bool
        Whether the spread of all nodes is computed, which takes one full decode a member.

    Notes
    -----
    P. J. van Leeuwen and G. Evensen, "Data assimilation and inverse methods in terms of a probabilistic formulation",
    Monthly Weather Review 124, 2898-2913, 1996.
    """

    name: ClassVar[str] = "one-step ES in latents"

    def _forecast(self, prior: Gaussian, rng: np.random.Generator) -> FirstEnsemble:
        return FirstEnsemble.of(prior, rng, self._n_members)


class LatentFilter(_OneUpdate):
    r"""The ensemble Kalman filter in the latent space: the ensemble of a moment is the forecast of the next.

    What the latents have in excess of the simulation's code, the simulation's error, is carried on: over a moment it
    keeps the share ``phi = exp(-frame_s / memory_s)`` and gains noise of ``1 - phi^2`` times the prior's covariance, so
    that without markers its covariance is that prior. Then one update, as that of the ensemble smoother.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs, with a model.
    memory_s : float
        Time after which an error of the simulation is forgotten, s.
    n_members, spread
        As of `OneStepSmoother`.

    Notes
    -----
    G. Burgers, P. J. van Leeuwen and G. Evensen, "Analysis scheme in the ensemble Kalman filter", Monthly Weather
    Review 126, 1719-1724, 1998. With a `memory_s` far below `Setting.frame_s` it is the one-step smoother.
    """

    name: ClassVar[str] = "EnKF in latents"
    remembers: ClassVar[bool] = True

    def __init__(self, setting: Setting, *, memory_s: float = 0.1, n_members: int = 100, spread: bool = False) -> None:
        super().__init__(setting, n_members=n_members, spread=spread)
        self._kept_share = float(np.exp(-setting.frame_s / real("memory_s", memory_s, above=0.0, unit="s")))
        self._errors: tuple[FloatArray, bool] | None = None

    def _forecast(self, prior: Gaussian, rng: np.random.Generator) -> FirstEnsemble:
        if self._errors is None:
            return FirstEnsemble.of(prior, rng, self._n_members)
        errors, exact = self._errors
        share = self._kept_share
        shape = (len(errors), errors.shape[1])
        draws, balanced = balanced_draws(rng, shape, errors - errors.mean(axis=1, keepdims=True))
        news = np.linalg.cholesky(prior.covariance) @ draws
        latents = prior.mean[:, None] + share * errors + np.sqrt(1.0 - share**2) * news
        return FirstEnsemble(np.ascontiguousarray(latents), exact and balanced)

    def _remember(self, prior: Gaussian, found: Assimilation) -> None:
        self._errors = found.latents - prior.mean[:, None], found.exact_draws


def _rows(model: PointsAround, moved: FloatArray, moment: Moment) -> FloatArray:
    """Return predictions (n_obs, n_members) of the markers seen, from displacements of points."""
    return np.ascontiguousarray(model.markers(moved)[:, moment.seen].reshape(len(moved), -1).T)
