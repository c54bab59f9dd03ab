"""One event: drawn, solved, read at the user's nodes, the pool and the inner targets."""

import json

import numpy as np

from loadfree.generator.bodies import read
from loadfree.generator.draw import YOUNG_KPA, Skin, acting, largest_mm, physics
from loadfree.generator.places import interpolation
from loadfree.generator.solve import HeldBody, TooHardError, prepare, solve

#: This share of the pool's places must move by more than this (mm): otherwise the markers would be uninformative.
MOVING_SHARE, MOVING_MM = 0.15, 0.3

#: Draws of an event until one can be solved and moves markers.
N_DRAWS = 12


#: Longest edges under a contact, of its smallest radius, and at least, mm.
EDGE_SHARE, EDGE_MM = 0.6, 3.5


class Bench:
    """A body on which events are drawn and solved."""

    def __init__(self, name):
        self.stored = read(name)
        self.body = self.held()
        self.skin = Skin(self.body)

    def held(self, spots=()):
        """Return the data's body, its base glued, finer under spots: see `Stored.data_mesh`."""
        return HeldBody(self.stored.data_mesh(spots), self.stored.axis)

    def run(self, plan):
        """Return the arrays of an event and what it is; draws again where it fails or moves no marker."""
        rng = np.random.default_rng(plan.seed)
        for draw in range(N_DRAWS):
            contacts, weight, shares = self.acting(plan, rng)
            truth = self.physics(plan, rng)
            start = prepare(self.body_under(contacts), truth, contacts, tuple(weight), shares, largest_mm(rng))
            run, reader = start.run, self.reader(start.run.body)
            try:
                if self.moves_markers(self.seen(reader, start.linear)):
                    solve(start)
                    fields = self.seen(reader, run.u)
                    if self.moves_markers(fields):
                        return fields, self._told(plan, contacts, weight, start, draw)
            except (FloatingPointError, TooHardError):
                continue
            finally:
                run.factor.free()
        message = f"no draw of {plan} could be solved and moved the markers"
        raise FloatingPointError(message)

    def acting(self, plan, rng):
        """Return contacts, the direction of the weight and the shares of motion of an event's plan."""
        return acting(plan, self.skin, rng)

    def physics(self, plan, rng):
        """Return the truth's physics; differences from the believed model are written to ``plan.truth``."""
        return physics(plan, self.skin, self.body, rng)

    @staticmethod
    def moves_markers(fields):
        """Return whether enough of the pool moves visibly."""
        return np.quantile(np.linalg.norm(fields["pool"], axis=1), 1 - MOVING_SHARE) > MOVING_MM

    def body_under(self, contacts):
        """Return the data's body, finer under contacts."""
        spots = [(c.centre, max(c.radii), max(EDGE_SHARE * min(c.radii), EDGE_MM)) for c in contacts]
        return self.held(spots)

    def reader(self, body):
        """Return the matrix that reads a field of the data's body at the user's nodes, the pool and the targets."""
        stored = self.stored
        return interpolation(body, np.concatenate([stored.nodes_mm, stored.pool_mm, stored.targets_mm]))[0]

    def seen(self, reader, u):
        """Return displacements in mm by place: ``nodes``, ``pool``, ``targets``; the user's base stays where it is."""
        fields = self.read(reader, u)
        fields["nodes"][self.stored.fixed_nodes] = 0.0
        return fields

    def read(self, reader, u):
        """Return displacements in mm by place, as they are in the data's body."""
        ends = np.cumsum([len(self.stored.nodes_mm), len(self.stored.pool_mm)])
        return dict(zip(("nodes", "pool", "targets"), np.split(reader @ u, ends), strict=True))

    def _told(self, plan, contacts, weight, start, draw):
        """Return what an event is, as plain data; forces of contacts as they would be at the believed modulus."""
        run = start.run
        believed = YOUNG_KPA / run.physics.young
        forces, dipoles = believed * run.forces(), believed * run.dipoles([np.asarray(c.centre) for c in contacts])
        acts = [{"force_mN": _rounded(f), "dipole_mN_mm": _rounded(d, 3)} for f, d in zip(forces, dipoles, strict=True)]
        description = {
            "body": plan.body,
            "event": plan.number,
            "kind": plan.kind,
            "difference": plan.difference,
            "truth": plan.truth,
            "contacts": [c.description() | act for c, act in zip(contacts, acts, strict=True)],
            "weight_mN_per_mm3": _rounded(run.stroke[0] * run.heavy * np.asarray(weight), 9),
            "largest_mm": float(np.linalg.norm(run.u, axis=1).max()),
            "gradient": float(run.gradient_size(run.u)),
            "off_linear_mm": float(np.linalg.norm(run.u - start.linear, axis=1).mean()),
            "elements": run.body.mesh.t.shape[1],
            "draw": draw,
            "seed": plan.seed,
            "seconds": run.seconds,
            "factorings": run.counts["factorings"],
        }
        for contact, part in zip(description["contacts"], run.parts, strict=True):
            if contact["kind"] != "traction":
                contact["stroke_mm"] = float(run.stroke[0] * part[3])
        return json.loads(json.dumps(description))


def _rounded(values, digits=4):
    return np.round(values, digits).tolist()
