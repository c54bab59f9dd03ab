"""Equilibrium of one event: blind.generator's solver, with contacts and weight that grow together."""

import time as clock
from dataclasses import dataclass

import numpy as np

from blind.generator.solver import Body, Run
from loadfree.generator.meshing import skin_facets

#: Shares of the final motion at which equilibrium is found on the way.
STEPS = (0.5, 1.0)

#: Largest change of the last iteration in mm: the force of a pad is its tie stiffness times its remaining slip.
TOLERANCE_MM = 2e-6

#: Largest displacement gradient (99.5 % of the volume, first order) that an event may have.
LARGEST_GRADIENT = 0.7


#: An event that needs more factorisations than this is abandoned: its elements are about to invert.
MOST_FACTORS = 20


class TooHardError(Exception):
    """An event takes too many factors."""


class HeldBody(Body):
    """A body whose glued base is where a coordinate is zero."""

    def __init__(self, mesh, axis):
        super().__init__(mesh)
        facets = mesh.boundary_facets()
        self.skin_facets = skin_facets(mesh, axis)
        self.base_facets = np.setdiff1d(facets, self.skin_facets)
        self.base_nodes = self.nodes_of(self.base_facets)
        #: Contacts keep away from these.
        self.closed_nodes = self.base_nodes
        self._skin = np.stack([mesh.f2t[0, self.skin_facets], self._opposite[self.skin_facets]], axis=1)

    def nodes_of(self, facets):
        """Return the nodes of boundary facets, six each."""
        element = self.mesh.f2t[0, facets]
        inside = np.ones((len(element), 10), dtype=bool)
        opposite = self._opposite[facets]
        inside[np.arange(len(element)), opposite] = False
        edges = np.array([[0, 1], [1, 2], [0, 2], [0, 3], [1, 3], [2, 3]])
        inside[:, 4:] = ~(edges[None] == opposite[:, None, None]).any(axis=2)
        return np.unique(self.dofs[element][inside])


class EventRun(Run):
    """Contacts and a weight, all times one amplitude: the first entry of the stroke.

    Parameters
    ----------
    body : HeldBody
    physics : Physics
        Law, modulus, Poisson's ratio and stiff places; nothing that acts.
    contacts : list of Contact
    weight : tuple of float
        Direction of a body force, unit length, or zero.
    """

    def __init__(self, body, physics, contacts, weight=(0.0, 0.0, 0.0)):
        super().__init__(body, physics, {})
        self.parts = []
        for contact in contacts:
            ends = body.mesh.p[:3, body.mesh.facets[:, body.skin_facets]]
            off = np.linalg.norm(ends - np.asarray(contact.centre)[:, None, None], axis=0).min(axis=0)
            surface = body.surface(body.skin_facets[off < max(contact.radii) + 6.0], intorder=12)
            load, tie = contact.fields(surface.points, surface.normals)
            used = (np.abs(load).max(axis=-1) > 0).any(axis=1)
            self.parts.append([surface.part(used), load[used], tie[used], 1.0])
        self.unit_weight = np.einsum("eqa,eq,x->eax", body.N, body.dx, np.asarray(weight))
        self.heavy = 1.0

    def unit_responses(self):
        """Return first-order displacements (n_parts, n, 3) to each contact at amplitude 1, and to the unit weight."""
        zero = np.zeros_like(self.u)
        self.stroke, self.time = np.zeros(3), 0.0
        self.memory.begin(0.0, 0.0)
        _, blocks = self._residual(zero, True)
        self.factor.update(self.body.held(self.body.scatter(blocks), self.fixed))
        self.ready = True
        answers = []
        for surface, load, *_ in self.parts:
            forces = zero.copy()
            surface.forces(load, forces)
            answers.append(self._response(forces))
        if self.unit_weight.any():
            rows = [np.bincount(self.body.dofs.ravel(), self.unit_weight[..., x].ravel(), len(zero)) for x in range(3)]
            answers.append(self._response(np.stack(rows, axis=1)))
        return np.array(answers)

    def _response(self, forces):
        forces.reshape(-1)[self.fixed] = 0.0
        return self.factor.solve(forces.ravel()).reshape(-1, 3)

    def gradient_size(self, u):
        """Return the norm of the displacement gradient that 99.5 % of the volume stay below."""
        h = np.einsum("eqax,eai->eqix", self.body.dN, u[self.body.dofs])
        size = np.linalg.norm(h, axis=(2, 3)).ravel()
        order = np.argsort(size)
        share = np.cumsum(self.body.dx.ravel()[order]) / self.body.dx.sum()
        return size[order[np.searchsorted(share, 0.995)]]

    def forces(self):
        """Return the force of each contact on the body (n_parts, 3) in mN."""
        return np.array([np.einsum("kqx,kq->x", self._traction(part, self.u)[0], part[0].dx) for part in self.parts])

    def dipoles(self, centres):
        """Return first moments of each contact's traction about its centre, force by arm, (n_parts, 3, 3) in mN mm."""
        return np.array(
            [
                np.einsum("kqx,kqy,kq->xy", self._traction(part, self.u)[0], part[0].points - centre, part[0].dx)
                for part, centre in zip(self.parts, centres, strict=True)
            ]
        )

    def _traction(self, part, u):
        surface, load, tie, weight = part
        return self.stroke[0] * weight * load - np.einsum("kqxy,kqy->kqx", tie, surface.at(u)), tie

    def _residual(self, u, tangent):
        if self.counts["factorings"] > MOST_FACTORS:
            message = f"no equilibrium within {MOST_FACTORS} factors"
            raise TooHardError(message)
        self.weight = self.stroke[0] * self.heavy * self.unit_weight
        return super()._residual(u, tangent)

    def _add_surfaces(self, u, residual, blocks):
        for part in self.parts:
            traction, tie = self._traction(part, u)
            part[0].forces(traction, residual)
            if blocks is not None and tie.any():
                blocks.append((part[0].elements, part[0].matrices(tie)))


@dataclass
class Start:
    """An event before its equilibrium is sought.

    Attributes
    ----------
    run : EventRun
    linear : ndarray, shape (n, 3)
        Displacement to first order, mm, at the event's size.
    goal : float
        Its largest displacement, mm.
    per_mm : float
        Amplitude for 1 mm of largest displacement, to first order.
    """

    run: EventRun
    linear: np.ndarray
    goal: float
    per_mm: float


def prepare(body, physics, contacts, weight, shares, largest):
    """Return an event's first-order answer, sized to a largest displacement.

    Parameters
    ----------
    body, physics, contacts, weight
        See `EventRun`.
    shares : list of float
        Largest first-order motion of each contact, then of the weight, relative to each other.
    largest : float
        Largest displacement in mm; smaller where the gradient would pass `LARGEST_GRADIENT`.
    """
    run = EventRun(body, physics, contacts, weight)
    answers = run.unit_responses()
    scales = [share / np.linalg.norm(u, axis=1).max() for share, u in zip(shares, answers, strict=True)]
    for part, scale in zip(run.parts, scales, strict=False):
        part[3] = scale
    if len(answers) > len(run.parts):
        run.heavy = scales[-1]
    linear = np.einsum("k,knx->nx", scales, answers)
    size = np.linalg.norm(linear, axis=1).max()
    goal = min(largest, LARGEST_GRADIENT * size / run.gradient_size(linear))
    return Start(run, goal / size * linear, goal, 1.0 / size)


def solve(start):
    """Find the equilibrium of an event in steps whose amplitude follows the motion so far; ``start.run.u`` holds it.

    Raises FloatingPointError or TooHardError where there is none within `MOST_FACTORS`.
    """
    begun, run, per_mm = clock.time(), start.run, start.per_mm
    for number, step in enumerate(STEPS):
        run.step(float(number + 1), (per_mm * start.goal * step, 0.0, 0.0), TOLERANCE_MM)
        per_mm = run.stroke[0] / np.linalg.norm(run.u, axis=1).max()
    run.seconds = clock.time() - begun
