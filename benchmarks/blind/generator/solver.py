"""Equilibrium of ten-node tetrahedra with all that may act on them; geometry and bases by scikit-fem.

``Body`` holds the data of a mesh; ``Physics`` the loads and laws; ``Run`` steps through time and keeps histories.
Unknowns are nodal displacements u (n, 3) in mm; forces in mN, stresses in kPa.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.sparse as sp
import skfem

from blind.generator.laws import Law
from blind.generator.memory import Memory
from blind.generator.mesh import find_places, shape_functions
from blind.generator.sparse import Factor

#: Penalty that ties surfaces, kPa/mm; the body's own stiffness is near 1.
TIE = 3000.0

#: Elements cut by a pad's edge stiffen more than their share inside: the edge is drawn in by this part of their size.
#: Measured: with it rims of 4 and 2.5 mm agree, and so do the open example's forces (README).
RIM = 0.34

logging.getLogger("skfem").setLevel(logging.ERROR)


@dataclass
class Physics:
    """What the data's body is and what acts on it."""

    young: float = 10.0
    poisson: float = 0.45
    law: Law = field(default_factory=Law)
    #: Factor on Young's modulus at points (..., 3); None: 1.
    contrast: Callable | None = None
    memory: Memory = field(default_factory=Memory)
    #: Weight in mN/mm^3.
    weight: tuple = (0.0, 0.0, 0.0)
    #: None: nodes of the base are fixed; else a `blind.generator.base` object.
    base: object = None
    #: Moves the pads: (name, points, stroke (3,), time) -> displacement of points; None: the stroke itself.
    pad_motion: Callable | None = None
    #: Pads' centres are moved by this much, by name.
    pad_shift: dict = field(default_factory=dict)
    #: Share of a pad's tie at points: (name, distance over radius, stroke size) -> (n,); None: 1 within the radius.
    pad_hold: Callable | None = None
    #: Displacement of the base: (points, time) -> (n, 3).
    base_motion: Callable | None = None
    #: Further surface springs: (points, u, normal) -> traction (n, 3) and its derivative (n, 3, 3).
    touch: Callable | None = None
    #: Springs between pairs of points: list of (point, point, mN/mm).
    threads: list = field(default_factory=list)


class Body:
    """Bases, dofs and sparsity pattern of a mesh."""

    def __init__(self, mesh, intorder=2):
        self.mesh = mesh
        element = skfem.ElementTetP2()
        cells = skfem.CellBasis(mesh, element, intorder=intorder)
        self.places = cells.doflocs
        self.n_nodes = self.places.shape[1]
        self.dofs = cells.element_dofs.T.copy()
        self.dN = np.stack([cells.basis[i][0].grad.transpose(1, 2, 0) for i in range(10)], axis=2)
        self.N = np.stack([np.broadcast_to(np.asarray(cells.basis[i][0]), cells.dx.shape) for i in range(10)], axis=2)
        self.dx = cells.dx
        self.points = np.asarray(cells.global_coordinates()).transpose(1, 2, 0)
        facets = mesh.boundary_facets()
        low = mesh.p[2][mesh.facets[:, facets]].max(axis=0) < 1e-9
        self.base_facets, self.skin_facets = facets[low], facets[~low]
        self.base_nodes = np.unique(cells.get_dofs(self.base_facets).flatten())
        self._opposite = np.full(mesh.facets.shape[1], -1)
        for f in facets:
            self._opposite[f] = np.flatnonzero(~np.isin(mesh.t[:, mesh.f2t[0, f]], mesh.facets[:, f]))[0]
        self._skin = np.stack([mesh.f2t[0, self.skin_facets], self._opposite[self.skin_facets]], axis=1)
        self._pattern()

    def surface(self, facets, intorder):
        """Return the basis of boundary facets: dofs (k, 10), N (k, q, 10), dx (k, q), points and normals (k, q, 3)."""
        x, weights = skfem.quadrature.get_quadrature(skfem.ElementTriP1(), intorder)
        elements = self.mesh.f2t[0, facets]
        corners = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1.0]])
        k = len(facets)
        N, points, normals = (
            np.empty((k, len(weights), 10)),
            np.empty((k, len(weights), 3)),
            np.empty((k, len(weights), 3)),
        )
        for opposite in range(4):
            chosen = np.flatnonzero(self._opposite[facets] == opposite)
            ends = np.delete(corners, opposite, axis=0)
            axes = ends[1:] - ends[0]
            value, slope = shape_functions((ends[0] + x.T @ axes).T)
            nodes = self.places[:, self.dofs[elements[chosen]]]
            N[chosen] = value.T
            points[chosen] = np.einsum("xka,aq->kqx", nodes, value)
            along = np.einsum("xka,adq,td->tkqx", nodes, slope, axes, optimize=True)
            normal = np.cross(along[0], along[1])
            inward = self.places[:, self.dofs[elements[chosen], opposite]].T[:, None] - points[chosen]
            normals[chosen] = normal * -np.sign((normal * inward).sum(axis=-1, keepdims=True))
        size = np.linalg.norm(normals, axis=-1)
        return Surface(elements, self.dofs[elements], N, size * weights, points, normals / size[..., None])

    def interpolation(self, points, on_skin):
        """Return the matrix (n, n_nodes) that interpolates at points."""
        nodes, weights = find_places(self.places, self.dofs.T, points, self._skin if on_skin else None)
        rows = np.repeat(np.arange(len(points)), 10)
        return sp.csr_matrix((weights.ravel(), (rows, nodes.ravel())), shape=(len(points), self.n_nodes))

    def _pattern(self):
        """Find where each entry of the element matrices goes in the upper triangle of the whole."""
        self.vector_dofs = (3 * self.dofs[:, :, None] + np.arange(3)).reshape(len(self.dofs), 30)
        rows = np.repeat(self.vector_dofs, 30, axis=1)
        columns = np.tile(self.vector_dofs, (1, 30))
        n = 3 * self.n_nodes
        self._keep = rows <= columns
        key = rows[self._keep].astype(np.int64) * n + columns[self._keep]
        unique, inverse = np.unique(key, return_inverse=True)
        self._slot = np.full(rows.shape, len(unique), dtype=np.int64)
        self._slot[self._keep] = inverse
        self._rows, self._columns = unique // n, unique % n
        indptr = np.searchsorted(self._rows, np.arange(n + 1))
        self.empty = sp.csr_matrix(
            (np.zeros(len(unique)), self._columns.astype(np.int32), indptr.astype(np.int32)), shape=(n, n)
        )

    def scatter(self, blocks):
        """Return values of the upper triangle from (elements, matrices (k, 30, 30)) pairs."""
        values = np.zeros(self.empty.nnz + 1)
        for elements, matrices in blocks:
            slots = self._slot[elements].ravel()
            values += np.bincount(slots, matrices.reshape(len(elements), 900).ravel(), len(values))
        return values[:-1]

    def held(self, values, fixed):
        """Return the matrix with fixed dofs taken out."""
        out = fixed[self._rows] | fixed[self._columns]
        data = np.where(out, 0.0, values)
        data[out & (self._rows == self._columns)] = 1.0
        return sp.csr_matrix((data, self.empty.indices, self.empty.indptr), shape=self.empty.shape)


@dataclass
class Surface:
    """Quadrature on boundary facets."""

    elements: np.ndarray
    dofs: np.ndarray
    N: np.ndarray
    dx: np.ndarray
    points: np.ndarray
    normals: np.ndarray

    def part(self, chosen):
        """Return some of the facets."""
        return Surface(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def at(self, u):
        """Return a nodal field (n, 3) at the quadrature points."""
        return np.einsum("kqa,kax->kqx", self.N, u[self.dofs])

    def forces(self, traction, out):
        """Add nodal forces of a traction (k, q, 3)."""
        local = np.einsum("kqa,kqx,kq->kax", self.N, traction, self.dx, optimize=True)
        for x in range(3):
            out[:, x] += np.bincount(self.dofs.ravel(), local[:, :, x].ravel(), len(out))

    def matrices(self, slope):
        """Return matrices (k, 30, 30) of a derivative (k, q, 3, 3) of minus the traction."""
        return np.einsum("kqa,kqb,kqxy,kq->kaxby", self.N, self.N, slope, self.dx, optimize=True)


class Run:
    """One body under one physics, stepped through time."""

    def __init__(self, body, physics, pads):
        self.body, self.physics = body, physics
        self.u = np.zeros((body.n_nodes, 3))
        self.mu = physics.young / (2 * (1 + physics.poisson))
        self.ratio = 2 * physics.poisson / (1 - 2 * physics.poisson)
        self.scale = np.ones(body.dx.shape) if physics.contrast is None else physics.contrast(body.points)
        self.memory = physics.memory.start(body.dx.shape, self.mu * self.scale)
        self.factor = Factor()
        self.ready = False
        self.before = None
        self.stroke = np.zeros(3)
        self.pads = {}
        for name, (centre, radius) in pads.items():
            centre = np.asarray(centre) + np.asarray(physics.pad_shift.get(name, (0.0, 0.0, 0.0)))
            ends = body.mesh.p[:, body.mesh.facets[:, body.skin_facets]]
            reach = np.linalg.norm(ends - centre[:, None, None], axis=0).min(axis=0)
            surface = body.surface(body.skin_facets[reach < radius + 6.0], intorder=12)
            distance = np.linalg.norm(surface.points - centre, axis=2) + RIM * np.sqrt(surface.dx.sum(axis=1))[:, None]
            inside = (distance < radius).any(axis=1)
            self.pads[name] = (surface.part(inside), distance[inside], radius, centre)
        self.base = None
        if physics.base is not None:
            self.base = physics.base.start(body.surface(body.base_facets, intorder=8))
        self.fixed = np.zeros(3 * body.n_nodes, dtype=bool)
        if physics.base is None:
            self.fixed[(3 * body.base_nodes[:, None] + np.arange(3)).ravel()] = True
        self.touch = body.surface(body.skin_facets, intorder=4) if physics.touch else None
        self.weight = np.einsum("eqa,eq,x->eax", body.N, body.dx, np.asarray(physics.weight))
        self.threads = []
        for a, b, stiffness in physics.threads:
            weights = body.interpolation(np.array([a, b]), on_skin=False)
            self.threads.append((weights[0] - weights[1], stiffness))
        self.pad = None
        self.clock = 0.0
        self.counts = {"factorings": 0, "iterations": 0}

    def bond(self, name):
        """Glue a pad to the shape as it is now; None takes it off."""
        self.pad = name
        self.ready = False
        self.before = None
        self.stroke = self.stroke_before = np.zeros(3)
        if name is not None:
            self.bonded_at = self.pads[name][0].at(self.u)

    def step(self, time, stroke=(0.0, 0.0, 0.0), tolerance=2e-4, depth=0):
        """Find equilibrium at a time, by way of the middle of the step if need be.

        Raises FloatingPointError if there is none.
        """
        dt = time - self.clock
        stroke = np.asarray(stroke, dtype=float)
        if depth == 0:
            self.stroke_before = self.stroke
        self.stroke, self.time = stroke, time
        self.memory.begin(dt, time)
        old = self.u
        try:
            self._newton(tolerance, self._guess(stroke))
            self.before = (self.stroke_before, old)
        except FloatingPointError:
            self.u = old
            self.ready = False
            self._halve(time, stroke, tolerance, depth)
            return
        self.memory.end(self._gradient(self.u), self._stress)
        if self.base is not None:
            self.base.end(self.u)
        self.clock = time

    def _halve(self, time, stroke, tolerance, depth):
        if depth > 5:
            message = f"no equilibrium at {time} s"
            raise FloatingPointError(message)
        before, clock = self.stroke_before, self.clock
        self.counts["halved"] = self.counts.get("halved", 0) + 1
        self.step(0.5 * (clock + time), 0.5 * (before + stroke), tolerance, depth + 1)
        self.stroke_before = self.stroke
        self.step(time, stroke, tolerance, depth + 1)

    def pad_force(self):
        """Return the force of the pad on the body (3,)."""
        surface, *_ = self.pads[self.pad]
        traction, _ = self._pad_traction(self.u)
        return np.einsum("kqx,kq->x", traction, surface.dx)

    def _guess(self, stroke):
        """Go on as in the step before, if that was along the same line and turns nothing inside out."""
        if self.before is None:
            return self.u.copy()
        then, u_then = self.before
        last, now = self.stroke_before - then, stroke - self.stroke_before
        size = last @ last
        if size == 0.0 or np.linalg.norm(now - last * (now @ last) / size) > 1e-9:
            return self.u.copy()
        guess = self.u + (self.u - u_then) * (now @ last) / size
        try:
            self._gradient(guess, check=True)
        except FloatingPointError:
            return self.u.copy()
        return guess

    def _newton(self, tolerance, u):
        fixed_goal = self._fixed_goal()
        if fixed_goal is not None:
            u.reshape(-1)[self.fixed] = fixed_goal
        last, need = np.inf, not self.ready
        for _ in range(60):
            residual, blocks = self._residual(u, need)
            if blocks is not None:
                self.factor.update(self.body.held(self.body.scatter(blocks), self.fixed))
                self.counts["factorings"] += 1
                self.ready = True
            self.counts["iterations"] += 1
            change = self.factor.solve(residual.ravel())
            size = np.abs(change).max()
            if not np.isfinite(size):
                message = "the step is not finite"
                raise FloatingPointError(message)
            share = min(1.0, 12.0 / size) if size > 0 else 1.0
            while True:
                try:
                    trial = u + share * change.reshape(-1, 3)
                    self._gradient(trial, check=True)
                    break
                except FloatingPointError:
                    share *= 0.5
                    if share < 1e-3:
                        raise
            u = trial
            if size < tolerance:
                self.u = u
                return
            fresh = blocks is not None
            need = size > 0.3 * last and not (fresh and size < 0.01)
            last = size
        message = f"no equilibrium after 60 iterations; the last step was {size:.2e} mm"
        raise FloatingPointError(message)

    def _fixed_goal(self):
        motion = self.physics.base_motion
        if motion is None or self.physics.base is not None:
            return None
        goal = np.zeros((self.body.n_nodes, 3))
        goal[self.body.base_nodes] = motion(self.body.places[:, self.body.base_nodes].T, self.time)
        return goal.ravel()[self.fixed]

    def _gradient(self, u, check=False):
        F = np.eye(3) + np.swapaxes(u[self.body.dofs], 1, 2)[:, None] @ self.body.dN
        if check and np.any(np.linalg.det(F) <= 0.02):
            message = "an element is turned inside out"
            raise FloatingPointError(message)
        return F

    def _stress(self, F, tangent, volume_only=False):
        """Return energy, stress and tangent in kPa."""
        W, P, A = self.physics.law.response(F, self.ratio, tangent, volume_only)
        scale = self.mu * self.scale
        return (
            None if W is None else scale * W,
            scale[..., None, None] * P,
            None if A is None else scale[..., None, None] * A,
        )

    def _residual(self, u, tangent):
        """Return out-of-balance forces (n, 3), zero at fixed dofs, and the blocks of the tangent or None."""
        body = self.body
        P, A = self.memory.response(self._gradient(u), self._stress, tangent)
        k, q = body.dx.shape
        local = np.matmul(
            (body.dN * body.dx[:, :, None, None]).transpose(0, 2, 1, 3).reshape(k, 10, q * 3),
            P.transpose(0, 1, 3, 2).reshape(k, q * 3, 3),
        )
        local = self.weight - local
        residual = np.stack(
            [np.bincount(body.dofs.ravel(), local[:, :, x].ravel(), body.n_nodes) for x in range(3)], axis=1
        )
        blocks = [(np.arange(k), self._matrices(A))] if tangent else None
        self._add_surfaces(u, residual, blocks)
        residual[self.fixed.reshape(-1, 3)] = 0.0
        return residual, blocks

    def _matrices(self, A):
        body = self.body
        k, q = body.dx.shape
        weighted = body.dN * body.dx[:, :, None, None]
        A = A.reshape(k, q, 3, 3, 9).transpose(0, 1, 3, 2, 4).reshape(k, q, 3, 27)
        left = np.matmul(weighted, A).reshape(k, q, 10, 3, 3, 3)  # a, i, j, J
        left = left.transpose(0, 2, 3, 4, 1, 5).reshape(k, 90, q * 3)
        right = body.dN.transpose(0, 1, 3, 2).reshape(k, q * 3, 10)
        full = np.matmul(left, right).reshape(k, 10, 3, 3, 10)
        return full.transpose(0, 1, 2, 4, 3)

    def _pad_traction(self, u):
        surface, distance, radius, _ = self.pads[self.pad]
        if self.physics.pad_hold is None:
            tie = TIE * (distance < radius)
        else:
            tie = TIE * self.physics.pad_hold(self.pad, distance / radius, np.linalg.norm(self.stroke))
        motion = self.stroke
        if self.physics.pad_motion is not None:
            motion = self.physics.pad_motion(self.pad, surface.points, self.stroke, self.time)
        return tie[..., None] * (motion - (surface.at(u) - self.bonded_at)), tie

    def _add_surfaces(self, u, residual, blocks):
        eye = np.eye(3)
        if self.pad is not None:
            surface = self.pads[self.pad][0]
            traction, tie = self._pad_traction(u)
            surface.forces(traction, residual)
            if blocks is not None:
                blocks.append((surface.elements, surface.matrices(tie[..., None, None] * eye)))
        if self.base is not None:
            traction, slope = self.base.traction(u)
            self.base.surface.forces(traction, residual)
            if blocks is not None:
                blocks.append((self.base.surface.elements, self.base.surface.matrices(slope)))
        if self.touch is not None:
            traction, slope = self.physics.touch(self.touch.points, self.touch.at(u), self.touch.normals)
            self.touch.forces(traction, residual)
            if blocks is not None:
                blocks.append((self.touch.elements, self.touch.matrices(slope)))
        for weights, stiffness in self.threads:
            # The thread couples far dofs; its stiffness is left out of the tangent and kept in the residual.
            pull = stiffness * (weights @ u)
            residual -= weights.T @ pull
