"""Caches values per mesh, for as long as the mesh lives."""

from collections.abc import Callable
from functools import wraps
from typing import TypeVar
from weakref import WeakKeyDictionary

from tissuereg.body.mesh import Mesh

Made = TypeVar("Made")


def per_mesh(make: Callable[[Mesh], Made]) -> Callable[[Mesh], Made]:
    """Return a function that computes its value once for every mesh, whose arrays never change.

    Two threads that call it at the same time may both compute it; both values are the same.
    """
    kept: WeakKeyDictionary[Mesh, Made] = WeakKeyDictionary()

    @wraps(make)
    def found(mesh: Mesh) -> Made:
        answer = kept.get(mesh)
        if answer is None:
            answer = kept[mesh] = make(mesh)
        return answer

    return found
