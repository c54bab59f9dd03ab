"""Markers that are lost to a value of the tracker: python -m misuse.lost [--events N] [--swaps].

On every body, in good events of 8 to 30 markers, one marker (in every other event one in five) gets a value that
trackers write for a marker which they do not see, and one good marker is held out. Printed for each value: events,
answers that are trusted, trusted ones in which the held-out marker lies outside the region that holds it with 99.9 %,
and the farthest it is off in those, mm.
With ``--swaps`` two measured places are exchanged instead, and the answers that fit all others as without it counted.
"""

import argparse
import sys
import warnings

import numpy as np
from threadpoolctl import threadpool_limits

import tissuereg as tr
from misuse.events import BODIES, misusable

VALUES = {
    "nothing lost": None,
    "0, 0, 0": (0.0, 0.0, 0.0),
    "-9999.99": (-9999.99,) * 3,
    "bad float": (-3.697314e28,) * 3,
    "one constant place": (-212.417, 80.293, -931.88),
}


def lost(body: str, number: int, value: "tuple[float, ...] | None") -> tuple[bool, bool, float]:
    """Return whether the answer is trusted, whether the held-out marker is outside its region, and how far off, mm."""
    event = misusable(body, number)
    rng = np.random.default_rng([22, 4, BODIES.index(body), number])
    n_lost = 1 if number % 4 == 1 else max(1, len(event.measured) // 5)
    held_out, *rows = rng.permutation(len(event.measured))[: 1 + n_lost]
    measured = event.measured.copy()
    truth = measured[held_out].copy()
    measured[held_out] = np.nan
    if value is not None:
        measured[rows] = value
    result = tr.register(event.mesh(), event.but(measured=measured).markers(), settings=tr.RegisterSettings(threads=1))
    target = result.unseen[event.markers().names[held_out]]
    off = float(np.linalg.norm(target.mean - truth))
    return result.trust.ok, not target.region(0.999).contains(truth), off


def swapped(body: str, number: int) -> tuple[bool, bool]:
    """Return whether two exchanged markers are named, and whether they are used again where they were put back."""
    event = misusable(body, number)
    rng = np.random.default_rng([22, 5, BODIES.index(body), number])
    pair = rng.permutation(len(event.measured))[:2]
    measured = event.measured.copy()
    measured[pair] = measured[pair[::-1]]
    result = tr.register(event.mesh(), event.but(measured=measured).markers(), settings=tr.RegisterSettings(threads=1))
    named = sum(reason.startswith("swapped: ") for reason in result.trust.reasons) == 1
    right = np.allclose(result.all_markers.measured, event.measured)
    return named, right and not {event.markers().names[i] for i in pair} - set(result.markers.used)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--events", type=int, default=2, help="events of each body")
    parser.add_argument("--swaps", action="store_true", help="exchange two markers instead")
    options = parser.parse_args()
    numbers = range(1, 2 * options.events, 2)
    with threadpool_limits(limits=1), warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        if options.swaps:
            found = np.array([swapped(body, number) for body in BODIES for number in numbers])
            print(f"exchanged: {len(found)} events, named once {found[:, 0].sum()}, put back {found[:, 1].sum()}")
            return 0
        for name, value in VALUES.items():
            rows = [lost(body, number, value) for body in BODIES for number in numbers]
            bad = [off for trusted, outside, off in rows if trusted and outside]
            trusted = sum(row[0] for row in rows)
            print(f"{name}: {len(rows)} events, trusted {trusted}, outside {len(bad)}, {max(bad, default=0.0):.1f} mm")
    return 0


if __name__ == "__main__":
    sys.exit(main())
