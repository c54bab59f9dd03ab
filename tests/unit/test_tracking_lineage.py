"""What is carried from frame to frame: its error, its end, and a body that buckles under dead loads."""

import numpy as np
import pytest

from tissuereg.tracking.restart import Lineage, Restart, SimulatedFrame

FIELD = np.ones((5, 3))


def simulated(size_mm, *, carried):
    field = size_mm / np.sqrt(3.0) * FIELD
    return SimulatedFrame(field, 0.0 * field, field, carried)


def test_variances_of_states_that_are_carried_on_add_up():
    lineage = Lineage(0.1)
    assert lineage.widening(0.04, simulated(1.0, carried=False)) == 1.0
    assert lineage.goes_on(0.01, simulated(1.0, carried=False))
    assert lineage.widening(0.02, simulated(1.0, carried=True)) == pytest.approx(1.0 + 0.01 / 0.02)
    assert lineage.goes_on(0.02, simulated(1.0, carried=True))
    assert lineage.widening(0.03, simulated(1.0, carried=True)) == pytest.approx(1.0 + 0.03 / 0.03)


def test_a_lineage_ends_at_the_variance_of_a_registration_from_the_plain_simulation():
    lineage = Lineage(0.1)
    lineage.widening(0.04, simulated(1.0, carried=False))
    assert lineage.goes_on(0.03, simulated(1.0, carried=True))
    assert not lineage.goes_on(0.03, simulated(1.0, carried=True))
    assert lineage.widening(0.05, simulated(1.0, carried=False)) == 1.0
    assert lineage.goes_on(0.03, simulated(1.0, carried=True))


def test_that_variance_grows_with_the_squared_size_of_the_event():
    lineage = Lineage(0.1)
    lineage.widening(0.04, simulated(1.0, carried=False))
    assert lineage.goes_on(0.15, simulated(2.0, carried=True))
    assert not lineage.goes_on(0.02, simulated(2.0, carried=True))


def test_without_a_simulation_nothing_is_carried_on():
    assert Lineage(0.1).widening(0.04, None) == 1.0


class Buckling:
    """A body that follows its actuator, and jumps under dead loads once it was moved far."""

    def field(self, actuator, *, start=None):
        return actuator * FIELD

    def holding(self, displacement, actuator):
        return displacement - actuator * FIELD

    def held_field(self, actuator, forces, start):
        return actuator * FIELD + forces + (0.0 if actuator < 3.0 else 50.0)


def test_a_body_that_buckles_under_dead_loads_carries_its_displacement_on():
    restart = Restart(Buckling(), "forces", 0.1)
    for share in (0.0, 1.0):
        restart.registered(restart.simulated(share), (share + 0.2) * FIELD, share)
    # Rounding.
    assert np.allclose(restart.simulated(2.0).field, 2.2 * FIELD, rtol=0.0, atol=1e-12)
    assert restart.fallbacks == 0
    assert np.allclose(restart.simulated(3.0).field, 3.2 * FIELD, rtol=0.0, atol=1e-12)
    assert restart.fallbacks == 1


def test_a_renewed_start_is_the_plain_simulation_and_no_motion():
    restart = Restart(Buckling(), "displacement", 0.1)
    for share in (0.0, 1.0):
        restart.registered(restart.simulated(share), (share + 0.2) * FIELD, share)
    assert restart.simulated(1.5).carried
    restart.renew()
    found = restart.simulated(1.5)
    assert not found.carried
    assert np.array_equal(found.field, 1.5 * FIELD)
    # Rounding.
    assert np.allclose(found.change, 0.5 * FIELD, rtol=0.0, atol=1e-12)
