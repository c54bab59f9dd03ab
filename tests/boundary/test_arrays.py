"""What may cross into the compiled module, and what comes back."""

import pickle
import re

import numpy as np
import pytest

from tissuereg import _core
from tissuereg.errors import ShapeError

RNG = np.random.default_rng(7)


@pytest.fixture(scope="module")
def body(block_mesh):
    return _core.Body(block_mesh.nodes, block_mesh.tets, block_mesh.fixed_nodes)


@pytest.fixture(scope="module")
def update():
    predicted = RNG.standard_normal((6, 20))
    noise = _core.Noise.diagonal(np.full(6, 0.3))
    return predicted, np.zeros(6), noise, RNG.standard_normal((6, 20))


def one(value):
    return np.array([value])


NO_NODES, NO_WEIGHTS = np.empty(0, dtype=np.int64), np.empty((0, 3))


NOTHING = NO_NODES, NO_WEIGHTS


def at_rest(body):
    return body.linearise(np.zeros_like(body.nodes), one(9.0), one(0.4))


@pytest.mark.parametrize(
    ("name", "call"),
    [
        ("nodes", lambda b, m: _core.Body(m.nodes.astype(np.float32), m.tets, m.fixed_nodes)),
        ("nodes", lambda b, m: _core.Body(m.nodes[:, :2], m.tets, m.fixed_nodes)),
        ("nodes", lambda b, m: _core.Body(np.asfortranarray(m.nodes), m.tets, m.fixed_nodes)),
        ("nodes", lambda b, m: _core.Body(m.nodes.astype(">f8"), m.tets, m.fixed_nodes)),
        ("nodes", lambda b, m: _core.check_mesh(m.nodes.tolist(), m.tets)),
        ("tets", lambda b, m: _core.check_mesh(m.nodes, m.tets.astype(np.int32))),
        ("tets", lambda b, m: _core.surface_triangles(m.nodes, m.tets[:, :3])),
        ("nodes", lambda b, m: _core.tet_volumes(m.nodes[:, :2], m.tets)),
        ("tets", lambda b, m: _core.tet_volumes(m.nodes, m.tets[:, :3])),
        ("held_nodes", lambda b, m: _core.Body(m.nodes, m.tets, m.fixed_nodes[:, None])),
        ("young", lambda b, m: b.solve(np.ones(2), one(0.4))),
        ("springs", lambda b, m: b.solve(one(9.0), one(0.4), springs=np.zeros((1, 2)))),
        ("springs", lambda b, m: b.solve_many(one(9.0), one(0.4), springs=np.zeros((1, 1, 2)))),
        ("start", lambda b, m: b.solve_many(one(9.0), one(0.4), start=np.zeros((2, len(m.nodes), 3)))),
        ("displacement", lambda b, m: b.internal_forces(np.zeros((2, 3)), one(9.0), one(0.4))),
        ("displacement", lambda b, m: b.spring_forces(np.zeros((2, 3)))),
        ("forces", lambda b, m: at_rest(b).responses(np.zeros((len(m.nodes), 3)))),
        ("weights", lambda b, m: at_rest(b).compliance([(np.array([3]), NO_WEIGHTS, *NOTHING)])),
        ("poisson", lambda b, m: b.solve(one(9.0), 0.4)),
        ("forces", lambda b, m: b.solve(one(9.0), one(0.4), forces=np.zeros((3, 3)))),
        ("body_force", lambda b, m: b.solve(one(9.0), one(0.4), body_force=np.zeros(2))),
        ("prescribed", lambda b, m: b.solve(one(9.0), one(0.4), prescribed=np.zeros((1, 3)))),
        ("start", lambda b, m: b.solve(one(9.0), one(0.4), start=np.zeros((1, 3)))),
        ("young", lambda b, m: b.solve_many(np.ones((2, 5)), np.ones(2))),
        ("poisson", lambda b, m: b.solve_many(np.ones(2), np.ones(3))),
        ("forces", lambda b, m: b.solve_many(np.ones(2), np.ones(2), forces=np.zeros((2, 4, 3)))),
        ("body_force", lambda b, m: b.solve_many(np.ones(2), np.ones(2), body_force=np.zeros(3))),
        ("triangles", lambda b, m: b.traction_forces(np.zeros(3, dtype=np.int64), np.zeros((1, 3)))),
        ("traction", lambda b, m: b.traction_forces(np.zeros((1, 3), dtype=np.int64), np.zeros((2, 3)))),
        ("displacement", lambda b, m: b.linearise(np.zeros((3, 3)), one(9.0), one(0.4))),
        ("young", lambda b, m: b.linearise(np.zeros_like(b.nodes), np.ones(2), one(0.4))),
        ("rates", lambda b, m: _core.Cause.field("young", np.ones(360))),
        ("forces", lambda b, m: _core.Cause.load(forces=np.ones(3))),
        ("nodes", lambda b, m: at_rest(b).adjoints([(np.ones(1), np.ones((1, 3)), NO_NODES, NO_WEIGHTS)])),
        ("weights", lambda b, m: at_rest(b).adjoints([(np.array([1]), np.ones((2, 3)), NO_NODES, NO_WEIGHTS)])),
        ("held_weights", lambda b, m: at_rest(b).adjoints([(NO_NODES, NO_WEIGHTS, np.array([0]), NO_WEIGHTS)])),
        ("alphas", lambda b, m: _core.check_schedule(np.ones((1, 1)))),
        ("predicted", lambda b, m: _core.screen_members(np.ones(3), 1e6)),
        ("std", lambda b, m: _core.Noise.diagonal([0.1])),
        ("covariance", lambda b, m: _core.Noise.dense(np.ones(3))),
        ("covariance", lambda b, m: _core.Noise.dense(np.ones((3, 2)))),
    ],
)
def test_a_wrong_array_is_refused_by_name_with_what_was_wanted_and_what_was_found(body, block_mesh, name, call):
    with pytest.raises(ShapeError, match=rf"`{name}` must .*, got ") as caught:
        call(body, block_mesh)
    assert caught.value.where == name


def test_a_refusal_names_the_shapes_the_dtype_and_the_order_wanted(body):
    wanted = (
        r"`forces` must be a C-ordered float64 array of shape (120, 3), got float32 of shape (120, 3), not C-ordered"
    )
    with pytest.raises(ShapeError, match=re.escape(wanted)):
        body.solve(one(9.0), one(0.4), forces=np.zeros((120, 3), dtype=np.float32, order="F"))


@pytest.mark.parametrize("position", [0, 1, 3])
def test_a_step_refuses_wrong_arrays_by_name(update, position):
    name = ("predicted", "observed", "noise", "draws")[position]
    arguments = list(update)
    arguments[position] = np.ascontiguousarray(arguments[position][..., :-1]) if position else np.zeros(3)
    with pytest.raises(ShapeError, match=f"`{name}` must"):
        _core.Step(*arguments, alpha=1.0)
    with pytest.raises(ShapeError, match="`parameters` must"):
        _core.Step(*update, alpha=1.0).apply(np.zeros((2, 19)))


def test_a_noise_of_another_size_is_refused(update):
    predicted, observed, _, draws = update
    with pytest.raises(ShapeError, match="`noise` must"):
        _core.Step(predicted, observed, _core.Noise.diagonal(np.ones(5)), draws, alpha=1.0)


def test_inputs_stay_as_they_are(block_mesh, update):
    nodes, tets = block_mesh.nodes.copy(), block_mesh.tets.copy()
    held = block_mesh.fixed_nodes.copy()
    forces = RNG.standard_normal((1, *nodes.shape))
    parameters = RNG.standard_normal((4, 20))
    given = [nodes, tets, held, forces, parameters, *(x for x in update if isinstance(x, np.ndarray))]
    before = [x.copy() for x in given]
    for array in given:
        array.setflags(write=False)
    body = _core.Body(nodes, tets, held)
    found = body.solve(one(9.0), one(0.4), forces=forces[0])
    body.solve(one(9.0), one(0.4), forces=forces[0], start=found.displacement)
    body.solve_many(one(9.0), one(0.4), forces=forces)
    here = body.linearise(found.displacement, one(9.0), one(0.4), forces=forces[0])
    rates = np.ones((body.n_tets, 1))
    given.append(rates)
    before.append(rates.copy())
    here.derivatives([_core.Cause.field("young", rates), _core.Cause.load(forces=forces[0])])
    _core.Step(*update, alpha=2.0).apply(parameters)
    _core.Step.square_root(*update[:3], alpha=2.0).apply(parameters)
    for array, copy in zip(given, before, strict=True):
        array.setflags(write=True)
        np.testing.assert_array_equal(array, copy)


def test_results_own_their_memory_and_have_the_stated_shapes(body, block_mesh):
    n, h = body.n_nodes, len(block_mesh.fixed_nodes)
    found = body.solve(one(9.0), one(0.4), body_force=np.array([0.0, 1e-3, 0.0]))
    assert (found.displacement.shape, found.reactions.shape) == ((n, 3), (h, 3))
    assert found.displacement.dtype == found.reactions.dtype == np.float64
    assert found.displacement is found.displacement, "the same array each time, no copy"
    many = body.solve_many(np.full(2, 9.0), np.full(2, 0.4), body_force=np.zeros((2, 3)))
    assert (many.displacement.shape, many.reactions.shape) == ((2, n, 3), (2, h, 3))
    assert len(many.reports) == 2
    here = body.linearise(found.displacement, one(9.0), one(0.4), body_force=np.array([0.0, 1e-3, 0.0]))
    displacement, reactions = here.derivatives([_core.Cause.parameter("young"), _core.Cause.parameter("poisson")])
    assert (displacement.shape, reactions.shape) == ((2, n, 3), (2, h, 3))
    adjoints = here.adjoints([(np.array([n - 1]), np.ones((1, 3)), NO_NODES, NO_WEIGHTS)])
    assert adjoints.young.shape == adjoints.poisson.shape == (1, body.n_tets, 1)
    assert (adjoints.forces.shape, adjoints.body_force.shape) == ((1, n, 3), (1, 3))
    assert adjoints.prescribed.shape == (1, h, 3)
    nothing, _ = here.derivatives([])
    assert nothing.shape == (0, n, 3)
    assert body.surface_triangles.dtype == body.tets.dtype == body.held_nodes.dtype == np.int64
    assert not np.shares_memory(body.nodes, block_mesh.nodes)


def test_forces_may_have_a_row_a_corner_node_or_a_row_a_node(block_mesh):
    body = _core.Body(block_mesh.nodes, block_mesh.tets, block_mesh.fixed_nodes, element="tet10")
    assert body.n_nodes > body.n_corner_nodes == block_mesh.n_nodes
    assert body.mid_edges.shape == (body.n_nodes - body.n_corner_nodes, 2)
    corners = np.zeros((body.n_corner_nodes, 3))
    corners[-1] = (0.0, 3.0, 0.0)
    everywhere = np.zeros((body.n_nodes, 3))
    everywhere[: len(corners)] = corners
    a, b = (body.solve(one(9.0), one(0.4), forces=forces).displacement for forces in (corners, everywhere))
    np.testing.assert_array_equal(a, b)


def test_uniform_values_and_equal_values_a_tet_give_the_same_answer(body):
    gravity = np.array([0.0, -9.81e-3, 0.0])
    field = np.full(body.n_tets, 9.0)
    a = body.solve(one(9.0), one(0.4), body_force=gravity).displacement
    b = body.solve(field, one(0.4), body_force=gravity).displacement
    c = body.solve_many(field[None], one(0.4), body_force=gravity[None]).displacement[0]
    np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-7 * np.abs(a).max())
    np.testing.assert_allclose(c, a, rtol=0.0, atol=1e-7 * np.abs(a).max())


def test_a_body_on_springs_survives_pickling(block_mesh):
    bed = [(block_mesh.surface, [0.3, 0.1]), (block_mesh.surface[:2], [0.2, 0.0])]
    body = _core.Body(block_mesh.nodes, block_mesh.tets, NO_NODES, springs=bed, rests=True)
    again = pickle.loads(pickle.dumps(body))
    for (triangles, stiffness), (wanted, numbers) in zip(again.springs, bed, strict=True):
        np.testing.assert_array_equal(triangles, wanted)
        assert stiffness == numbers
    load = {"body_force": np.array([0.0, 1e-3, 0.0])}
    one_answer, other = (b.solve(one(9.0), one(0.4), **load).displacement for b in (body, again))
    assert np.abs(one_answer).max() > 0.0
    np.testing.assert_array_equal(one_answer, other)


def test_a_body_survives_pickling(body):
    again = pickle.loads(pickle.dumps(body))
    assert repr(again) == repr(body) == 'Body(n_nodes=120, n_tets=360, n_held=20, element="tet4")'
    np.testing.assert_array_equal(again.nodes, body.nodes)


def test_no_members_give_empty_arrays(body):
    many = body.solve_many(np.empty(0), np.empty(0))
    assert many.displacement.shape == (0, body.n_nodes, 3)
    assert (many.failed, many.reports) == ([], [])


def test_schedules_come_as_arrays():
    np.testing.assert_array_equal(_core.schedule_geometric(3, 2.0), [7.0, 3.5, 1.75])
    np.testing.assert_array_equal(_core.check_schedule(np.ones(2), total=2.0), np.ones(2))


def test_screening_names_members_and_reasons():
    predicted = np.array([[1.0, np.nan, 2.0, 1e19, np.inf]])
    kept, dropped = _core.screen_members(predicted, 1e6)
    np.testing.assert_array_equal(kept, [0, 2])
    assert dropped == [
        (1, "prediction 0 is not a number"),
        (3, "prediction 0 is 1e19, beyond 1e6"),
        (4, "prediction 0 is infinite"),
    ]


def test_a_step_is_the_textbook_update(update):
    predicted, observed, noise, draws = update
    parameters = RNG.standard_normal((3, 20))
    covariance = np.cov(np.vstack([parameters, predicted]))
    gain = covariance[:3, 3:] @ np.linalg.inv(covariance[3:, 3:] + 2.0 * np.diag(np.full(6, 0.09)))
    wanted = parameters + gain @ (observed[:, None] + np.sqrt(2.0) * 0.3 * draws - predicted)
    step = _core.Step(predicted, observed, noise, draws, alpha=2.0)
    assert (step.n_members, step.factorisation, noise.n_obs) == (20, "cholesky", 6)
    np.testing.assert_allclose(step.apply(parameters), wanted, rtol=0.0, atol=1e-12)
