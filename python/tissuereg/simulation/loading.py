"""Loads in the frames of an experiment's cases (load histories): pads, weight, forces on patches."""

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.experiment.experiment import Actuator, Case, Experiment

#: Loads whose parts differ by less than this share of the largest are one state.
_SAME = 1e-9


def pads_of(experiment: Experiment, case: Case) -> list[Actuator]:
    """Return the actuators (pads) of an experiment whose displacement a case (load history) prescribes."""
    return [a for a in experiment.actuators if a.kind == "displacement" and a.name in case.displacements]


def weight_of(experiment: Experiment) -> FloatArray | None:
    """Return the body's own weight as a body force in mN/mm^3, shape (3,); None without gravity."""
    gravity = experiment.gravity
    return None if gravity is None else experiment.material.weight(gravity.direction, gravity.g_mm_per_s2)


def hangs_already(experiment: Experiment) -> bool:
    """Return whether the mesh of an experiment was imaged under gravity, so that it is not the unloaded shape."""
    return experiment.gravity is not None and experiment.gravity.in_reference


def traction_of(experiment: Experiment, case: Case, frame: int) -> tuple[IntArray, FloatArray] | None:
    """Return the tractions of the force actuators in one frame of a case (load history).

    `experiment`: experiment with the actuators; `case`: one of its cases; `frame`: row of the case. Result: boundary
    triangles (n, 3) as node numbers, and the dead traction on each, (n, 3), in kPa; None without a force actuator.
    """
    triangles, tractions = [], []
    for pad in experiment.actuators:
        if pad.kind == "force" and pad.name in case.applied_forces:
            patch, area = _patch(experiment, pad)
            triangles.append(patch)
            tractions.append(np.broadcast_to(case.applied_forces[pad.name][frame] / area, (len(patch), 3)))
    return (np.concatenate(triangles), np.concatenate(tractions)) if triangles else None


def distinct_states(case: Case) -> tuple[FloatArray, IntArray]:
    """Return the distinct loads of a case in the order in which they first appear, and every frame's index among them.

    `case`: case with the commands of its actuators. Result: loads (n_states, n_parts), the components of displacement
    (mm) and force (mN) commands, each over the largest of its actuator and thus dimensionless, after a first column of
    zeros; indices (n_frames,).
    """
    given = [np.asarray(v) for v in (*case.displacements.values(), *case.applied_forces.values())]
    parts = [values / max(float(np.abs(values).max()), np.finfo(float).tiny) for values in given]
    table = np.concatenate([np.zeros((len(case.times), 1)), *parts], axis=1)
    _, first, inverse = np.unique(np.round(table / _SAME), axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return table[first[order]], rank[inverse.ravel()]


def first_frames(of_frame: IntArray) -> IntArray:
    """Return the frame in which each distinct load first appears, (n_states,), from the index of every frame's load."""
    return np.unique(of_frame, return_index=True)[1]


def _patch(experiment: Experiment, pad: Actuator) -> tuple[IntArray, float]:
    """Return the boundary triangles (n, 3) of a force actuator's patch, as node numbers, and their area in mm^2."""
    mesh = experiment.mesh
    inside = np.isin(mesh.surface, pad.nodes)
    # A patch smaller than a triangle still loads the triangles around its nodes.
    rows = inside.all(axis=1) if inside.all(axis=1).any() else inside.any(axis=1)
    triangles = mesh.surface[rows]
    corners = mesh.nodes[triangles]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return triangles, float(0.5 * np.linalg.norm(normal, axis=1).sum())
