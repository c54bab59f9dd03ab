"""The solver's hyperelastic laws: their names, their shape parameters, and the values at which a fit of these begins.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from tissuereg import _core


@dataclass(frozen=True)
class ShapeKey:
    """One dimensionless shape parameter of a hyperelastic law: a number that sets the form of the stress-strain curve.

    Attributes
    ----------
    name : str
        Its key in `Material.shape`.
    series : bool
        Whether the parameter is a list with one number per term of the law, as Ogden's exponents are.
    least, largest : float
        Bounds between which a fit seeks the parameter; infinite where there is no bound.
    """

    name: str
    series: bool
    least: float
    largest: float


@dataclass(frozen=True)
class Declaration:
    """A hyperelastic law of the solver, as the compiled core declares it.

    Attributes
    ----------
    name : str
        Its name, as in `Material.law`.
    shape : tuple of ShapeKey
        Its shape parameters, in order.
    starts : tuple of tuple of float
        Starting points of a fit, each with one value per shape parameter. Empty for a law with series of terms, whose
        starting points depend on the number of terms.
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

    `law`: name of a law that has no series of terms; `*values`: values of its first parameters, in the order in which the law declares them. Result: a table of dimensionless numbers by name, for the argument `shape` of `Material`.

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
