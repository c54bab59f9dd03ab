"""What picture, page and command line share: sentences, and what was found beside the fit of the markers."""

from collections.abc import Iterable, Mapping, Sequence
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


def verdict(ok: bool) -> str:
    """Return a sentence on whether a registration can be trusted.

    Examples
    --------
    >>> verdict(False)
    'Do not trust this registration.'
    """
    return "Nothing speaks against this registration." if ok else "Do not trust this registration."


def counted(number: int, thing: str) -> str:
    """Return a number of things.

    Examples
    --------
    >>> counted(1, "marker"), counted(3, "marker")
    ('1 marker', '3 markers')
    """
    return f"{number} {thing}{'' if number == 1 else 's'}"


def start_word(simulated: bool) -> str:
    """Return what distances are compared with: the believed simulation, or the body at rest."""
    return "in the simulation" if simulated else "before"


def silent(names: Sequence[str]) -> str:
    """Return the warning for targets that the markers do not constrain (flag "no marker tells").

    Examples
    --------
    >>> silent(["lesion"])
    'No marker tells of lesion: its region holds only if nothing else pushes or pulls nearby.'
    """
    whose = "its region holds" if len(names) == 1 else "their regions hold"
    return f"No marker tells of {', '.join(names)}: {whose} only if nothing else pushes or pulls nearby."


def fallback_lines(places: Mapping[str, Iterable[float]]) -> list[str]:
    """Return where linear elasticity alone has the targets of an answer that is not to be trusted, in mm.

    Examples
    --------
    >>> fallback_lines({"lesion": (1.0, 2.5, -3.0)})
    ['By linear elasticity alone, without a region: lesion at (1.00, 2.50, -3.00) mm.']
    """
    return [
        f"By linear elasticity alone, without a region: {name} at ({', '.join(f'{x:.2f}' for x in place)}) mm."
        for name, place in places.items()
    ]
