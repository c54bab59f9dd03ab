"""Which events there are: kinds and model differences in equal shares over both halves, the rest drawn from a seed."""

from dataclasses import dataclass, field

import numpy as np
from scipy.spatial import KDTree

from blind.generator.laws import Law
from blind.generator.solver import Physics
from loadfree.generator.bodies import BODIES
from loadfree.generator.contacts import PROFILES, Contact

KINDS = ("traction", "bonded", "sliding", "two", "gravity")
DIFFERENCES = ("poisson", "ball", "young", "law")
N_EVENTS = 40

#: What a user believes.
YOUNG_KPA, POISSON = 10.0, 0.45

#: Largest displacement in mm: log-uniform, and the share of larger events.
MOTION_MM, LARGE_MM, LARGE_SHARE = (2.0, 15.0), (15.0, 25.0), 0.07


@dataclass
class Plan:
    """What an event is, before its contacts are placed."""

    body: str
    number: int
    kind: str
    difference: str | None = None
    truth: dict = field(default_factory=dict)

    @property
    def name(self):
        """What the file of the event is called."""
        return f"{self.body}-{self.number:02d}"

    @property
    def seed(self):
        """Seed of all draws of the event."""
        return [2211, BODIES.index(self.body), self.number]


def plans(body):
    """Return the plans of a body's events: per half every kind four times, two of them with another model."""
    found = [None] * N_EVENTS
    which = BODIES.index(body)
    for half in (0, 1):
        rows = []
        for k, kind in enumerate(KINDS):
            first = (2 * (k + half) + which) % 4
            rows += [(kind, None), (kind, None), (kind, DIFFERENCES[first]), (kind, DIFFERENCES[(first + 1) % 4])]
        for place, row in enumerate(np.random.default_rng([2210, which, half]).permutation(len(rows))):
            found[2 * place + half] = Plan(body, 2 * place + half, *rows[row])
    return found


def largest_mm(rng):
    """Return a largest displacement."""
    low, high = LARGE_MM if rng.uniform() < LARGE_SHARE else MOTION_MM
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


class Skin:
    """The free surface of the data's body, as points to put contacts on."""

    def __init__(self, body):
        surface = body.surface(body.skin_facets, 1)
        self.points, self.normals = surface.points[:, 0], surface.normals[:, 0]
        self.area = surface.dx.sum(axis=1)
        self.base = KDTree(body.places[:, body.closed_nodes].T)
        low, high = body.places.min(axis=1), body.places.max(axis=1)
        self.extent, self.thickness = (high - low).max(), (high - low).min()

    def contact(self, rng, kind, away=None):
        """Return a contact of a kind; `away`: contacts that it must not touch."""
        widest = min(25.0, 0.25 * self.extent, 0.55 * self.thickness)
        radius = float(np.exp(rng.uniform(np.log(6.0), np.log(widest))))
        round_ = rng.uniform() < 0.6
        radii = (radius, radius) if round_ else (radius, radius * rng.uniform(0.5, 0.8))
        for _ in range(1000):
            place = rng.choice(len(self.points), p=self.area / self.area.sum())
            centre = self.points[place]
            if self.base.query(centre)[0] < 1.1 * radius + 3.0:
                continue
            if all(np.linalg.norm(centre - other.centre) > 1.1 * (radius + max(other.radii)) for other in away or ()):
                break
        normal = self._normal(centre, self.normals[place], radius)
        side = np.cross(normal, rng.normal(size=3))
        side /= np.linalg.norm(side)
        return Contact(
            kind,
            _rounded(centre),
            _rounded(normal),
            _rounded(side),
            _rounded(radii),
            _rounded(self._direction(rng, kind, normal)),
            str(rng.choice(PROFILES)),
            _rounded(0.5 / radius * rng.uniform(0, 0.6) * _unit(rng) if kind == "bonded" else np.zeros(3)),
        )

    def _normal(self, centre, there, radius):
        near = (np.linalg.norm(self.points - centre, axis=1) < 0.6 * radius) & (self.normals @ there > 0.5)
        mean = there * 1e-6 + (self.area[near, None] * self.normals[near]).sum(axis=0)
        return mean / np.linalg.norm(mean)

    @staticmethod
    def _direction(rng, kind, normal):
        """Within 60 degrees of the normal, evenly over the cap; push or pull; a sliding pad mostly pushes."""
        if kind == "sliding":
            return normal * (1.0 if rng.uniform() < 0.2 else -1.0)
        side = np.cross(normal, _unit(rng))
        side /= np.linalg.norm(side)
        rise = rng.uniform(0.5, 1.0)
        direction = rise * normal + np.sqrt(1 - rise**2) * side
        return direction * rng.choice([-1.0, 1.0])


def acting(plan, skin, rng):
    """Return contacts, the direction of the weight and the shares of motion of an event's plan."""
    kind = plan.kind
    if kind == "two":
        kinds = rng.choice(KINDS[:3], size=2)
        first = skin.contact(rng, str(kinds[0]))
        return [first, skin.contact(rng, str(kinds[1]), [first])], np.zeros(3), [1.0, rng.uniform(0.5, 1.0)]
    if kind == "gravity":
        return [skin.contact(rng, "traction")], _unit(rng), [rng.uniform(0.25, 0.6), 1.0]
    return [skin.contact(rng, kind)], np.zeros(3), [1.0]


def physics(plan, skin, body, rng):
    """Return the truth's physics; differences from the believed model are written to ``plan.truth``."""
    if plan.difference == "poisson":
        plan.truth = {"poisson": float(rng.choice([0.42, 0.47]))}
    elif plan.difference == "young":
        plan.truth = {"young_kpa": 1.3 * YOUNG_KPA}
    elif plan.difference == "law":
        name, shape = [("fung", {"b": 3.0}), ("fung_split", {"b": 3.0}), ("gent", {"limit": 0.6})][rng.integers(3)]
        plan.truth = {"law": name, "shape": shape}
        return Physics(young=YOUNG_KPA, poisson=POISSON, law=Law(name, shape))
    elif plan.difference == "ball":
        radius = skin.extent * rng.uniform(0.12, 0.18)
        radius = min(radius, 0.45 * skin.thickness)
        flat = body.points.reshape(-1, 3)
        centre = flat[rng.choice(len(flat), p=body.dx.ravel() / body.dx.sum())]
        plan.truth = {"ball_centre_mm": _rounded(centre), "ball_radius_mm": float(radius), "ball_factor": 5.0}
        return Physics(
            young=YOUNG_KPA,
            poisson=POISSON,
            contrast=lambda points: np.where(np.linalg.norm(points - centre, axis=-1) < radius, 5.0, 1.0),
        )
    return Physics(young=plan.truth.get("young_kpa", YOUNG_KPA), poisson=plan.truth.get("poisson", POISSON))


def _unit(rng):
    direction = rng.normal(size=3)
    return direction / np.linalg.norm(direction)


def _rounded(values):
    return tuple(float(v) for v in np.round(values, 6))
