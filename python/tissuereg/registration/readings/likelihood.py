r"""Likelihood of markers under a reading (interpretation of the input): of their places, and of their motion.

Places. All markers are mounted at the same height s above the surface, with errors of standard deviation t; one in
thirty may lie anywhere:

    p(d_i | s, t) = 0.97 N(d_i; s, t^2) + 0.03 N(d_i; 0, (extent / 5)^2),      d_i: distance from the surface, signed,

averaged over four s and three t. Alternatively all were placed inside the body, at depths up to one or two tenths of
its extent, or each one was mounted or placed inside. A layout much smaller or larger than the body is unlikely in
itself, and so are markers on held surface.

Motion. The displacements v (n,) of the seen coordinates are a sample of a Gaussian field that fades towards held nodes,

    v ~ N(0, a^2 W K_l W + B S B' + noise^2),    W: freedom of each place, K_l: Matern 3/2 of length l,

with the size a of the deformation, and columns B (n, 18), of variances S: translations and rotations that fade as well,
within a layer or along the body; six more do not fade if nothing is held or the reading allows a rigid motion. The
density is averaged over sizes a from 0.2 to 20 % of the body's extent, three lengths and three noises. K is
diagonalised once per length, so that all sizes, noises and readings with the same places share one factorisation.
"""

from functools import cache

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.registration.readings.settings import MOTION, PLACES


def standoff(extent: float) -> float:
    """Return the largest plausible height of a marker above the surface, mm, for a body of this extent, mm."""
    return min(PLACES.standoff_mm, PLACES.standoff_share * extent)


def places_likelihood(distance: FloatArray, extent: float) -> FloatArray:
    """Return the log-likelihood of the markers' distances from the surface under each of many readings.

    A reading is one interpretation of the input. `distance` (n_readings, n_markers): signed distances of the reference
    places from the surface, negative inside, mm; `extent`: largest extent of the body along an axis, mm. Result:
    (n_readings,), up to a constant that all readings share.
    """
    highest = standoff(extent)
    depths = extent * np.array(PLACES.depths)
    # Half of a normal density, on the inner side of the surface, has twice its height.
    deep = 2.0 * np.mean(np.exp(-0.5 * (distance[..., None] / depths) ** 2) / depths, axis=-1)
    deep = np.where(distance < 0.0, deep, 0.0)
    finest = 0.3 * highest / PLACES.standoff_mm + 0.003 * extent
    parts, mixed = [], []
    for height in highest * np.array([0.0, 0.25, 0.5, 0.9]):
        for error in (finest, 2.0 * finest, 0.4 * highest):
            wide = np.where(distance < height, min(error, 2.0 * finest), error)
            good = np.exp(-0.5 * ((distance - height) / wide) ** 2) / error
            anywhere = np.exp(-0.5 * (distance / (0.2 * extent)) ** 2) / (0.2 * extent)
            # The cost is bounded: beyond the body's own size a marker is wrong in any case.
            anywhere = np.maximum(anywhere, np.exp(-8.0) / (0.2 * extent))
            wrong = PLACES.wrong_share * anywhere
            parts.append(np.log((1 - PLACES.wrong_share) * good + wrong).sum(axis=1))
            mixed.append(np.log((1 - PLACES.wrong_share) * 0.5 * (good + deep) + wrong).sum(axis=1))
    inside = np.log((1 - PLACES.wrong_share) * deep + wrong).sum(axis=1)
    some = np.logaddexp(inside, log_mean_exp(np.array(mixed)))
    return np.asarray(np.logaddexp(log_mean_exp(np.array(parts)), PLACES.inside_odds + some))


def nowhere_likelihood(distance: FloatArray, extent: float) -> float:
    """Return the log-likelihood of distances (n_markers,), mm, of places that are unrelated to the surface.

    `extent`: largest extent of the body along an axis, mm. The constant left out is that of `places_likelihood`.
    """
    wide = 0.2 * extent
    return float(np.maximum(-0.5 * (distance / wide) ** 2, -8.0).sum() - len(distance) * np.log(wide))


def layout_likelihood(places: FloatArray, held: BoolArray, skin_spread: float) -> FloatArray:
    """Return the log-likelihood of the layout of the markers on the body under each of many readings.

    A reading is one interpretation of the input. Many markers are probably spread over the body, and few are on held
    surface. `places` (n_readings, n_markers, 3): reference places, mm; `held` bool (n_readings, n_markers): whether the
    closest surface is held; `skin_spread`: root mean square distance of the surface from its mean, mm. Result:
    (n_readings,).
    """
    glued, n_markers = PLACES.held_odds * held.sum(axis=1), places.shape[1]
    if n_markers < PLACES.fewest_spread:
        return np.asarray(glued)
    spread = np.sqrt(np.sum((places - places.mean(axis=1, keepdims=True)) ** 2, axis=2).mean(axis=1))
    ratio = np.maximum(spread / skin_spread, 1e-9)
    outside = np.clip(np.log(PLACES.speck / ratio), 0.0, 3.0) + np.clip(np.log(ratio / PLACES.sprawl), 0.0, 3.0)
    return np.asarray(glued - max(6.0, n_markers) * outside)


def motion_likelihood(
    arms: FloatArray, freedom: FloatArray, motion: FloatArray, noise: float, extent: float, *, rigid: bool = False
) -> FloatArray:
    """Return the log-likelihood of the markers' displacements under each of many readings that share their places.

    A reading is one interpretation of the input. `arms` (n_markers, 3): reference places, in the frame of the
    displacements, mm; `freedom` (3, n_markers): how freely the body can move at each place, 0 to 1, for three lengths
    of fading, from `Skin.freedom`; `motion` (n_readings, n_markers, 3): displacements in mm; NaN = not seen, the same
    coordinates in all readings; `noise`: standard deviation of a measured coordinate, mm; `extent`: largest extent of
    the body along an axis, mm; `rigid`: whether the body may move rigidly as a whole. Result: (n_readings,), the
    density is per mm: a reading in other units adds the logarithm of its volume change.
    """
    seen = np.isfinite(motion[0])
    if not seen.any():
        return np.zeros(len(motion))
    fading, whole = _rigid_columns(arms, freedom, extent)
    columns = np.concatenate([*fading, whole], axis=2) if rigid else np.concatenate(fading, axis=2)
    sizes, together, noises, weights = _grid(noise, extent)
    factors = np.ones((len(sizes), columns.shape[2]))
    factors[:, : 6 * len(freedom)] = together[:, None]
    values, turned, mixed = _diagonal(arms, freedom[0], motion, columns, seen, np.array(MOTION.lengths) * extent)
    variance = sizes[:, None] ** 2 * values[:, None] + noises[:, None] ** 2
    logs = _gaussian(variance, turned, mixed, factors) + weights[:, None]
    # Weights sum to one for each length.
    return np.asarray(log_mean_exp(logs.reshape(-1, len(motion))) + np.log(len(sizes)))


@cache
def _grid(noise: float, extent: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the grid over which the likelihood of a motion is averaged, h combinations of three sizes.

    `noise`: standard deviation of a measured coordinate, mm; `extent`: largest extent of the body along an axis, mm.
    Result, (h,) each: size of the deformation, size of the rigid motion that fades towards held nodes, standard
    deviation of the noise, all in mm, and the logarithm of the prior weight.
    """
    points = [
        (size * extent, max(size, common) * extent, float(np.hypot(noise, extra)), of_size + of_common + of_noise)
        for size, of_size in zip(MOTION.sizes, np.log(MOTION.size_weights), strict=True)
        for common, of_common in zip(MOTION.together, np.log(MOTION.together_weights), strict=True)
        for extra, of_noise in zip(MOTION.extra_noise_mm, np.log(MOTION.noise_weights), strict=True)
        if common == 0.0 or common > size
    ]
    sizes, together, noises, weights = np.array(points).T
    return sizes, together, noises, weights


def likeliest(noise: float) -> float:
    """Return the largest log-likelihood of a measured coordinate, of deviation `noise`, mm, under any motion."""
    return -float(np.log(np.sqrt(2 * np.pi) * np.hypot(noise, MOTION.extra_noise_mm[0])))


def unrelated_likelihood(motion: FloatArray, extent: float) -> float:
    """Return the log-likelihood of displacements (n_markers, 3), mm, that are independent of each other.

    NaN are ignored; `extent`: largest extent of the body along an axis, mm.
    """
    values = motion[np.isfinite(motion)]
    wide = 0.35 * extent
    return float(np.sum(-0.5 * (values / wide) ** 2) - len(values) * (np.log(wide) + 0.5 * np.log(2 * np.pi)))


def _rigid_columns(arms: FloatArray, freedom: FloatArray, extent: float) -> tuple[list[FloatArray], FloatArray]:
    """Return the displacements of n markers by unit rigid motions: three translations and three rotations.

    `arms` (n, 3): reference places, mm; `freedom` (3, n): how freely the body can move at each place, 0 to 1, for three
    lengths of fading towards held nodes; `extent`: largest extent of the body along an axis, mm. Result: displacements
    (n, 3, 6) for each of these lengths, with axes marker, component, motion; and (n, 3, 6) for a body that moves as a
    whole.
    """
    centred = arms - arms.mean(axis=0)
    radius = max(float(np.sqrt(np.sum(centred**2, axis=1).mean())), 0.1 * extent)
    columns = np.zeros((len(arms), 3, 6))
    columns[:, :, :3] = np.eye(3)
    for axis, second, third in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        columns[:, second, 3 + axis] = -centred[:, third]
        columns[:, third, 3 + axis] = centred[:, second]
    local, whole = columns.copy(), columns.copy()
    local[:, :, 3:] /= radius
    whole[:, :, :3] *= MOTION.rigid_share * extent
    whole[:, :, 3:] *= MOTION.rigid_radian
    return [local * fade[:, None, None] for fade in freedom], whole


def _diagonal(
    arms: FloatArray,
    freedom: FloatArray,
    motion: FloatArray,
    columns: FloatArray,
    seen: BoolArray,
    lengths: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return a smooth motion of each length l in the frame of the eigenvectors of its covariance.

    `arms` (n_markers, 3): reference places, mm; `freedom` (n_markers,): how freely the body can move there, 0 to 1;
    `motion` (n_readings, n_markers, 3): displacements, mm; `columns` (n_markers, 3, c): displacements by c rigid
    motions; `seen` bool (n_markers, 3): the n coordinates that are used; `lengths` (l,): lengths over which a motion
    varies, mm. Result: eigenvalues (l, n), displacements (l, n, n_readings) and columns (l, n, c) in that frame.
    """
    gaps = np.sqrt(3.0) * np.linalg.norm(arms[:, None] - arms[None], axis=2) / lengths[:, None, None]
    covariance = (1.0 + gaps) * np.exp(-gaps) * freedom[:, None] * freedom[None]
    values, turned, mixed = [], [], []
    known: tuple[bytes, FloatArray, FloatArray] | None = None
    for axis in range(3):
        rows = seen[:, axis]
        if not rows.any():
            continue
        if known is None or known[0] != rows.tobytes():
            spectrum, vectors = np.linalg.eigh(covariance[:, rows][:, :, rows])
            known = rows.tobytes(), spectrum, np.swapaxes(vectors, 1, 2)
        values.append(np.maximum(known[1], 0.0))
        turned.append(known[2] @ motion[:, rows, axis].T)
        mixed.append(known[2] @ columns[rows, axis])
    return np.concatenate(values, axis=1), np.concatenate(turned, axis=1), np.concatenate(mixed, axis=1)


def _gaussian(variance: FloatArray, turned: FloatArray, columns: FloatArray, factors: FloatArray) -> FloatArray:
    """Return the log-density of a Gaussian N(v; 0, D + B B'), (l, h, n_readings), for h variances D of each length l.

    D = diag(variance), (l, h, n), mm^2; v = `turned`, displacements, (l, n, n_readings), mm; B = `columns` (l, n, c)
    times `factors` (h, c).
    """
    weighted = factors[:, :, None] * (np.swapaxes(columns, 1, 2)[:, None] / variance[:, :, None])
    n, n_readings = columns.shape[2], turned.shape[2]
    plain = (1.0 / variance) @ turned**2
    whole = np.eye(n) + (weighted @ columns[:, None]) * factors[:, None]
    w = weighted @ turned[:, None]
    if n_readings > MOTION.few_readings:
        lower = np.linalg.cholesky(whole)
        explained = np.sum((np.linalg.inv(lower) @ w) ** 2, axis=2)
    else:
        # Bordered by the readings, one Cholesky factor L has L^-1 w as well; the corner only has to be large enough.
        inner = np.zeros((*variance.shape[:2], n + n_readings, n + n_readings))
        inner[..., :n, :n], inner[..., n:, :n] = whole, np.swapaxes(w, 2, 3)
        inner[..., n:, n:] = (1.0 + np.einsum("lhcr,lhcr->lh", w, w))[..., None, None] * np.eye(n_readings)
        factor = np.linalg.cholesky(inner)
        lower, explained = factor[..., :n, :n], np.sum(factor[..., n:, :n] ** 2, axis=3)
    diagonal = np.diagonal(lower, axis1=2, axis2=3)
    logs = np.log(2 * np.pi * variance).sum(axis=2) + 2.0 * np.log(diagonal).sum(axis=2)
    return np.asarray(-0.5 * (plain - explained + logs[..., None]))


def log_mean_exp(values: FloatArray) -> FloatArray:
    """Return the logarithm of the mean of exp(values) along the first axis."""
    top = values.max(axis=0)
    return np.asarray(top + np.log(np.exp(values - top).mean(axis=0)))
