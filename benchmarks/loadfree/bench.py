"""What a run needs to know of a bench: its events, the methods that are compared on them, where results lie."""

from collections.abc import Callable
from dataclasses import dataclass

from loadfree.events import BODIES, Body, read_body
from loadfree.layouts import LAYOUTS
from loadfree.rivals import METHODS, Answer, Case


@dataclass(frozen=True)
class Bench:
    """Events and methods.

    Attributes
    ----------
    mark : str
        What names of its result files have after ``loadfree-``: empty, or a word and a dash.
    bodies : tuple of str
    read : callable
        Returns a body with its events, by name.
    methods : dict
        By name: a function from a `Case` to an `Answer`.
    usual, layouts : tuple of str
        Methods and layouts that run by default.
    """

    mark: str
    bodies: tuple[str, ...]
    read: Callable[[str], Body]
    methods: dict[str, Callable[[Case], Answer]]
    usual: tuple[str, ...]
    layouts: tuple[str, ...] = LAYOUTS


#: Registration with nothing known of the load.
LOADFREE = Bench("", BODIES, read_body, METHODS, ("contacts", "none", "rigid", "spline", "gaussian"))
