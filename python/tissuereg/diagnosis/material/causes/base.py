"""Definition of a cause of material tests: the forms in which it is fitted, and its sentence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.material.scene import Scene
from tissuereg.experiment.effects import Effect


@dataclass(frozen=True, eq=False)
class Form:
    """One form of a cause: the formula of an effect on the believed model, with n parameters that are fitted.

    Attributes
    ----------
    label : str
        Name, for instance ``yeoh``.
    mean, std : ndarray of float64, shape (n,)
        Mean and standard deviation of the Gaussian prior of the fitted parameters.
    starts : tuple of tuple of float
        First guesses, each of n parameters.
    effect : callable
        Returns the effect for parameters (n,); None for Young's modulus, which every fit varies.
    """

    label: str
    mean: FloatArray
    std: FloatArray
    starts: tuple[tuple[float, ...], ...]
    effect: Callable[[FloatArray], Effect] | None


@dataclass(frozen=True)
class MaterialCause:
    """One cause that a material test can show: an error of the believed law.

    Attributes
    ----------
    id : str
        Id of the cause, the same as in the effect's table.
    slot : str
        Part of the model that it replaces; causes with the same slot exclude each other.
    forms : callable
        Returns the forms that curves of given ranges can show; none where the cause cannot be observed.
    sentence : callable
        Returns the finding in words, from the effect's table.
    parameters : mapping of str to str
        Names of its parameters in the answer, by key of the table.
    """

    id: str
    slot: str
    forms: Callable[[Scene], list[Form]]
    sentence: Callable[[Mapping[str, object]], str]
    parameters: Mapping[str, str] = field(default_factory=dict)


def form(
    label: str,
    prior: Sequence[tuple[float, float]],
    starts: Sequence[tuple[float, ...]],
    effect: Callable[[FloatArray], Effect],
) -> Form:
    """Return a form of a cause from the prior means and standard deviations of its n parameters.

    `label`: name; `prior`: n pairs of mean and standard deviation; `starts`: first guesses, each of n numbers; the
    means where empty; `effect`: function that returns the effect for parameters (n,).
    """
    mean, std = np.array([p[0] for p in prior]), np.array([p[1] for p in prior])
    return Form(label, mean, std, tuple(starts) or (tuple(mean.tolist()),), effect)


def sigmoid(x: float) -> float:
    """Return the logistic function 1 / (1 + exp(-x)), kept within (0, 1) by a margin of 1e-6."""
    return float(1e-6 + (1.0 - 2e-6) / (1.0 + np.exp(-np.clip(x, -40.0, 40.0))))


def exponential(x: float) -> float:
    """Return exp(x) with `x` clipped to [-40, 40], so that the result is finite."""
    return float(np.exp(np.clip(x, -40.0, 40.0)))
