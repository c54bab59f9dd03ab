"""Events of bodies that are held elsewhere than the user states: at a part of the glued base, or above it too."""

from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial import ConvexHull

from loadfree.generator.bodies import read
from loadfree.generator.draw import Plan
from loadfree.generator.events import Bench
from loadfree.generator.solve import HeldBody

#: Bodies with a flat base in the plane z = 0.
BODIES = ("dome", "phantom", "hole")

#: What truly holds: an outer ring of the base, its middle, three patches of it, all of it and a band above.
SUPPORTS = ("ring", "middle", "patches", "band")

#: Contacts of one event of each pair, and of the other.
SIMPLE, OTHER = ("traction", "bonded"), ("sliding", "two", "gravity")

#: The band is on the outer skin, not in a hole: beyond this share of the base's outline.
OUTER_SHARE = 0.7


class Outline:
    """The base's outline: 0 at its middle, 1 on its rim."""

    def __init__(self, base):
        hull = ConvexHull(base[:, :2])
        low, high = base[:, :2].min(axis=0), base[:, :2].max(axis=0)
        self.middle, self.width = (low + high) / 2, (high - low).max()
        self.normals = hull.equations[:, :2]
        self.reach = -(hull.equations[:, 2] + self.normals @ self.middle)

    def share(self, places):
        """Return the share (n,) of the way from the middle to the rim at which places (n, 3) lie, seen from above."""
        return ((places[:, :2] - self.middle) @ self.normals.T / self.reach).max(axis=1)

    def at(self, share, angle):
        """Return the point (2,) at a share of the way to the rim, in a direction."""
        along = np.array([np.cos(angle), np.sin(angle)])
        return self.middle + share * along / (self.normals @ along / self.reach).max()


@dataclass(frozen=True)
class Support:
    """What truly holds a body; lengths in mm.

    Parameters
    ----------
    kind : str
        See `SUPPORTS`.
    inner, outer : float
        Shares of the outline between which the base is held.
    centres : tuple of tuple of float
        Middles (x, y) of patches.
    radius : float
        Of the patches.
    height : float
        Of the band.
    """

    kind: str
    inner: float = 0.0
    outer: float = 2.0
    centres: tuple = ()
    radius: float = 0.0
    height: float = 0.0

    @classmethod
    def drawn(cls, kind, outline, rng):
        """Return a support of a kind."""
        if kind == "ring":
            return cls(kind, inner=_short(rng.uniform(0.6, 0.8)))
        if kind == "middle":
            return cls(kind, outer=_short(rng.uniform(0.4, 0.6)))
        if kind == "band":
            return cls(kind, height=_short(outline.width * rng.uniform(0.08, 0.14)))
        turns = rng.uniform(0, 2 * np.pi) + 2 * np.pi / 3 * (np.arange(3) + rng.uniform(-0.15, 0.15, 3))
        centres = [outline.at(rng.uniform(0.45, 0.75), turn) for turn in turns]
        centres = tuple(tuple(_short(value) for value in centre) for centre in centres)
        return cls(kind, centres=centres, radius=_short(outline.width * rng.uniform(0.075, 0.11)))

    def holds(self, places, outline):
        """Return which places (n, 3) of the surface are held."""
        share, height = outline.share(places), places[:, 2]
        on_base = np.abs(height) < 1e-6
        if self.kind == "patches":
            off = np.linalg.norm(places[:, None, :2] - np.array(self.centres), axis=2).min(axis=1)
            return on_base & (off <= self.radius)
        if self.kind == "band":
            return on_base | ((height <= self.height) & (share > OUTER_SHARE))
        return on_base & (share >= self.inner) & (share <= self.outer)


class PartlyHeldBody(HeldBody):
    """A body held according to a function of surface places; contacts keep away from there and from the base."""

    def __init__(self, mesh, axis, holds):
        super().__init__(mesh, axis)
        surface = np.union1d(self.base_nodes, self.nodes_of(self.skin_facets))
        held = surface[holds(self.places[:, surface].T)]
        self.closed_nodes = np.union1d(self.base_nodes, held)
        self.base_nodes = held


@dataclass
class SupportPlan(Plan):
    """An event of a body that is held elsewhere than the user states."""

    support: str = "ring"

    @property
    def name(self):
        """What the file of the event is called."""
        return f"supports-{super().name}"

    @property
    def seed(self):
        """Seed of all draws of the event."""
        return [2221, BODIES.index(self.body), self.number]


def plans(body):
    """Return the plans of a body's events: two of each support, one with a simple contact; halves share them evenly."""
    found, which = [], BODIES.index(body)
    for number in range(2 * len(SUPPORTS)):
        place = number // 2
        simple = (which + place + number) % 2 == 0
        kind = SIMPLE[(place // 2 + which) % 2] if simple else OTHER[(place + which) % 3]
        found.append(SupportPlan(body, number, kind, support=SUPPORTS[place]))
    return found


class SupportBench(Bench):
    """The body of one event, held as it truly is."""

    def __init__(self, plan):
        stored = read(plan.body)
        self.outline = Outline(stored.nodes_mm[stored.fixed_nodes])
        self.support = Support.drawn(plan.support, self.outline, np.random.default_rng([*plan.seed, 1]))
        super().__init__(plan.body)

    def held(self, spots=()):
        """Return the data's body, held as it truly is, finer under spots."""
        return PartlyHeldBody(self.stored.data_mesh(spots), self.stored.axis, self.holds)

    def holds(self, places):
        """Return which places (n, 3) of the surface are held."""
        return self.support.holds(places, self.outline)

    def seen(self, reader, u):
        """Return displacements in mm by place: ``nodes``, ``pool``, ``targets``."""
        return self.read(reader, u)

    def _told(self, *event):
        return super()._told(*event) | {"support": asdict(self.support)}


def _short(value):
    return round(float(value), 4)
