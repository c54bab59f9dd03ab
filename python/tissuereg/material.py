"""What the body is made of: small-strain moduli, law and density."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray, float_array
from tissuereg.errors import MaterialError

#: Laws that the solver owns.
LAWS = ("neo-hookean",)

#: 1 g/cm^3 under 1 mm/s^2, in mN/mm^3 (1 g/cm^3 = 1e-6 kg/mm^3; 1 kg mm/s^2 = 1 mN).
MN_PER_MM3 = 1e-6

#: Standard gravity of this project, mm/s^2.
GRAVITY_MM_PER_S2 = 9810.0


@dataclass(frozen=True, eq=False)
class Material:
    """A compressible hyperelastic solid.

    Parameters
    ----------
    young : float or array_like of float, shape (n_tets,)
        Young's modulus at small strain in kPa, one for all or one a tet; positive.
    poisson : float or array_like of float, shape (n_tets,)
        Poisson's ratio at small strain, in (-1, 0.5).
    law : str
        ``"neo-hookean"``: ``mu/2 (I1 - 3) - mu ln J + lambda/2 (ln J)^2``.
    density : float
        Mass density in g/cm^3; matters only under gravity.

    Raises
    ------
    MaterialError
        If a value is outside its range or the law unknown.
    """

    young: Any = 10.0
    poisson: Any = 0.45
    law: str = "neo-hookean"
    density: float = 1.0

    def __post_init__(self) -> None:
        if self.law not in LAWS:
            message = f"`law` must be one of {', '.join(LAWS)}, got '{self.law}'"
            raise MaterialError(message, where="law")
        if not (np.isfinite(self.density) and self.density > 0):
            message = f"`density` must be positive, in g/cm^3, got {self.density}"
            raise MaterialError(message, where="density")
        young, poisson = self.young_array, self.poisson_array
        _within("young", young, np.isfinite(young) & (young > 0), "positive, in kPa")
        _within("poisson", poisson, (poisson > -1) & (poisson < 0.5), "in (-1, 0.5)")

    @property
    def young_array(self) -> FloatArray:
        """Young's modulus in kPa, shape (1,) or (n_tets,)."""
        return float_array("young", np.atleast_1d(self.young), (None,))

    @property
    def poisson_array(self) -> FloatArray:
        """Poisson's ratio, shape (1,) or (n_tets,)."""
        return float_array("poisson", np.atleast_1d(self.poisson), (None,))

    def weight(self, direction: Any = (0.0, 0.0, -1.0), g: float = GRAVITY_MM_PER_S2) -> FloatArray:
        """Return the body force of gravity.

        Parameters
        ----------
        direction : array_like of float, shape (3,)
            Where gravity points; normalised here.
        g : float
            Acceleration in mm/s^2.

        Returns
        -------
        ndarray of float64, shape (3,)
            Force per undeformed volume in mN/mm^3.

        Raises
        ------
        MaterialError
            If `direction` has no length.
        """
        towards = float_array("direction", direction, (3,))
        length = float(np.linalg.norm(towards))
        if not (np.isfinite(length) and length > 0):
            message = f"`direction` of gravity must have a length, got {towards.tolist()}"
            raise MaterialError(message, where="direction")
        return towards / length * (self.density * MN_PER_MM3 * g)


def _within(name: str, values: FloatArray, good: Any, wanted: str) -> None:
    if not np.all(good):
        tet = int(np.argmin(good))
        place = f" at tet {tet}" if values.size > 1 else ""
        message = f"`{name}` must be {wanted}, got {values[tet]:g}{place}"
        raise MaterialError(message, where=name, tet=tet)
