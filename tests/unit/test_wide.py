"""Many right-hand sides at an equilibrium, forces that hold a displacement, bodies on springs, starts near by."""

import numpy as np
import pytest

import tissuereg as tr
from support.meshes import block
from tissuereg.errors import LoadError, ShapeError, SupportError, TissueRegError
from tissuereg.simulation.sensitivity import Linearised, ModulusField, Observation, Parameter
from tissuereg.simulation.solve import Simulator

TIGHT = {"tolerance": 1e-12, "method": "newton"}
ELEMENTS = ["tet4", "tet4-averaged", "tet10"]
PULL = tr.Load(body_force=[0.02, 0.005, 0.04])
SILICONE = tr.Material(9.0, 0.4)
RNG_SEED = 4


@pytest.fixture(params=ELEMENTS)
def simulator(request):
    return Simulator(block(cells=(2, 1, 3)), element=request.param)


def linearised(simulator, load=PULL, **settings):
    found = simulator.solve(load, SILICONE, **TIGHT)
    return Linearised(simulator, load, SILICONE, found.all_displacement, **settings)


def markers(simulator, n):
    rng = np.random.default_rng(RNG_SEED)
    free = np.setdiff1d(np.arange(simulator.mesh.n_nodes), simulator.held_nodes)
    return [Observation(rng.choice(free, 3, replace=False), rng.normal(size=(3, 3))) for _ in range(n)]


def assert_near(found, wanted, share):
    assert found.shape == wanted.shape
    assert np.abs(wanted).max() > 0.0
    assert np.abs(found - wanted).max() < share * np.abs(wanted).max()


@pytest.mark.parametrize(("precision", "share"), [("double", 1e-11), ("single", 1e-7)])
def test_the_compliance_is_part_of_the_adjoints(simulator, precision, share):
    seen = markers(simulator, 11)
    adjoints = linearised(simulator).adjoints(seen)
    here = linearised(simulator, precision=precision)
    found = here.compliance(seen)
    for name in ("forces", "body_force", "prescribed"):
        assert_near(getattr(found, name), getattr(adjoints, name), share)
    assert here.report["precision"] == precision
    assert here.report["factorisations"] == 1
    assert here.report["right_hand_sides"] == 11


def test_unbalanced_forces_times_the_compliance_are_the_adjoints_by_fields(simulator):
    here, seen = linearised(simulator), markers(simulator, 4)
    fields = np.random.default_rng(RNG_SEED).normal(size=(5, simulator.mesh.n_tets, simulator.n_points))
    unbalanced = here.unbalanced([ModulusField("young", rates) for rates in fields])
    found = -np.einsum("oni,cni->oc", here.compliance(seen).forces, unbalanced)
    assert_near(found, np.einsum("otp,ctp->oc", here.adjoints(seen).young, fields), 1e-10)


def test_responses_are_derivatives_by_forces(simulator):
    here = linearised(simulator)
    forces = np.random.default_rng(RNG_SEED).normal(size=(9, simulator.body.n_nodes, 3))
    wanted = here.derivatives([tr.Load(forces=rows[: simulator.mesh.n_nodes]) for rows in forces])
    forces[:, simulator.mesh.n_nodes :] = 0.0
    assert_near(here.responses(forces), wanted.all_displacement, 1e-10)


def test_threads_and_batches_do_not_change_the_bits():
    simulator = Simulator(block(cells=(8, 6, 10)))
    seen = markers(simulator, 21)
    for precision in ("double", "single"):
        one, two = (linearised(simulator, precision=precision, threads=n) for n in (1, 2))
        whole = one.compliance(seen).forces
        np.testing.assert_array_equal(two.compliance(seen).forces, whole)
        parts = [two.compliance(seen[:4]).forces, two.compliance(seen[4:]).forces]
        np.testing.assert_array_equal(np.concatenate(parts), whole)


def test_internal_forces_hold_the_displacement(simulator):
    found = simulator.solve(PULL, SILICONE, **TIGHT)
    forces = simulator.internal_forces(found.all_displacement, SILICONE)
    total = forces[: simulator.mesh.n_nodes].sum(axis=0) + forces[simulator.mesh.n_nodes :].sum(axis=0)
    # All of them balance: the reactions carry the weight.
    np.testing.assert_allclose(total, 0.0, atol=1e-9 * np.abs(forces).max())
    again = simulator.body.solve(*simulator.moduli(SILICONE), forces=forces, tolerance=1e-12)
    assert_near(again.displacement, found.all_displacement, 1e-9)
    mooney = tr.Material(9.0, 0.4, law="mooney-rivlin", shape={"share": 0.5})
    assert np.abs(simulator.internal_forces(found.all_displacement, mooney) - forces).max() > 1e-3


def on_springs(element="tet4", stiffness=(0.3, 0.1), **more):
    """Return a block that springs hold all over its surface, and nothing else."""
    mesh = block(cells=(2, 1, 3))
    everywhere = mesh.surface
    return Simulator(mesh, element=element, held_nodes=(), springs=[(everywhere, stiffness)], **more)


@pytest.mark.parametrize("element", ELEMENTS)
def test_a_body_without_held_nodes_rests_on_springs(element):
    simulator = on_springs(element)
    forces = np.zeros((simulator.mesh.n_nodes, 3))
    forces[0] = [3.0, -2.0, 5.0]
    load = tr.Load(forces=forces)
    found = simulator.solve(load, SILICONE, **TIGHT)
    assert found.reactions.shape == (0, 3)
    carried = simulator.spring_forces(found.all_displacement)
    assert carried.shape == (1, simulator.body.n_nodes, 3)
    np.testing.assert_allclose(carried[0].sum(axis=0), -forces[0], atol=1e-9)
    held = simulator.internal_forces(found.all_displacement, SILICONE)
    np.testing.assert_allclose(held[: len(forces)], forces, atol=1e-9)
    # A stiffness of its own, and how the answer follows it.
    stiffer = simulator.solve(load, SILICONE, springs=[[0.301, 0.1]], **TIGHT).all_displacement
    softer = simulator.solve(load, SILICONE, springs=[[0.299, 0.1]], **TIGHT).all_displacement
    here = Linearised(simulator, load, SILICONE, found.all_displacement)
    by_normal = here.derivatives([Parameter("springs.normal_kpa_per_mm")]).all_displacement[0]
    assert_near(by_normal, (stiffer - softer) / 0.002, 1e-4)
    seen = markers(simulator, 3)
    adjoints = here.adjoints(seen)
    assert adjoints.springs.shape == (3, 1, 2)
    read = [np.sum(one.weights * by_normal[one.nodes]) for one in seen]
    np.testing.assert_allclose(adjoints.springs[:, 0, 0], read, rtol=1e-8)
    assert_near(here.compliance(seen).forces, adjoints.forces, 1e-11)
    assert here.compliance(seen).prescribed.shape == (3, 0, 3)


def test_springs_whose_far_ends_move_take_the_body_along():
    simulator = on_springs()
    shift = np.broadcast_to([1.0, -2.0, 0.5], (simulator.body.n_nodes, 3))
    load = tr.Load(forces=-simulator.spring_forces(shift).sum(axis=0))
    found = simulator.solve(load, SILICONE, **TIGHT)
    np.testing.assert_allclose(found.displacement, shift, atol=1e-9)


def test_springs_of_many_members():
    simulator = on_springs()
    stiffness = np.array([[[0.3, 0.1]], [[0.6, 0.2]], [[0.1, 0.1]]])
    loads, materials = [PULL] * 3, [SILICONE] * 3
    many = simulator.solve_many(loads, materials, springs=stiffness)
    for member, own in enumerate(stiffness):
        alone = simulator.solve(PULL, SILICONE, springs=own)
        assert_near(many.displacement[member], alone.displacement, 1e-7)
    assert np.abs(many.displacement[0] - many.displacement[1]).max() > 1e-3
    same = simulator.solve_many(loads, materials, springs=stiffness[0])
    np.testing.assert_array_equal(same.displacement[2], many.displacement[0])


def test_members_start_where_they_are_told():
    simulator = Simulator(block(cells=(2, 1, 3)))
    loads = [tr.Load(body_force=[0.02, 0.005, 0.04 + by]) for by in (0.0, 0.001)]
    materials = [SILICONE] * 2
    parts = [simulator.load_parts(load) for load in loads]
    stacked = np.stack([part["body_force"] for part in parts])
    moduli = np.full(2, 9.0), np.full(2, 0.4)
    cold = simulator.body.solve_many(*moduli, body_force=stacked)
    for start in (cold.displacement, cold.displacement[0]):
        warm = simulator.body.solve_many(*moduli, body_force=stacked, start=start)
        assert warm.reports[0]["iterations"] == 0
        assert warm.reports[1]["iterations"] < cold.reports[1]["iterations"]
        assert_near(warm.displacement, cold.displacement, 1e-7)
    again = simulator.solve_many(loads, materials, start=cold.displacement)
    np.testing.assert_array_equal(again.all_displacement[0], cold.displacement[0])


def test_a_load_near_by_is_found_from_here():
    simulator = Simulator(block(cells=(4, 2, 5)))
    here = linearised(simulator, precision="single")
    more = tr.Load(body_force=1.2 * np.asarray(PULL.body_force))
    near, alone = here.solve_near(more), simulator.solve(more, SILICONE)
    assert_near(near.displacement, alone.displacement, 1e-7)
    assert near.report["factorisations"] == 1
    assert near.report["iterations"] < alone.report["iterations"]


def test_wrong_input_is_named(simulator):
    here = linearised(simulator)
    with pytest.raises(LoadError, match="displacements alone"):
        here.compliance([Observation(held_nodes=simulator.held_nodes[:1], held_weights=[[1.0, 0.0, 0.0]])])
    with pytest.raises(ShapeError, match="`forces` must have shape"):
        here.responses(np.zeros((4, 3)))
    with pytest.raises(ShapeError, match="`displacement` must have shape"):
        simulator.internal_forces(np.zeros((2, 3)), SILICONE)
    with pytest.raises(ShapeError, match="`start` must have shape"):
        simulator.solve_many([PULL], [SILICONE], start=np.zeros((2, 3)))
    with pytest.raises(ShapeError, match="`springs` must have shape"):
        simulator.solve(PULL, SILICONE, springs=[[1.0, 1.0]])
    with pytest.raises(TissueRegError, match="`precision` must be"):
        linearised(simulator, precision="half")
    with pytest.raises(SupportError):
        on_springs(rests=False)
    with pytest.raises(SupportError, match="springs"):
        on_springs().solve(PULL, SILICONE, springs=[[0.3, 0.0]])
    inside = np.array([[0, 1, 30]])
    with pytest.raises(LoadError, match="surface"):
        Simulator(simulator.mesh, springs=[(inside, (1.0, 1.0))])
