"""Partly wrong supports: the user states that the whole base is held; in truth a part of it is, or more."""

from loadfree.bench import Bench
from loadfree.events import Body, read_set
from loadfree.rivals import METHODS, Answer, Case, registered

BODIES = ("dome", "phantom", "hole")

#: The true supports: an outer ring of the base, its middle, three patches of it, all of it and a band above.
KINDS = ("ring", "middle", "patches", "band")


def read_supports(name: str) -> Body:
    """Return a body of the archive with the events of ``data/supports.npz``."""
    return read_set(name, "supports")


def perhaps(case: Case) -> Answer:
    """Register with doubtful supports."""
    return registered(case, held="perhaps")


def sure(case: Case) -> Answer:
    """Register with the base held as given."""
    return registered(case, held="sure")


SUPPORTS = Bench(
    "supports-",
    BODIES,
    read_supports,
    {"perhaps": perhaps, "sure": sure} | {name: METHODS[name] for name in ("rigid", "spline", "none")},
    usual=("perhaps", "sure", "rigid", "spline", "none"),
    layouts=("spread", "random", "near"),
)
