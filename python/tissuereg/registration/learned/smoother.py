r"""ES-MDA under a prior that is a mixture: the posterior ensemble of a learned registration.

Component c says that the latents are N(m_c, s^2 P_c) and the model's own error at markers and targets is N(0, s^2 E_c),
with s one of a few scales. A pair of component and scale is one Gaussian prior, and gets an ensemble of its own:

1. **Screen.** The decoder, linear by regression about a point, gives the evidence of every pair; the few that the
   markers allow are kept.
2. **ES-MDA** in each: ``C_d = s^2 E_c[markers, markers] + R`` with the tracker's noise R; the ensembles of all pairs
   are decoded in one batch a step. Square-root form: no observation is perturbed.
3. **Evidence** of each pair from the predictions of every step n with inflation a_n, exact for a linear decoder:

       log Z = log N(0; 0, C_d) + sum_n log [ N(y; mean Y_n, cov Y_n + a_n C_d) / N(0; 0, a_n C_d) ].

4. **Answer.** Each member's error is conditioned on its own residual at the markers:
   ``t_i = T(z_i) + B (y - g(z_i))``, ``B = s^2 E_c[targets, markers] C_d^-1``, and over members and pairs the moments
   are those of a mixture.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, IntArray, frozen
from tissuereg.errors import EnsembleError
from tissuereg.registration.learned.batches import together
from tissuereg.registration.learned.components import probabilities
from tissuereg.registration.learned.draws import ABSURD_MM, balanced_draws, spread_factor
from tissuereg.registration.learned.mixture import Component, Evidence, LinearDecoder

#: Latents (n_latent, n_columns) to displacements at markers and targets (n_columns, n_rows), mm.
Decode = Callable[[FloatArray], FloatArray]

#: Draws about a point by which the decoder is linear there, over the number of latents, and their spread in standard
#: deviations of the training set's codes: the region where posteriors lie.
_DRAWS_A_LATENT, _SPREAD = 2.3, 0.2

#: Linearisations: about the start, and then about the mean that the one before gave.
_SCREENINGS = 3

#: Linearisations without a marker, from the answer with all.
_AGAIN = 2

#: Pairs that get an ensemble at most, and the least of their probabilities over that of the best.
_MOST_PAIRS, _LEAST_SHARE = 3, 1e-3


@dataclass(frozen=True, eq=False)
class Screening:
    """Evidence of all pairs of component and scale, by a decoder that is linear about the most probable latents.

    `first`: evidence by the decoder that is linear about the start, which no marker has moved; `found`: evidence of the
    pairs; `decode`: the decoder itself; `spread` (n_latent,): standard deviation of the training set's codes;
    `simulated`: whether the start is the code of a simulation, about which `first` has compared every marker with the
    others.
    """

    first: Evidence
    found: Evidence
    decode: Decode
    spread: FloatArray
    simulated: bool

    @property
    def linear(self) -> LinearDecoder:
        """The decoder that is linear about the most probable latents, at markers and targets."""
        return self.found.model

    @classmethod
    def of(
        cls,
        decode: Decode,
        prior: list[Component],
        observed: FloatArray,
        noise: FloatArray,
        start: FloatArray,
        spread: FloatArray,
        *,
        rounds: int = _SCREENINGS,
        simulated: bool = False,
    ) -> "Screening":
        """Return the evidence of the pairs.

        `observed` (n_obs,): measured displacements, mm, the first n_obs rows of what is decoded; `noise` (n_obs,
        n_obs): covariance of the tracker's noise, mm^2; `start` (n_latent,): where the first draws lie; `spread`
        (n_latent,): standard deviation of the training set's codes; `rounds`: linearisations, about the start and then
        about the mean that the one before gave; `simulated`: whether the start is the code of a simulation: it is near
        the answer then, so that one round less is enough, and every marker is compared with the others about it. Cost:
        a decode of about 2 n_latent columns each.
        """
        n = len(start)
        draws, _ = normals(0, n, round(_DRAWS_A_LATENT * n) + 2)
        point, made, pairs = start, list[Evidence](), None
        for number in range(rounds - simulated):
            rows = decode(point[:, None] + _SPREAD * spread[:, None] * draws)
            slopes = (rows - rows.mean(axis=0)).T @ draws.T / (draws.shape[1] - 1) / (_SPREAD * spread)
            linear = LinearDecoder(point, rows.mean(axis=0), slopes)
            every = simulated and number == 0
            made.append(Evidence.of(prior, linear, observed, noise, compared="every" if every else "none", pairs=pairs))
            point, pairs = made[-1].mean_latents, made[-1].likely
        return cls(made[0], made[-1], decode, spread, simulated)

    def under(self, prior: list[Component], observed: FloatArray, noise: FloatArray) -> "Screening":
        """Return the evidence of pairs with the same decoder under other weights; arguments as for `of`."""
        linear = self.first.model
        first = Evidence.of(prior, linear, observed, noise, compared="every" if self.simulated else "none")
        return replace(self, first=first, found=Evidence.of(prior, self.linear, observed, noise))

    def chance_of(self, marker: int, prior: list[Component], observed: FloatArray, noise: FloatArray) -> float:
        """Return the chance that a marker lies as far from its prediction by the others, linearised about their answer.

        With a wrong marker among them the decoder is linear where that one pulled it. `marker`: its number; the other
        arguments are as for `of`. Cost: two decodes of about 2 n_latent columns.
        """
        own = 3 * marker + np.arange(3)
        rows = np.concatenate([np.delete(np.arange(len(observed)), own), own])
        ordered = [replace(one, errors=one.errors[np.ix_(rows, rows)]) for one in prior]
        there, among = observed[rows], noise[np.ix_(rows, rows)]
        without = Screening.of(
            lambda latents: self.decode(latents)[:, rows],
            ordered,
            there[:-3],
            among[:-3, :-3],
            self.found.mean_latents,
            self.spread,
            rounds=_AGAIN,
        )
        pairs = without.found.likely
        found = Evidence.of(ordered, without.linear, there, among, compared="last", pairs=pairs)
        return float(found.chances()[1][0])

    def kept(self) -> IntArray:
        """Return the numbers of the pairs that get an ensemble, the most probable one first."""
        logs = self.found.logs
        best = np.argsort(-logs, kind="stable")[:_MOST_PAIRS]
        return np.asarray(self.found.pairs[best[logs[best] >= logs.max() + np.log(_LEAST_SHARE)]])


@dataclass(frozen=True, eq=False)
class Pair:
    """The posterior ensemble of one pair of component and scale.

    Attributes
    ----------
    component : int
        Number of the component.
    scale : float
        Factor on its standard deviations.
    weight : float
        Posterior probability.
    latents : ndarray of float64, shape (n_latent, n_members)
        Posterior members.
    mean : ndarray of float64, shape (n_rows,)
        Mean displacement of markers and targets, the model's own error included, mm.
    covariance : ndarray of float64, shape (n_rows, n_rows)
        mm^2.
    pulls : ndarray of float64, shape (n_members, n_obs)
        ``C_d^-1 (y - g(z_i))`` of each member, 1/mm: times a covariance of errors with those at the markers it is the
        error that the markers tell.
    noise : ndarray of float64, shape (n_obs, n_obs)
        C_d: the tracker's noise and the model's own error at the markers, mm^2.
    """

    component: int
    scale: float
    weight: float
    latents: FloatArray
    mean: FloatArray
    covariance: FloatArray
    pulls: FloatArray
    noise: FloatArray


@dataclass(frozen=True, eq=False)
class Smoothed:
    """The posterior of a learned registration: a mixture of ensembles; rows are markers, then targets.

    Attributes
    ----------
    pairs : tuple of Pair
        Their weights sum to one.
    dropped : list of (int, str)
        Members that were lost, by their number among those of all pairs, with the reason.
    """

    pairs: tuple[Pair, ...]
    dropped: list[tuple[int, str]]

    @property
    def weights(self) -> FloatArray:
        """Probability of each pair, (n_pairs,)."""
        return np.array([pair.weight for pair in self.pairs])

    @property
    def mean(self) -> FloatArray:
        """Mean displacement (n_rows,) of markers and targets, mm."""
        return np.asarray(self.weights @ np.array([pair.mean for pair in self.pairs]))

    @property
    def mean_latents(self) -> FloatArray:
        """Mean of the latents (n_latent,)."""
        return np.asarray(self.weights @ np.array([pair.latents.mean(axis=1) for pair in self.pairs]))

    @property
    def covariance(self) -> FloatArray:
        """Covariance (n_rows, n_rows) of the mixture, mm^2."""
        mean = self.mean
        total = np.zeros((len(mean), len(mean)))
        for pair in self.pairs:
            away = pair.mean - mean
            total += pair.weight * (pair.covariance + np.outer(away, away))
        return total


def smooth(
    decode: Decode,
    prior: list[Component],
    kept: IntArray,
    observed: FloatArray,
    noise: FloatArray,
    draws: tuple[FloatArray, bool],
    alphas: tuple[float, ...],
    threads: int = 1,
) -> Smoothed:
    """Return the posterior by ES-MDA in some pairs of component and scale.

    `decode`: latents (n_latent, n_columns) to displacements at markers and targets (n_columns, n_rows), mm; `kept`
    int64 (n_pairs,): numbers of the pairs, all scales of one component after those of another; `observed` (n_obs,):
    measured displacements, mm, the first n_obs rows; `noise` (n_obs, n_obs): covariance of the tracker's noise, mm^2;
    `draws` (n_latent, n_members): standard normals, and whether their sample moments are exact; `alphas`: inflation
    coefficients, whose inverses sum to one; `threads`: pairs that are updated at once. Raises `EnsembleError` if fewer
    than half of a pair's members survive.
    Cost: a decode of n_pairs n_members columns for every coefficient and one more.
    """
    component = np.repeat(np.arange(len(prior)), [len(one.scales) for one in prior])[kept]
    scale, weight = (np.concatenate([getattr(one, name) for one in prior])[kept] for name in ("scales", "weights"))
    n_obs, n_members = len(observed), draws[0].shape[1]
    ensembles = [
        prior[c].mean[:, None] + s * np.linalg.cholesky(prior[c].covariance) @ draws[0]
        for c, s in zip(component, scale, strict=True)
    ]
    errors = [s**2 * prior[c].errors for c, s in zip(component, scale, strict=True)]
    covariances = [one[:n_obs, :n_obs] + noise for one in errors]
    noises = [_core.Noise.dense(np.ascontiguousarray(one)) for one in covariances]
    log_dets = np.array([np.linalg.slogdet(2.0 * np.pi * one)[1] for one in covariances])
    # Of the whole schedule: inverses of coefficients sum to one, or to zero where there is no step.
    logs, dropped = np.log(weight) - 0.5 * log_dets * sum(1.0 / alpha for alpha in alphas), list[tuple[int, str]]()
    for alpha in (*alphas, None):
        ends = np.cumsum([one.shape[1] for one in ensembles])
        parts = np.split(decode(np.concatenate(ensembles, axis=1)), ends[:-1])
        tasks = [partial(_updated, *one, observed, alpha) for one in zip(ensembles, parts, noises, strict=True)]
        for number, (*updated, lost, log) in enumerate(together(tasks, threads)):
            ensembles[number], parts[number] = updated
            logs[number] += log
            dropped += [(number * n_members + int(index), reason) for index, reason in lost]
            if len(parts[number]) < max(2, n_members // 2):
                left = len(parts[number])
                message = f"at least half of {n_members} ensemble members must survive, {left} are left"
                raise EnsembleError(message, dropped=dropped)
    factor = spread_factor(n_members, exact=draws[1])
    found = zip(component, scale, probabilities(logs), ensembles, parts, errors, covariances, strict=True)
    pairs = []
    for c, s, weight, latents, rows, error, covariance in found:
        mean, spread, pulls = _conditioned(rows, error, covariance, observed, factor)
        pairs.append(Pair(int(c), float(s), float(weight), latents, mean, spread, pulls, covariance))
    return Smoothed(tuple(pairs), dropped)


def _updated(
    latents: FloatArray, rows: FloatArray, noise: _core.Noise, observed: FloatArray, alpha: float | None
) -> tuple[FloatArray, FloatArray, list[tuple[int, str]], float]:
    """Return the members of a pair after a step, those before it decoded, those that were lost, and its log evidence.

    `latents` (n_latent, n_members); `rows` (n_members, n_rows): decoded, mm; `noise`: C_d; `alpha`: None for no step.
    """
    kept, lost = _core.screen_members(np.ascontiguousarray(rows.T), ABSURD_MM)
    if lost:
        rows, latents = rows[kept], latents[:, kept]
    if alpha is None or len(kept) < 2:
        return latents, rows, lost, 0.0
    predicted = np.ascontiguousarray(rows[:, : len(observed)].T)
    step = _core.Step.square_root(predicted, observed, noise, alpha=alpha, threads=1)
    return step.apply(np.ascontiguousarray(latents)), rows, lost, step.log_evidence or 0.0


def _conditioned(
    rows: FloatArray, error: FloatArray, covariance: FloatArray, observed: FloatArray, factor: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return mean (n_rows,), covariance (n_rows, n_rows) and pulls of a posterior ensemble, as for `Pair`.

    Each member's error is conditioned on what it leaves at the markers. `rows` (n_members, n_rows): the members
    decoded; `error` (n_rows, n_rows): covariance of the model's own error; `covariance` (n_obs, n_obs): C_d; `factor`:
    on the members' covariance, for their number.
    """
    n_obs = len(observed)
    pulls = np.asarray(np.linalg.solve(covariance, observed[:, None] - rows[:, :n_obs].T).T, np.float64)
    answers = rows + pulls @ error[:n_obs]
    left = error - error[:, :n_obs] @ np.linalg.solve(covariance, error[:n_obs])
    mean = answers.mean(axis=0)
    away = answers - mean
    return mean, np.asarray(away.T @ away * (factor / (len(away) - 1)) + left), pulls


@lru_cache(maxsize=4)
def normals(seed: int, n_latent: int, n_members: int) -> tuple[FloatArray, bool]:
    """Return standard normal draws (n_latent, n_members) of a first ensemble, and whether their moments are exact."""
    draws, exact = balanced_draws(np.random.default_rng([seed, 2]), (n_latent, n_members), np.empty((0, n_members)))
    return frozen(draws), exact
