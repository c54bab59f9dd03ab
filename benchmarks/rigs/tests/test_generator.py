"""The truth's solvers: a patch of uniform strain, the closed form of a pulled bar, one code against the other."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip(
    "ngsolve", reason="the foreign codes are in an environment of their own: make -C benchmarks/rigs data"
)
pytest.importorskip("skfem")
pytest.importorskip("pypardiso")

from scipy.optimize import brentq

from rigs.generator.bodies import box_of
from rigs.generator.history import Course
from rigs.generator.meshing import truth_mesh
from rigs.generator.newton import step
from rigs.generator.ngs import NgSolver
from rigs.generator.rigs import Hold, Load, Pad, Rig
from rigs.generator.skeleton import marked
from rigs.generator.skf import SkSolver, bent_edges
from rigs.generator.truth import Memory, Truth, moduli

YOUNG, NU = 10.0, 0.45


def rig_with(law=("neo-hookean", {})):
    body = box_of([40.0, 40.0, 40.0])
    pad = Pad(
        "top",
        np.array([20.0, 20.0, 40.0]),
        np.array([0.0, 0.0, 1.0]),
        np.array([1.0, 0.0, 0.0]),
        "round",
        np.array([9.0, 9.0]),
        True,
    )
    load = Load("push", 10.0, {"top": np.array([1.0, 0.0, -4.0])})
    return Rig(
        "rig-00", 0, body, law, (YOUNG, 2.0), NU, [Hold("base", 2, 0.0)], [pad], [load], 5, 1, "", True, False, 500
    )


def solvers(rig):
    mesh = truth_mesh(rig, fine=0.6)
    one = NgSolver(rig, mesh)
    return one, SkSolver(rig, mesh, bent_edges(one.skeleton))


@pytest.fixture(scope="module", params=["neo-hookean", "fung"])
def both(request):
    law = (request.param, {"b": 1.5} if request.param == "fung" else {})
    rig = rig_with(law)
    return rig, solvers(rig)


@pytest.fixture(scope="module", params=["neo-hookean", "fung"])
def plain(request):
    """Straight elements: no pad, at whose rim the middles of edges are moved."""
    law = (request.param, {"b": 1.5} if request.param == "fung" else {})
    rig = replace(rig_with(law), pads=[], loads=[])
    return rig, solvers(rig)


def nodal(solver, matrix):
    """Return the state of a uniform gradient: coefficients of edges carry no share of it on straight edges."""
    return solver.skeleton.places @ matrix.T


def test_a_patch_of_uniform_strain_stays_uniform(plain):
    _, codes = plain
    gradient = np.array([[0.05, 0.02, 0.0], [0.0, -0.04, 0.03], [0.01, 0.0, 0.06]])
    for solver in codes:
        solver.start(Truth())
        aim = nodal(solver, gradient)
        skin = np.zeros(len(aim), dtype=bool)
        skin[solver.skeleton.faces] = True
        free = np.repeat(~skin[:, None], 3, axis=1)
        u = step(solver, np.zeros_like(aim), free, aim)
        assert np.abs(u - aim).max() < 1e-5


def test_a_bar_pulled_at_its_ends_has_the_closed_form(plain):
    rig, codes = plain
    mu, lam, _ = moduli(rig, Truth())
    if rig.law[0] != "neo-hookean":
        pytest.skip("the closed form is that of the neo-Hookean law")
    along = 1.15

    def side(a):
        # Stress across: mu (a - 1/a) + lambda ln J / a = 0.
        return mu * (a - 1 / a) + lam * np.log(along * a * a) / a

    across = brentq(side, 0.8, 1.1)
    stress = mu * (along - 1 / along) + lam * np.log(along * across**2) / along
    for solver in codes:
        solver.start(Truth())
        places = solver.skeleton.places
        bottom, top = (solver.skeleton.patch(lambda p, z=z: np.abs(p[:, 2] - z) < 1e-6) for z in (0.0, 40.0))
        corner = solver.skeleton.corners() if not solver.skeleton.nodal else np.ones(len(places), dtype=bool)
        free = np.ones_like(places, dtype=bool)
        free[bottom | top, 2] = False
        # Symmetry planes keep it in place.
        for axis in (0, 1):
            free[solver.skeleton.patch(lambda p, k=axis: np.abs(p[:, k]) < 1e-6), axis] = False
        given = np.zeros_like(places)
        given[top, 2] = np.where(corner[top], 40.0 * (along - 1), 0.0)
        u = step(solver, np.zeros_like(places), free, given)
        force = solver.residual(u)[top & corner, 2].sum()
        assert force == pytest.approx(stress * 1600.0, rel=1e-5)


def test_the_two_codes_agree(both):
    rig, codes = both
    found = [Course(rig, solver, marked(solver.skeleton, rig)) for solver in codes]
    forces = [course.run(Truth()).forces for course in found]
    np.testing.assert_allclose(forces[0], forces[1], atol=0.01)


def test_relaxation_falls_to_its_long_run_share():
    rig = rig_with()
    solver = solvers(rig)[0]
    reads = marked(solver.skeleton, rig)
    elastic = Course(rig, solver, reads).run(Truth())
    relaxed = Course(rig, solver, reads).run(Truth(memory=Memory(relaxing=((0.3, 0.3),))))
    held = [k for k, time in enumerate(elastic.times) if time == 18.0]
    np.testing.assert_allclose(relaxed.forces[held], 0.7 * elastic.forces[held], rtol=2e-3)


def test_growth_without_pads_keeps_the_shape():
    rig = rig_with()
    solver = solvers(rig)[0]
    reads = marked(solver.skeleton, rig)
    grown = Course(rig, solver, reads).run(Truth(growth=lambda time, points: np.full(len(points), 0.01 * (time > 1.5))))
    assert np.abs(grown.places[1] - grown.places[0]).max() < 1e-5
    assert np.abs(grown.places[3] - grown.places[0]).max() > 0.1
