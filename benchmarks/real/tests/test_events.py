"""Which answers on a specimen count as right."""

import pytest

from real.events import is_right


@pytest.mark.parametrize(
    ("experiment", "verdict", "named", "right"),
    [
        ("resin/bioflex-steam", "group", ["stiffness / stiffening"], True),
        ("resin/bioflex-steam", "named", ["stiffness", "relaxation"], False),
        ("resin/bioflex-steam", "consistent", [], False),
        ("heart/before", "named", ["relaxation", "stiffening"], True),
        ("heart/before", "named", ["relaxation"], False),
        ("heart/null", "named", ["stiffening"], False),
        ("heart/null", "consistent", [], True),
    ],
)
def test_an_answer_is_right_that_names_all_that_happened_and_nothing_else(experiment, verdict, named, right):
    assert is_right({"experiment": experiment, "verdict": verdict, "named": named}) is right
