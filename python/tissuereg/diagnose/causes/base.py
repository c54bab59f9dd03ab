"""What a cause is: hypotheses with their columns, knobs for the nonlinear fit, a sentence."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.effects import Effect

#: Parameters as an answer gives them: numbers, lists of numbers, names.
Values = dict[str, Any]

#: Weights, one in all, and sets of effects whose answers they belong to.
Mixture = list[tuple[float, tuple[Effect, ...]]]


@dataclass(frozen=True, eq=False)
class Variant:
    """One hypothesis of a cause: discrete choices made, amplitudes free.

    Attributes
    ----------
    label : str
        What tells it from the cause's other hypotheses.
    columns : ndarray of float64, shape (p, size)
        What everything measured does over one prior deviation of each amplitude, mm and mN.
    settings : mapping
        The discrete choices.
    positive : bool
        Whether its one amplitude cannot be negative.
    fixed : bool
        Whether the one amplitude is 1, as of two markers that are exchanged.
    """

    label: str
    columns: FloatArray
    settings: Mapping[str, Any] = field(default_factory=dict)
    positive: bool = False
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class Knobs:
    """A cause's free coordinates, all real numbers with normal priors.

    Attributes
    ----------
    start, mean, deviation : ndarray of float64, shape (k,)
        Where the fit begins, and the prior.
    effects : callable
        Gives the effects of coordinates (k,) on a body whose modulus is the second argument in kPa.
    values : callable
        Gives the parameters of the answer, in the same way.
    step : ndarray of float64, shape (k,)
        For difference quotients.
    columns : ndarray of float64, shape (k, size), optional
        What a unit of every coordinate changes, mm and mN, where the fit takes that for the effects: a mesh may answer
        them in jumps.
    between : callable, optional
        Gives weights and effects, of coordinates and modulus, between whose answers the fit takes that of the effects,
        where the user's mesh would jump from one to the other.
    starts : ndarray of float64, shape (n, k), optional
        Other places where the fit may begin.
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
        """Return weights, one in all, and effects whose answers the user's mesh gives for coordinates (k,)."""
        return [(1.0, self.effects(x, young))] if self.between is None else self.between(x, young)


class Cause(ABC):
    """One physical cause that a diagnosis can name."""

    #: As in the answers.
    id: ClassVar[str]

    #: Settings of a variant that no knob passes between.
    discrete: ClassVar[tuple[str, ...]] = ()

    #: Whether the nuisances hold it too, as small as it always is: what is held out then tells no difference.
    always_fitted: ClassVar[bool] = False

    #: Whether what it changes is no multiple of Young's modulus, as its knobs have it.
    absolute: ClassVar[bool] = False

    @abstractmethod
    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return the hypotheses that fit an experiment; none where the cause makes no sense.

        Parameters
        ----------
        bench : Bench
            The believed model and its derivatives.

        Returns
        -------
        iterable of Variant
            All with the same number of columns.
        """

    @abstractmethod
    def knobs(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> Knobs:
        """Return the coordinates of the nonlinear fit.

        Parameters
        ----------
        bench : Bench
            The believed model.
        variant : Variant
            Where to begin.
        amplitudes : ndarray of float64, shape (p,)
            Of the variant's columns, in prior deviations.

        Returns
        -------
        Knobs
            With the same discrete choices.
        """

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return hypotheses too much like one of the bank to be screened, which are fitted beside it.

        Parameters
        ----------
        bench : Bench
            The believed model.
        variant : Variant
            Of the bank.

        Returns
        -------
        tuple of Variant
            With its columns and other choices.
        """
        return ()

    @abstractmethod
    def sentence(self, values: Values) -> str:
        """Return the finding in plain words."""


def knobs(
    coordinates: Iterable[tuple[float, float, float, float]],
    effects: Callable[[FloatArray, float], tuple[Effect, ...]],
    values: Callable[[FloatArray, float], Values],
) -> Knobs:
    """Return knobs from rows of start, prior mean, prior deviation and step."""
    start, mean, deviation, step = np.array(list(coordinates), np.float64).T
    return Knobs(start, mean, deviation, effects, values, step)


def three(vector: FloatArray | Sequence[float]) -> tuple[float, float, float]:
    """Return a vector as the tables of effects hold it."""
    x, y, z = (float(v) for v in vector)
    return x, y, z


def logistic(x: float) -> float:
    """Return 1 / (1 + exp(-x))."""
    return float(1.0 / (1.0 + np.exp(-x)))


def logit(p: float, edge: float = 0.02) -> float:
    """Return the inverse of `logistic`, of a share kept an edge away from 0 and 1."""
    p = min(max(p, edge), 1.0 - edge)
    return float(np.log(p / (1.0 - p)))
