"""Events that no load on the believed body explains: fibres along a body that is pulled, and a part that swells."""

from dataclasses import dataclass, replace

import numpy as np

from blind.generator.laws import Law
from blind.generator.memory import Memory
from blind.generator.solver import Physics
from loadfree.generator.draw import POISSON, YOUNG_KPA, Plan
from loadfree.generator.events import Bench
from loadfree.generator.solve import STEPS

BODIES = ("dome", "slab", "beam")

KINDS = ("fibres", "growth")

#: Events of each kind on a body: even and odd ones alternate.
N_EACH = 6

#: Stiffness of the fibres over the shear modulus, and the exponent of their law.
FIBRES, EXPONENT = (2.0, 10.0), 1.0

#: Linear strain of what swells or shrinks, and its radius over the body's smallest side.
STRAIN, RADIUS = (0.05, 0.2), (0.2, 0.4)


@dataclass
class InnerPlan(Plan):
    """An event of a body that is not as believed inside."""

    @property
    def name(self):
        """What the file of the event is called."""
        return f"inner-{super().name}"

    @property
    def seed(self):
        """Seed of all draws of the event."""
        return [2231, BODIES.index(self.body), self.number]


def plans(body):
    """Return the plans of a body's events, halves alike."""
    return [InnerPlan(body, number, KINDS[number // 2 % 2]) for number in range(2 * N_EACH)]


class InnerBench(Bench):
    """A body with fibres along it, or with a ball inside that grows with the load."""

    def acting(self, plan, rng):
        """Return a contact: with fibres a pad on the far third of the body, pulled along them."""
        if plan.kind == "growth":
            return [self.skin.contact(rng, "traction")], np.zeros(3), [1.0]
        along = np.eye(3)[self.stored.axis]
        reach = self.body.places.max(axis=1) @ along
        while True:
            contact = self.skin.contact(rng, "bonded")
            if np.dot(contact.centre, along) > 0.65 * reach:
                break
        pulled = along + 0.3 * rng.standard_normal(3)
        return [replace(contact, direction=tuple(pulled / np.linalg.norm(pulled)))], np.zeros(3), [1.0]

    def physics(self, plan, rng):
        """Return the truth's physics, and write what it is to ``plan.truth``."""
        self.ball = None
        if plan.kind == "fibres":
            stiffness = float(np.exp(rng.uniform(*np.log(FIBRES))))
            along = np.eye(3)[self.stored.axis] + 0.15 * rng.standard_normal(3)
            shape = {"k1": stiffness, "k2": EXPONENT, "tension_only": False}
            plan.truth = {"law": "fibre", "shape": shape, "direction": np.round(along, 6).tolist()}
            return Physics(young=YOUNG_KPA, poisson=POISSON, law=Law("fibre", shape, tuple(along)))
        flat = self.body.points.reshape(-1, 3)
        centre = flat[rng.choice(len(flat), p=self.body.dx.ravel() / self.body.dx.sum())]
        strain = float(rng.choice([-1.0, 1.0]) * rng.uniform(*STRAIN))
        self.ball = np.round(centre, 6), float(self.skin.thickness * rng.uniform(*RADIUS)), strain
        plan.truth = dict(zip(("ball_centre_mm", "ball_radius_mm", "strain"), self.ball, strict=True))
        plan.truth["ball_centre_mm"] = plan.truth["ball_centre_mm"].tolist()
        return Physics(young=YOUNG_KPA, poisson=POISSON, memory=Memory(growth=self.grown))

    def grown(self, time):
        """Return the linear strain at the points of the body at hand; it grows by steps, as the load does."""
        centre, radius, strain = self.ball
        inside = np.linalg.norm(self.at_hand.points - centre, axis=-1) < radius
        return strain * min(time / len(STEPS), 1.0) * inside

    def body_under(self, contacts):
        """Return the data's body, finer under contacts; growth is of its points."""
        self.at_hand = super().body_under(contacts)
        return self.at_hand
