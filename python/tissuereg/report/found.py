"""What a registration found beside the fit of markers, whichever method made it."""

from typing import TYPE_CHECKING

from tissuereg.registration.contacts.result import ContactRegistration

if TYPE_CHECKING:
    from tissuereg.registration.contacts.found import FoundContact
    from tissuereg.registration.contacts.surface_fit import SurfaceFit
    from tissuereg.registration.result import Registration


def contacts_of(result: "Registration") -> "tuple[FoundContact, ...]":
    """Return the contacts of a registration; none of a trained model."""
    return result.contacts if isinstance(result, ContactRegistration) else ()


def surface_of(result: "Registration") -> "SurfaceFit | None":
    """Return the fit of the points of the surface, if any were given."""
    return result.surface if isinstance(result, ContactRegistration) else None
