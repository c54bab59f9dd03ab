"""Forty ways to misread the input, each with the kinds of suspicion that name it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from misuse.events import BODIES, Event, stored
from tissuereg.body.closest import ClosestTriangles

Change = Callable[[Event, np.random.Generator], Event]


@dataclass(frozen=True)
class Misuse:
    """One mistake.

    Attributes
    ----------
    title : str
        For the table.
    change : callable
        Event and generator in, misread event out.
    named : set of str
        Kinds of suspicion that name the reason.
    """

    title: str
    change: Change
    named: frozenset[str]


def scaled(factor: float, what: str) -> Change:
    def change(event, rng):
        x = event.reference * (factor if what != "measured" else 1.0)
        y = event.measured * (factor if what != "reference" else 1.0)
        return event.but(reference=x, measured=y)

    return change


def turned(order: str, signs: str, what: str) -> Change:
    columns, factors = ["xyz".index(axis) for axis in order], [-1.0 if s == "-" else 1.0 for s in signs]

    def change(event, rng):
        x = event.reference[:, columns] * factors if what != "measured" else event.reference
        y = event.measured[:, columns] * factors if what != "reference" else event.measured
        return event.but(reference=x, measured=y)

    return change


def moved(what: str, shift: bool, turn: bool) -> Change:
    def change(event, rng):
        direction, axis = (v / np.linalg.norm(v) for v in rng.standard_normal((2, 3)))
        rotation = Rotation.from_rotvec(np.deg2rad(rng.uniform(5, 30) if turn else 0.0) * axis)
        step = rng.uniform(5, 40) * direction if shift else np.zeros(3)
        points = getattr(event, what)
        middle = points.mean(axis=0)
        return event.but(**{what: rotation.apply(points - middle) + middle + step})

    return change


def mesh_scaled(factor: float) -> Change:
    return lambda event, rng: event.but(nodes=event.nodes * factor)


def mirrored_mesh(event, rng):
    return event.but(nodes=event.nodes * (-1.0, 1.0, 1.0), tets=event.tets[:, [0, 2, 1, 3]])


def swapped(what: str) -> Change:
    def change(event, rng):
        rows = getattr(event, what).copy()
        i, j = rng.choice(len(rows), 2, replace=False)
        rows[[i, j]] = rows[[j, i]]
        return event.but(**{what: rows})

    return change


def rolled(event, rng):
    return event.but(measured=np.roll(event.measured, int(rng.choice([1, -1])), axis=0))


def ordered(event, rng):
    return event.but(measured=event.measured[np.argsort(event.measured[:, rng.integers(3)])])


def other_organ(event, rng):
    sizes = [len(stored(body)["nodes_mm"]) for body in BODIES]
    others = [body for body, n in zip(BODIES, sizes, strict=True) if n != len(event.nodes)]
    kept = stored(str(rng.choice(others)))
    rows = rng.choice(len(kept["place_mm"]), len(event.reference), replace=False)
    x = kept["place_mm"][rows]
    y = x + kept["displacement_mm"][rng.integers(40)][rows] + event.std * rng.standard_normal(x.shape)
    return event.but(reference=x, measured=y)


def stale(share: float) -> Change:
    def change(event, rng):
        rows = rng.choice(len(event.reference), max(1, round(share * len(event.reference))), replace=False)
        measured = event.measured.copy()
        measured[rows] = event.reference[rows]
        return event.but(measured=measured)

    return change


def copied(event, rng):
    measured = event.measured.copy()
    i, j = rng.choice(len(measured), 2, replace=False)
    measured[i] = measured[j]
    return event.but(measured=measured)


def listed_twice(again: bool) -> Change:
    def change(event, rng):
        row = int(rng.integers(len(event.reference)))
        noise = event.std * rng.standard_normal(3) if again else 0.0
        return event.but(
            reference=np.vstack([event.reference, event.reference[row]]),
            measured=np.vstack([event.measured, event.measured[row] + noise]),
        )

    return change


def columns_moved(event, rng):
    six = np.roll(np.hstack([event.reference, event.measured]), int(rng.choice([1, -1])), axis=1)
    return event.but(reference=six[:, :3], measured=six[:, 3:])


def column_moved(event, rng):
    measured, axis = event.measured.copy(), rng.integers(3)
    measured[:, axis] = np.roll(measured[:, axis], int(rng.choice([1, -1])))
    return event.but(measured=measured)


def on_the_base(event, rng):
    """Three markers on held surface, in a body whose whole support slides by 8 to 20 mm under them alone."""
    body = next(name for name in BODIES if len(stored(name)["nodes_mm"]) == len(event.nodes))
    places = stored(body)["held_place_mm"]
    places = places[rng.choice(len(places), 3, replace=False)]
    direction = rng.standard_normal(3)
    step = rng.uniform(8, 20) * direction / np.linalg.norm(direction)
    return event.but(
        reference=np.vstack([event.reference, places]),
        measured=np.vstack([event.measured, places + step + event.std * rng.standard_normal((3, 3))]),
    )


def _misuse(title: str, change: Change, *named: str) -> Misuse:
    return Misuse(title, change, frozenset(named))


MISUSES = [
    _misuse("all markers in metres", scaled(0.001, "all"), "unit"),
    _misuse("all markers in centimetres", scaled(0.1, "all"), "unit"),
    _misuse("all markers in micrometres", scaled(1000.0, "all"), "unit"),
    _misuse("all markers in inches", scaled(1 / 25.4, "all"), "unit"),
    _misuse("measured in metres", scaled(0.001, "measured"), "unit"),
    _misuse("measured in centimetres", scaled(0.1, "measured"), "unit"),
    _misuse("reference in metres", scaled(0.001, "reference"), "unit"),
    _misuse("reference in centimetres", scaled(0.1, "reference"), "unit"),
    _misuse("mesh in centimetres", mesh_scaled(0.1), "unit"),
    _misuse("mesh in metres", mesh_scaled(0.001), "unit"),
    _misuse("all: x, y negated (LPS, RAS)", turned("xyz", "--+", "all"), "frame"),
    _misuse("measured: x, y negated", turned("xyz", "--+", "measured"), "frame"),
    _misuse("reference: x, y negated", turned("xyz", "--+", "reference"), "frame"),
    _misuse("all: x negated", turned("xyz", "-++", "all"), "frame", "mirrored"),
    _misuse("all: z negated", turned("xyz", "++-", "all"), "frame", "mirrored"),
    _misuse("measured: x negated", turned("xyz", "-++", "measured"), "frame", "mirrored"),
    _misuse("all: columns y x z", turned("yxz", "+++", "all"), "frame"),
    _misuse("all: columns z x y", turned("zxy", "+++", "all"), "frame"),
    _misuse("measured: columns y x z", turned("yxz", "+++", "measured"), "frame"),
    _misuse("reference: columns z x y", turned("zxy", "+++", "reference"), "frame"),
    _misuse("mirrored mesh", mirrored_mesh, "frame", "mirrored"),
    _misuse("reference shifted 5 to 40 mm", moved("reference", True, False), "rigid motion"),
    _misuse("reference turned 5 to 30 degrees", moved("reference", False, True), "rigid motion"),
    _misuse("reference shifted and turned", moved("reference", True, True), "rigid motion"),
    _misuse("measured shifted 5 to 40 mm", moved("measured", True, False), "rigid motion"),
    _misuse("measured turned 5 to 30 degrees", moved("measured", False, True), "rigid motion"),
    _misuse("measured shifted and turned", moved("measured", True, True), "rigid motion"),
    _misuse("two measured rows exchanged", swapped("measured"), "swapped"),
    _misuse("two reference rows exchanged", swapped("reference"), "swapped"),
    _misuse("measured rows moved by one", rolled, "swapped"),
    _misuse("measured rows sorted by a coordinate", ordered, "swapped"),
    _misuse("markers of another organ", other_organ, "far from the surface", "rigid motion"),
    _misuse("measured is the reference, all markers", stale(1.0), "stale"),
    _misuse("measured is the reference, a third", stale(1 / 3), "stale"),
    _misuse("one marker's measurement given to another", copied, "repeated"),
    _misuse("marker listed twice", listed_twice(False), "repeated"),
    _misuse("place listed twice, measured twice", listed_twice(True), "repeated"),
    _misuse("six columns moved by one", columns_moved, "columns"),
    _misuse("one measured column moved by a row", column_moved, "columns"),
    _misuse("markers on held surface that move", on_the_base, "held"),
]


def alike(before: Event, after: Event) -> bool:
    """Return whether geometry cannot detect it: places keep their distance from the surface, motions their size.

    Within 2 mm of the surface and with the same motion between the same neighbours; exchanged markers that lie within
    3 mm and the noise of each other; markers of another body that all lie within 6 mm of this one's surface.
    """
    if _other_places(before, after):
        return bool(np.max(off_surface(after)) < 6.0)
    if (
        len(after.reference) != len(before.reference)
        or np.ptp(after.nodes) < 0.5 * np.ptp(before.nodes)
        or not np.isfinite(after.measured).all()
    ):
        return False
    if (after.measured == after.reference).all(axis=1).any():
        return False
    changed = np.abs(np.vstack([after.reference - before.reference, after.measured - before.measured])).max()
    if np.allclose(after.nodes, before.nodes) and 0 < changed < 3.0 + 3.0 * before.std:
        return True
    sizes = [np.linalg.norm(e.measured - e.reference, axis=1) for e in (before, after)]
    pairs = [np.linalg.norm(e.reference[:, None] - e.reference[None], axis=2) for e in (before, after)]
    if not (np.allclose(*sizes, atol=1e-6) and np.allclose(*pairs, atol=1e-6)):
        return False
    off = [off_surface(e) for e in (before, after)]
    return bool(np.max(off[1] - off[0]) < 2.0)


def _other_places(before: Event, after: Event) -> bool:
    """Return whether the markers are those of another body."""
    own = stored(next(name for name in BODIES if len(stored(name)["nodes_mm"]) == len(before.nodes)))["place_mm"]
    others = np.concatenate([stored(name)["place_mm"] for name in BODIES if stored(name)["place_mm"] is not own])
    return bool(np.isin(after.reference, others).all())


def off_surface(event: Event) -> np.ndarray:
    """Return unsigned distances of the reference places from the surface, mm."""
    mesh = event.mesh()
    return ClosestTriangles(mesh.nodes[mesh.surface]).find(event.reference).distances
