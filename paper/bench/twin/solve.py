"""Equilibria of a rig: ten-node tetrahedra by scikit-fem and the blind bench's Newton.

Second-order displacements on straight-edged tetrahedra, four quadrature points an element for all terms; the volume is
kept by the energy alone (ratio/2 ln^2 J), without a pressure field, which second-order tetrahedra stand at the rigs'
Poisson's ratios of at most 0.485. Unsplit Ogden law of one term. Pads stick to the skin and the base rests on springs.
"""

import time as clock

import numpy as np
import skfem
from blind.generator.base import Springs
from blind.generator.laws import Law
from blind.generator.solver import TIE, Body, Physics, Run

from tissuereg.phantom.breast import breast_mesh
from twin.rig import points

#: Corner nodes of the mesh; the second order adds those in the middle of edges.
N_CORNERS = 2000

#: Shares of the strokes at which equilibrium is found.
SHARES = np.arange(1, 9) / 8.0

_BODIES = {}


def body_of(n_corners=N_CORNERS):
    """Return the data's body, and its free surface as triangles of the mesh."""
    if n_corners not in _BODIES:
        mesh = breast_mesh(n_corners)
        skin = mesh.surface[mesh.nodes[mesh.surface, 2].max(axis=1) > 0.0]
        _BODIES[n_corners] = Body(skfem.MeshTet(mesh.nodes.T.copy(), mesh.tets.T.copy())), mesh.nodes, skin
    return _BODIES[n_corners]


class TwinRun(Run):
    """A rig at shares of its strokes: the first entry of the stroke of `step`."""

    def __init__(self, body, rig, physics=None):
        physics = physics or Physics(
            young=rig.young,
            poisson=rig.poisson,
            law=Law("ogden", {"alpha": rig.alpha}),
            contrast=rig.contrast,
            base=Springs(rig.base_along, rig.base_across),
        )
        super().__init__(body, physics, {k: (one.centre, one.radius) for k, one in enumerate(rig.actuators)})
        self.strokes = [one.stroke * one.direction for one in rig.actuators]

    def _add_surfaces(self, u, residual, blocks):
        for stroke, (surface, distance, radius, _) in zip(self.strokes, self.pads.values(), strict=True):
            tie = TIE * (distance < radius)
            surface.forces(tie[..., None] * (self.stroke[0] * stroke - surface.at(u)), residual)
            if blocks is not None:
                blocks.append((surface.elements, surface.matrices(tie[..., None, None] * np.eye(3))))
        super()._add_surfaces(u, residual, blocks)

    def pad_forces(self):
        """Return the force of each pad on the body (n_pads, 3) in mN."""
        forces = []
        for stroke, (surface, distance, radius, _) in zip(self.strokes, self.pads.values(), strict=True):
            traction = (TIE * (distance < radius))[..., None] * (self.stroke[0] * stroke - surface.at(self.u))
            forces.append(np.einsum("kqx,kq->x", traction, surface.dx))
        return np.array(forces)


def solve(rig, shares=SHARES, n_corners=N_CORNERS):
    """Return arrays by name, places (mm) and what moves them at the shares (mm, mN), and the work that was done."""
    begun = clock.process_time()
    body, nodes, skin = body_of(n_corners)
    markers, sensor, inner = points(rig, nodes, skin)
    on_skin = body.interpolation(markers, on_skin=True)
    inside = body.interpolation(np.vstack([sensor, inner]), on_skin=False)
    run = TwinRun(body, rig)
    seen, below, forces = [], [], []
    for k, share in enumerate(shares):
        run.step(k + 1.0, (share, 0.0, 0.0))
        seen.append(on_skin @ run.u)
        below.append(inside @ run.u)
        forces.append(run.pad_forces())
    run.factor.free()
    below = np.array(below)
    return {
        "shares": np.asarray(shares),
        "markers_mm": markers,
        "sensor_mm": sensor,
        "inner_mm": inner,
        "marker_displacement_mm": np.array(seen),
        "sensor_displacement_mm": below[:, 0],
        "inner_displacement_mm": below[:, 1:],
        "pad_force_mN": np.array(forces),
    }, {
        "n_nodes": body.n_nodes,
        "factorisations": run.counts["factorings"],
        "cpu_s": round(clock.process_time() - begun, 1),
        "mean_displacement_mm": float(np.linalg.norm(run.u, axis=1).mean()),
        "largest_displacement_mm": float(np.linalg.norm(run.u, axis=1).max()),
    }
