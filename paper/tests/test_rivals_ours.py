"""The package's own registrations as methods of the comparison: what they say is what a registrar says."""

import numpy as np
import pytest

import tissuereg as tr
from support.small_model import SMALL_MODEL
from tissuereg.phantom.event import make_event
from tissuereg.registration.learned.network import NetworkModel
from tissuereg_paper.rivals import Network, PhysicsPrior, Setting


@pytest.fixture(scope="module")
def event():
    return make_event(seed=0, size="small")


@pytest.fixture(scope="module")
def simulation(event):
    return tr.simulate(event.mesh, event.load, event.material, threads=1).displacement


@pytest.fixture(scope="module")
def setting(event):
    return Setting(
        event.mesh,
        np.asarray(event.markers.reference),
        np.asarray(event.markers.std),
        event.material,
        model=NetworkModel(SMALL_MODEL, event.mesh, threads=1),
        seed=3,
        threads=1,
    )


@pytest.mark.parametrize(("rival", "with_model"), [(PhysicsPrior, False), (Network, True)])
def test_a_moment_is_registered_as_by_a_registrar(event, simulation, setting, rival, with_model):
    gone = np.array(event.markers.measured)
    gone[4] = np.nan
    places, body = tr.Markers(event.markers.reference, std=event.markers.std), tr.Body(event.mesh, event.material)
    model = setting.model if with_model else None
    registrar = tr.Registrar(body, places, model, seed=3, settings=tr.RegisterSettings(threads=1))
    expected = registrar.register(gone, simulation)
    found = rival(setting, spread=True).register(gone, simulation)
    np.testing.assert_array_equal(found.displacement_mm, expected.displacement)
    assert found.kept["trusted"] == expected.trust.ok
    # The length of a node's spread is the registrar's, whether or not the axes are known apart.
    np.testing.assert_allclose(np.linalg.norm(found.spread_mm, axis=1), expected.std, rtol=1e-12)


def test_a_spread_that_nobody_asked_for_is_not_made(event, simulation, setting):
    assert Network(setting).register(event.markers.measured, simulation).spread_mm is None
