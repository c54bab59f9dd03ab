"""The result of a registration without a trained model."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from tissuereg._base.arguments import MOST_COUNTED, whole
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ModelError
from tissuereg.registration.contacts.found import FoundContact
from tissuereg.registration.contacts.surface_fit import SurfaceFit
from tissuereg.registration.result import Registration


@dataclass(frozen=True, eq=False, kw_only=True, repr=False)
class ContactRegistration(Registration):
    """A body in equilibrium under the load that explains the measurements.

    Attributes
    ----------
    search : callable
        Function without arguments that returns the contacts; see `contacts`.
    forces : ndarray of float64, shape (n_nodes, 3)
        Nodal forces of the estimated load in mN at the believed modulus, in the tracker's frame, including the believed
        load but not its body force.
    work : dict of str to int
        Numbers of factorisations, right-hand sides, equilibrium solves, sweeps of the Markov chains, and other work.
    explained_mm : dict of str to float
        Root mean square motion of the nodes, mm, by each part of the answer: ``loads``, ``tracker`` (a rigid motion),
        ``stiffness`` (its change across the body) and ``unexplained`` (what no load on the body explains).
    draw : callable of int
        Function of a number of draws that returns posterior displacement fields, (count, n_nodes, 3), mm; see `draws`.
    surface : SurfaceFit or None
        Fit of the points of the surface; None if none were given.
    """

    search: Callable[[], tuple[FoundContact, ...]]
    forces: FloatArray
    work: dict[str, int]
    explained_mm: dict[str, float]
    draw: Callable[[int], FloatArray]
    surface: SurfaceFit | None = None

    @cached_property
    def contacts(self) -> tuple[FoundContact, ...]:
        """Places where the body is probably pushed or pulled, tuple of `FoundContact`, the most probable first."""
        return self.search()

    def draws(self, count: int) -> FloatArray:
        """Return displacement fields drawn from the posterior, each in equilibrium.

        Parameters
        ----------
        count : int
            Number of fields, at least 1.

        Returns
        -------
        ndarray of float64, shape (count, n_nodes, 3)
            Displacement of every node in each field, mm. The same at every call. Cost: one solve for each field,
            started from the registered state.

        Raises
        ------
        ModelError
            If `count` is no number of fields.
        ConvergenceError
            If a drawn load finds no equilibrium.
        """
        if whole("count", count, least=-MOST_COUNTED, error=ModelError) < 1:
            message = f"`count` must be at least 1, got {count}"
            raise ModelError(message, where="count")
        return self.draw(count)

    def _found_words(self) -> str:
        return f"{len(self.contacts)} contact{'' if len(self.contacts) == 1 else 's'}, "

    def _found_json(self) -> dict[str, Any]:
        return {
            **super()._found_json(),
            "surface": None if self.surface is None else self.surface.to_json(),
            "contacts": [contact.to_json() for contact in self.contacts],
            "explained_mm": dict(self.explained_mm),
            "work": dict(self.work),
        }
