"""Evidence of supports and of the noise: how well a body explains the markers.

The contacts of all radii are approximated by one Gaussian; its size and those of all families of causes are chosen for
the highest evidence.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.condensed import Condensed
from tissuereg.registration.contacts.fit import ContactFit, Passes
from tissuereg.registration.contacts.observations import LinearObservations
from tissuereg.registration.contacts.places import smooth_fields
from tissuereg.registration.contacts.settings import DISCRETISATION, EvidenceSettings
from tissuereg.registration.contacts.state import RigidMotion
from tissuereg.registration.trust import NOISE_FACTORS


@dataclass(frozen=True, eq=False)
class MarkerEvidence:
    """What the markers speak for, beside contacts: those found and others anywhere are the rival explanation.

    `fit`: the contacts that were found; `problem`: observations of markers about the body that was found, mm;
    `settings`: sizes that are tried.
    """

    fit: ContactFit
    problem: LinearObservations
    settings: EvidenceSettings

    def log_noise_odds(self, tracker: FloatArray) -> float:
        """Return by how much the markers speak for larger noise than stated: the largest log ratio of evidences.

        `tracker` (n_obs,): the tracker's part of the observations' variances, mm^2, which is compared with
        `NOISE_FACTORS`^2 times as much. Less the logarithm of the number of factors, so that it exceeds x with a chance
        of at most exp(-x) if the noise is as stated (A. A. Markov). Where loads can explain the markers it is negative.
        """
        larger = [
            self._best(self.problem.variances + (factor**2 - 1.0) * tracker, self._parts) for factor in NOISE_FACTORS
        ]
        return max(larger) - self._stated - float(np.log(len(NOISE_FACTORS)))

    def log_support_odds(self) -> float:
        """Return by how much the markers speak for surely held nodes that moved: log ratio of the largest evidences.

        The nodes move by smooth fields of one unknown size; as a whole they move as the tracker drifts, which is a
        rival, too. No node held: 0.
        """
        body = self.fit.columns.body
        held = body.supports.sure
        if not len(held):
            return 0.0
        smooth = smooth_fields(body.mesh.nodes[held], DISCRETISATION.support_fields)
        rates = self.fit.tangent.sensed(self.problem.rows)[0].image("prescribed", lambda one: one.prescribed)
        moved = np.einsum("rnx,fn->rfx", rates, smooth, optimize=True).reshape(len(rates), -1)
        given = [*self._parts, (moved @ moved.T, *self._parts[0][1:])]
        return self._best(self.problem.variances, given) - self._stated

    @cached_property
    def _parts(self) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
        """Parts of the observations' covariance as of `_parts`, then the contacts that were found."""
        fit, responses = self.fit, self.problem.responses
        slots = np.asarray(fit.samples[0])[:, :, 0]
        count = np.bincount(slots[slots >= 0], minlength=fit.columns.n_patches) / max(len(slots), 1)
        parts = _parts(fit.columns, responses, self.settings)
        if count.any():
            some = np.flatnonzero(np.repeat(count, 3))
            own = responses[:, some]
            parts.append(((own * np.repeat(count, 3)[some]) @ own.T, *parts[0][1:]))
        return parts

    @cached_property
    def _stated(self) -> float:
        """Log evidence of what is stated."""
        return self._best(self.problem.variances, self._parts)

    def _best(self, variances: FloatArray, parts: list[tuple[FloatArray, FloatArray, FloatArray]]) -> float:
        return _best_over_sizes(self.problem.innovation, np.diag(variances), parts, self.settings)


@dataclass(frozen=True)
class SupportStiffness:
    """Estimated stiffness of doubtful supports, one number for each set of springs, in Young's modulus over extent.

    `best`: values of the highest evidence; `log_std`: standard deviation of the natural logarithm of each, with the
    others fixed. Both are empty if no support is on springs.
    """

    best: tuple[float, ...]
    log_std: tuple[float, ...]


def support_stiffness(passes: Passes, frame: RigidMotion) -> SupportStiffness:
    """Return the stiffness of doubtful supports that has the highest evidence, with its uncertainty.

    `passes`: holds the body, its material, causes and data, and counts the work; `frame`: initial rigid motion from the
    body's frame to the tracker's. First the best common value of all sets of springs is found, then the best of one set
    after the other, twice. Cost: one factorisation, one right-hand side for each component of a marker and three for
    each cell (a small part of the supports), for any number of candidates.
    """
    tried, settings = passes.settings.stiffness_tried, passes.settings.evidence
    n_sets = len(passes.columns.body.springs)
    if not n_sets:
        return SupportStiffness((), ())
    condensed = Condensed.of(passes, frame, tried[len(tried) // 2])
    parts = _parts(condensed.columns, condensed.responses, settings)
    noise = np.diag(condensed.variances)
    known: dict[tuple[int, ...], float] = {}

    def value(levels: tuple[int, ...]) -> float:
        if levels not in known:
            there = condensed.on([tried[level] for level in levels])
            seen = [(there.observed(covariance), factors, log_prior) for covariance, factors, log_prior in parts]
            known[levels] = _best_over_sizes(there.innovation, noise, seen, settings)
        return known[levels]

    def others(levels: tuple[int, ...], index: int) -> list[tuple[int, ...]]:
        return [(*levels[:index], level, *levels[index + 1 :]) for level in range(len(tried))]

    best = max(((level,) * n_sets for level in range(len(tried))), key=value)
    for index in [*range(n_sets)] * 2:
        best = max(others(best, index), key=value)
    spread = []
    for index in range(n_sets):
        chances = np.exp([value(levels) - value(best) for levels in others(best, index)])
        logs, chances = np.log(tried), chances / chances.sum()
        spread.append(float(np.sqrt(chances @ (logs - chances @ logs) ** 2)))
    return SupportStiffness(tuple(tried[level] for level in best), tuple(spread))


def _parts(
    columns: Columns, responses: FloatArray, settings: EvidenceSettings
) -> list[tuple[FloatArray, FloatArray, FloatArray]]:
    """Return the parts of the observations' covariance whose sizes are unknown: one contact anywhere, then each family.

    `responses` (n_obs, n_columns): displacement of the observations by a unit coefficient of every cause, mm. Result:
    for each part its covariance (n_obs, n_obs) at size one, mm^2, the candidate factors on it (n_sizes,),
    dimensionless, and the logarithm of their prior (n_sizes,).
    """
    patches = columns.body.patches
    count = np.bincount(patches.level)
    likely = np.repeat(1.0 / (3.0 * len(count) * count[patches.level]), 3)
    own = responses[:, : len(likely)]
    least, most = np.log10(settings.sizes_mm)
    sizes = 10.0 ** np.arange(least, most + 0.01, 1.0 / settings.sizes_a_decade)
    parts = [((own * likely) @ own.T, sizes**2, np.zeros(len(sizes)))]
    for variances, factors, log_prior in columns.core_families():
        parts.append(((responses * variances) @ responses.T, factors, log_prior))
    return parts


def _best_over_sizes(
    innovation: FloatArray,
    noise: FloatArray,
    parts: list[tuple[FloatArray, FloatArray, FloatArray]],
    settings: EvidenceSettings,
) -> float:
    """Return the log evidence maximised over the sizes of all parts of the covariance, one part after the other.

    `innovation` (n_obs,): measured minus predicted displacement, mm; `noise` (n_obs, n_obs): covariance of the noise,
    mm^2; `parts`: for each part its covariance (n_obs, n_obs), mm^2, candidate factors on it and log priors (n_sizes,).
    """
    levels = [int(np.argmin(np.abs(np.log(factors)))) for _, factors, _ in parts]
    best = last = -np.inf
    for _ in range(settings.rounds):
        before = best
        for index, (covariance, factors, log_prior) in enumerate(parts):
            others = [f[i] * c for k, ((c, f, _), i) in enumerate(zip(parts, levels, strict=True)) if k != index]
            values = _log_normals(innovation, noise + sum(others), covariance, factors)
            levels[index] = int(np.argmax(values + log_prior))
            last = float(values[levels[index]])
        best = last + sum(float(p[2][i]) for p, i in zip(parts, levels, strict=True))
        if best - before < settings.least_gain:
            break
    return best


def _log_normals(innovation: FloatArray, rest: FloatArray, covariance: FloatArray, factors: FloatArray) -> FloatArray:
    """Return log N(innovation; 0, rest + factor covariance) up to a constant for each of some factors, (n_factors,).

    `innovation` (n_obs,), mm; `rest`, `covariance` (n_obs, n_obs), mm^2. One decomposition serves all factors.
    """
    from scipy.linalg import solve_triangular

    factor = np.linalg.cholesky(rest)
    # One solution for both.
    half = solve_triangular(factor, np.column_stack([covariance, innovation]), lower=True, check_finite=False)
    values, vectors = np.linalg.eigh(solve_triangular(factor, half[:, :-1].T, lower=True, check_finite=False))
    white = vectors.T @ half[:, -1]
    spread = 1.0 + np.multiply.outer(factors, np.maximum(values, 0.0))
    logs = (white**2 / spread + np.log(spread)).sum(axis=1)
    return np.asarray(-0.5 * logs - np.log(np.diag(factor)).sum())
