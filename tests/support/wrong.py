"""Wrong arguments: what none of ours is, and what must come of a call with one."""

import math
import warnings

import numpy as np
import pytest

from tissuereg.errors import TissueRegError


class SomeClass:
    """May be called, with anything."""

    def __init__(self, *given):
        pass


#: What no argument of ours is, or only few are.
WRONG = {
    "None": None,
    "a word": "words",
    "an empty text": "",
    "bytes": b"\xff",
    "a null byte": "a\0b",
    "a long text": "a" * 3000,
    "true": True,
    "minus one": -1,
    "zero": 0,
    "a fraction": 1.5,
    "nan": math.nan,
    "infinity": math.inf,
    "a huge number": 1e300,
    "a huge count": 10**30,
    "a complex number": 1j,
    "an object": object(),
    "a class": SomeClass,
    "an empty list": [],
    "a ragged list": [[1.0], [2.0, 3.0]],
    "a list of None": [None, None, None],
    "a mapping": {"a": 1},
    "a mapping of numbers": {1: (0.0, 0.0, 0.0)},
    "a cube of zeros": np.zeros((2, 2, 2)),
    "numbers as text": np.array(["a", "b", "c"]),
    "nan thrice": np.full(3, np.nan),
}


def swept(calls):
    """Return one parameter set a wrong argument of `calls`: name -> (function, good arguments by name)."""
    return [
        pytest.param(call, argument, wrong, id=f"{name}({argument}={what})")
        for name, (call, good) in calls.items()
        for argument in good
        for what, wrong in WRONG.items()
    ]


def ends_well(call, argument, called, **given):
    """Run a call; what is wrong must be an error of ours that names the argument, or what it is `called`."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        try:
            call(**given)
        except TissueRegError as error:
            said = f"{error} {error.where}"
            assert any(name in said for name in (argument, *called.get(argument, argument).split("|"))), said
            assert len(said) < 1000, "a message is for reading"
