"""How a pad's force on a rough mesh is carried into that on a fine one, where more than the load has acted on it."""

import numpy as np

from tissuereg._arrays import FloatArray

#: Frames whose force is less than this share of the largest tell no ratio.
LEAST_LOADED = 0.02

#: A map changes a force by no more than this share of it along and across: what differs more is no ratio.
MOST_CHANGED = 0.6


def force_maps(rough: FloatArray, fine: FloatArray) -> FloatArray:
    """Return matrices that carry forces on a rough mesh into those on a fine one.

    Parameters
    ----------
    rough, fine : ndarray of float64, shape (n_frames, 3)
        Elastic forces of one pad in one case, mN; NaN in frames without equilibrium.

    Returns
    -------
    ndarray of float64, shape (n_frames, 3, 3)
        ``map @ rough`` is ``fine`` in loaded frames, unless they differ by more than `MOST_CHANGED`. A frame without
        load has the map of the least loaded one; all are the identity where nothing is loaded.

    Notes
    -----
    A mesh is too stiff by a factor that hangs on how far the pad has moved. A relaxed force has the factor of the
    shape that the body is in: in a pull-back of the open example with relaxation (38 %) the forces so corrected are
    8 mN off, with the elastic difference of the frame 20 mN, of 1,784 mN; the noise is 5 mN.
    """
    size = np.linalg.norm(rough, axis=1)
    size[~np.isfinite(fine).all(axis=1)] = np.nan
    identity: FloatArray = np.tile(np.eye(3), (len(rough), 1, 1))
    if not np.nanmax(size, initial=0.0) > 0.0:
        return identity
    loaded = size > LEAST_LOADED * np.nanmax(size)
    least = int(np.argmin(np.where(loaded, size, np.inf)))
    taken = np.where(loaded, np.arange(len(rough)), least)
    before, after = rough[taken], fine[taken]
    power = (before**2).sum(axis=1)[:, None]
    ratio = (before * after).sum(axis=1)[:, None] / power
    along = np.clip(ratio, 1.0 - MOST_CHANGED, 1.0 + MOST_CHANGED)
    across = (after - ratio * before) / np.sqrt(power)
    across *= np.minimum(1.0, MOST_CHANGED / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300))
    turned = across[:, :, None] * (before / np.sqrt(power))[:, None, :]
    return np.asarray(along[:, :, None] * identity + turned)


def mapped(forces: FloatArray, maps: FloatArray) -> FloatArray:
    """Return forces (..., 3) carried by maps (..., 3, 3)."""
    return np.asarray(np.einsum("...j,...ij->...i", forces, maps))
