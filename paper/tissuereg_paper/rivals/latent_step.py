"""One update of an ensemble of latents a moment: the ensemble smoother, and the ensemble Kalman filter over time."""

from abc import abstractmethod
from functools import cached_property
from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arguments import flag, real, whole
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.registration.learned.draws import balanced_draws
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.points import PointModel, PointsAround
from tissuereg.registration.learned.repair import repaired
from tissuereg_paper.latents import LinearPredictions, error_covariance, errors_of, prior_of, widened
from tissuereg_paper.rivals.assimilation import (
    Assimilation,
    AssimilationSettings,
    FirstEnsemble,
    assimilate,
)
from tissuereg_paper.rivals.rival import Estimate, Moment, Rival, Setting

#: Members decoded to whole fields at once.
_BATCH = 50


class _OneUpdate(Rival):
    """An ensemble of the latents of the setting's model, updated by all markers of a moment in one step.

    Prior and noise of a moment are those of `tissuereg_paper.latents`; the answer is decoded from the ensemble's mean,
    and smoothed where tetrahedra are inverted, as the package does.
    """

    needs: ClassVar[frozenset[str]] = frozenset({"model"})

    def __init__(self, setting: Setting, *, n_members: int = 100, spread: bool = False) -> None:
        super().__init__(setting)
        self._n_members = whole("n_members", n_members, least=2)
        self._spread = flag("spread", spread)
        observed = MarkerObservation(setting.mesh, setting.reference_mm, setting.markers(setting.reference_mm).names)
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
        prior, observed = prior_of(self._points.model, moment.simulation_mm), moment.displacement_mm.ravel()
        drawn = FirstEnsemble.of(prior, rng, self._n_members)
        predicted = _rows(model, np.concatenate([prior.mean[:, None], drawn.latents], axis=1), moment)
        own, own_at_nodes = self._own_changed if model.code is not None else self._own_whole
        noise = np.diag(np.repeat(self.setting.std_mm[moment.seen] ** 2, 3))
        noise += error_covariance(own[:, _components(moment)])
        linear, factor = LinearPredictions.of(prior, drawn.latents, predicted[:, 1:], predicted[:, 0]), 1.0
        if linear is not None:
            prior, factor = widened(prior, self._points.model.prior(), linear, observed, noise)
        found = assimilate(
            lambda latents: _rows(model, latents, moment),
            observed,
            noise,
            prior,
            rng=rng,
            settings=AssimilationSettings(
                schedule=[1.0], min_members=max(2, self._n_members // 5), threads=self.setting.threads
            ),
            first=self._forecast(prior, rng),
        )
        self._remember(prior, found)
        displacement, _ = repaired(self.setting.mesh, model.latent.decode(found.mean[:, None])[0])
        spread = _std(model, found, displacement, own_at_nodes) if self._spread else None
        return Estimate(displacement, spread, {"widened": factor, "latents": found.latents})

    @cached_property
    def _own_whole(self) -> tuple[FloatArray, FloatArray]:
        return self._own(simulated=False)

    @cached_property
    def _own_changed(self) -> tuple[FloatArray, FloatArray]:
        return self._own(simulated=True)

    def _own(self, *, simulated: bool) -> tuple[FloatArray, FloatArray]:
        """Return the model's errors at all markers (n_fields, 3 n_markers), mm; mean squares (n_nodes, 3) in mm^2."""
        fields = errors_of(self._points.model, simulated=simulated)
        if not len(fields):
            return np.empty((0, 3 * len(self.setting.reference_mm))), np.zeros(fields.shape[1:])
        return self._points.components(self._points.at_points(fields)), np.mean(fields**2, axis=0)

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


def _rows(model: PointsAround, latents: FloatArray, moment: Moment) -> FloatArray:
    """Return predictions (n_obs, n_members), mm, of the markers seen, from latents (n_latent, n_members)."""
    return np.ascontiguousarray(model.decode(np.ascontiguousarray(latents))[:, _components(moment)].T)


def _components(moment: Moment) -> IntArray:
    """Return the numbers (n_obs,) of the components of the markers seen among those of all markers."""
    return np.asarray((3 * moment.seen[:, None] + np.arange(3)).ravel())


def _std(model: PointsAround, found: Assimilation, displacement: FloatArray, own: FloatArray) -> FloatArray:
    """Return the spread (n_nodes, 3) of the nodes, mm, alike along all axes, the model's own error included.

    `displacement` (n_nodes, 3): answer, mm; `own` (n_nodes, 3): mean squares of the model's errors, mm^2.
    """
    latents = found.latents
    square, total = np.zeros(len(displacement)), np.zeros(displacement.shape)
    for first in range(0, latents.shape[1], _BATCH):
        away = model.latent.decode(latents[:, first : first + _BATCH]) - displacement
        square += np.einsum("eni,eni->n", away, away)
        total += away.sum(axis=0)
    n = latents.shape[1]
    variance = found.spread_factor * np.maximum(square - np.einsum("ni,ni->n", total, total) / n, 0.0) / (n - 1)
    return np.repeat(np.sqrt((variance + own.sum(axis=1))[:, None] / 3.0), 3, axis=1)
