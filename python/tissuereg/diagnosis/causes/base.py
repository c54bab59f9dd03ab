"""Base class of causes: hypotheses with sensitivity columns, free parameters of the nonlinear fit, and a sentence.

A cause has several hypotheses (`Variant`), one for each discrete choice: an actuator, a place, a direction, an onset.
Screening uses their columns, the change of all measured numbers by one prior standard deviation of each amplitude. The
nonlinear fit starts from a hypothesis and varies the cause's free parameters (`FreeParameters`), real numbers with
normal priors, from which the effects of a simulation and the parameters of the answer follow.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.experiment.effects import Effect

#: Physical parameters as in an answer: numbers, lists of numbers, names.
Values = dict[str, Any]

#: Weights with the sum 1, each with a set of effects whose predictions are to be averaged.
Mixture = list[tuple[float, tuple[Effect, ...]]]


@dataclass(frozen=True, eq=False)
class Variant:
    """One hypothesis of a cause: fixed discrete choices, free amplitudes.

    Attributes
    ----------
    label : str
        Distinguishes it from the cause's other hypotheses.
    columns : ndarray of float64, shape (p, size)
        Change of all measured numbers by one prior standard deviation of each amplitude, mm and mN.
    settings : mapping
        The discrete choices.
    positive : bool
        Whether its one amplitude cannot be negative.
    fixed : bool
        Whether its one amplitude is exactly 1, as for two markers that are exchanged.
    """

    label: str
    columns: FloatArray
    settings: Mapping[str, Any] = field(default_factory=dict)
    positive: bool = False
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """A cause's free parameters: unconstrained real numbers with normal priors.

    Attributes
    ----------
    start, mean, deviation : ndarray of float64, shape (k,)
        First guess, prior mean and prior standard deviation.
    effects : callable
        Returns the effects for parameters (k,) and the body's modulus in kPa.
    values : callable
        Returns the physical parameters of the answer for the same arguments.
    step : ndarray of float64, shape (k,)
        Steps of difference quotients.
    columns : ndarray of float64, shape (k, size), optional
        Linear change by a unit of every parameter, mm and mN, used in fits instead of simulations where those would
        change in jumps on the user's mesh.
    between : callable, optional
        Returns weights and effects for the same arguments, whose predictions are averaged in fits where a simulation
        would jump from one to the other on the user's mesh.
    starts : ndarray of float64, shape (n, k), optional
        Further first guesses.
    """

    start: FloatArray
    mean: FloatArray
    deviation: FloatArray
    effects: Callable[[FloatArray, float], tuple[Effect, ...]]
    values: Callable[[FloatArray, float], Values]
    step: FloatArray
    columns: FloatArray | None = None
    between: Callable[[FloatArray, float], Mixture] | None = None
    starts: FloatArray | None = None

    def mixture(self, x: FloatArray, young: float) -> Mixture:
        """Return weights with the sum 1, and effects whose predictions on the user's mesh are averaged for (k,)."""
        return [(1.0, self.effects(x, young))] if self.between is None else self.between(x, young)


class Cause(ABC):
    """One physical cause that a diagnosis can name."""

    #: Id in answers and in ``[[effect]]`` tables.
    id: ClassVar[str]

    #: Keys of `Variant.settings` that the free parameters cannot change.
    discrete: ClassVar[tuple[str, ...]] = ()

    #: Whether a nuisance parameter of small prior deviation describes the same effect. Held-out data then hardly differ
    #: between the models, and the proof requires no least gain.
    always_fitted: ClassVar[bool] = False

    #: Whether what it changes is no multiple of Young's modulus, as its free_parameters have it.
    absolute: ClassVar[bool] = False

    @abstractmethod
    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return the hypotheses of the cause in an experiment; none where it cannot occur or be seen.

        Parameters
        ----------
        bench : Bench
            The believed model and its sensitivities.

        Returns
        -------
        iterable of Variant
            All with the same number of columns.
        """

    @abstractmethod
    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the free parameters of the nonlinear fit.

        Parameters
        ----------
        bench : Bench
            The believed model.
        variant : Variant
            Hypothesis from which the fit starts.
        amplitudes : ndarray of float64, shape (p,)
            Fitted linear amplitudes of its columns, in prior standard deviations.

        Returns
        -------
        FreeParameters
            With the discrete choices of the hypothesis.
        """

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return hypotheses that are too similar to one of the bank to be screened; all of them are fitted.

        Parameters
        ----------
        bench : Bench
            The believed model.
        variant : Variant
            Hypothesis of the bank.

        Returns
        -------
        tuple of Variant
            With other discrete choices.
        """
        return ()

    @abstractmethod
    def sentence(self, values: Values) -> str:
        """Return the finding in words."""


def free_parameters(
    coordinates: Iterable[tuple[float, float, float, float]],
    effects: Callable[[FloatArray, float], tuple[Effect, ...]],
    values: Callable[[FloatArray, float], Values],
) -> FreeParameters:
    """Return free parameters from rows of first guess, prior mean, prior standard deviation and step."""
    start, mean, deviation, step = np.array(list(coordinates), np.float64).T
    return FreeParameters(start, mean, deviation, effects, values, step)


def three(vector: FloatArray | Sequence[float]) -> tuple[float, float, float]:
    """Return a vector as a tuple of three floats, as effects take it."""
    x, y, z = (float(v) for v in vector)
    return x, y, z


def logistic(x: float) -> float:
    """Return 1 / (1 + exp(-x))."""
    return float(1.0 / (1.0 + np.exp(-x)))


def logit(p: float, edge: float = 0.02) -> float:
    """Return the inverse of `logistic` for a share that is clipped to [edge, 1 - edge]."""
    p = min(max(p, edge), 1.0 - edge)
    return float(np.log(p / (1.0 - p)))
