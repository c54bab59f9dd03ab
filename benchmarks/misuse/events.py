"""Good events: markers on a body's skin or up to 6 mm off it, their true motion, noise, gaps; by body and number."""

from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import tissuereg as tr

DATA = Path(__file__).parent / "data"
BODIES = ("dome", "phantom", "slab", "beam", "ellipsoid")

_COUNTS, _MISUSED_COUNTS = (3, 4, 6, 10, 15, 15, 24, 40, 60), (8, 10, 15, 15, 20, 30)
_LAYOUTS = ("random", "spread", "cluster", "near the load")


@dataclass(frozen=True, eq=False)
class Event:
    """A body with markers as a user would give them.

    Attributes
    ----------
    nodes, tets, fixed : ndarray
        The mesh; `fixed` is None where nothing is held.
    reference, measured : ndarray of float64, shape (n_markers, 3)
        mm.
    std : float
        mm.
    """

    nodes: np.ndarray
    tets: np.ndarray
    fixed: "np.ndarray | None"
    reference: np.ndarray
    measured: np.ndarray
    std: float

    def but(self, **changes) -> "Event":
        """Return the event with other values."""
        return replace(self, **changes)

    def mesh(self) -> tr.Mesh:
        """Return the mesh that a user would make of it."""
        return tr.Mesh(self.nodes, self.tets, {} if self.fixed is None else {"fixed": self.fixed})

    def markers(self) -> tr.Markers:
        """Return the markers that a user would make of it."""
        return tr.Markers(self.reference, self.measured, self.std)


@cache
def stored(body: str) -> dict[str, np.ndarray]:
    with np.load(DATA / f"{body}.npz") as kept:
        return {name: kept[name].astype(np.int64 if kept[name].dtype == np.uint16 else np.float64) for name in kept}


def misusable(body: str, number: int) -> Event:
    """Return a good event that misuses start from: 8 to 30 markers, all seen, noise up to 0.5 mm."""
    rng = np.random.default_rng([22, 1, BODIES.index(body), number])
    kept = stored(body)
    return _draw(kept, number, rng, int(rng.choice(_MISUSED_COUNTS)), rng.choice(_LAYOUTS[:2]), noise=(0.05, 0.5))


def good(body: str, number: int) -> Event:
    """Return a good event: 3 to 60 markers in any layout, gaps, rounded numbers, free bodies that move rigidly."""
    rng = np.random.default_rng([22, 0, BODIES.index(body), number])
    kept = stored(body)
    event = _draw(kept, number, rng, int(rng.choice(_COUNTS)), rng.choice(_LAYOUTS), noise=(0.05, 1.0))
    measured = event.measured.copy()
    if rng.random() < 0.1:
        turn = Rotation.from_rotvec(np.deg2rad(rng.uniform(0, 40)) * _direction(rng)).as_matrix()
        middle = event.nodes.mean(axis=0)
        measured = (measured - middle) @ turn.T + middle + rng.uniform(0, 60) * _direction(rng)
        event = event.but(fixed=None)
    if rng.random() < 0.2:
        gone = rng.random(len(measured)) < 0.25
        single = rng.random(measured.shape) < 0.15
        measured[gone] = np.nan
        measured[single] = np.nan
    digits = rng.choice([1, 2, 3, 12])
    return event.but(reference=np.round(event.reference, digits), measured=np.round(measured, digits))


def _draw(kept, number, rng, count, layout, noise) -> Event:
    field, tilt = kept["displacement_mm"][number % 40], kept["tilt"][number % 40]
    rows = _layout(kept["place_mm"], field, layout, count, rng)
    height = rng.choice([0.0, rng.uniform(0, 6)]) * np.ones(count)
    if rng.random() < 0.3:
        height = rng.uniform(0, 6, count)
    std = float(np.exp(rng.uniform(*np.log(noise))))
    reference = kept["place_mm"][rows] + height[:, None] * kept["normal"][rows]
    moved = field[rows] + height[:, None] * tilt[rows]
    measured = reference + moved + std * rng.standard_normal((count, 3))
    return Event(kept["nodes_mm"], kept["tets"], kept["fixed_nodes"], reference, measured, std)


def _layout(places, field, layout, count, rng):
    """Return rows of the pool."""
    if layout == "random":
        return rng.choice(len(places), count, replace=False)
    if layout in ("cluster", "near the load"):
        size = np.linalg.norm(field, axis=1)
        centre = places[rng.integers(len(places)) if layout == "cluster" else int(np.argmax(size))]
        near = np.argsort(np.linalg.norm(places - centre, axis=1))
        return rng.permutation(rng.choice(near[: min(2 * count, len(places))], count, replace=False))
    rows = [int(rng.integers(len(places)))]
    while len(rows) < count:
        gaps = np.linalg.norm(places[:, None] - places[rows][None], axis=2).min(axis=1)
        rows.append(int(np.argmax(gaps)))
    return rng.permutation(rows)


def _direction(rng):
    vector = rng.standard_normal(3)
    return vector / np.linalg.norm(vector)
