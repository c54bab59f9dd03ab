"""How markers follow causes, against differences of real solves; coefficients and loads."""

import numpy as np
import pytest
from threadpoolctl import ThreadpoolController

import tissuereg as tr
from support.pushes import MATERIAL, NOTHING, TIGHT, body, columns_of
from tissuereg.body.observe import MarkerObservation
from tissuereg.registration.contacts.columns import Columns, _by_unbalanced, contact_sizes, log_filled
from tissuereg.registration.contacts.sensed import Sensed
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.registration.contacts.state import RigidMotion
from tissuereg.simulation.sensitivity import Compliance, Linearised, Observation


@pytest.fixture(scope="module", params=["sure", "partly", "perhaps", "free", "believed"])
def case(request):
    """Columns, coefficients of a moderate state, and the responses of three markers there."""
    held, believed = request.param, None
    if held == "believed":
        held, rng = "sure", np.random.default_rng(3)
        on_base = body().simulator
        forces = np.where(rng.random((body().mesh.n_nodes, 1)) < 0.1, rng.normal(0.0, 20.0, (1, 3)), 0.0)
        prescribed = 0.02 * rng.normal(size=(len(on_base.held_nodes), 3))
        believed = {"forces": forces, "body_force": np.array([0.0, 0.002, -0.01]), "prescribed": prescribed}
    columns = columns_of(held, believed)
    mesh = columns.body.mesh
    rng = np.random.default_rng(5)
    coefficients = np.zeros(columns.n_columns)
    coefficients[rng.choice(3 * columns.n_patches, 12, replace=False)] = rng.normal(0.0, 0.8, 12)
    coefficients[3 * columns.n_patches :] = 0.1 * rng.normal(size=columns.n_columns - 3 * columns.n_patches)
    coefficients = columns.without_frame(coefficients)
    free = mesh.surface_nodes[mesh.nodes[mesh.surface_nodes, 2] > 11.0]
    reference = mesh.nodes[free[[10, 60, 105]]] + [[0.0, 0.0, 0.0], [0.0, 0.0, 0.0], [1.0, 0.5, 0.8]]
    observed = MarkerObservation.of(mesh, tr.Markers(reference, reference))
    found = columns.body.simulator.solve(columns.load(coefficients), MATERIAL, **TIGHT)
    here = Linearised(columns.body.simulator, columns.load(coefficients), MATERIAL, found.all_displacement)
    rows = observed.rows(found.displacement[observed.nodes])
    compliance = here.compliance([Observation(nodes, weights) for nodes, weights in rows])
    places = reference + observed.predict(found.displacement[observed.nodes])
    return columns, coefficients, (observed, reference), columns.responses(Sensed(compliance), places)


def seen(columns, coefficients, markers):
    """Return where the markers are seen under coefficients, rigid motion included, (9,)."""
    found = columns.body.simulator.solve(columns.load(coefficients), MATERIAL, **TIGHT)
    observed, reference = markers
    places = reference + observed.predict(found.displacement[observed.nodes])
    return RigidMotion.still().followed_by(columns.frame(coefficients), columns.rigid).apply(places).ravel()


def test_responses_of_every_block_are_slopes_of_solves(case):
    columns, coefficients, markers, responses = case
    assert responses.shape == (9, columns.n_columns)
    step = 1e-3
    for family in columns.families:
        own = np.arange(columns.n_columns)[family.columns]
        # All of a small block; of the patches some, all directions among them.
        chosen = own if len(own) <= 6 else own[[3, 40, -25, -4, -2, -1]]
        for column in chosen:
            change = np.zeros(columns.n_columns)
            change[column] = step
            there, back = (seen(columns, coefficients + sign * change, markers) for sign in (1, -1))
            slope = (there - back) / (2 * step)
            assert np.abs(slope).max() > 0.0, family.name
            assert np.abs(responses[:, column] - slope).max() < 1e-4 * np.abs(slope).max(), (family.name, column)


def test_responses_to_changes_of_the_stiffness_have_the_same_bits_at_any_number_of_threads_of_blas():
    # A renewal makes them beside calls that change that number for the whole process.
    rng = np.random.default_rng(2)
    own = Compliance(rng.normal(size=(60, 4258, 3)), np.zeros((60, 3)), np.zeros((60, 0, 3)))
    forces, found = rng.normal(size=(3, 4258, 3)), []
    blas = ThreadpoolController().select(user_api="blas")
    for threads in (1, 2):
        with blas.limit(limits=threads):
            found.append(_by_unbalanced(own, forces))
    assert np.array_equal(*found)
    wanted = own.forces.reshape(60, -1) @ forces.reshape(3, -1).T
    assert np.abs(found[0] - wanted).max() < 1e-12 * np.abs(wanted).max()


@pytest.mark.parametrize("held", ["sure", "partly", "perhaps", "free", "believed"])
def test_forces_of_many_changes_are_differences_of_loads(held):
    believed = {"body_force": np.array([1e-4, 0.0, -1e-3]), "forces": np.zeros((405, 3))}
    believed["forces"][30] = (3.0, -2.0, 5.0)
    columns = columns_of(*(("perhaps", believed) if held == "believed" else (held, None)))
    rng = np.random.default_rng(3)
    here, changes = rng.standard_normal(columns.n_columns), rng.standard_normal((4, columns.n_columns))
    before, found = columns.load(here), columns.forces(changes)
    for change, forces in zip(changes, found, strict=True):
        after = columns.load(here + change)
        weight = columns.weight_forces(np.asarray(after.body_force) - np.asarray(before.body_force))
        wanted = np.asarray(after.forces) - np.asarray(before.forces) + weight
        assert np.abs(forces - wanted).max() < 1e-10 * np.abs(wanted).max()


def test_blocks_are_those_that_the_body_asks_for():
    names = {held: [family.name for family in columns_of(held).families] for held in ("sure", "partly", "free")}
    assert names["sure"] == ["background", "weight"]
    assert names["partly"] == ["background", "weight", "supports"]
    assert names["free"] == ["background", "weight", "frame"]
    believed = columns_of("perhaps", {"body_force": np.array([0.0, 0.0, 1e-3])})
    assert [family.name for family in believed.families] == ["background", "weight", "believed", "supports"]
    stops = [family.columns.stop for family in believed.families]
    assert [family.columns.start for family in believed.families] == [0, *stops[:-1]]
    assert believed.n_columns == stops[-1]


def test_zero_coefficients_are_the_believed_load():
    forces = np.random.default_rng(0).normal(size=(body().mesh.n_nodes, 3))
    believed = {"forces": forces, "body_force": np.array([0.0, 0.0, -0.01])}
    load = columns_of("sure", believed).load(np.zeros(columns_of("sure", believed).n_columns))
    assert np.array_equal(load.forces, forces)
    assert np.array_equal(load.body_force, believed["body_force"])
    assert not load.prescribed.any()


def test_young_cancels_from_all_but_the_forces():
    soft = columns_of()
    stiff = Columns.of(body(), MATERIAL.scaled(10.0), NOTHING, ContactSettings())
    coefficients = np.random.default_rng(2).normal(size=soft.n_columns) * 0.02
    one, two = soft.load(coefficients), stiff.load(coefficients)
    assert np.allclose(10 * one.forces, two.forces)
    assert np.allclose(10 * one.body_force, two.body_force)


def test_a_body_force_is_shared_out_by_volume(case):
    columns = case[0]
    forces = columns.weight_forces(np.array([1.0, 2.0, -3.0]))
    assert forces.sum(axis=0) == pytest.approx(60 * 60 * 24 * np.array([1.0, 2.0, -3.0]))


def test_the_prior_of_slots_is_a_probability():
    columns, settings = columns_of(), ContactSettings()
    logs = log_filled(columns, settings)
    assert logs.shape == (columns.n_patches, len(settings.sizes))
    empty = 1.0 / (1.0 + settings.odds)
    assert np.exp(logs).sum() + empty == pytest.approx(1.0)
    # The same for every radius, whatever its number of centres.
    by_level = np.bincount(columns.body.patches.level, np.exp(logs).sum(axis=1))
    assert by_level == pytest.approx(np.full(len(by_level), (1 - empty) / len(by_level)))
    # Half a normal distribution over sizes, as wide as a share of the radius.
    squares = contact_sizes(columns, settings) ** 2
    width = settings.largest_share * columns.body.patches.radii[:, None]
    assert logs - logs[:, :1] == pytest.approx(-0.5 * (squares - squares[0]) / width**2)


def test_sizes_of_a_family_are_log_normal():
    family = columns_of().families[1]
    settings = ContactSettings()
    middle = int(np.argmax(family.log_prior))
    assert family.factors[middle] == pytest.approx((settings.weight[0] * body().mesh.extent) ** 2)
    spread = 0.5 * np.log(family.factors / family.factors[middle]) / settings.weight[1]
    assert family.log_prior == pytest.approx(-0.5 * spread**2)
