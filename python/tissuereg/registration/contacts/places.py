"""Farthest-point sampling, smooth fields around the sampled places, and compact groups of places."""

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray


def smooth_fields(middles: FloatArray, count: int) -> FloatArray:
    """Return overlapping Gaussian fields, centred at places far from each other, scaled to a constant sum of squares.

    `middles` (n, 3): places at which the fields are evaluated, mm; `count`: largest number of fields. Result:
    (n_fields, n), dimensionless; their squares sum to one at every place.
    """
    from scipy.spatial import cKDTree

    chosen = far_apart(middles, min(count, len(middles)))
    places = middles[chosen]
    if len(places) < 2:
        return np.ones((1, len(middles)))
    gaps = np.asarray(cKDTree(places).query(places, k=2)[0])
    width = 0.8 * float(np.median(gaps[:, 1]))
    # One array for all steps: on a large body it is the largest of all.
    fields = np.asarray((-2.0 * places) @ middles.T)
    fields += np.sum(middles**2, axis=1)
    fields += np.sum(places**2, axis=1)[:, None]
    fields *= -0.5 / width**2
    np.exp(fields, out=fields)
    fields /= np.sqrt(np.einsum("fn,fn->n", fields, fields))
    return fields


def far_apart(places: FloatArray, count: int) -> IntArray:
    """Return the indices int64 (count,) of places, each the farthest from those before it; the first is in the middle.

    `places` (n, 3): mm; `count`: number of places to choose.
    """
    # Axis by axis: reductions over an axis of length three are slow.
    x, y, z = (np.ascontiguousarray(places[:, axis]) for axis in range(3))

    def away(place: FloatArray) -> FloatArray:
        return np.asarray(np.sqrt((x - place[0]) ** 2 + (y - place[1]) ** 2 + (z - place[2]) ** 2))

    chosen = [int(np.argmin(away(places.mean(axis=0))))]
    gap = away(places[chosen[0]])
    while len(chosen) < count:
        chosen.append(int(np.argmax(gap)))
        np.minimum(gap, away(places[chosen[-1]]), out=gap)
    return np.array(chosen, np.int64)


def gathered(places: FloatArray, weights: FloatArray, count: int, rounds: int = 5) -> IntArray:
    """Return the compact group of each place (Lloyd's algorithm, started from places far apart).

    `places` (n, 3): mm; `weights` (n,): weight of each place in the centre of its group; `count`: largest number of
    groups; `rounds`: number of iterations. Result: int64 (n,), 0 to the number of groups minus one; none is empty.
    """
    from scipy.spatial import cKDTree

    middles = places[far_apart(places, min(count, len(places)))]
    group = np.asarray(cKDTree(middles).query(places)[1])
    for _ in range(rounds):
        total = np.bincount(group, weights, len(middles))
        moved = np.stack([np.bincount(group, weights * along, len(middles)) for along in places.T], axis=1)
        middles = np.where(total[:, None] > 0.0, moved / np.maximum(total, 1e-300)[:, None], middles)
        group = np.asarray(cKDTree(middles).query(places)[1])
    return np.asarray(np.unique(group, return_inverse=True)[1], np.int64)
