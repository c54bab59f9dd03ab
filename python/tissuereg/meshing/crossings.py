"""Triangles of a surface that intersect each other."""

from collections.abc import Iterator

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.triangles import Triangles
from tissuereg.meshing.settings import MESHING


def crossing_pairs(surface: Triangles) -> IntArray | None:
    """Return the pairs of triangles, as indices (n_pairs, 2), that intersect: an edge of one passes through the other.

    The surface's vertices must have been merged; triangles that touch, or lie in one plane, do not count. Return None
    if more than `MESHING.most_pairs` pairs would have to be tested. Method: bounding boxes are assigned to strips along
    one axis and sorted along another; those that overlap are tested. 300,000 triangles of like size take about ten
    seconds.
    """
    corners = surface.corners
    low, high = corners.min(axis=1), corners.max(axis=1)
    # Along the sweep's axis boxes are sorted, along the strips' axis they are shared out to strips.
    extent = np.ptp(corners.reshape(-1, 3), axis=0)
    ratio = (high - low).mean(axis=0) / np.maximum(extent, 1e-12 * extent.max())
    sweep, strips = np.argsort(ratio, kind="stable")[:2]
    member, strip = _in_strips(low[:, strips], high[:, strips])
    offset = 2.0 * strip * np.ptp(corners[..., sweep])
    order = np.argsort(offset + low[member, sweep], kind="stable")
    member, offset = member[order], offset[order]
    begin, end = offset + low[member, sweep], offset + high[member, sweep]
    after = np.maximum(np.searchsorted(begin, end, side="right") - np.arange(len(order)) - 1, 0)
    if after.sum() > MESHING.most_pairs:
        return None
    found = [np.empty((0, 2), np.int64)]
    for first, second in _blocks(after):
        a, b = member[first], member[second]
        near = ((low[a] <= high[b]) & (low[b] <= high[a])).all(axis=1)
        a, b = a[near], b[near]
        crossing = _cross(corners[a], corners[b])
        found.append(np.sort(np.stack([a[crossing], b[crossing]], axis=1), axis=1))
    return np.unique(np.concatenate(found), axis=0)


def _in_strips(low: FloatArray, high: FloatArray) -> tuple[IntArray, IntArray]:
    """Return all pairs of a triangle and a strip of space that it reaches into, as two index arrays (n_pairs,).

    `low`, `high` (m,): extent of each triangle, in mm, along the axis that the strips divide.
    """
    span = float(high.max() - low.min())
    width = max(MESHING.strip * float((high - low).mean()), span / MESHING.most_strips)
    first, last = (((bound - low.min()) // width).astype(np.int64) for bound in (low, high))
    count = last - first + 1
    member = np.repeat(np.arange(len(low)), count)
    return member, first[member] + np.arange(len(member)) - np.repeat(np.cumsum(count) - count, count)


def _blocks(after: IntArray) -> Iterator[tuple[IntArray, IntArray]]:
    """Yield all pairs of a row and one of the rows that follow it, in blocks of two equally long index arrays.

    `after` (m,): number of the rows directly after it with which each row is paired.
    """
    ends = np.cumsum(after)
    start = 0
    while start < len(after):
        before = ends[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(ends, before + MESHING.block, side="right")))
        count = after[start:stop]
        first = np.repeat(np.arange(start, stop), count)
        step = np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
        yield first, first + 1 + step
        start = stop


def _cross(one: FloatArray, other: FloatArray) -> BoolArray:
    """Return a mask (n,) of the pairs of triangles that intersect; `one`, `other` (n, 3, 3): their corners, mm."""
    size = np.maximum(np.ptp(one, axis=1).max(axis=1), np.ptp(other, axis=1).max(axis=1))
    nought = MESHING.nought * size**3
    crossing = np.zeros(len(one), bool)
    for edges_of, through in ((one, other), (other, one)):
        for k in range(3):
            crossing |= _passes(edges_of[:, k], edges_of[:, (k + 1) % 3], through, nought)
    return crossing


def _passes(start: FloatArray, end: FloatArray, through: FloatArray, nought: FloatArray) -> BoolArray:
    """Return a mask (n,) of the segments that pass through the inside of a triangle each.

    `start`, `end` (n, 3): ends of the segments, mm; `through` (n, 3, 3): corners of the triangle that belongs to each
    segment, mm; `nought` (n,): six times the volume in mm^3 below which a tetrahedron counts as flat.
    """
    a, b, c = (through[:, i] for i in range(3))
    before, behind = _volume(start, a, b, c), _volume(end, a, b, c)
    apart = (before * behind < 0) & (np.abs(before) > nought) & (np.abs(behind) > nought)
    sides = np.stack([_volume(start, end, a, b), _volume(start, end, b, c), _volume(start, end, c, a)])
    return np.asarray(apart & ((sides > nought).all(axis=0) | (sides < -nought).all(axis=0)))


def _volume(a: FloatArray, b: FloatArray, c: FloatArray, d: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a))
