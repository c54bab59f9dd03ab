"""What the page of the bench is made of."""

import pytest

from misuse.misuses import MISUSES
from misuse.page import interval


def test_there_are_forty_mistakes_with_a_title_each():
    assert len({misuse.title for misuse in MISUSES}) == 40


def test_wilsons_interval_is_that_of_the_textbook():
    low, high = interval(1, 500)
    assert (low, high) == pytest.approx((0.000353, 0.011234), abs=1e-5)
