"""Random events on a body."""

import numpy as np
import pytest

from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.simulation.recipe import Variation
from tissuereg.simulation.sampling import Event, EventSampler, EventSettings, Plate
from tissuereg.simulation.solve import Simulator


def test_tractions_of_patches_that_share_triangles_add_up(block_mesh):
    simulator = Simulator(block_mesh)
    top = np.ascontiguousarray(block_mesh.surface[(block_mesh.nodes[block_mesh.surface][:, :, 2] > 39.9).all(axis=1)])
    pull, shear = np.array([0.0, 0.0, 0.2]), np.array([0.1, 0.0, 0.0])
    event = Event(((top, pull), (np.roll(top[: len(top) // 2], 1, axis=1), shear)), np.zeros(3))
    expected = sum(
        simulator.body.traction_forces(facets, np.tile(3.0 * traction, (len(facets), 1)))
        for facets, traction in event.patches
    )
    np.testing.assert_allclose(simulator.forces(event.load(simulator, 3.0)), expected, atol=1e-12)


def sampler(mesh, **settings):
    return EventSampler(mesh, EventSettings(**settings))


def total_force(simulator, event):
    return simulator.forces(event.load(simulator, 1.0)).sum(axis=0)


def test_a_plate_pushes_with_its_whole_force_along_its_direction(block_mesh):
    simulator = Simulator(block_mesh)
    plates = sampler(block_mesh, plate_share=1.0, body_force_share=0.0)
    for seed in range(20):
        event = plates.draw(np.random.default_rng(seed))
        np.testing.assert_allclose(total_force(simulator, event), event.plate.direction, atol=1e-12)
        assert event.body_force.tolist() == [0.0, 0.0, 0.0]


def test_a_plate_presses_hardest_where_it_meets_the_body_first(block_mesh):
    plates = sampler(block_mesh)
    # Tilted about y: it meets the top's edge at x = 30 first, 15 sin(10 deg) = 2.6 mm before the middle.
    tilt = np.deg2rad(10.0)
    down = np.array([-np.sin(tilt), 0.0, -np.cos(tilt)])
    triangles, traction = plates.pressed(Plate(np.array([15.0, 10.0, 40.0]), 100.0, down, 3.0))
    centres = block_mesh.nodes[triangles].mean(axis=1)
    pressure = np.linalg.norm(traction, axis=1)
    top = centres[:, 2] > 39.9
    along = (centres[top] - [15.0, 10.0, 40.0]) @ down
    expected = along.min() + 3.0 - along
    np.testing.assert_allclose(pressure[top] / pressure[top].max(), expected / expected.max(), atol=1e-12)
    assert centres[top][pressure[top].argmax(), 0] > 25.0


def test_a_plate_presses_no_face_that_looks_away_from_it(block_mesh):
    plates = sampler(block_mesh)
    triangles, _ = plates.pressed(Plate(np.array([15.0, 10.0, 40.0]), 100.0, np.array([0.0, 0.0, -1.0]), 50.0))
    assert (block_mesh.nodes[triangles][:, :, 2] == 40.0).all()


def test_shares_are_those_of_the_settings(block_mesh):
    mixed = sampler(block_mesh, plate_share=0.3, gravity_share=0.2)
    rng = np.random.default_rng(1)
    events = [mixed.draw(rng) for _ in range(1000)]
    plates = sum(event.plate is not None for event in events)
    weights = sum(not event.patches for event in events)
    # Standard deviation of a count out of 1000: at most 15.
    assert abs(plates - 300) < 60
    assert abs(weights - 200) < 60
    assert all(np.linalg.norm(event.body_force) > 0.0 for event in events if not event.patches)
    columns = mixed.columns(events, np.ones(1000))
    assert np.isfinite(columns["plate_radius_mm"]).sum() == plates
    assert np.isnan(columns["patch_radius_mm"]).all(axis=1).sum() == plates + weights


def test_without_plates_and_weights_the_draws_are_those_of_old_recipes(block_mesh):
    event = sampler(block_mesh).draw(np.random.default_rng(3))
    rng = np.random.default_rng(3)
    n_patches = int(rng.integers(1, 4))
    assert len(event.patches) == len(event.drawn) == n_patches


def test_a_body_force_alone_is_a_load(block_mesh):
    simulator = Simulator(block_mesh)
    event = sampler(block_mesh, gravity_share=1.0).draw(np.random.default_rng(0))
    load = event.load(simulator, 50.0)
    assert load.traction is None
    total = np.asarray(load.body_force) * block_mesh.volumes.sum()
    assert np.linalg.norm(total) == pytest.approx(50.0)


def test_variations_have_the_stated_deviations():
    rng, believed = np.random.default_rng(3), Load(body_force=[0.0, 0.0, -2.0], prescribed=np.array([[1.0, 0.0, 0.0]]))
    drawn = [Variation().draw(believed, Material(20.0), rng) for _ in range(4000)]
    weight = np.array([load.body_force for load, _ in drawn])
    push = np.array([load.prescribed[0] for load, _ in drawn])
    sizes = {
        "modulus": (np.log([material.young / 20.0 for _, material in drawn]), 0.25),
        "load": (np.log(np.linalg.norm(weight, axis=1) / 2.0), 0.05),
        "motion": (np.log(np.linalg.norm(push, axis=1)), 0.03),
        # A rotation about each of two axes tilts by its angle, to first order.
        "tilt of a load": (np.arcsin(weight[:, 0] / np.linalg.norm(weight, axis=1)), np.deg2rad(3.0)),
        "tilt of a motion": (np.arcsin(push[:, 1] / np.linalg.norm(push, axis=1)), np.deg2rad(2.0)),
    }
    for name, (values, std) in sizes.items():
        assert np.std(values) == pytest.approx(std, rel=0.05), name
        assert abs(np.mean(values)) < 4.0 * std / np.sqrt(4000), name
