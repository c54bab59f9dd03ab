"""Tracks without a label, joined where one ends and another begins: a lost marker comes back with a new number."""

from typing import NamedTuple

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.io.recordings.recording import listed
from tissuereg.io.recordings.tracks import unique


class StitchSettings(NamedTuple):
    """When two tracks are one marker's.

    `sure`: probability that a link must have; `longest`: longest gap, in frames; `fewest`: pairs of places from which
    the motion over a gap is known, and most `samples` of a track; `floor_mm`: smallest standard deviation of a motion;
    `told`: most tracks that the notes name.
    """

    sure: float = 0.99
    longest: int = 200
    fewest: int = 30
    samples: int = 1000
    floor_mm: float = 0.01
    told: int = 20


STITCH = StitchSettings()


class _Part(NamedTuple):
    """A track: its number, its first and last frame, and its places there (3,), mm."""

    track: int
    begin: int
    end: int
    start: FloatArray
    stop: FloatArray


class Stitched(NamedTuple):
    """Names, places (n_frames, n, 3), mm, and notes of joined tracks; `numbered`: names that were made up for them."""

    names: list[str]
    places: FloatArray
    notes: list[str]
    numbered: tuple[str, ...] = ()


def stitched(names: list[str], places: FloatArray, loose: set[str]) -> Stitched:
    """Return names, places and notes after the tracks whose names are in `loose` were joined.

    A link's probability weighs the motion over the gap, by how far markers of this recording move in as many frames,
    against every other track that ended before and against a marker that is new. Joined ones are called U1, U2 ... in
    order of appearance; `names` and `places`: of all tracks.
    """
    rows = [i for i, name in enumerate(names) if name in loose]
    if not rows:
        return Stitched(names, places, [])
    parts = [part for i in rows if (part := _part(i, places[:, i])) is not None]
    parts.sort(key=lambda one: one.begin)
    motion = _Drift(places, parts)
    volume = float(np.prod(np.maximum(np.ptp(_finite(places), axis=0), 1.0))) if parts else 1.0
    chains, chance = _chains(parts, motion, volume)
    kept = [i for i in range(len(names)) if i not in rows]
    joined = [_merged(places, chain) for chain in chains]
    titles = unique([*(names[i] for i in kept), *(f"U{k + 1}" for k in range(len(chains)))])[len(kept) :]
    notes = [f"{len(parts)} unlabelled tracks were joined to {len(chains)} markers, called U1 to U{len(chains)}"]
    linked = [k for k, chain in enumerate(chains) if len(chain) > 1]
    for k in linked[: STITCH.told]:
        tracks = listed([names[one.track] for one in chains[k]])
        notes.append(f"{titles[k]}: {tracks}, all one marker with a probability of {100 * chance[k]:.1f} %")
    if len(linked) > STITCH.told:
        notes.append(f"and {len(linked) - STITCH.told} more joined tracks")
    stacked = np.stack([*(places[:, i] for i in kept), *joined], axis=1) if kept or joined else places[:, :0]
    return Stitched([*(names[i] for i in kept), *titles], stacked, notes, tuple(titles))


def _part(track: int, places: FloatArray) -> _Part | None:
    seen = np.flatnonzero(np.isfinite(places).all(axis=1))
    if not len(seen):
        return None
    return _Part(track, int(seen[0]), int(seen[-1]), places[seen[0]], places[seen[-1]])


def _finite(places: FloatArray) -> FloatArray:
    flat = places.reshape(-1, 3)
    return flat[np.isfinite(flat).all(axis=1)]


class _Drift:
    """How far markers of a recording move in a number of frames; computed once for each."""

    def __init__(self, places: FloatArray, parts: list[_Part]) -> None:
        self._places, self._parts = places, parts
        self._known: dict[int, float | None] = {}

    def over(self, gap: int) -> float | None:
        """Return the standard deviation of a coordinate's motion over a gap, mm; None where it is not known."""
        if gap not in self._known:
            self._known[gap] = self._measured(gap) if gap <= STITCH.longest else None
        return self._known[gap]

    def _measured(self, gap: int) -> float | None:
        tracks = [self._places[one.begin : one.end + 1, one.track] for one in self._parts]
        moved = [track[gap:] - track[:-gap] for track in tracks if len(track) > gap]
        # So many of each are enough: tracks may be long.
        found = _finite(np.concatenate([one[:: 1 + len(one) // STITCH.samples] for one in moved] or [np.empty((0, 3))]))
        return max(float(np.sqrt(np.mean(found**2))), STITCH.floor_mm) if len(found) >= STITCH.fewest else None


def _density(one: _Part, other: _Part, motion: _Drift) -> float:
    """Return how likely a marker is to go from the end of `one` to the beginning of `other`, 1/mm^3."""
    std = motion.over(other.begin - one.end) if one.end < other.begin else None
    if std is None:
        return 0.0
    away = float(np.sum((other.start - one.stop) ** 2)) / std**2
    return float(np.exp(-0.5 * away) / (np.sqrt(2.0 * np.pi) * std) ** 3)


def _chains(parts: list[_Part], motion: _Drift, volume: float) -> tuple[list[list[_Part]], list[float]]:
    """Return the tracks of each marker in the order of time, and the probability that all its links are right."""
    chains: list[list[_Part]] = []
    chance: list[float] = []
    for part in parts:
        ends = [_density(chain[-1], part, motion) for chain in chains]
        best = int(np.argmax(ends)) if ends else -1
        link = 0.0
        if best >= 0 and ends[best] > 0.0:
            # Tracks at the same time are not one marker's: they compete for the one that ended.
            last = chains[best][-1]
            rivals = [one for one in parts if last.end < one.begin <= part.end and one.end >= part.begin]
            claims = sum(_density(last, one, motion) for one in rivals)
            link = ends[best] / (max(sum(ends), claims) + 1.0 / volume)
        if link >= STITCH.sure:
            chains[best].append(part)
            chance[best] *= link
        else:
            chains.append([part])
            chance.append(1.0)
    return chains, chance


def _merged(places: FloatArray, chain: list[_Part]) -> FloatArray:
    merged = np.full_like(places[:, 0], np.nan)
    for part in chain:
        merged[part.begin : part.end + 1] = places[part.begin : part.end + 1, part.track]
    return merged
