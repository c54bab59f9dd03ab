"""The generator's own mechanics against closed forms; the solves want scikit-fem."""

import numpy as np
import pytest

from blind.generator.laws import INVARIANT, Law
from blind.generator.memory import History, Memory
from blind.generator.shapes import Shape, boundary_triangles, half_ball, jittered, tets_from_bricks, volumes

SHAPES = {
    "fung": {"b": 2.0},
    "yeoh_split": {"c2": 0.5, "c3": 0.1},
    "fung_split": {"b": 1.0},
    "gent": {"limit": 4.0},
    "veronda_split": {"b": 1.0},
    "mooney": {"share": 0.4},
    "mooney_split": {"share": 0.4},
    "neo_hookean": {},
    "fibre": {"k1": 0.5, "k2": 2.0, "dispersion": 0.1},
    "ogden": {"alpha": -6.0},
    "one_sided": {"extra": 0.7},
}


@pytest.mark.parametrize("name", SHAPES)
def test_tangents_are_differences_of_stresses(name):
    rng = np.random.default_rng(0)
    F = np.eye(3) + 0.15 * rng.normal(size=(5, 3, 3))
    law = Law(name, SHAPES[name], (1.0, 2.0, 0.5))
    _, _, A = law.response(F, 4.0)
    step = 1e-6
    for k in range(9):
        h = step * np.eye(9)[k].reshape(3, 3)
        difference = (law.response(F + h, 4.0, False)[1] - law.response(F - h, 4.0, False)[1]) / (2 * step)
        # Equal stretches are parted by 1e-6 in the principal laws.
        np.testing.assert_allclose(difference.reshape(5, 9), A[..., k], rtol=0, atol=1e-5 * np.abs(A).max())


@pytest.mark.parametrize("name", INVARIANT)
def test_every_law_has_the_believed_moduli_at_rest(name):
    law = Law(name, {"k1": 0.0, "k2": 1.0} if name == "fibre" else SHAPES[name])
    _, P, A = law.response(np.eye(3)[None], 4.0)
    A = A.reshape(3, 3, 3, 3)
    np.testing.assert_allclose(P, 0.0, atol=1e-14)
    assert (A[0, 1, 0, 1], A[0, 0, 1, 1], A[0, 0, 0, 0]) == pytest.approx((1.0, 4.0, 6.0))


def test_relaxation_ends_where_the_long_run_modulus_says():
    F = np.diag([1.1, 0.96, 0.96])[None, None]
    law = Law()

    def stress(F, tangent, volume_only=False):
        return law.response(F, 4.0, tangent, volume_only)

    history = History(Memory(relaxing=((0.2, 0.5), (0.3, 2.0))), (1, 1))
    times = [0.0, 1e-6, *np.linspace(1.0, 60.0, 60)]
    stresses = []
    for before, time in zip([0.0, *times], times, strict=False):
        history.begin(time - before, time)
        shape = np.eye(3)[None, None] if time == 0.0 else F
        stresses.append(history.response(shape, stress, False)[0])
        history.end(shape, stress)
    elastic = law.response(F, 4.0, False)[1]
    np.testing.assert_allclose(stresses[1], elastic, rtol=1e-5)
    np.testing.assert_allclose(stresses[-1], 0.5 * elastic, rtol=1e-6, atol=1e-9)


def test_the_half_ball_is_filled_once():
    shape = Shape((60.0, 60.0, 50.0))
    ball, bricks = half_ball(8, 4, 4, turn=0.3)
    tets = tets_from_bricks(ball, bricks, np.random.default_rng(0))
    nodes = jittered(shape, ball, tets, np.random.default_rng(1), 0.15)
    assert volumes(nodes, tets).min() > 0
    # Flat facets cut off less than 3 % of 2/3 pi 60 60 50 mm^3.
    assert volumes(nodes, tets).sum() == pytest.approx(2 / 3 * np.pi * 60 * 60 * 50, rel=0.03)
    triangles = boundary_triangles(tets)
    area = np.cross(nodes[triangles[:, 1]] - nodes[triangles[:, 0]], nodes[triangles[:, 2]] - nodes[triangles[:, 0]])
    np.testing.assert_allclose(area.sum(axis=0), 0.0, atol=1e-6)


def _cube():
    skfem = pytest.importorskip(
        "skfem", reason="scikit-fem is absent: the foreign solver is not checked (extra: blind)"
    )
    from blind.generator.solver import Body

    mesh = skfem.MeshTet().refined(1)
    return Body(skfem.MeshTet2.from_mesh(skfem.MeshTet(10.0 * mesh.p, mesh.t)))


def _uniaxial(stretch, ratio):
    """Return the stretch across and the nominal stress over mu of the neo-Hookean law under tension."""
    across = 1.0
    for _ in range(60):
        log_j = np.log(stretch * across**2)
        miss = across - 1 / across + ratio * log_j / across
        slope = 1 + 1 / across**2 + ratio * (2 - log_j) / across**2
        across -= miss / slope
    return across, stretch - 1 / stretch + ratio * np.log(stretch * across**2) / stretch


def test_uniaxial_tension_is_the_closed_form():
    body = _cube()
    from blind.generator.solver import Physics, Run

    across, stress = _uniaxial(1.2, 9.0)
    F = np.diag([across, across, 1.2])
    run = Run(body, Physics(young=10.0, poisson=0.45), {})
    u = body.places.T @ (F - np.eye(3))
    inner = np.ones(body.n_nodes, dtype=bool)
    inner[np.abs(body.places.T - 5.0).max(axis=1) > 5 - 1e-9] = False
    residual, _ = run._residual(u, False)
    np.testing.assert_allclose(residual[inner], 0.0, atol=1e-8)
    top = body.places[2] > 10 - 1e-9
    mu = 10.0 / 2.9
    raw = Run(body, Physics(young=10.0, poisson=0.45), {})
    raw.fixed[:] = False
    pull = -raw._residual(u, False)[0][top].sum(axis=0)
    np.testing.assert_allclose(pull, [0.0, 0.0, 100.0 * mu * stress], rtol=1e-10, atol=1e-8)


def test_weight_is_carried_by_the_base():
    body = _cube()
    from blind.generator.base import Springs
    from blind.generator.solver import Physics, Run

    run = Run(body, Physics(young=10.0, weight=(0.0, 0.0, -9.81e-3), base=Springs(50.0)), {})
    run.step(0.0)
    traction, _ = run.base.traction(run.u)
    force = np.einsum("kqx,kq->x", traction, run.base.surface.dx)
    np.testing.assert_allclose(force, [0.0, 0.0, 9.81], rtol=2e-3, atol=2e-3)


def test_a_moving_base_moves_the_body_rigidly():
    body = _cube()
    from blind.generator.solver import Physics, Run

    run = Run(body, Physics(base_motion=lambda points, time: np.full_like(points, 0.3 * time)), {})
    run.step(1.0)
    np.testing.assert_allclose(run.u, 0.3, atol=1e-6)
