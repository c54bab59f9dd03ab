"""Suspicions that the input is misread, as sentences that start with the kind of mistake."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.registration.readings.settings import COSTS
from tissuereg.registration.readings.weigh import Weighed

#: Odds are stated up to this power of ten.
_MOST_DIGITS = 9


@dataclass(frozen=True, eq=False)
class Suspicion:
    """One reason to suspect that the input is misread.

    Attributes
    ----------
    kind : str
        ``unit``, ``frame``, ``mirrored``, ``rigid motion``, ``swapped``, ``columns``, ``far from the surface``,
        ``places``, ``unrelated``, ``stale``, ``repeated`` or ``held``.
    sentence : str
        The reason; it starts with the kind.
    markers : tuple of str
        Names of the markers concerned; empty = all.
    measured : ndarray of float64, shape (n, 3), or None
        Measured places of these markers in their right order, mm, if that they were exchanged is certain.
    """

    kind: str
    sentence: str
    markers: tuple[str, ...] = ()
    measured: FloatArray | None = None


def explained(plain: Weighed, best: Weighed, others: Sequence[Weighed], names: tuple[str, ...]) -> Suspicion:
    """Return the suspicion that another reading (interpretation) of the input is right.

    `plain`, `best`: the input as given, and the reading that beats it; `others`: all readings that were evaluated, to
    list those that fit equally well; `names`: names of all markers.
    """
    reading = best.reading
    facts = []
    if reading.places is not plain.reading.places:
        facts.append(
            f"the reference places then lie {_typical(best.distance)} mm from the surface instead of "
            f"{_typical(plain.distance)} mm"
        )
    if reading.places is plain.reading.places or best.of_motion > plain.of_motion + 3.0:
        facts.append(f"the markers then move by {_size(best.motion)} mm instead of {_size(plain.motion)} mm")
    rivals = [w for w in others if not np.array_equal(w.reading.motion, reading.motion, equal_nan=True)]
    ties = sorted(
        (w for w in rivals if w.total > best.total - COSTS.tie and w.reading.kind == reading.kind),
        key=lambda w: -w.total,
    )
    also = f"; as good: {ties[0].reading.words}" if ties else ""
    sentence = f"{reading.kind}: {reading.words} fit better: {' and '.join(facts)} ({_odds(best, plain)}){also}"
    rows, measured = list(reading.rows), None
    next_best = max([plain.total + COSTS.margin, *(w.total for w in rivals)])
    if reading.kind == "swapped" and best.total > next_best + COSTS.margin:
        measured = (reading.places + reading.motion)[rows]
    return Suspicion(reading.kind, sentence, tuple(names[i] for i in rows), measured)


def far(names: Sequence[str], distance: Sequence[float], extent: float) -> Suspicion:
    """Return the suspicion that markers lie off the surface and no reading of the input explains it.

    `names`: the markers; `distance` (n,): distances of each from the surface, mm; `extent`: of the body, mm.
    """
    farthest = int(np.argmax(distance))
    sentence = (
        f"far from the surface: {listed(names)} {_be(names)} up to {distance[farthest]:.1f} mm ({names[farthest]}) "
        f"away from a body of extent {extent:.0f} mm, and no other unit, frame or rigid motion explains the places"
    )
    return Suspicion("far from the surface", sentence, tuple(names))


def unrelated(motion: FloatArray) -> Suspicion:
    """Return the suspicion that measured and reference places are unrelated; motion in mm, NaN = not seen."""
    sentence = (
        f"unrelated: neighbouring markers move by {_size(motion)} mm in directions of their own, as no one body can; "
        "measured and reference places belong to different markers or bodies"
    )
    return Suspicion("unrelated", sentence)


def stale(names: Sequence[str]) -> Suspicion:
    """Return the suspicion that the measured places of the markers `names` are copies of the reference places."""
    sentence = (
        f"stale: {listed(names)} {_be(names)} measured exactly at the reference place, to the last digit; "
        "a tracker that sees a marker has noise, so this is an old or a copied value"
    )
    return Suspicion("stale", sentence, tuple(names))


def repeated(names: Sequence[str], what: str) -> Suspicion:
    """Return the suspicion that two markers have the same numbers; `what` is "reference", "measured" or "both"."""
    places = {
        "both": "reference place and the same measured place",
        "reference": "reference place",
        "measured": "measured place",
    }
    sentence = f"repeated: {listed(names)} have the same {places[what]}, to the last digit; one marker is listed twice"
    return Suspicion("repeated", sentence, tuple(names))


def held(names: Sequence[str], size: float) -> Suspicion:
    """Return the suspicion that the markers `names`, which are on held surface, move, by up to `size` mm."""
    sit, move = ("sit", "move") if len(names) > 1 else ("sits", "moves")
    sentence = (
        f"held: {listed(names)} {sit} on surface that is held and yet {move} by up to {size:.1f} mm; "
        "the support has slipped or the held nodes are wrong"
    )
    return Suspicion("held", sentence, tuple(names))


def listed(names: Sequence[str]) -> str:
    """Return the names of markers as words; of many, the first few and the number of the others."""
    shown = ", ".join(names[:4])
    more = f" and {len(names) - 4} more" if len(names) > 4 else ""
    return f"{'markers' if len(names) > 1 else 'marker'} {shown}{more}"


def _be(names: Sequence[str]) -> str:
    return "are" if len(names) > 1 else "is"


def _odds(best: Weighed, plain: Weighed) -> str:
    digits = int((best.total - plain.total) / np.log(10.0))
    return f"odds 1e{digits} to 1" if digits <= _MOST_DIGITS else f"odds above 1e{_MOST_DIGITS} to 1"


def _typical(distance: FloatArray) -> str:
    return f"{np.sqrt(np.mean(distance**2)):.3g}"


def _size(motion: FloatArray) -> str:
    values = motion[np.isfinite(motion)]
    return f"{np.sqrt(3.0 * np.mean(values**2)) if len(values) else 0.0:.3g}"
