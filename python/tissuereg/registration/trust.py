r"""Tests of one registration against its assumptions, to decide whether it can be trusted.

With a trained model, test statistics are compared with those of trial registrations (`judge_by_rehearsal`). Without one
the misfit of a registration is

    J = (z - z0)' P^-1 (z - z0)  +  r' C_d^-1 r,

the prior term and the data term at the posterior mean z of the coefficients of the load, with their prior mean z0 and
prior covariance P, the residual r of the markers and the noise covariance C_d. If prior and
noise are as stated and the model is linear, J equals the chi-square of the innovation and follows a chi-square law with
one degree of freedom per measured coordinate. Each marker is tested separately by its fitted residual
(`tissuereg.registration.wrong_markers`).
"""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.shown import short_repr
from tissuereg.registration.wrong_markers import score_markers

#: Significance level of the tests.
LEVEL = 0.01

#: How many times larger than stated the noise may be, in standard deviations, to be told from the stated one.
NOISE_FACTORS = (3.0, 10.0)

#: The sentence on such noise.
NOISY = "noise: the markers scatter as if their noise was several times larger than stated"

#: The sentence on a support that moved.
GAVE = (
    "support: the markers move as if nodes that are surely held had moved; if they may give, say so "
    '(`held="perhaps"`, --held perhaps)'
)

#: A motion that one marker alone reports: how many times it exceeds the others' and the noise, and shares of the extent
#: that it exceeds and within which no other marker is. Of 954 good events six have such a motion.
_ALONE, _NOISE_ALONE, _FAR, _NEAR = 5.0, 3.0, 0.1, 0.1


@dataclass(frozen=True)
class Trust:
    """Whether a registration can be trusted, the reasons if not, and the test statistics.

    Attributes
    ----------
    ok : bool
        True if no test failed, so that `reasons` is empty.
    p_value : float
        Probability of a misfit at least this large if prior and noise are as stated; with a trained model the share of
        calibration events (trial registrations) that look at least as bad, or an estimate of it without calibration.
    reasons : list of str
        Reasons not to trust the result, in sentences that start with their kind: ``misfit``, ``few markers``, ``wrong
        marker``, ``lone motion``, ``inverted tets``, ``simulation``, ``unfamiliar``, ``unexplained``, ``stiffness``,
        ``noise``, ``support``, or a kind of `tissuereg.registration.readings.Suspicion`.
    chi_square : float
        Misfit J: squared residuals over the noise, plus the squared distance from the prior mean over the prior
        covariance; with a trained model the first alone.
    residual_chi_square : float
        Data term of J alone: squared residuals over the noise.
    n_obs : int
        Number of measured coordinates of markers, plus that of points of the surface.
    """

    ok: bool
    p_value: float
    chi_square: float
    residual_chi_square: float
    n_obs: int
    reasons: list[str] = field(default_factory=list)

    __repr__ = short_repr


def judge(
    names: tuple[str, ...],
    residual: FloatArray,
    noise: FloatArray,
    posterior_spread: FloatArray,
    prior_misfit: float,
    min_det_f: float,
    notes: list[str],
    points: tuple[float, int] = (0.0, 0),
) -> Trust:
    """Return whether a registration without a model can be trusted, and why not, by tests of misfit and markers.

    `names`: markers that were used; `residual` (n_markers, 3): measured minus fitted places, mm; NaN = not seen,
    ignored; `noise` (3 n_markers, 3 n_markers): covariance C_d of the noise, mm^2; `posterior_spread` (3 n_markers, 3
    n_markers): posterior covariance of the markers' predictions, H P+ H' with the observation matrix H, mm^2;
    `prior_misfit`: prior term of the misfit J, the squared distance of the unknowns from their prior mean in units of
    the prior covariance; `min_det_f`: smallest volume ratio of a tet of the registered body; `notes`: reasons found
    earlier in the registration; `points`: data term of the points of the surface, and their number. Result: `Trust`
    with one reason per failed test, after those of `notes`.
    """
    from scipy.stats import chi2

    flat = residual.ravel()
    seen = np.flatnonzero(np.isfinite(flat))
    n_obs = len(seen) + points[1]
    data_misfit = float(flat[seen] @ np.linalg.solve(noise[np.ix_(seen, seen)], flat[seen])) + points[0]
    total = data_misfit + prior_misfit
    p_value = float(chi2.sf(total, n_obs)) if n_obs else 1.0
    reasons = list(notes)
    if p_value < LEVEL:
        reasons.append(
            f"misfit: {_data(len(names), points[1])} and model disagree, {total:.1f} where {n_obs} is expected "
            f"(p = {p_value:.2g}); the noise is larger than stated, the prior too narrow, or the model misses something"
        )
    if not points[1]:
        reasons += _too_few(names)
    # Markers are taken for independent here: a spread estimated from samples is not consistent enough with the noise to
    # take out what correlated errors share.
    own = np.kron(np.eye(len(names)), np.ones((3, 3)))
    scores = score_markers(residual, noise * own, posterior_spread)
    for index in sorted(scores.wrong(LEVEL)):
        off = np.sqrt(scores.chi_square[index])
        reasons.append(f"wrong marker: {names[index]} does not fit the others, {off:.1f} standard deviations off")
    if min_det_f <= 0:
        reasons.append(f"inverted tets: the registered body turns tets inside out, smallest det F {min_det_f:.3g}")
    return Trust(not reasons, p_value, total, data_misfit, n_obs, reasons)


def lone_motion(
    names: tuple[str, ...], places: FloatArray, moved: FloatArray, std: FloatArray, extent: float
) -> list[str]:
    """Return a list with the sentence that one marker alone reports a large motion, if so.

    No neighbour can confirm it, and it is several times larger than any other: it may be a load beside the marker, or a
    place that was not the marker's. `names`: markers that were used; `places` (n_markers, 3): where they sit, mm;
    `moved` (n_markers,): length of their motions beside a rigid one, mm; `std` (n_markers,): noise, mm; `extent`: of
    the body, mm.
    """
    if len(names) < 2:
        return []
    first, second = (int(i) for i in np.argsort(-moved, kind="stable")[:2])
    gaps = np.linalg.norm(places - places[first], axis=1)
    gaps[first] = np.inf
    others = max(float(moved[second]), _NOISE_ALONE * float(std[first]))
    if moved[first] < max(_ALONE * others, _FAR * extent) or gaps.min() < _NEAR * extent:
        return []
    return [
        f"lone motion: {names[first]} alone reports {moved[first]:.1f} mm, the others up to {moved[second]:.1f} mm, "
        f"and no marker within {gaps.min():.0f} mm confirms it"
    ]


class Shown(Protocol):
    """Test statistics of one registration, larger where it looks worse; `learned.statistics.Statistics` has them."""

    @property
    def row(self) -> FloatArray:
        """Misfit, wrong marker, unfamiliar, simulation, noise, (5,)."""
        ...

    @property
    def marker_rows(self) -> FloatArray:
        """The statistic "wrong marker" of each marker, (n_markers,), of which `row` has the largest."""
        ...

    @property
    def marker_misfits(self) -> FloatArray:
        """Squared misfit of each marker to the prediction from the others, over its variance, (n_markers,)."""
        ...


class Compared(Protocol):
    """Set of calibration events: trial registrations with right measurements, with which one is compared."""

    @property
    def level(self) -> float:
        """The p-value below which an answer is not trusted."""
        ...

    def p_value(self, statistics: FloatArray) -> float:
        """Return the share of calibration events whose rarest statistic is as rare as that of statistics (5,)."""
        ...

    def shares(self, statistics: FloatArray) -> FloatArray:
        """Return for each of statistics (5,) the share of calibration events that look as bad."""
        ...

    def share(self, number: int, value: float) -> float:
        """Return the share of calibration events in which the statistic with this number is as large as `value`."""
        ...


def judge_by_rehearsal(
    names: tuple[str, ...],
    residual: FloatArray,
    noise: FloatArray,
    calibration_set: Compared,
    shown: Shown,
    min_det_f: float,
    notes: list[str],
) -> Trust:
    """Return whether a registration with a trained model can be trusted, and why not, by comparison with trials.

    Its test statistics are judged together against those of calibration events (trial registrations with right
    measurements), by any statistic; `calibration_set` says which share is too small. `names`: markers that were used;
    `residual` (n_markers, 3): measured minus fitted places, mm; `noise` (3 n_markers, 3 n_markers): covariance of the
    tracker's noise, mm^2; `calibration_set`: the calibration events; `shown`: test statistics of the registration;
    `min_det_f`: smallest volume ratio of a tet of the registered body; `notes`: reasons found earlier in the
    registration. Result: `Trust`, with a reason for each statistic that is rare enough to be one, and at least for the
    rarest.
    """
    flat = residual.ravel()
    data = float(flat @ np.linalg.solve(noise, flat))
    statistics = shown.row
    p_value, level, reasons = calibration_set.p_value(statistics), calibration_set.level, list(notes)
    if p_value < level:
        shares = calibration_set.shares(statistics)
        limit = max(level / len(shares), float(shares.min()))
        misfit, marker, unfamiliar, simulation, scatter = (bool(share <= limit) for share in shares)
        if misfit:
            reasons.append(
                f"misfit: fewer than one in {_in_words(shares[0])} calibration events fit the model so badly "
                f"(p = {shares[0]:.2g}); the noise is larger than stated, or the body does what the model never saw"
            )
        if marker:
            for index, statistic in enumerate(shown.marker_rows):
                if calibration_set.share(1, float(statistic)) > limit:
                    continue
                off = np.sqrt(shown.marker_misfits[index])
                reasons.append(
                    f"wrong marker: {names[index]} does not fit the others, {off:.1f} standard deviations off"
                )
        if unfamiliar:
            reasons.append(
                f"unfamiliar: the shape lies {statistics[2]:.1f} standard deviations from all that the model knows"
            )
        if scatter:
            reasons.append(NOISY)
        if simulation:
            reasons.append("simulation: another event than the simulated one explains the markers better")
    reasons += _too_few(names)
    if min_det_f <= 0:
        reasons.append(f"inverted tets: the registered body turns tets inside out, smallest det F {min_det_f:.3g}")
    return Trust(not reasons, p_value, data, data, len(flat), reasons)


def _too_few(names: tuple[str, ...]) -> list[str]:
    """Return the reason not to trust a result from one marker or none, in a list; empty if `names` has more markers."""
    if len(names) > 1:
        return []
    used = f"{names[0]} alone was used, and nothing else could contradict it" if names else "none was used"
    return [f"few markers: {used}"]


def _in_words(p_value: float) -> str:
    return f"{int(1.0 / max(p_value, 1e-9)):,}"


def _data(n_markers: int, n_points: int) -> str:
    """Return in words which data were used, such as "markers and surface points", given the number of each."""
    return " and ".join(word for word, count in (("markers", n_markers), ("surface points", n_points)) if count)
