"""What every cause is: forms that a fit can take, and a sentence."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.material.scene import Scene
from tissuereg.effects import Effect


@dataclass(frozen=True, eq=False)
class Form:
    """One way in which a cause may act: an effect with numbers that are fitted.

    Attributes
    ----------
    label : str
        Such as ``yeoh``.
    mean, std : ndarray of float64, shape (n,)
        Gaussian prior of the fitted numbers.
    starts : tuple of tuple of float
        Where searches begin.
    effect : callable
        Effect of given numbers; None for the modulus, which every fit has.
    """

    label: str
    mean: FloatArray
    std: FloatArray
    starts: tuple[tuple[float, ...], ...]
    effect: Callable[[FloatArray], Effect] | None


@dataclass(frozen=True)
class Cause:
    """One id that a material test can find.

    Attributes
    ----------
    id : str
        As in the effect's table.
    slot : str
        What it takes up; causes of one slot exclude each other.
    forms : callable
        Forms that the curves of a scene can show; none where the cause cannot be seen.
    sentence : callable
        What is found, from the effect's table.
    parameters : mapping of str to str
        Names of its numbers in the answer, by key of the table.
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
    """Return a form from means and standard deviations of its numbers.

    Parameters
    ----------
    label : str
        Name.
    prior : sequence of (mean, std)
        One a number.
    starts : sequence of tuple of float
        Empty: the means.
    effect : callable
        Effect of given numbers.

    Returns
    -------
    Form
        For a fit.
    """
    mean, std = np.array([p[0] for p in prior]), np.array([p[1] for p in prior])
    return Form(label, mean, std, tuple(starts) or (tuple(mean.tolist()),), effect)


def sigmoid(x: float) -> float:
    """Return a number from 0 to 1 that grows with any number, kept off both ends."""
    return float(1e-6 + (1.0 - 2e-6) / (1.0 + np.exp(-np.clip(x, -40.0, 40.0))))


def exponential(x: float) -> float:
    """Return a positive number that stays finite."""
    return float(np.exp(np.clip(x, -40.0, 40.0)))
