"""Materials: law, small-strain moduli, fibres and density."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._base.arguments import flag, found, maybe, named, of_kind, real, text
from tissuereg._base.arrays import FloatArray, depth, float_array
from tissuereg._base.provenance import keep_with, recorded, warn
from tissuereg._base.shown import short_repr
from tissuereg.body.laws import DECLARED
from tissuereg.errors import MaterialError, UnitWarning

#: Laws of the solver, and the names of their shape parameters.
SHAPE_KEYS: Mapping[str, tuple[str, ...]] = {
    name: tuple(key.name for key in law.shape) for name, law in DECLARED.items()
}

#: Names of the laws.
LAWS = tuple(SHAPE_KEYS)

#: Energies of volume change.
VOLUMETRIC = ("log", "quadratic", "coupled")

#: 1 g/cm^3 under 1 mm/s^2, in mN/mm^3 (1 g/cm^3 = 1e-6 kg/mm^3; 1 kg mm/s^2 = 1 mN).
MN_PER_MM3 = 1e-6

#: Standard gravity of this project, mm/s^2.
GRAVITY_MM_PER_S2 = 9810.0

#: Young's moduli of soft tissues and silicones, kPa: a median outside is accepted, with a `UnitWarning`.
SOFT_YOUNG_KPA = (0.01, 1e5)

#: Young's moduli of solids, kPa: foams of a millionth of a kPa to ten times diamond. Values outside are refused.
SOLID_YOUNG_KPA = (1e-6, 1e10)


@dataclass(frozen=True, eq=False)
class Fibre:
    """A family of parallel fibres, whose energy is added to that of any hyperelastic law.

    Energy density ``k1/(2 k2) (exp(k2 e^2) - 1)`` with ``e`` the squared isochoric stretch along the fibres minus 1
    (Holzapfel, Gasser and Ogden, Journal of Elasticity 61, 2000).

    Parameters
    ----------
    k1_over_mu : float
        Stiffness ``k1`` of the fibres over the shear modulus ``mu`` of the law, dimensionless; not negative.
    k2 : float
        Rate ``k2`` at which the fibres stiffen with stretch, dimensionless; not negative.
    direction : array_like of float, shape (3,), (n_tets, 3) or (n_tets, n_points, 3)
        Direction of the fibres in the undeformed body, for the whole body, per tet, or per quadrature point of each
        tet; its length is ignored.
    tension_only : bool
        Whether shortened fibres carry no force.
    """

    k1_over_mu: float = 1.0
    k2: float = 1.0
    direction: Any = (0.0, 0.0, 1.0)
    tension_only: bool = True

    def __post_init__(self) -> None:
        # The ranges are the solver's.
        of_kind("k1_over_mu", self.k1_over_mu, (int, float, np.number), error=MaterialError)
        of_kind("k2", self.k2, (int, float, np.number), error=MaterialError)
        float_array("direction", self.direction, (None,) * max(depth("direction", self.direction), 1))
        flag("tension_only", self.tension_only, error=MaterialError)


@dataclass(frozen=True, eq=False)
class Material:
    """A hyperelastic solid: moduli at small strain, and a law that has these moduli whatever its shape parameters are.

    A bimodular solid has these moduli under compression in all directions; stretched directions are stiffer by the
    share ``excess`` of the shear modulus.

    In the table, mu is the shear modulus, K the bulk modulus, lambda the first Lame parameter, J the volume ratio, I1
    and I2 the invariants of the right Cauchy-Green tensor and l the principal stretches; ``bar`` marks isochoric ones,
    and ``U`` is the volumetric energy:

    | law | energy density | shape |
    | --- | --- | --- |
    | neo-hookean | `mu/2 (I1 - 3) - mu ln J + U` (lambda in place of K) | |
    | bimodular | neo-hookean `+ mu excess sum <ln l_i>^2`, stretches l_i | excess |
    | mooney-rivlin | `mu/2 ((1 - share) (I1bar - 3) + share (I2bar - 3)) + U` | share |
    | yeoh | `c1 a + c2 a^2 + c3 a^3 + U`, a = I1bar - 3, c1 = mu/2 | c2_over_c1, c3_over_c1 |
    | ogden | `sum 2 mu_p/alpha_p^2 (sum lbar^alpha_p - 3) + U` | alpha, weight (1 to 3 terms each) |
    | fung | `mu/(2 b) (exp(b (I1bar - 3)) - 1) + U` | b |
    | veronda-westmann | `mu/b (exp(b (I1bar - 3)) - 1) - mu/2 (I2bar - 3) + U` | b |
    | st-venant-kirchhoff | `lambda/2 (tr E)^2 + mu E : E`, E Green-Lagrange strain | |
    | hooke | the same of small strain | |

    That is the split form of a law. The coupled form has ``I1 - 3 - 2 ln J`` for ``I1bar - 3``,
    ``I2 - 3 - 4 ln J - 2 (ln J)^2`` for ``I2bar - 3``, ``l^alpha - 1 - alpha ln l`` for ``lbar^alpha - 1`` and lambda
    for K (what FEBio calls coupled or unconstrained): it is the neo-Hookean law where the shape parameters vanish.

    Parameters
    ----------
    young : float or array_like of float, shape (n_tets,) or (n_tets, n_points)
        Young's modulus at small strain in kPa: one for the whole body, one per tet, or one per quadrature point of each
        tet; positive.
    poisson : float or array_like of float, shape (n_tets,) or (n_tets, n_points)
        Poisson's ratio at small strain, in (-1, 0.5): for the whole body, per tet, or per quadrature point of each tet.
    law : str
        Name of a law in the table.
    density : float
        Mass density in g/cm^3; it has an effect only under gravity.
    shape : mapping of str to float or sequence of float
        Shape parameters of the law by name, all dimensionless. Ogden's weights are normalised to shares of the shear
        modulus.
    volumetric : str
        Volumetric energy ``U``. ``"log"``: ``U = K/2 (ln J)^2``; ``"quadratic"``: ``U = K/2 (J - 1)^2``; ``"coupled"``:
        the coupled form of the law, with ``U = lambda/2 (ln J)^2``.
    fibre : Fibre, optional
        Fibres whose energy is added to that of the law.

    Raises
    ------
    MaterialError
        If a value is outside its range, or the law or one of its parameters is unknown.

    Warns
    -----
    UnitWarning
        If the median of Young's modulus is outside 0.01 to 1e5 kPa, between which soft tissues and silicones lie: it
        may be in Pa or MPa. A value outside 1e-6 to 1e10 kPa, which no solid has, is refused by a MaterialError.

    Examples
    --------
    >>> import tissuereg as tr
    >>> brain = tr.Material(young=2.0, poisson=0.49, law="ogden", shape={"alpha": [-19.0], "weight": [1.0]})
    >>> brain.shape["alpha"]
    [-19.0]
    """

    young: Any = 10.0
    poisson: Any = 0.45
    law: str = "neo-hookean"
    density: float = 1.0
    shape: Mapping[str, Any] = field(default_factory=dict)
    volumetric: str = "log"
    fibre: Fibre | None = None

    __repr__ = short_repr

    def __post_init__(self) -> None:
        _positive("density", self.density, "g/cm^3")
        text("law", self.law, error=MaterialError)
        text("volumetric", self.volumetric, error=MaterialError)
        named("shape", of_kind("shape", self.shape, Mapping, error=MaterialError), error=MaterialError)
        maybe("fibre", self.fibre, Fibre, error=MaterialError)
        young, poisson = self.young_array, self.poisson_array
        _within("young", young, np.isfinite(young) & (young > 0), "positive, in kPa")
        _within("poisson", poisson, (poisson > -1) & (poisson < 0.5), "in (-1, 0.5)")
        with recorded() as record:
            _check_unit(young)
        keep_with(self, record)
        self.core_law()

    @property
    def young_array(self) -> FloatArray:
        """Young's modulus in kPa, shape (1,), (n_tets,) or (n_tets, n_points), the last per quadrature point."""
        return _field("young", self.young)

    @property
    def poisson_array(self) -> FloatArray:
        """Poisson's ratio, shape (1,), (n_tets,) or (n_tets, n_points), the last per quadrature point."""
        return _field("poisson", self.poisson)

    def core_law(self) -> _core.Law:
        """Return law, shape parameters and fibres as an object of the compiled solver.

        Returns
        -------
        _core.Law
            The law without moduli, which the solver takes separately.

        Raises
        ------
        MaterialError
            If a shape parameter is missing, unknown or outside its range.
        """
        shape = {key: _numbers(key, value) for key, value in self.shape.items()}
        if self.fibre is None:
            return _core.Law(self.law, shape, volumetric=self.volumetric)
        fibre = self.fibre
        return _core.Law(
            self.law,
            shape,
            volumetric=self.volumetric,
            direction=np.ascontiguousarray(fibre.direction, dtype=np.float64),
            k1_over_mu=float(fibre.k1_over_mu),
            k2=float(fibre.k2),
            tension_only=bool(fibre.tension_only),
        )

    def scaled(self, factor: Any) -> "Material":
        """Return the same material with Young's modulus multiplied by a factor.

        Parameters
        ----------
        factor : float or array_like of float, shape (n_tets,) or (n_tets, n_points)
            Positive factor on Young's modulus: for the whole body, per tet, or per quadrature point of each tet.

        Returns
        -------
        Material
            A copy that differs in Young's modulus alone.
        """
        young, factor = self.young_array, float_array("factor", factor, (None,) * min(depth("factor", factor), 2))
        _within("factor", factor, np.isfinite(factor) & (factor > 0), "positive")
        deepest = max(young.ndim, factor.ndim)
        young, factor = (v[:, None] if v.ndim == 1 and deepest == 2 else v for v in (young, factor))
        return replace(self, young=young * factor)

    def digest(self) -> str:
        """Return a SHA-256 hash of law, shape parameters, moduli and fibres: of everything but the density.

        Returns
        -------
        str
            Hexadecimal digits, equal for materials that are equal but for their density.
        """
        digest = hashlib.sha256(f"{self.law} {self.volumetric}".encode())
        for key in sorted(self.shape):
            digest.update(f"{key} {_numbers(key, self.shape[key])}".encode())
        for values in (self.young_array, self.poisson_array):
            digest.update(f"{values.shape}".encode() + values.tobytes())
        if self.fibre is not None:
            direction = np.asarray(self.fibre.direction, dtype=np.float64)
            digest.update(f"{self.fibre.k1_over_mu} {self.fibre.k2} {self.fibre.tension_only}".encode())
            digest.update(f"{direction.shape}".encode() + direction.tobytes())
        return digest.hexdigest()

    def weight(self, direction: Any = (0.0, 0.0, -1.0), g: float = GRAVITY_MM_PER_S2) -> FloatArray:
        """Return the body force that gravity exerts on the material.

        Parameters
        ----------
        direction : array_like of float, shape (3,)
            Direction of gravity; normalised here.
        g : float
            Acceleration of gravity in mm/s^2.

        Returns
        -------
        ndarray of float64, shape (3,)
            Force per undeformed volume in mN/mm^3.

        Raises
        ------
        MaterialError
            If `direction` has no length.
        """
        g = real("g", g, unit="mm/s^2", error=MaterialError)
        towards = float_array("direction", direction, (3,))
        length = float(np.linalg.norm(towards))
        if not (np.isfinite(length) and length > 0):
            message = f"`direction` of gravity must have a length, got {towards.tolist()}"
            raise MaterialError(message, where="direction")
        return towards / length * (self.density * MN_PER_MM3 * g)


def _field(name: str, value: Any) -> FloatArray:
    n_axes = min(depth(name, value), 2)
    return np.atleast_1d(float_array(name, value, (None,) * n_axes))


def _numbers(key: str, value: Any) -> list[float]:
    depth(key, value)
    array = np.atleast_1d(value)
    if array.dtype.kind not in "iuf" or array.ndim != 1:
        message = f"`{key}` must be a number or a list of numbers, got {value!r}"
        raise MaterialError(message, where=key)
    return [float(v) for v in array]


def _within(name: str, values: FloatArray, good: Any, wanted: str) -> None:
    if not np.all(good):
        entry = int(np.argmin(good))
        tet = entry // (values.shape[1] if values.ndim == 2 else 1)
        place = f" at tet {tet}" if values.size > 1 else ""
        message = f"`{name}` must be {wanted}, got {values.flat[entry]:g}{place}"
        raise MaterialError(message, where=name, tet=tet)


def _positive(name: str, value: Any, unit: str) -> None:
    try:
        real(name, value, above=0.0, error=MaterialError)
    except MaterialError:
        message = f"`{name}` must be positive, in {unit}, got {found(value)}"
        raise MaterialError(message, where=name) from None


def _check_unit(young: FloatArray) -> None:
    """Refuse Young's moduli (kPa, any shape) that no solid has; warn of a likely unit if their median is not soft."""
    lowest, highest = SOLID_YOUNG_KPA
    _within("young", young, (young >= lowest) & (young <= highest), f"in kPa, from {lowest:g} to {highest:g} kPa")
    typical = float(np.median(young)) if young.size else 1.0
    softest, stiffest = SOFT_YOUNG_KPA
    if not softest <= typical <= stiffest:
        # One digit only, so that slightly different moduli of many members give one warning.
        unit = "Pa: divide by 1000" if typical > stiffest else "MPa: multiply by 1000"
        message = (
            f"`young` is taken in kPa, got about {typical:.0e}; soft tissues and silicones lie between {softest:g} and "
            f"{stiffest:g} kPa, so it may be in {unit}"
        )
        warn(message, UnitWarning)
