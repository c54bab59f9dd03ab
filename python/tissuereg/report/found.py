"""What a registration found beside the fit of markers; a trained model finds none of it.

Results import their pages when they are asked to write themselves, so that no page may import their classes.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from tissuereg._base.arrays import FloatArray
    from tissuereg.registration.contacts.found import FoundContact
    from tissuereg.registration.contacts.surface_fit import SurfaceFit
    from tissuereg.registration.result import Registration


def contacts_of(result: "Registration") -> "tuple[FoundContact, ...]":
    """Return the contacts of a registration."""
    return getattr(result, "contacts", ())


def surface_of(result: "Registration") -> "SurfaceFit | None":
    """Return the fit of the points of the surface, if any were given."""
    return getattr(result, "surface", None)


def forces_of(result: "Registration") -> "FloatArray | None":
    """Return the nodal forces (n_nodes, 3) of the estimated load, mN."""
    return getattr(result, "forces", None)


def work_of(result: "Registration") -> dict[str, int]:
    """Return the counters of the search for contacts."""
    return getattr(result, "work", {})
