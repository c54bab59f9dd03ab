"""What is kept from call to call: the tangent at rest, observations at a tangent, and what belongs to a mesh."""

import gc
import weakref
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import tissuereg as tr
from support.meshes import block
from support.pushes import MATERIAL, NOTHING, TIGHT, body, columns_of, push
from tissuereg.body.mesh import per_mesh
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts.body import forget_bodies
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.measured import MarkerData
from tissuereg.registration.contacts.settings import EFFORT, ContactSettings
from tissuereg.registration.contacts.state import BodyState, RigidMotion
from tissuereg.registration.contacts.tangent import Tangent, forget_rest, tangent_at
from tissuereg.registration.readings.skin import skin_of
from tissuereg.simulation.sensitivity import Linearised, ModulusField, Parameter


@pytest.fixture(autouse=True)
def nothing_kept():
    forget_rest()


def at_rest(columns):
    n_nodes = columns.body.simulator.body.n_nodes
    return BodyState(np.zeros(columns.n_columns), np.zeros((n_nodes, 3)), RigidMotion.still())


def rows(nodes):
    return [(np.array([node]), np.eye(3)[axis : axis + 1]) for node in nodes for axis in range(3)]


def test_the_tangent_at_rest_is_factored_once_a_body_material_and_number_of_threads():
    columns = columns_of()
    here, factored = tangent_at(columns, MATERIAL, at_rest(columns), 1)
    again, none = tangent_at(columns, MATERIAL, at_rest(columns), 1)
    assert (factored, none) == (1, 0)
    assert again.linearised is here.linearised
    for other in [
        (columns, tr.Material(9.0, 0.4), 1),
        (columns, tr.Material(8.0, 0.4, law="mooney-rivlin", shape={"share": 0.3}), 1),
        (columns, MATERIAL, 2),
        (columns_of("perhaps"), MATERIAL, 1),
        (columns_of("perhaps").on_springs([3.0, 3.0]), MATERIAL, 1),
    ]:
        tangent_at(columns, MATERIAL, at_rest(columns), 1)
        found, factored = tangent_at(other[0], other[1], at_rest(other[0]), other[2])
        assert factored == 1, other
        assert found.linearised is not here.linearised
    # Under a load the rest shape is no equilibrium, and no cached tangent may be used for it.
    loaded = columns_of(believed={"body_force": np.array([0.0, 0.0, -1e-3])})
    with pytest.raises(ConvergenceError):
        tangent_at(loaded, MATERIAL, at_rest(loaded), 1)


def test_a_body_that_moved_is_not_taken_for_one_at_rest():
    columns, fit_at = columns_of(), at_rest(columns_of())
    tangent_at(columns, MATERIAL, fit_at, 1)
    coefficients = fit_at.coefficients.copy()
    coefficients[3] = 1e-3
    load = columns.load(coefficients)
    moved = columns.body.simulator.solve(load, MATERIAL, **TIGHT).all_displacement
    found, factored = tangent_at(columns, MATERIAL, BodyState(coefficients, moved, fit_at.frame), 1)
    assert factored == 1
    assert found.linearised is not tangent_at(columns, MATERIAL, fit_at, 1)[0].linearised


def test_remembered_observations_have_the_same_bits_and_cost_nothing():
    columns = columns_of()
    tangent, _ = tangent_at(columns, MATERIAL, at_rest(columns), 1)
    first, solved = tangent.compliance(rows([402, 302]))
    assert solved == 6
    mixed, solved = tangent.compliance(rows([302, 202, 402]))
    assert solved == 3
    alone = Tangent(tangent.linearised).compliance(rows([302, 202, 402]))[0]
    for part in ("forces", "body_force", "prescribed"):
        assert np.array_equal(getattr(mixed, part), getattr(alone, part))
    assert np.array_equal(mixed.forces[:3], first.forces[3:])
    twice, solved = tangent.compliance([*rows([102]), *rows([102])])
    assert solved == 3
    assert np.array_equal(twice.forces[:3], twice.forces[3:])


def test_known_kept_and_missing_rows_come_in_the_order_that_is_asked_for(monkeypatch):
    columns = columns_of()
    first, _ = tangent_at(columns, MATERIAL, at_rest(columns), 1)
    first.compliance(rows([402]))
    nodes = [302, 402, 202]
    wanted = Tangent(first.linearised).compliance(rows(nodes))[0]
    # Of another registration, which knows one of them and keeps none.
    found, solved = first.anew().compliance(rows(nodes))
    assert solved == 6
    # One is kept, two known from the other registration, one missing, and there is no room for more.
    crowded = first.anew()
    crowded.compliance(rows([202]))
    monkeypatch.setattr("tissuereg.registration.contacts.tangent.EFFORT", replace(EFFORT, remembered=8))
    more, solved = crowded.compliance(rows([102, *nodes]))
    assert solved == 3
    assert len(crowded._kept) == 3
    for part in ("forces", "body_force", "prescribed"):
        assert np.array_equal(getattr(found, part), getattr(wanted, part))
        assert np.array_equal(getattr(more, part)[3:], getattr(wanted, part))
    assert np.array_equal(more.forces[:3], Tangent(first.linearised).compliance(rows([102]))[0].forces)


def test_uncertain_parameters_of_one_name_are_told_apart():
    columns = columns_of()
    coefficients = np.zeros(columns.n_columns)
    coefficients[[3, 40]] = 0.5
    load, simulator = columns.load(coefficients), columns.body.simulator
    moved = simulator.solve(load, MATERIAL, **TIGHT).all_displacement
    pushed, n_tets = Linearised(simulator, load, MATERIAL, moved), columns.body.mesh.n_tets
    tangent = Tangent(pushed)
    halves = [ModulusField("young", (np.arange(n_tets) < n_tets // 2) == first) for first in (True, False)]
    whole = [ModulusField(name, np.ones(n_tets)) for name in ("young", "poisson")]
    sensed, _ = tangent.sensed(rows([302, 202]))
    for cause in [*halves, *whole, Parameter("young")]:
        slope = pushed.derivatives([cause]).displacement[0, [302, 202]].ravel()
        assert np.abs(tangent.by_cause(sensed, cause) + slope).max() < 1e-6 * np.abs(slope).max()


def test_a_tangent_at_rest_is_that_of_its_changes_of_stiffness():
    plain = columns_of()
    graded = Columns.of(body(), MATERIAL, NOTHING, ContactSettings(), stiffness=(0.1, 0.5))
    made = [tangent_at(columns, MATERIAL, at_rest(columns), 1)[0] for columns in (plain, graded, graded)]
    assert [len(tangent.stiffness_forces) for tangent in made] == [0, 3, 3]
    # At rest no stiffness moves anything; under other forces both registrations answer alike.
    forces = np.random.default_rng(3).normal(size=made[1].stiffness_forces.shape)
    made[1]._first.stiffness_forces = forces
    wanted = made[1].linearised.responses(forces)
    assert np.array_equal(made[1].by_stiffness, wanted)
    assert np.array_equal(made[2].by_stiffness, wanted)


def test_an_answer_does_not_depend_on_what_was_registered_before():
    # A body that nothing holds: its markers are seen along turned axes, whose rows are sums of known ones.
    body, given = tr.Body(push().mesh, MATERIAL, "tet4", "free"), push().markers()
    settings = tr.RegisterSettings(threads=1)

    def turned(angle):
        turn = Rotation.from_rotvec([angle, 0.0, 0.0]).as_matrix()
        return tr.Markers(given.reference, given.measured @ turn.T, given.axis_std, given.names)

    alone = tr.register(body, turned(0.1), settings=settings)
    forget_rest()
    tr.register(body, turned(-0.05), settings=settings)
    after = tr.register(body, turned(0.1), settings=settings)
    assert np.array_equal(alone.displacement, after.displacement)
    assert np.array_equal(alone.std, after.std)


def test_rows_are_summed_of_those_of_the_same_nodes_unless_they_are_nearly_alike():
    columns = columns_of()
    tangent, _ = tangent_at(columns, MATERIAL, at_rest(columns), 1)
    node, turn = np.array([203]), Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    turned = [(node, axis[None]) for axis in turn]
    tangent.compliance(rows([203]))
    found, solved = tangent.compliance(turned)
    assert solved == 0
    wanted = Tangent(tangent.linearised).compliance(turned)[0]
    assert np.abs(found.forces - wanted.forces).max() < 1e-5 * np.abs(wanted.forces).max()
    for name in (None, "first"):
        image = tangent.sensed([*turned, *rows([203])])[0].image(name, lambda one: one.forces[:, :, 1])
        wanted = np.concatenate([found.forces, tangent.compliance(rows([203]))[0].forces])[:, :, 1]
        assert np.abs(image - wanted).max() < 1e-12 * np.abs(wanted).max()
    # What is kept of a function grows with the rows.
    more = tangent.sensed([*rows([102]), *turned])[0].image("first", lambda one: one.forces[:, :, 1])
    assert np.array_equal(more[:3], tangent.compliance(rows([102]))[0].forces[:, :, 1])
    alike = [(np.array([153]), np.array([[1.0, 1e-4 * k, 1e-4 * k * k]])) for k in range(4)]
    assert tangent.compliance(alike[:3])[1] == 3
    assert tangent.compliance(alike[3:])[1] == 1


def test_what_is_remembered_is_limited():
    columns = columns_of()
    tangent, _ = tangent_at(columns, MATERIAL, at_rest(columns), 1)
    many = rows(range(100, 100 + EFFORT.remembered // 3 + 1))
    assert tangent.compliance(many)[1] == len(many)
    assert tangent.compliance(many)[1] == len(many)


def test_the_second_call_on_a_mesh_factors_less_and_answers_alike():
    body, settings = tr.Body(push().mesh, MATERIAL, "tet4"), tr.RegisterSettings(threads=1)
    first, second = (tr.register(body, push().markers(), settings=settings) for _ in range(2))
    assert second.work["factorisations"] == first.work["factorisations"] - 1
    assert second.work["right_hand_sides"] == first.work["right_hand_sides"] - 48
    assert np.array_equal(first.displacement, second.displacement)
    assert np.array_equal(first.std, second.std)


def test_what_belongs_to_a_mesh_is_made_once_and_goes_with_it():
    made = []

    @per_mesh
    def size(mesh):
        made.append(mesh.n_nodes)
        return mesh.n_nodes

    mesh = block((9.0, 9.0, 9.0), (2, 2, 2))
    assert size(mesh) == size(mesh) == 27
    assert made == [27]
    assert skin_of(mesh) is skin_of(mesh)
    tr.register(mesh, (mesh.nodes[-4:], mesh.nodes[-4:] + 0.1), targets={"middle": (4.0, 4.0, 4.0)})
    gone = weakref.ref(mesh)
    del mesh
    forget_bodies()
    forget_rest()
    gc.collect()
    assert gone() is None


def test_the_skin_follows_the_set_of_held_nodes():
    mesh = block((9.0, 9.0, 9.0), (2, 2, 2))
    before = skin_of(mesh)
    mesh.node_sets["fixed"] = np.array([0, 1, 2])
    assert skin_of(mesh) is not before
    assert np.array_equal(skin_of(mesh).held, [0, 1, 2])


def test_a_step_that_ends_otherwise_than_predicted_is_linearised_anew(monkeypatch):
    def fit(ends):
        forget_rest()
        monkeypatch.setattr("tissuereg.registration.contacts.fit._Pass.ended_as_predicted", lambda *_: ends)
        return tr.register(
            tr.Body(push().mesh, material=MATERIAL, element="tet4"),
            push().markers(),
            settings=tr.RegisterSettings(threads=1),
        )

    kept, anew = fit(True), fit(False)
    assert anew.work["factorisations"] == kept.work["factorisations"] + 1
    assert np.array_equal(anew.displacement, kept.displacement)
    # About the end and about where the last step began: nearly the same.
    assert np.abs(anew.std / np.maximum(kept.std, 1e-9) - 1.0)[kept.std > 0.01].max() < 0.3
    assert not np.array_equal(anew.std, kept.std)


def test_markers_off_the_surface_are_linearised_where_the_tangent_is():
    markers = push().markers(off=2.0)
    observed = MarkerObservation.of(push().mesh, markers)
    data = MarkerData(observed, markers, 0.02)
    state = BodyState(np.zeros(3), push().displacement, RigidMotion.still())
    here, rest = 1.0 * push().displacement, np.zeros_like(push().displacement)
    for moved in (None, here, rest):
        at = here if moved is None else moved
        wanted = observed.rows(at[observed.nodes])
        found = data.read(state, weighed=False, moved=moved).rows
        assert len(found) == len(wanted)
        assert all(np.array_equal(a[1], b[1]) for a, b in zip(found, wanted, strict=True))
    # They turn with the skin: rows at rest are others.
    assert any(
        not np.allclose(a[1], b[1])
        for a, b in zip(observed.rows(here[observed.nodes]), observed.rows(rest[observed.nodes]), strict=True)
    )
