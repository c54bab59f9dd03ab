"""The truth by NGSolve: curved ten-node tetrahedra, energies differentiated by it, histories at quadrature points."""

import ngsolve as ng
import numpy as np
from ngsolve.comp import IntegrationRuleSpace

from rigs.generator.meshing import EDGES
from rigs.generator.rigs import Hold
from rigs.generator.skeleton import Skeleton
from rigs.generator.truth import Truth, moduli

ng.ngsglobals.msg_level = 0
ONE = ng.Id(3)


class NgSolver:
    """Equilibria of one rig's mesh under one truth.

    Parameters
    ----------
    rig : Rig
    mesh : netgen mesh
    """

    code = "ngsolve"

    def __init__(self, rig, mesh):
        self.rig = rig
        self.mesh = ng.Mesh(mesh)
        self.mesh.Curve(2)
        scalar = ng.H1(self.mesh, order=2)
        self.space = ng.VectorH1(self.mesh, order=2)
        self.n = scalar.ndof
        places = ng.GridFunction(self.space)
        places.Set(ng.CF((ng.x, ng.y, ng.z)))
        self.skeleton = self._skeleton(places.vec.FV().NumPy().reshape(3, -1).T.copy())
        self._quarters()
        self.rules = IntegrationRuleSpace(self.mesh, order=1)
        self.dx = ng.dx(intrules=self.rules.GetIntegrationRules())
        points = ng.GridFunction(self.rules**3)
        points.Interpolate(ng.CF((ng.x, ng.y, ng.z)))
        self.points = points.vec.FV().NumPy().reshape(3, -1).T.copy()
        self.state = ng.GridFunction(self.space)
        self.force = self.state.vec.CreateVector()
        self._label(mesh)

    def _skeleton(self, places):
        nv = self.mesh.nv
        tets, counts = [], {}
        for element in self.mesh.Elements(ng.VOL):
            corners = [v.nr for v in element.vertices]
            edges = {frozenset(v.nr for v in self.mesh[e].vertices): nv + e.nr for e in element.edges}
            pairs = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
            tets.append(corners + [edges[frozenset((corners[i], corners[j]))] for i, j in pairs])
            for face in element.faces:
                counts[face.nr] = counts.get(face.nr, 0) + 1
        faces, self.regions = [], []
        for element in self.mesh.Elements(ng.BND):
            if counts[element.faces[0].nr] > 1:
                continue
            a, b, c = (v.nr for v in element.vertices)
            edges = {frozenset(v.nr for v in self.mesh[e].vertices): nv + e.nr for e in element.edges}
            faces.append([a, b, c, edges[frozenset((a, b))], edges[frozenset((a, c))], edges[frozenset((b, c))]])
            self.regions.append(element.index)
        tets = np.array(tets)
        # An edge's function is a multiple of the product of its corners' weights: 1/16 in the middle of an element.
        scalar, element = ng.H1(self.mesh, order=2), ng.ElementId(ng.VOL, 0)
        shapes = np.asarray(scalar.GetFE(element).CalcShape(0.25, 0.25, 0.25)).ravel()
        bulge = 16.0 * float(shapes[list(scalar.GetDofNrs(element)).index(tets[0, 4])])
        return Skeleton(places, tets, np.array(faces), bulge, nodal=False)

    def _quarters(self):
        """Move the middles of edges that begin at a pad's rim to a quarter: stress is singular there."""
        skeleton = self.skeleton
        rim = np.zeros(self.n, dtype=bool)
        for pad in self.rig.pads:
            faces = skeleton.faces[pad.inside(skeleton.face_middles), :3]
            edges = np.sort(faces[:, [0, 1, 1, 2, 0, 2]].reshape(-1, 2), axis=1)
            edges, counts = np.unique(edges, axis=0, return_counts=True)
            rim[edges[counts == 1]] = True
        moved = np.zeros((self.n, 3))
        for k, (i, j) in enumerate(EDGES):
            a, b, edge = skeleton.tets[:, i], skeleton.tets[:, j], skeleton.tets[:, 4 + k]
            once = rim[a] != rim[b]
            near, far = np.where(rim[a], a, b)[once], np.where(rim[a], b, a)[once]
            middle = skeleton.places[[near, far]].mean(axis=0) + skeleton.bulge / 4 * skeleton.places[edge[once]]
            quarter = 0.375 * skeleton.places[near] - 0.125 * skeleton.places[far] + 0.75 * middle
            moved[edge[once]] = (quarter - middle) * 4 / skeleton.bulge
        self.moved = ng.GridFunction(self.space)
        self.moved.vec.FV().NumPy()[:] = moved.T.ravel()
        self.mesh.SetDeformation(self.moved)
        skeleton.places += moved

    def _label(self, mesh):
        """Name the faces of the solid by what they are."""
        middles, regions = self.skeleton.face_middles, np.array(self.regions)
        for region in range(len(self.mesh.GetBoundaries())):
            mesh.SetBCName(region, "inner")
            some = middles[regions == region]
            if not len(some):
                continue
            mesh.SetBCName(region, "free")
            for patch in (*self.rig.holds, *self.rig.pads):
                if patch.inside(some).mean() > 0.5:
                    mesh.SetBCName(region, "held" if isinstance(patch, Hold) else patch.name)

    def start(self, truth: Truth):
        """Take a truth; all histories begin anew."""
        self.truth, memory = truth, truth.memory
        self.time_step, self.growth = ng.Parameter(1.0), ng.GridFunction(self.rules)
        self.growth.vec[:] = 1.0
        factor = ng.GridFunction(self.rules)
        factor.vec.FV().NumPy()[:] = 1.0 if truth.contrast is None else truth.contrast(self.points)
        self.form = ng.BilinearForm(self.space, symmetric=True)
        u = self.space.TrialFunction()
        gradient = ONE + ng.Grad(u)
        c = gradient.trans * gradient
        elastic = c / self.growth**2
        whole, volume = energies(self.rig, truth, elastic)
        self.parts = []
        stored = ng.CF(0)
        scale = factor * self.growth**3
        total = whole
        if memory.damage:
            share, m, unloading = memory.damage
            self.largest = top = ng.GridFunction(self.rules)
            top.vec[:] = 0.0
            if unloading:
                # The factor on the stress is one at the largest energy, and falls below it.
                lost = whole - share * (whole - m * ng.exp((whole - top) / m))
                total = ng.IfPos(whole - top, whole, lost)
            else:
                first = (1.0 - share) * whole - share * m * ng.exp(-whole / m)
                total = ng.IfPos(whole - top, first, (1.0 - share * (1.0 - ng.exp(-top / m))) * whole)
        for number, (piece, terms) in enumerate(((whole, memory.relaxing), (volume, memory.draining))):
            for share, tau in terms:
                history, before = (ng.GridFunction(self.rules**9) for _ in range(2))
                history.vec[:], before.vec[:] = 0.0, 0.0
                weight, fade = ng.Parameter(1.0), ng.Parameter(1.0)
                self.parts.append((number, share, tau, history, before, weight, fade))
                total = total - share * piece + share * weight * piece
                kept = fade * history - share * weight * before
                stored = stored + 0.5 * ng.InnerProduct(kept.Reshape((3, 3)), c)
        if memory.viscosity:
            self.last = ng.GridFunction(self.rules**9)
            rate = 0.5 * (c - self.last.Reshape((3, 3)))
            stored = stored + memory.viscosity * truth.young / (2 * self.time_step) * ng.InnerProduct(rate, rate)
        if memory.kept:
            self.most = ng.GridFunction(self.rules**9)
            self.most.vec[:] = 0.0
            most = self.most.Reshape((3, 3))
            mu, _, _ = moduli(self.rig, truth)
            where = ng.GridFunction(self.rules)
            share, mask = memory.kept
            where.vec.FV().NumPy()[:] = share if mask is None else share * mask(self.points)
            # Of the shape alone: the trace of a large strain is no change of volume.
            back = 2 * mu * where * (most - ng.Trace(most) / 3 * ONE)
            stored = stored - 0.5 * ng.InnerProduct(back, c)
        self.form += ng.Variation((scale * total + factor * stored).Compile() * self.dx)
        if truth.weight is not None:
            self.form += ng.Variation(-ng.InnerProduct(ng.CF(tuple(truth.weight)), u) * self.dx)
        if truth.thread is not None:
            near = ng.GridFunction(self.rules)
            near.vec.FV().NumPy()[:] = truth.thread[0](self.points)
            self.form += ng.Variation(0.5 * truth.thread[1] * near * ng.InnerProduct(u, u) * self.dx)
        self._on_surfaces(truth, u)
        # What histories take from a state.
        grad = ONE + ng.Grad(self.state)
        right = grad.trans * grad
        variable = (right / self.growth**2).MakeVariable()
        now, now_volume = energies(self.rig, truth, variable)
        self.right = right
        self.taken = (2 * now.Diff(variable) / self.growth**2, 2 * now_volume.Diff(variable) / self.growth**2)
        self.now = now
        self.refresh(np.zeros((self.n, 3)))

    def _on_surfaces(self, truth, u):
        held = self.mesh.Boundaries("held")
        support = truth.support or {}
        if "springs" in support:
            stiff, limit = support["springs"], support.get("limit")
            square = ng.InnerProduct(u, u)
            # With a limit the springs let go as they stretch.
            energy = 0.5 * stiff * (limit**2 * ng.log(1 + square / limit**2) if limit else square)
            self.form += ng.Variation(energy * ng.ds(definedon=held))
        if truth.wall is not None:
            normal, place, stiff = truth.wall
            gap = place - ng.InnerProduct(ng.CF((ng.x, ng.y, ng.z)) + u, ng.CF(tuple(normal)))
            energy = ng.IfPos(gap, 0.0, 0.5 * stiff * gap**2)
            self.form += ng.Variation(energy * ng.ds(definedon=self.mesh.Boundaries("free")))

    def refresh(self, u):
        """Begin the fading histories anew from a state of rest."""
        self._put(u)
        for _, _, _, history, before, *_ in self.parts:
            history.vec[:], before.vec[:] = 0.0, 0.0
        if self.truth.memory.viscosity:
            self.last.Interpolate(self.right.Reshape((9,)))

    def set_time(self, step, time):
        """Tell how long the next step is, and when it ends."""
        self.time_step.Set(step)
        for _, _, tau, _, _, weight, fade in self.parts:
            fade.Set(np.exp(-step / tau))
            weight.Set((1 - np.exp(-step / tau)) * tau / step)
        if self.truth.growth is not None:
            self.growth.vec.FV().NumPy()[:] = 1.0 + self.truth.growth(time, self.points)

    def keep(self, u):
        """Let the histories take a state that was reached."""
        self._put(u)
        memory = self.truth.memory
        for number, share, _, history, before, weight, fade in self.parts:
            now = ng.GridFunction(self.rules**9)
            now.Interpolate(self.taken[number].Reshape((9,)))
            h, b, s = (g.vec.FV().NumPy() for g in (history, before, now))
            h[:] = fade.Get() * h + share * weight.Get() * (s - b)
            b[:] = s
        if memory.viscosity:
            self.last.Interpolate(self.right.Reshape((9,)))
        if memory.damage:
            now = ng.GridFunction(self.rules)
            now.Interpolate(self.now)
            top = self.largest.vec.FV().NumPy()
            top[:] = np.maximum(top, now.vec.FV().NumPy())
        if memory.kept:
            now = ng.GridFunction(self.rules**9)
            now.Interpolate((0.5 * (self.right - ONE)).Reshape((9,)))
            new, old = (g.vec.FV().NumPy().reshape(9, -1) for g in (now, self.most))
            larger = (new**2).sum(axis=0) > (old**2).sum(axis=0)
            old[:, larger] = new[:, larger]

    def _put(self, u):
        self.state.vec.FV().NumPy()[:] = u.T.ravel()

    def residual(self, u):
        """Return the forces (n, 3) that hold a state."""
        self._put(u)
        self.form.Apply(self.state.vec, self.force)
        return self.force.FV().NumPy().reshape(3, -1).T.copy()

    def tangent(self, u, free):
        """Return functions that multiply by the tangent, and that solve with it on free components (n, 3)."""
        self._put(u)
        self.form.AssembleLinearization(self.state.vec)
        mask = ng.BitArray(3 * self.n)
        mask.Clear()
        for k in np.flatnonzero(free.T.ravel()):
            mask.Set(int(k))
        inverse = self.form.mat.Inverse(mask, inverse="sparsecholesky")
        matrix = self.form.mat
        given, found = self.state.vec.CreateVector(), self.state.vec.CreateVector()

        def multiply(v):
            given.FV().NumPy()[:] = v.T.ravel()
            found.data = matrix * given
            return found.FV().NumPy().reshape(3, -1).T.copy()

        def solve(v):
            given.FV().NumPy()[:] = v.T.ravel()
            found.data = inverse * given
            return found.FV().NumPy().reshape(3, -1).T.copy()

        return multiply, solve


def energies(rig, truth, c):
    """Return the energy of a strain C, and its volumetric part, in kPa."""
    mu, lam, bulk = moduli(rig, truth)
    name, shape = truth.law or rig.law
    first, det = ng.Trace(c), ng.Det(c)
    log_j = 0.5 * ng.log(det)
    second = 0.5 * (first * first - ng.InnerProduct(c, c))
    ring = ng.exp(-2 / 3 * log_j) * first - 3
    ring_two = ng.exp(-4 / 3 * log_j) * second - 3
    split, joint = bulk / 2 * log_j**2, lam / 2 * log_j**2
    plain = mu / 2 * (first - 3 - 2 * log_j)
    if name == "neo-hookean":
        return plain + joint, joint
    if name == "mooney-rivlin":
        s = shape["share"]
        return mu / 2 * ((1 - s) * ring + s * ring_two) + split, split
    if name == "fung":
        return mu / (2 * shape["b"]) * (ng.exp(shape["b"] * ring) - 1) + split, split
    # Forms of the hidden effects: not split.
    if name == "exponential":
        return mu / (2 * shape["b"]) * (ng.exp(shape["b"] * (first - 3 - 2 * log_j)) - 1) + joint, joint
    if name == "second":
        s = shape["share"]
        return plain * (1 - s) + s * mu / 2 * (second - 3 - 4 * log_j) + joint, joint
    if name == "inverse":
        s, inverse = shape["share"], ng.Inv(c)
        return plain * (1 - s) + s * (mu / 8 * (ng.InnerProduct(inverse, inverse) - 3) + mu / 2 * log_j) + joint, joint
    if name == "fibres":
        a = ng.CF(tuple(shape["direction"]))
        stretch = ng.InnerProduct(c * a, a) - 1
        extra = ng.IfPos(stretch, stretch**2 + shape["cubic"] * stretch**3, 0.0)
        return plain + joint + 0.5 * shape["k"] * mu * extra, joint
    message = f"law must be known, got {name}"
    raise ValueError(message)
