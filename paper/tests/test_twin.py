"""The virtual twin of the phantom rig: its solver against closed forms and against this package's own equilibrium."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from blind.generator.base import Springs
from blind.generator.laws import Law
from blind.generator.solver import Physics

import tissuereg as tr
from support.scripts import REPOSITORY

sys.path.append(str(REPOSITORY / "benchmarks"))

from twin.pairs import pairs_of
from twin.rig import PUSHES, draw, points, pushes
from twin.solve import TwinRun, body_of

N_CORNERS = 250


@pytest.fixture(scope="module")
def body():
    return body_of(N_CORNERS)


@pytest.fixture(scope="module")
def pressed(body):
    """A rig by the package's own law, pressed by a fifth of its stroke, its base held."""
    rig = draw(1, 0)
    run = TwinRun(body[0], rig, Physics(young=10.0, poisson=0.45))
    run.step(1.0, (0.2, 0.0, 0.0), tolerance=1e-7)
    return rig, run


def test_a_uniform_deformation_of_the_ogden_law_is_in_equilibrium(body):
    rig = draw(1, 0)
    run = TwinRun(body[0], rig, Physics(poisson=0.48, law=Law("ogden", {"alpha": 8.0})))
    run.stroke = np.zeros(3)
    gradient = np.array([[0.12, 0.05, 0.0], [0.0, -0.08, 0.02], [0.03, 0.0, 0.06]])
    run.pads = {}
    run.strokes = []
    residual, _ = run._residual(body[0].places.T @ gradient.T, False)
    facets = body[0].mesh.boundary_facets()
    outer = np.unique(np.concatenate([body[0].surface(facets, 1).dofs[row] for row in range(len(facets))]))
    inner = np.setdiff1d(np.arange(body[0].n_nodes), outer)
    # Stresses of tens of kPa on tens of mm^2: rounding of forces up to 1e3 mN.
    assert len(inner) > 20
    np.testing.assert_allclose(residual[inner], 0.0, atol=1e-8)


def test_the_twins_equilibrium_is_one_for_this_packages_ten_node_solver(body, pressed):
    _, run = pressed
    mesh = tr.phantom.breast_mesh(N_CORNERS)
    simulator = tr.Simulator(mesh, element="tet10")
    places = np.vstack([mesh.nodes, mesh.nodes[mesh.edges].mean(axis=1)])
    order = {tuple(np.round(place, 6)): row for row, place in enumerate(body[0].places.T)}
    rows = np.array([order[tuple(np.round(place, 6))] for place in places])
    forces = simulator.internal_forces(run.u[rows], tr.Material(10.0, 0.45))
    under_pad = np.unique(run.pads[0][0].dofs)
    free = ~np.isin(rows, under_pad) & (places[:, 2] > 0.0)
    assert np.abs(run.u).max() > 2.0
    assert np.abs(forces[~free]).max() > 10.0
    # The last Newton step moved nothing by 1e-7 mm; element stiffnesses are of some hundreds of mN/mm.
    np.testing.assert_allclose(forces[free], 0.0, atol=1e-3)


def test_pads_move_the_skin_by_their_stroke(pressed):
    rig, run = pressed
    surface, distance, radius, _ = run.pads[0]
    wanted = 0.2 * rig.actuators[0].stroke * rig.actuators[0].direction
    inside = distance < 0.8 * radius
    slip = np.linalg.norm(surface.at(run.u) - wanted, axis=2)[inside]
    # Elements of 12 mm that the rim cuts are tied in part alone: a hundredth of the stroke in the mean.
    assert np.sqrt((slip**2).mean()) < 0.01 * np.linalg.norm(wanted)


def test_a_soft_base_gives_and_a_stiff_one_holds(body):
    rig = draw(1, 0)

    def base_motion(stiffness):
        run = TwinRun(body[0], rig, Physics(base=Springs(stiffness, stiffness)))
        run.step(1.0, (0.1, 0.0, 0.0))
        return np.abs(run.u[body[0].base_nodes]).max()

    soft, stiff = base_motion(1.0), base_motion(1000.0)
    assert soft > 0.02
    assert stiff < 0.1 * soft


def test_a_rig_depends_on_scenario_and_seed_alone():
    first, again = draw(2, 3), draw(2, 3)
    assert first.young == again.young
    np.testing.assert_array_equal(first.actuators[1].centre, again.actuators[1].centre)
    assert draw(2, 4).young != first.young
    assert draw(1, 3).young != first.young


@pytest.mark.parametrize("scenario", [1, 2])
def test_markers_lie_off_the_pads_and_the_sensor_deep(body, scenario):
    rig = draw(scenario, 1)
    markers, sensor, inner = points(rig, *body[1:])
    assert len(rig.actuators) == scenario
    assert (len(markers), len(inner)) == (15, 200)
    for pad in rig.actuators:
        assert np.linalg.norm(markers - pad.centre, axis=1).min() > pad.radius
    skin = body[1][body[2]].mean(axis=1)
    assert np.linalg.norm(skin - sensor, axis=1).min() > 10.0


def test_pushes_grow_to_the_whole_stroke_and_end_at_rest():
    motion = pushes()
    assert motion.max() == pytest.approx(1.0)
    assert motion[-1] == pytest.approx(0.0, abs=1e-12)
    thirds = motion.reshape(len(PUSHES), -1).max(axis=1)
    np.testing.assert_allclose(thirds, PUSHES, rtol=1e-12)
    # 40 Hz: no jump between frames is more than a tenth of the stroke.
    assert np.abs(np.diff(motion)).max() < 0.1


def as_believed(rig):
    """Return a rig whose truth is what is believed: one modulus, a base as good as held, pads where they are known."""
    known = [replace(one, known_centre=one.centre, known_direction=one.direction) for one in rig.actuators]
    # Ogden's law of exponent 2 is the isochoric neo-Hookean one.
    same = {"young": 10.0, "poisson": 0.45, "alpha": 2.0, "inclusion_contrast": 1.0, "base_along": 1e5}
    return replace(rig, actuators=tuple(known), base_across=1e5, **same)


def test_a_rig_that_is_as_believed_makes_pairs_that_are_equal():
    mesh = tr.phantom.phantom_mesh("small")
    simulations, truths = pairs_of(as_believed(draw(2, 0)), mesh)
    assert len(truths) == 4
    moved = np.linalg.norm(truths, axis=2).mean(axis=1)
    assert moved[-1] > 1.0
    assert (np.diff(moved) > 0.0).all()
    # The laws differ in how volume and shape are coupled, by some percent at large strains.
    assert (np.linalg.norm(simulations - truths, axis=2).mean(axis=1) < 0.05 * moved).all()


def test_a_base_that_gives_moves_along_its_plane_and_across():
    mesh = tr.phantom.phantom_mesh("small")
    rig = as_believed(draw(1, 0))
    base = mesh.fixed_nodes
    for soft, moving in (("base_along", (0, 1)), ("base_across", (2,))):
        truths = pairs_of(replace(rig, **{soft: 0.5}), mesh)[1]
        moved = np.abs(truths[-1][base]).max(axis=0)
        for axis in range(3):
            # The other stiffness is 1e5 kPa/mm; a push of 15 mm moves a soft base by some tenths of a millimetre.
            assert (moved[axis] > 0.1) == (axis in moving), (soft, moved)


def test_a_rig_twice_as_stiff_as_believed_is_simulated_to_move_farther():
    mesh = tr.phantom.phantom_mesh("small")
    rig = as_believed(draw(1, 0))
    simulations, truths = pairs_of(replace(rig, young=15.0), mesh)
    factors = (simulations * truths).sum(axis=(1, 2)) / (truths**2).sum(axis=(1, 2))
    assert len(factors) >= 3
    assert (factors[:3] > 1.2).all()
