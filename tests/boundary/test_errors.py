"""Every exception that the compiled module raises, raised once, with its class, its message and its attributes."""

import numpy as np
import pytest

from tissuereg import _core, errors


def one(value):
    return np.array([value])


@pytest.fixture(scope="module")
def body(block_mesh):
    return _core.Body(block_mesh.nodes, block_mesh.tets, block_mesh.fixed_nodes)


def changed(array, index, value):
    array = array.copy()
    array[index] = value
    return array


@pytest.mark.parametrize(
    ("match", "attribute", "change"),
    [
        ("at least one tet", None, lambda n, t: (n, t[:0])),
        ("node 3 is at", ("node", 3), lambda n, t: (changed(n, (3, 1), np.nan), t)),
        ("tetrahedron 5 names node 120", ("tet", 5), lambda n, t: (n, changed(t, (5, 2), 120))),
        ("`tets` must hold node numbers from 0 on, got -1 in row 5", None, lambda n, t: (n, changed(t, (5, 2), -1))),
        ("tetrahedron 5 names node .* more than once", ("tet", 5), lambda n, t: (n, changed(t, (5, 2), t[5, 1]))),
        ("tetrahedron 5 is inverted", ("tet", 5), lambda n, t: (n, changed(t, 5, t[5, [0, 2, 1, 3]]))),
        ("belongs to none", ("node", 120), lambda n, t: (np.vstack([n, [[1.0, 2.0, 3.0]]]), t)),
        ("is degenerate", ("tet", 0), lambda n, t: (n * [1.0, 1.0, 1e-14], t)),
        ("may share one", ("triangle", None), lambda n, t: (n, np.vstack([t, t[5]]))),
    ],
)
def test_a_bad_mesh_raises_mesh_error(block_mesh, match, attribute, change):
    nodes, tets = change(block_mesh.nodes, block_mesh.tets)
    with pytest.raises(errors.MeshError, match=match) as caught:
        _core.check_mesh(nodes, tets)
    if attribute is not None:
        name, value = attribute
        assert value is None or getattr(caught.value, name) == value
        assert hasattr(caught.value, name)
        assert caught.value.where


def test_volumes_of_tets_are_signed_and_refuse_a_node_that_is_not_there(block_mesh):
    nodes, tets = block_mesh.nodes, block_mesh.tets
    corners = nodes[tets]
    by_determinant = np.linalg.det(corners[:, 1:] - corners[:, :1]) / 6.0
    np.testing.assert_allclose(_core.tet_volumes(nodes, tets), by_determinant, rtol=1e-12)
    np.testing.assert_allclose(_core.tet_volumes(nodes * [1.0, 1.0, -1.0], tets), -by_determinant, rtol=1e-12)
    with pytest.raises(errors.MeshError, match="tetrahedron 5 names node 120"):
        _core.tet_volumes(nodes, changed(tets, (5, 2), 120))


@pytest.mark.parametrize(
    ("match", "held"),
    [
        ("still free: ", []),
        ("rotation about", [0]),
        ("does not exist", [120]),
        ("more than once", [0, 0]),
        ("got -1", [-1]),
    ],
)
def test_a_body_that_is_not_held_raises_support_error(block_mesh, match, held):
    with pytest.raises(errors.SupportError, match=match):
        _core.Body(block_mesh.nodes, block_mesh.tets, np.array(held, dtype=np.int64))


def test_rigid_modes_are_named_in_an_attribute(block_mesh):
    with pytest.raises(errors.SupportError) as caught:
        _core.Body(block_mesh.nodes, block_mesh.tets, np.array([0]))
    assert len(caught.value.modes) == 3


@pytest.mark.parametrize(
    ("young", "poisson", "match"), [(0.0, 0.4, "Young"), (9.0, 0.5, "Poisson"), (9.0, np.nan, "Pois")]
)
def test_a_bad_modulus_raises_material_error(body, young, poisson, match):
    with pytest.raises(errors.MaterialError, match=match):
        body.solve(one(young), one(poisson))
    with pytest.raises(errors.MaterialError, match=f"member 1: {match}") as caught:
        body.solve_many(np.array([9.0, young]), np.array([0.4, poisson]))
    assert caught.value.where.startswith("member 1")


def test_a_bad_load_raises_load_error(body, block_mesh):
    nan = np.full((body.n_nodes, 3), np.nan)
    with pytest.raises(errors.LoadError, match="nodal forces must be finite"):
        body.solve(one(9.0), one(0.4), forces=nan)
    with pytest.raises(errors.LoadError, match="member 1: nodal forces"):
        body.solve_many(np.full(2, 9.0), np.full(2, 0.4), forces=np.stack([np.zeros_like(nan), nan]))
    with pytest.raises(errors.LoadError, match="no facet of the body's surface") as caught:
        body.traction_forces(np.array([[0, 1, 119]]), np.zeros((1, 3)))
    assert caught.value.row == 0
    start = -1.5 * block_mesh.nodes
    with pytest.raises(errors.LoadError, match="inverts tetrahedron"):
        body.solve(one(9.0), one(0.4), start=start)


def test_bad_settings_raise_with_their_name(body):
    with pytest.raises(errors.TissueRegError, match="`tolerance` must be above 0"):
        body.solve(one(9.0), one(0.4), tolerance=-1.0)
    with pytest.raises(errors.TissueRegError, match=r"`method` must be .*, got `magic`"):
        body.solve(one(9.0), one(0.4), method="magic")
    with pytest.raises(errors.TissueRegError, match=r"`element` must be .*, got `hex8`"):
        _core.Body(body.nodes, body.tets, body.held_nodes, element="hex8")


def test_a_load_without_equilibrium_raises_convergence_error_with_a_report(body):
    crushing = np.array([0.0, 0.0, -50.0])
    with pytest.raises(errors.ConvergenceError, match="no equilibrium at load fraction") as caught:
        body.solve(one(1.0), one(0.4), body_force=crushing, max_iterations=5)
    report = caught.value.report
    assert 0.0 <= report["load_fraction"] < 1.0
    assert report["iterations"] <= 5
    assert report["worst_tets"]
    assert report["residual_mN"] > report["tolerance_mN"]
    assert report["factorisations"] >= 1
    # Nothing was found within five iterations but the rest shape.
    assert report["load_fraction"] == 0.0
    np.testing.assert_array_equal(report["displacement"], np.zeros_like(body.nodes))


def test_a_member_without_equilibrium_is_a_row_and_not_an_exception(body):
    loads = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, -50.0], [0.0, 1e-3, 0.0]])
    many = body.solve_many(np.ones(3), np.full(3, 0.4), body_force=loads, max_iterations=30)
    ((member, reason),) = many.failed
    assert member == 1
    assert "no equilibrium" in reason
    assert np.isnan(many.displacement[1]).all()
    assert np.isnan(many.reactions[1]).all()
    assert np.isfinite(many.displacement[[0, 2]]).all()
    assert many.reports[1] == {}


def test_bad_derivatives_raise_by_cause(body):
    load = {"body_force": np.array([0.0, 1e-3, 0.0])}
    rest = np.zeros_like(body.nodes)
    with pytest.raises(errors.ConvergenceError, match="equilibrium"):
        body.linearise(rest, one(9.0), one(0.4), **load)
    here = body.linearise(rest, one(9.0), one(0.4))
    with pytest.raises(errors.TissueRegError, match=r"`name` must be a parameter of .*, got `c7`"):
        _core.Cause.parameter("c7")
    with pytest.raises(errors.TissueRegError, match=r"`name` must be `young` or `poisson`, got `b`"):
        _core.Cause.field("b", np.ones((body.n_tets, 1)))
    with pytest.raises(errors.MaterialError, match="FibreK1 of this law"):
        here.derivatives([_core.Cause.parameter("k1_over_mu")])
    with pytest.raises(errors.ShapeError, match="rates"):
        here.derivatives([_core.Cause.field("young", np.ones((3, 1)))])
    none = np.empty(0, dtype=np.int64), np.empty((0, 3))
    with pytest.raises(errors.LoadError, match="which is not held") as caught:
        here.adjoints([(*none, np.array([body.n_nodes - 1]), np.ones((1, 3)))])
    assert caught.value.node == body.n_nodes - 1
    with pytest.raises(errors.LoadError, match="got -1 in row 0"):
        here.adjoints([(np.array([-1]), np.ones((1, 3)), *none)])


@pytest.mark.parametrize(
    ("match", "call"),
    [
        ("at least one step", lambda: _core.schedule_geometric(0, 1.0)),
        ("decrease", lambda: _core.schedule_geometric(3, 0.0)),
        ("positive and finite, got -1 at step 1", lambda: _core.check_schedule(np.array([0.5, -1.0]))),
        ("add up to 1 within 1e-9, got 1.75", lambda: _core.check_schedule(np.array([4.0, 2.0, 1.0]))),
    ],
)
def test_a_bad_schedule_raises_schedule_error(match, call):
    with pytest.raises(errors.ScheduleError, match=match):
        call()


@pytest.mark.parametrize(
    ("match", "call"),
    [
        ("got 0 at observation 1", lambda: _core.Noise.diagonal(np.array([1.0, 0.0]))),
        ("fails at pivot 1", lambda: _core.Noise.dense(np.ones((2, 2)))),
        ("must be symmetric", lambda: _core.Noise.dense(np.array([[1.0, 0.5], [0.0, 1.0]]))),
        ("must be finite", lambda: _core.Noise.dense(np.array([[1.0, np.nan], [0.0, 1.0]]))),
    ],
)
def test_a_bad_noise_raises_noise_error(match, call):
    with pytest.raises(errors.NoiseError, match=match):
        call()


def step(predicted=None, observed=None, std=1.0, alpha=1.0, n_members=10):
    predicted = np.arange(2.0 * n_members).reshape(2, n_members) if predicted is None else predicted
    observed = np.zeros(len(predicted)) if observed is None else observed
    noise = _core.Noise.diagonal(np.full(len(predicted), std))
    return _core.Step(predicted, observed, noise, np.zeros_like(predicted), alpha=alpha)


def test_bad_data_of_a_step_raise_by_cause():
    bad = np.ones((2, 10))
    bad[1, 3] = np.nan
    with pytest.raises(errors.EnsembleError, match="`predicted` must be finite, got NaN at row 1, column 3"):
        step(bad)
    bad[1, 3] = 1e19
    with pytest.raises(errors.EnsembleError, match="must stay within 1e12"):
        step(bad)
    with pytest.raises(errors.EnsembleError, match="at least 2 ensemble members") as caught:
        step(n_members=1)
    assert caught.value.dropped == []
    with pytest.raises(errors.MarkerError, match="`observed` must be finite"):
        step(observed=np.array([0.0, np.inf]))
    with pytest.raises(errors.ScheduleError, match="positive and finite, got 0"):
        step(alpha=0.0)
    with pytest.raises(errors.NoiseError, match="leave the range"):
        step(std=1e-310)
    with pytest.raises(errors.ShapeError, match="at least one observation"):
        step(np.empty((0, 10)))
    with pytest.raises(errors.EnsembleError, match="`parameters` must be finite"):
        step().apply(np.full((1, 10), np.nan))


def test_bad_data_of_group_scores_raise_by_cause():
    one, zero = np.eye(2), np.zeros((2, 2))
    with pytest.raises(errors.ArgumentError, match="`groups` must be less than `n_groups`"):
        _core.GroupScores(np.zeros(2), one, zero, np.array([0, -1]), 2)
    with pytest.raises(errors.NoiseError, match="fails at pivot 1"):
        _core.GroupScores(np.zeros(2), np.diag([1.0, -1.0]), zero, np.array([0, 1]), 2)
    with pytest.raises(errors.ShapeError, match="`groups`"):
        _core.GroupScores(np.zeros(2), one, zero, np.zeros(3, np.int64), 2)
    assert repr(_core.GroupScores(np.zeros(2), one, zero, np.array([0, 1]), 2)) == "GroupScores(n_groups=2)"


def test_choices_of_a_step_are_refused_by_name():
    predicted, noise = np.arange(8.0).reshape(2, 4), _core.Noise.diagonal(np.ones(2))
    arguments = (predicted, np.zeros(2), noise, np.zeros((2, 4)))
    with pytest.raises(errors.TissueRegError, match="`factorisation` must be one of auto, cholesky, qr, svd, got lu"):
        _core.Step(*arguments, alpha=1.0, factorisation="lu")
