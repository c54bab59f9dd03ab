"""Exchangeable simulations of a tracker: the package's own, tables of fields, any function."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.errors import ArgumentError, LoadError, ShapeError
from tissuereg.tracking import CalledPhysics, FemPhysics, HoldingPhysics, Physics, TablePhysics
from tissuereg.tracking.physics import as_physics
from tissuereg.tracking.restart import Restart

MESH = block(cells=(2, 2, 3))
MATERIAL = tr.Material(young=10.0, poisson=0.4)


def pushed(share):
    return tr.Load(forces=np.where(MESH.nodes[:, 2:] == 40.0, [60.0 * share, 0.0, -20.0 * share], 0.0))


def physics(**changed):
    return FemPhysics(MESH, MATERIAL, pushed, **{"threads": 1, "tolerance": 1e-10, **changed})


def test_a_table_returns_its_fields_and_goes_straight_from_one_to_the_next():
    fields = np.random.default_rng(0).standard_normal((3, 5, 3))
    table = TablePhysics([0.0, 1.0, 4.0], fields)
    assert np.array_equal(table.field(0.0), fields[0])
    assert np.array_equal(table.field(4.0), fields[2])
    assert np.allclose(table.field(1.75), 0.75 * fields[1] + 0.25 * fields[2], rtol=0.0, atol=1e-15)


def test_a_table_of_two_parameters_is_exact_for_products_of_straight_lines():
    x, y = np.array([0.0, 2.0, 3.0]), np.array([-1.0, 1.0])
    table = TablePhysics([x, y], (x[:, None, None, None] * y[:, None, None]) * np.ones((4, 3)))
    # Rounding of four products.
    assert np.allclose(table.field((2.5, 0.25)), 2.5 * 0.25, rtol=0.0, atol=1e-14)


@pytest.mark.parametrize("outside", [-0.1, 1.1, np.nan])
def test_a_table_knows_nothing_outside_of_itself(outside):
    with pytest.raises((ArgumentError, ShapeError), match="actuator"):
        TablePhysics([0.0, 1.0], np.zeros((2, 4, 3))).field(outside)


@pytest.mark.parametrize("axes", [[0.0], [1.0, 0.0], [0.0, 0.0], [0.0, np.inf]])
def test_an_axis_that_does_not_ascend_is_refused(axes):
    with pytest.raises(ArgumentError, match="axes"):
        TablePhysics(axes, np.zeros((len(axes), 4, 3)))


def test_forces_hold_a_registered_shape_while_the_actuators_stand_still():
    solver = physics()
    shape = solver.field(1.0) + 0.02 * np.sin(MESH.nodes / 9.0) * (MESH.nodes[:, 2:] > 0.0)
    forces = solver.holding(shape, 1.0)
    assert not forces[MESH.fixed_nodes].any()
    # Of a solve whose start is the answer to a relative residual of 1e-10.
    assert np.abs(solver.held_field(1.0, forces, shape) - shape).max() < 1e-8


def test_the_forces_that_hold_a_simulated_shape_are_none():
    solver = physics()
    forces = solver.holding(solver.field(0.7), 0.7)
    # The solver's tolerance, of 0.7 times 60 mN a node.
    assert np.abs(forces).max() < 1e-6


def test_weight_counts_among_the_known_loads():
    hanging = tr.Load(body_force=(0.0, 0.0, 0.01))
    solver = FemPhysics(MESH, MATERIAL, lambda _: hanging, tolerance=1e-10, threads=1)
    shape = solver.field(None)
    weight = 0.01 * MESH.volumes.sum() / MESH.n_nodes
    # The solver's tolerance beside the weight of a node.
    assert np.abs(solver.holding(shape, None)).max() < 1e-6 * weight * MESH.n_nodes


def test_held_forces_and_a_moved_actuator_are_one_load():
    solver = physics()
    extra = np.where(MESH.nodes[:, 2:] > 20.0, [0.0, 5.0, 0.0], 0.0)
    together = tr.Simulator(MESH).solve(
        tr.Load(forces=extra + pushed(1.2).forces), MATERIAL, tolerance=1e-10, threads=1
    )
    found = solver.held_field(1.2, extra, solver.field(1.0))
    # Two solves to a relative residual of 1e-10.
    assert np.abs(found - together.displacement).max() < 1e-7


def test_a_shape_that_is_inside_out_is_held_by_nothing_and_its_displacement_is_carried_on():
    solver = physics()
    turned = np.zeros_like(MESH.nodes)
    turned[-1] = [-40.0, 0.0, 0.0]
    with pytest.raises(LoadError):
        solver.holding(turned, 1.0)
    restart = carried_on(solver, "forces", turned)
    found = restart.simulated(1.1)
    assert restart.fallbacks == 1
    expected = turned + solver.field(1.1) - solver.field(1.0)
    # Solves to a relative residual of 1e-10, from different starts.
    assert np.abs(found.field - expected).max() < 1e-7


def carried_on(solver, how, registered, shares=(0.5, 1.0)):
    """Return a restart whose last frame moved so far that its registered state is carried on."""
    restart = Restart(solver, how, 0.1)
    for share in shares:
        restart.registered(restart.simulated(share), registered, share)
    return restart


def test_a_first_guess_changes_no_answer():
    shape = physics().field(0.9) + 0.01 * MESH.nodes[:, 2:] / 40.0
    cold, warm = (carried_on(physics(), how, shape) for how in ("reference", "guess"))
    # Two solves to a relative residual of 1e-10.
    assert np.abs(cold.simulated(1.1).field - warm.simulated(1.1).field).max() < 1e-7


def test_a_load_that_stands_still_is_solved_once(monkeypatch):
    solved = []
    plain = tr.Simulator.solve
    monkeypatch.setattr(tr.Simulator, "solve", lambda *a, **k: solved.append(1) or plain(*a, **k))
    solver = physics()
    first = solver.field(1.0)
    forces = solver.holding(first, 0.9)
    held = solver.held_field(1.0, forces, first)
    assert len(solved) == 2
    assert np.array_equal(solver.field(1.0, start=first), first)
    assert np.array_equal(solver.held_field(1.0, forces, first), held)
    assert len(solved) == 2
    # Another load, dead load or start from rest is solved anew; what is returned may be changed.
    solver.field(1.0, start=first)[:] = 0.0
    assert np.array_equal(solver.field(1.0, start=first), first)
    solver.field(1.1, start=first)
    solver.held_field(1.0, 0.5 * forces, first)
    solver.field(1.1)
    assert len(solved) == 5


def test_a_load_that_is_changed_in_place_is_another_one():
    prescribed = np.zeros((len(MESH.fixed_nodes), 3))
    load = tr.Load(prescribed=prescribed)
    solver = FemPhysics(MESH, MATERIAL, threads=1, tolerance=1e-10)
    before = solver.field(load)
    prescribed[:, 0] = 0.5
    # A body whose support is shifted is shifted.
    assert np.allclose(solver.field(load, start=before), [0.5, 0.0, 0.0], rtol=0.0, atol=1e-6)


class Straight:
    """A simulation in proportion to the actuator, moved on by dead loads; it notes its first guesses."""

    def __init__(self):
        self.guesses = []

    def field(self, actuator, *, start=None):
        self.guesses.append(start)
        return actuator * np.ones((4, 3))

    def holding(self, displacement, actuator):
        return displacement - actuator * np.ones((4, 3))

    def held_field(self, actuator, forces, start):
        self.guesses.append(start)
        return actuator * np.ones((4, 3)) + forces


def test_first_guesses_are_the_answers_where_actuators_move_evenly():
    solver = Straight()
    restart = Restart(solver, "forces", 0.1)
    for share in (0.5, 1.0, 1.5, 1.55, 1.6):
        solver.guesses.clear()
        found = restart.simulated(share)
        restart.registered(found, found.field + 0.3 * (share == 1.0), share)
    # The last frame moved as the one before it, and the one before it too little for another registered state.
    plain, held = solver.guesses
    assert np.allclose(plain, 1.6, rtol=0.0, atol=1e-12)
    assert np.allclose(held, found.field, rtol=0.0, atol=1e-12)
    assert np.allclose(found.field, 1.9, rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("how", ["forces", "displacement", "guess", "reference"])
def test_the_change_is_that_of_the_actuators_alone(how):
    solver = physics()
    registered = solver.field(1.0) + 0.3 * np.outer(MESH.nodes[:, 2] / 40.0, [1.0, 0.0, 0.0])
    found = carried_on(solver, how, registered).simulated(1.0)
    # They stand still: nothing but the solver's tolerance.
    assert np.abs(found.change).max() < 1e-7
    carried = how in ("forces", "displacement")
    assert np.abs(found.field - registered).max() < 1e-7 or not carried
    assert np.abs(found.field - registered).max() > 0.1 or carried


@pytest.mark.parametrize("how", ["forces", "displacement"])
def test_while_the_actuators_stand_still_no_other_state_is_carried_on(how):
    solver = physics()
    restart = carried_on(solver, how, solver.field(1.0) + 0.2 * (MESH.nodes[:, 2:] / 40.0))
    still = restart.simulated(1.0)
    for shift in (0.5, -0.5):
        restart.registered(still, still.field + shift * (MESH.nodes[:, 2:] / 40.0), 1.0)
        # The solver's tolerance.
        assert np.abs(restart.simulated(1.0).field - still.field).max() < 1e-7


@pytest.mark.parametrize("how", ["forces", "displacement"])
def test_nothing_is_carried_on_before_the_simulation_has_moved(how):
    solver = physics()
    restart = carried_on(solver, how, solver.field(1.0) + 0.2 * (MESH.nodes[:, 2:] / 40.0), (1.0, 1.0, 1.0))
    assert np.abs(restart.simulated(1.0).field - solver.field(1.0)).max() < 1e-7


def test_simulations_that_cannot_hold_a_shape_add_its_displacement():
    table = TablePhysics([0.0, 1.0], np.zeros((2, MESH.n_nodes, 3)))
    assert Restart(table, "forces", 0.1).how == "displacement"
    assert isinstance(physics(), HoldingPhysics)
    assert not isinstance(table, HoldingPhysics)
    assert isinstance(table, Physics)


def test_any_function_is_a_simulation_and_nothing_else_is_one():
    wrapped = as_physics(lambda stroke: stroke * np.ones((4, 3)), "simulator")
    assert isinstance(wrapped, CalledPhysics)
    assert np.array_equal(wrapped.field(2.0), np.full((4, 3), 2.0))
    for wrong in (3.0, "table", TablePhysics):
        with pytest.raises(ArgumentError, match="simulator"):
            as_physics(wrong, "simulator")
    with pytest.raises(ShapeError, match="simulation"):
        CalledPhysics(lambda _: [1.0, 2.0]).field(0.0)
