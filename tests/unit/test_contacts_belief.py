"""Believed loads that cannot be right are left out, and reported."""

import numpy as np
import pytest

import tissuereg as tr
from support import doors
from support.pushes import MATERIAL, push
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts.settings import PassSettings

LEFT_OUT = "the believed load was left out: "


def registered(**options):
    options = {"material": MATERIAL, "element": "tet4", "tracker": "fixed", "threads": 1, **options}
    return doors.registered(push().mesh, push().markers(), **options)


def moved():
    return np.linalg.norm(push().displacement, axis=1).mean()


def test_a_belief_without_an_equilibrium_is_left_out():
    result = registered(load=tr.Load(body_force=(0.0, 0.0, -40.0)))
    assert f"{LEFT_OUT}no equilibrium is found under it" in result.trust.reasons
    assert not result.trust.ok
    assert push().errors(result).mean() < 0.1 * moved()


def test_a_belief_that_is_far_off_is_corrected_and_kept():
    result = registered(load=tr.Load(body_force=(0.4, 0.0, 0.0)))
    assert not [reason for reason in result.trust.reasons if reason.startswith(LEFT_OUT)]
    assert result.markers.before_rms_mm > 10 * result.markers.after_rms_mm
    assert push().errors(result).mean() < 0.1 * moved()


@pytest.mark.parametrize(("unmet", "less", "leaves"), [(3.0, 0.5, False), (0.0, 0.5, False), (0.0, 9.9, True)])
def test_a_belief_is_left_out_where_the_markers_stay_unmet_and_are_met_without(unmet, less, leaves):
    settings = tr.ContactSettings(steps=PassSettings(unmet=unmet, much_less=less))
    result = registered(load=tr.Load(body_force=(0.0, 0.0, -1e-3)), contacts=settings)
    assert (f"{LEFT_OUT}no contacts added to it explain the markers" in result.trust.reasons) == leaves
    alone = registered()
    assert np.array_equal(result.displacement, alone.displacement) == leaves


def test_without_a_belief_nothing_stands_in_for_a_fit_that_fails(monkeypatch):
    def fails(*_):
        message = "no tangent"
        raise ConvergenceError(message, where="load")

    monkeypatch.setattr("tissuereg.registration.contacts.linear.Linearisation.at", fails)
    with pytest.raises(ConvergenceError):
        registered()
