"""Definition of a cause of material tests: the forms in which it is fitted, and its sentence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.material.scene import Scene
from tissuereg.experiment.effects import Effect


@dataclass(frozen=True, eq=False)
class Form:
    """One form of a cause: an effect with fitted parameters.

    Attributes
    ----------
    label : str
        Name, for instance ``yeoh``.
    mean, std : ndarray of float64, shape (n,)
        Gaussian prior of the fitted parameters.
    starts : tuple of tuple of float
        First guesses.
    effect : callable
        Returns the effect for parameters; None for the modulus, which every fit has.
    """

    label: str
    mean: FloatArray
    std: FloatArray
    starts: tuple[tuple[float, ...], ...]
    effect: Callable[[FloatArray], Effect] | None


@dataclass(frozen=True)
class MaterialCause:
    """One cause that a material test can show.

    Attributes
    ----------
    id : str
        As in the effect's table.
    slot : str
        Part of the model that it replaces; causes with the same slot exclude each other.
    forms : callable
        Returns the forms that curves of a scope can show; none where the cause cannot be seen.
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
    """Return a form from the prior means and standard deviations of its parameters.

    `label`: name; `prior`: one for each parameter; `starts`: first guesses; the means where empty; `effect`: returns
    the effect for parameters. Result: for a fit.
    """
    mean, std = np.array([p[0] for p in prior]), np.array([p[1] for p in prior])
    return Form(label, mean, std, tuple(starts) or (tuple(mean.tolist()),), effect)


def sigmoid(x: float) -> float:
    """Return the logistic function, kept within (0, 1) by a margin of 1e-6."""
    return float(1e-6 + (1.0 - 2e-6) / (1.0 + np.exp(-np.clip(x, -40.0, 40.0))))


def exponential(x: float) -> float:
    """Return the exponential function of a clipped argument, so that it is finite."""
    return float(np.exp(np.clip(x, -40.0, 40.0)))
