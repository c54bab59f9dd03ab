"""The solver's laws as they declare themselves: names, shape parameters, where fits begin."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tissuereg import _core


@dataclass(frozen=True)
class ShapeKey:
    """One shape parameter of a law, dimensionless.

    `name`: in `Material.shape`; `series`: whether it is a list, one number a term; `least`, `largest`: between which a
    fit seeks it; infinite where there is no bound.
    """

    name: str
    series: bool
    least: float
    largest: float


@dataclass(frozen=True)
class Declaration:
    """A law of the solver.

    `name`: in `Material.law`; `shape`: its shape parameters, in order; `starts`: shapes at which a fit begins; none
    where the number of terms decides.
    """

    name: str
    shape: tuple[ShapeKey, ...]
    starts: tuple[tuple[float, ...], ...]

    @property
    def has_terms(self) -> bool:
        """Whether its shape is one or more series of terms."""
        return any(key.series for key in self.shape)


def _declared() -> dict[str, Declaration]:
    found = {}
    for name, shape, starts in _core.laws():
        keys = tuple(ShapeKey(*key) for key in shape)
        found[name] = Declaration(name, keys, tuple(tuple(start) for start in starts))
    return found


#: All laws by name.
DECLARED: Mapping[str, Declaration] = _declared()


def shape_of(law: str, *values: float) -> dict[str, Any]:
    """Return the shape parameters of a law whose first ones have some values; all others vanish.

    `law`: without series of terms; `*values`: of the first parameters, in the order of the declaration. Result: as
    `Material.shape` takes them.

    Examples
    --------
    >>> shape_of("yeoh", 2.0)
    {'c2_over_c1': 2.0, 'c3_over_c1': 0.0}
    """
    names = [key.name for key in DECLARED[law].shape]
    return dict(zip(names, [*values, *[0.0] * (len(names) - len(values))], strict=True))


def main_key(law: str) -> str:
    """Return the name of the first shape parameter of a law."""
    return DECLARED[law].shape[0].name
