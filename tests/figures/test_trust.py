"""What `register` makes of single events of the bench."""

import numpy as np
import pytest

import tissuereg as tr
from misuse.events import good, misusable
from misuse.page import _names_its_marker, _reason
from misuse.run import marker_off, registered


@pytest.mark.parametrize(("body", "number"), [("dome", 64), ("ellipsoid", 12)])
def test_a_good_event_with_a_contact_smaller_than_an_element_is_trusted(body, number):
    assert registered(good(body, number))["trusted"]


def test_a_marker_dropped_inside_its_region_is_listed_and_takes_no_trust():
    event = good("dome", 84)
    answer = registered(event)
    assert answer["wrong"]
    assert answer["trusted"]


def test_a_marker_off_by_more_than_its_region_is_listed_and_takes_trust():
    name, event = marker_off("dome", 0)
    answer = registered(event)
    assert name in answer["wrong"]
    assert not answer["trusted"]
    assert _names_its_marker({"marker": name, "register": answer})
    assert "wrong marker" in _reason({"register": answer})


def test_a_marker_seen_in_one_component_is_judged_by_it_alone():
    name, event = marker_off("dome", 0)
    marker = event.markers().names.index(name)
    before = misusable("dome", 0).measured[marker]
    off = event.measured[marker] - before
    measured = event.measured.copy()
    axis = int(np.argmax(np.abs(off)))
    measured[marker] = np.nan
    measured[marker, axis] = before[axis] + 4.0 * off[axis]
    result = tr.register(event.mesh(), event.but(measured=measured).markers(), settings=tr.RegisterSettings(threads=1))
    assert (name, "wrong") in result.markers.dropped
    assert any(f" {name} " in reason for reason in result.trust.reasons)
