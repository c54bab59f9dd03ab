"""Solves the truths of one rig after the other, one file each, so that a run that was stopped goes on."""

import json
from pathlib import Path

import numpy as np

from rigs.generator.cases import DATA, save
from rigs.generator.history import Course
from rigs.generator.meshing import truth_mesh, user_mesh
from rigs.generator.ngs import NgSolver
from rigs.generator.rigs import make
from rigs.generator.skeleton import marked
from rigs.generator.skf import SkSolver, bent_edges
from rigs.generator.truth import Truth

BUILD = Path("build") / "rigs"


class Bench:
    """One rig with its solver, and the null's states and readings.

    `name`: of the rig; `fine`: factor on the fineness of the mesh.
    """

    def __init__(self, name, fine=1.0):
        self.rig = make(name)
        mesh = truth_mesh(self.rig, fine)
        self.solver = NgSolver(self.rig, mesh)
        if self.rig.solver == "scikit-fem":
            self.solver = SkSolver(self.rig, mesh, bent_edges(self.solver.skeleton))
        self.reads = marked(self.solver.skeleton, self.rig)
        self.near = {}
        course, self.null = self._run(Truth())
        self.near = course.tangents()

    def solve(self, truth):
        """Return the clean readings of a truth as arrays."""
        return self._run(truth)[1]

    def _run(self, truth):
        course = Course(self.rig, self.solver, self.reads, self.near)
        clean = course.run(truth)
        places = self.solver.skeleton.places
        return course, {
            "places": clean.places,
            "targets": clean.targets,
            "forces": clean.forces,
            "times": clean.times,
            "labels": np.array(clean.labels),
            "marks": self.reads[0] @ places,
            "inner": self.reads[1] @ places,
        }

    def bulge(self):
        """Return places (k, 3) on the free skin, their outward normals, and their motion in the first load case."""
        skeleton, rig = self.solver.skeleton, self.rig
        middles = skeleton.face_middles
        free = ~np.any([patch.inside(middles) for patch in (*rig.holds, *rig.pads)], axis=0)
        which = np.flatnonzero(free)
        reading = skeleton.on_faces(which, np.full((len(which), 3), 1 / 3))
        a, b, c = (skeleton.places[skeleton.faces[which, k]] for k in range(3))
        normals = np.cross(b - a, c - a)
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
        centre = skeleton.places[skeleton.tets[:, :4]].mean(axis=(0, 1))
        inward = np.einsum("ij,ij->i", middles[which] - centre, normals) < 0
        normals[inward] *= -1
        return middles[which], normals, reading @ self.near[rig.loads[0].name, 1.0][0]


def stored(name, key):
    """Return stored clean readings and what is known of them, or None."""
    path = BUILD / "clean" / name / f"{key}.npz"
    if not path.exists():
        return None
    with np.load(path) as file:
        found = {k: file[k] for k in file}
    return found, json.loads(str(found.pop("summary")))


def keep(name, key, clean, summary):
    """Store clean readings."""
    save(BUILD / "clean" / name / f"{key}.npz", summary=np.array(json.dumps(summary)), **clean)


def write_mesh(rig):
    """Store the user's mesh."""
    path = DATA / "meshes" / f"{rig.name}.npz"
    if not path.exists():
        mesh = user_mesh(rig)
        sets = {f"set_{name}": np.asarray(some).astype(np.int16) for name, some in mesh.sets.items()}
        save(path, nodes=mesh.nodes.astype(np.float32), tets=mesh.tets.astype(np.int16), **sets)
