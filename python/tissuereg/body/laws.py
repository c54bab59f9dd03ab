"""The solver's hyperelastic laws: their names, their shape parameters, and the starting values of fits of these."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tissuereg import _core


@dataclass(frozen=True)
class ShapeKey:
    """One dimensionless shape parameter of a hyperelastic law: a number that sets the form of the stress-strain curve.

    `name`: its key in `Material.shape`; `series`: whether it is a list with one number per term of the law, as Ogden's
    exponents are; `least`, `largest`: bounds between which a fit seeks it, infinite where there is no bound.
    """

    name: str
    series: bool
    least: float
    largest: float


@dataclass(frozen=True)
class Declaration:
    """A hyperelastic law of the solver, as the compiled core declares it.

    `name`: its name, as in `Material.law`; `shape`: its shape parameters, in order; `starts`: starting points of a fit,
    each with one value per shape parameter, and empty for a law whose shape parameters are lists with one number per
    term.
    """

    name: str
    shape: tuple[ShapeKey, ...]
    starts: tuple[tuple[float, ...], ...]

    @property
    def has_terms(self) -> bool:
        """Whether one or more of the law's shape parameters are lists with one number per term."""
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
    """Return the shape parameters of a law by name: the given values for its first parameters, 0 for all others.

    `law`: name of a law without series of terms; `*values`: values of its first parameters, in the order of the law's
    declaration. Result: dimensionless numbers by name, for the argument `shape` of `Material`.

    Examples
    --------
    >>> shape_of("yeoh", 2.0)
    {'c2_over_c1': 2.0, 'c3_over_c1': 0.0}
    """
    names = [key.name for key in DECLARED[law].shape]
    return dict(zip(names, [*values, *[0.0] * (len(names) - len(values))], strict=True))


def main_key(law: str) -> str:
    """Return the name of the first shape parameter that the law of this name declares."""
    return DECLARED[law].shape[0].name
