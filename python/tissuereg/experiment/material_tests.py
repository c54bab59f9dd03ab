"""Material tests: stresses under homogeneous deformation without a mesh, and laws fitted to measured curves."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_choice
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg.body.laws import DECLARED, shape_of
from tissuereg.body.material import Material
from tissuereg.errors import MaterialError

#: Deformation of each mode of a test, by its name in the solver.
MODES = {
    "tension": "uniaxial",
    "compression": "uniaxial",
    "equibiaxial": "equibiaxial",
    "simple-shear": "simple-shear",
}

#: Poisson's ratio in simulations of a law that was fitted without volume change.
NEARLY_INCOMPRESSIBLE = 0.495


def uniaxial_stress(material: Material, stretch: Any, *, incompressible: bool = False) -> FloatArray:
    """Return the nominal stress of a bar with free sides that is stretched along its axis.

    `material`: homogeneous material; `stretch` (n,): length over undeformed length, above 1 in tension;
    `incompressible`: keep the volume whatever Poisson's ratio is, with the same shear modulus. Result: (n,), first
    Piola-Kirchhoff stress in kPa, compression negative; NaN where the law has no finite stress. Raises `MaterialError`
    if the material varies over a body, or has no incompressible limit (st-venant-kirchhoff, hooke).

    Examples
    --------
    >>> import tissuereg as tr
    >>> from tissuereg.experiment.material_tests import uniaxial_stress
    >>> float(uniaxial_stress(tr.Material(3.0, 0.0), [1.001])[0].round(4))
    0.003
    """
    return _stress(material, "uniaxial", stretch, incompressible)


def equibiaxial_stress(material: Material, stretch: Any, *, incompressible: bool = False) -> FloatArray:
    """Return the nominal stress of a thin sheet that is stretched equally along two axes.

    `material`: homogeneous material; `stretch` (n,): length over undeformed length along both axes; `incompressible`:
    keep the volume whatever Poisson's ratio is, with the same shear modulus. Result: (n,), first Piola-Kirchhoff stress
    along either axis, kPa; NaN where the law has no finite stress. Raises `MaterialError` if the material varies over a
    body, or has no incompressible limit (st-venant-kirchhoff, hooke).
    """
    return _stress(material, "equibiaxial", stretch, incompressible)


def shear_stress(material: Material, shear: Any) -> FloatArray:
    """Return the nominal shear stress of simple shear, which keeps the volume.

    `material`: homogeneous material; `shear` (n,): amount of shear, displacement over height. Result: (n,), in kPa; NaN
    where the law has no finite stress. Raises `MaterialError` if the material varies over a body.
    """
    return _stress(material, "simple-shear", shear, False)


def _stress(material: Material, mode: str, amount: Any, incompressible: bool) -> FloatArray:
    moduli = moduli_of(material)
    if incompressible and material.law in ("st-venant-kirchhoff", "hooke"):
        message = f"the law '{material.law}' has no incompressible limit: it does not separate shape from volume"
        raise MaterialError(message, where="law")
    amounts = float_array("amounts", np.atleast_1d(amount), (None,))
    return material.core_law().nominal_stress(mode, amounts, *moduli, incompressible=incompressible)


def moduli_of(material: Material) -> tuple[float, float]:
    """Return Young's modulus in kPa and Poisson's ratio of a homogeneous material; `MaterialError` for any other."""
    young, poisson = material.young_array, material.poisson_array
    if young.size > 1 or poisson.size > 1:
        message = "a material test needs one Young's modulus and one Poisson's ratio, got fields over a body"
        raise MaterialError(message, where="young")
    return float(young[0]), float(poisson[0])


@dataclass(frozen=True, eq=False)
class MaterialTest:
    """One measured stress-strain curve of a material, without times.

    `mode`: ``tension``, ``compression``, ``equibiaxial`` or ``simple-shear``; `amount` (n,): stretches (length over
    undeformed length), or amounts of shear; `stress` (n,): nominal stress in kPa, compression negative; `name`: title.
    Raises `MaterialError` if the mode is unknown, or the columns differ in length, are empty or not finite.
    """

    mode: str
    amount: Any
    stress: Any
    name: str = ""

    def __post_init__(self) -> None:
        check_choice("mode", self.mode, MODES, MaterialError)
        for key in ("amount", "stress"):
            object.__setattr__(self, key, float_array(key, getattr(self, key), (None,)))
        finite = np.isfinite(self.amount).all() and np.isfinite(self.stress).all()
        if len(self.amount) != len(self.stress) or not len(self.amount) or not finite:
            rows = f"{len(self.amount)} and {len(self.stress)} rows"
            message = f"`amount` and `stress` must be finite and equally long, with at least one row, got {rows}"
            raise MaterialError(message, where="stress")

    def predicted(self, material: Material, *, incompressible: bool = True) -> FloatArray:
        """Return the stress that a material would have at the deformations of this test.

        `material`: homogeneous material; `incompressible`: keep the volume whatever Poisson's ratio is. Result: (n,),
        nominal stress in kPa.
        """
        return _stress(material, MODES[self.mode], self.amount, incompressible)

    def r_squared(self, material: Material, *, incompressible: bool = True) -> float:
        """Return the share of the variance of the measured stress that a material explains (R squared).

        `material`: homogeneous material; `incompressible`: keep the volume whatever Poisson's ratio is. Result: 1 for a
        perfect prediction, below 0 for one that is worse than the mean stress.
        """
        misfit = self.stress - self.predicted(material, incompressible=incompressible)
        return float(1 - np.sum(misfit**2) / np.sum((self.stress - self.stress.mean()) ** 2))


@dataclass(frozen=True)
class LawFit:
    """Result of a fit of a hyperelastic law to material tests.

    `material`: the law with its parameters; `incompressible`: whether it was fitted in its incompressible limit;
    `cost`: sum of squared weighted residuals, dimensionless for the weighting ``mode`` and in kPa^2 for ``plain``;
    `n_parameters`: number of fitted parameters, including Young's modulus; `standard_error`: root of the sum of squared
    residuals over (points - parameters), kPa, without weights.
    """

    material: Material
    incompressible: bool
    cost: float
    n_parameters: int
    standard_error: float


#: Of a law of one, two and three terms, where the search starts: exponents, then the shares of all terms but the first
#: over that of the first.
_OF_TERMS: tuple[tuple[tuple[float, ...], ...], ...] = (
    ((-20.0,), (-5.0,), (3.0,), (15.0,)),
    ((-20.0, 5.0, 1.0), (-5.0, 3.0, 1.0), (3.0, 12.0, 0.1), (-3.0, -25.0, 0.1)),
    ((-20.0, -3.0, 5.0, 1.0, 1.0), (2.0, 8.0, -4.0, 0.5, 0.5)),
)


def fit_law(
    tests: Sequence[MaterialTest],
    law: str,
    *,
    terms: int = 1,
    weighting: str = "mode",
    incompressible: bool = True,
    poisson: float = NEARLY_INCOMPRESSIBLE,
    volumetric: str = "log",
) -> LawFit:
    """Fit Young's modulus and the shape parameters of a hyperelastic law to material tests by least squares.

    Stress is linear in Young's modulus, which is solved for at every set of shape parameters; these are found by
    scipy's trust-region method from a few fixed starting points, so the result is the same at each call. `tests`: tests
    that are fitted together; `law`: name of a law of `Material`; `terms`: number of terms of an Ogden law, 1 to 3;
    `weighting`: ``"mode"``: residuals of a test over (its largest stress x root of its number of points), so that all
    tests have equal weight; ``"plain"``: residuals in kPa; `incompressible`: fit in the incompressible limit;
    st-venant-kirchhoff and hooke need False; `poisson`: Poisson's ratio of the fitted material; `volumetric`: name of
    its volumetric energy in `Material`. Result: the material and how well it fits. Raises `MaterialError` if the law is
    unknown, there are no tests, or no start leads to finite stresses.

    Examples
    --------
    >>> import numpy as np
    >>> from tissuereg import Material
    >>> from tissuereg.experiment.material_tests import MaterialTest, fit_law, uniaxial_stress
    >>> stretch = np.linspace(0.7, 1.3, 9)
    >>> test = MaterialTest("tension", stretch, uniaxial_stress(Material(3.0, 0.495), stretch, incompressible=True))
    >>> round(fit_law([test], "neo-hookean").material.young, 6)
    3.0
    """
    from scipy.optimize import least_squares

    check_choice("law", law, DECLARED, MaterialError)
    if not tests:
        message = "a law is fitted to at least one test, got none"
        raise MaterialError(message, where="tests")
    problem = _ShapeProblem(tests, law, _weights(tests, weighting), Material(1.0, poisson), volumetric, incompressible)
    best: tuple[float, FloatArray] | None = None
    for start, bounds in _starts(law, terms):
        x = np.array(start)
        if len(x):
            x = least_squares(problem.residuals, x, bounds=bounds, x_scale="jac", xtol=1e-14, ftol=1e-14, gtol=1e-14).x
        cost = float(np.sum(problem.residuals(x) ** 2))
        if problem.young(x) > 0 and (best is None or cost < best[0]):
            best = cost, x
    if best is None:
        message = f"the law '{law}' has no finite stress of the sign of these tests"
        raise MaterialError(message, where="tests")
    cost, x = best
    young = problem.young(x)
    misfit = np.concatenate([test.stress for test in tests]) - young * problem.unit_stress(x)
    n_parameters = 1 + len(x)
    spare = max(len(misfit) - n_parameters, 1)
    material = replace(problem.material(x), young=young)
    return LawFit(material, incompressible, cost, n_parameters, float(np.sqrt(np.sum(misfit**2) / spare)))


def _weights(tests: Sequence[MaterialTest], weighting: str) -> FloatArray:
    if weighting not in ("mode", "plain"):
        message = f"`weighting` must be mode or plain, got '{weighting}'"
        raise MaterialError(message, where="weighting")
    if weighting == "plain":
        return np.ones(sum(len(test.stress) for test in tests))
    scales = [np.abs(test.stress).max() * np.sqrt(len(test.stress)) for test in tests]
    if min(scales) == 0:
        message = "every test must hold a stress that is not zero"
        raise MaterialError(message, where="stress")
    return np.concatenate([np.full(len(t.stress), 1 / s) for t, s in zip(tests, scales, strict=True)])


def _starts(law: str, terms: int) -> list[tuple[tuple[float, ...], tuple[Any, Any]]]:
    declared = DECLARED[law]
    if not declared.has_terms:
        bounds = ([key.least for key in declared.shape], [key.largest for key in declared.shape])
        return [(start, bounds) for start in declared.starts]
    if terms not in (1, 2, 3):
        message = f"`terms` of an Ogden law must be 1, 2 or 3, got {terms}"
        raise MaterialError(message, where="terms")
    # Beyond an exponent of 200 no test distinguishes laws; shares stay positive.
    lower, upper = [-200.0] * terms + [0.0] * (terms - 1), [200.0] * terms + [1e3] * (terms - 1)
    return [(start, (lower, upper)) for start in _OF_TERMS[terms - 1]]


@dataclass(frozen=True, eq=False)
class _ShapeProblem:
    """Least-squares problem of material tests in the shape parameters of a law; Young's modulus is fitted along.

    `tests`: curves; `law`: name of the law; `weights` (n_rows,): weight of each row, 1/kPa; `unit`: material with
    Young's modulus 1 kPa and the wanted Poisson's ratio; `volumetric`: name of the volumetric energy; `incompressible`:
    whether the volume is preserved.
    """

    tests: Sequence[MaterialTest]
    law: str
    weights: FloatArray
    unit: Material
    volumetric: str
    incompressible: bool

    def material(self, x: FloatArray) -> Material:
        """Return the law with shape parameters x and Young's modulus 1 kPa; Ogden: exponents, then weight ratios."""
        values = [float(v) for v in x]
        shape: dict[str, Any] = {}
        if DECLARED[self.law].has_terms:
            n = (len(values) + 1) // 2
            shares = np.array([1.0, *values[n:]])
            shape = {"alpha": values[:n], "weight": (shares / shares.sum()).tolist()}
        else:
            shape = dict(shape_of(self.law, *values))
        return replace(self.unit, law=self.law, shape=shape, volumetric=self.volumetric)

    def unit_stress(self, x: FloatArray) -> FloatArray:
        """Return the stress (n_rows,), kPa, of all tests in turn, for shape parameters x and a modulus of 1 kPa."""
        material = self.material(x)
        return np.concatenate([t.predicted(material, incompressible=self.incompressible) for t in self.tests])

    def young(self, x: FloatArray) -> float:
        """Return the Young's modulus, kPa, that fits best with shape parameters x; NaN without a finite stress."""
        measured = np.concatenate([test.stress for test in self.tests])
        unit = self.unit_stress(x) * self.weights
        return float(np.sum(unit * measured * self.weights) / np.sum(unit * unit))

    def residuals(self, x: FloatArray) -> FloatArray:
        """Return the weighted residuals (n_rows,) for shape parameters x and the Young's modulus that fits best.

        If that modulus is not positive, or the law has no finite stress, the model's stress is taken to be zero.
        """
        measured = np.concatenate([test.stress for test in self.tests])
        young = self.young(x)
        modelled = young * self.unit_stress(x) if young > 0 else np.zeros(len(measured))
        weighted: FloatArray = (modelled - measured) * self.weights
        return weighted
