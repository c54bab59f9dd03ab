r"""Tests of one registration against its assumptions, to decide whether it can be trusted.

The misfit of a registration is

    J = (z - z0)' P^-1 (z - z0)  +  r' C_d^-1 r,

prior and data terms at the posterior mean. If prior and noise are as stated and the model is linear, J equals the
chi-square of the innovation and follows a chi-square law with one degree of freedom per measured coordinate.
Each marker is tested separately by its fitted residual (`tissuereg.wrong_markers`).
"""

from dataclasses import dataclass, field

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.wrong_markers import score_markers

#: Significance level of the tests.
LEVEL = 0.01


@dataclass(frozen=True)
class Trust:
    """Whether a registration can be trusted, and why not.

    Attributes
    ----------
    ok : bool
        True if there is no reason against it.
    p_value : float
        Probability of a misfit at least this large if prior and noise are as stated.
    reasons : list of str
        Reasons not to trust the result, in sentences that start with their kind: ``misfit``, ``few markers``, ``wrong
        marker``, ``inverted tets``, ``simulation``, or a kind of `tissuereg.readings.Suspicion`.
    chi_square : float
        J above.
    residual_chi_square : float
        Data term of J alone.
    n_obs : int
        Number of measured coordinates.
    """

    ok: bool
    p_value: float
    chi_square: float
    residual_chi_square: float
    n_obs: int
    reasons: list[str] = field(default_factory=list)


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
    """Return whether a registration can be trusted, and why not.

    Parameters
    ----------
    names : tuple of str
        Markers that were used.
    residual : ndarray of float64, shape (n_markers, 3)
        Measured minus fitted, mm; NaN = not seen, ignored.
    noise : ndarray of float64, shape (3 n_markers, 3 n_markers)
        Covariance C_d, mm^2.
    posterior_spread : ndarray of float64, shape (3 n_markers, 3 n_markers)
        Posterior covariance H P+ H' of the markers' predictions, mm^2.
    prior_misfit : float
        Prior term of J.
    min_det_f : float
        Smallest volume ratio of the registered body.
    notes : list of str
        Reasons found earlier in the registration.
    points : (float, int)
        Data term of the points of the surface, and their number.

    Returns
    -------
    Trust
        With one reason per failed test.
    """
    from scipy.stats import chi2

    flat = residual.ravel()
    seen = np.flatnonzero(np.isfinite(flat))
    n_obs = len(seen) + points[1]
    data_misfit = float(flat[seen] @ np.linalg.solve(noise[np.ix_(seen, seen)], flat[seen])) + points[0]
    total = data_misfit + prior_misfit
    p_value = float(chi2.sf(total, n_obs))
    reasons = list(notes)
    if p_value < LEVEL:
        reasons.append(
            f"misfit: {_data(len(names), points[1])} and model disagree, {total:.1f} where {n_obs} is expected "
            f"(p = {p_value:.2g}); the noise is larger than stated, the prior too narrow, or the model misses something"
        )
    if len(names) == 1 and not points[1]:
        reasons.append(f"few markers: {names[0]} alone was used, and nothing else could contradict it")
    # Markers are taken for independent here: a spread estimated from an ensemble is not consistent enough with the
    # noise to take out what correlated errors share.
    own = np.kron(np.eye(len(names)), np.ones((3, 3)))
    scores = score_markers(residual, noise * own, posterior_spread)
    for index in sorted(scores.wrong(LEVEL)):
        off = np.sqrt(scores.chi_square[index])
        reasons.append(f"wrong marker: {names[index]} does not fit the others, {off:.1f} standard deviations off")
    if min_det_f <= 0:
        reasons.append(f"inverted tets: the registered body turns tets inside out, smallest det F {min_det_f:.3g}")
    return Trust(not reasons, p_value, total, data_misfit, n_obs, reasons)


def _data(n_markers: int, n_points: int) -> str:
    """Return what was measured, in words."""
    return " and ".join(word for word, count in (("markers", n_markers), ("surface points", n_points)) if count)
