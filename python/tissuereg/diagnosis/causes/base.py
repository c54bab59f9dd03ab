"""Base class of causes: hypotheses with sensitivity columns, free parameters of fits, forms in curves, a sentence.

A cause has several hypotheses (`Variant`), one for each discrete choice: an actuator, a place, a direction, an onset.
Screening uses their columns; the nonlinear fit starts from a hypothesis and varies the cause's free parameters
(`FreeParameters`). Stress curves have no hypotheses; a cause that they can show has forms, each with its free
parameters.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.settings import DEFAULT, MaterialSettings
from tissuereg.experiment.effects import EFFECTS, ChainEffect, Effect
from tissuereg.experiment.effects.elastic import OtherLaw

#: Physical parameters as in an answer: numbers, lists of numbers, names.
Values = dict[str, Any]

#: Weights with the sum 1, each with a set of effects whose predictions are to be averaged.
Mixture = list[tuple[float, tuple[Effect, ...]]]


@dataclass(frozen=True, eq=False)
class Variant:
    """One hypothesis of a cause: its discrete choices are fixed, and p amplitudes are free.

    `label`: name among the hypotheses of the cause; `columns` (p, size): change of all measured numbers by one prior
    standard deviation of each amplitude, mm (markers) and mN (forces); `settings`: the discrete choices by name, such
    as ``{"actuator": "left pad"}``, and values at which the fit starts; `positive`: whether the one amplitude (p = 1)
    cannot be negative; `fixed`: whether the one amplitude is exactly 1, as for two markers that are exchanged.
    """

    label: str
    columns: FloatArray
    settings: Mapping[str, Any] = field(default_factory=dict)
    positive: bool = False
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class FreeParameters:
    """The k parameters that the nonlinear fit of one cause varies: real numbers without bounds, with normal priors.

    `start`, `mean`, `deviation` (k,): first guess, prior mean and prior standard deviation; `effects`, `values`: take
    parameters (k,) and the body's Young's modulus in kPa, and return the effects of a simulation and the physical
    parameters of the answer, by key of the effect's table; `step` (k,): steps of difference quotients; `columns` (k,
    size): linear change of all measured numbers by a unit of every parameter, mm and mN, used in fits instead of
    simulations that would jump on the user's mesh; `between`: takes the same as `effects`; returns what is averaged in
    fits (`mixture`) where one simulation would jump; `starts` (n, k): further n first guesses; `label`: name among the
    forms that a cause has in curves.
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
    label: str = ""

    @property
    def guesses(self) -> list[FloatArray]:
        """All first guesses, each (k,)."""
        return [self.start, *([] if self.starts is None else self.starts)]

    def mixture(self, x: FloatArray, young: float) -> Mixture:
        """Return pairs of a weight and effects whose predictions on the user's mesh are averaged at parameters (k,).

        `young`: Young's modulus, kPa. The weights have the sum 1; there is a single pair where `between` is None.
        """
        return [(1.0, self.effects(x, young))] if self.between is None else self.between(x, young)


@dataclass(frozen=True)
class Scene:
    """Tested modes and ranges of a set of curves, which set the priors and decide what causes can be observed.

    `modes`: tested modes; `poisson`: believed Poisson's ratio; `invariant`: largest ``I1 - 3``, with I1 the first
    invariant of the right Cauchy-Green tensor at preserved volume; `two_sided`: whether bars were stretched and
    compressed, each by more than 1 %; `paced`: whether effects of time can be distinguished from those of strain (times
    are known, with holds, unloading, or two rates that differ by a fifth); `unloaded`: whether the strain falls below
    nine tenths of its largest so far; `shortest_s`, `longest_s`: range of time constants that the curves can resolve,
    s; `peak`: largest stress, kPa; `peak_energy`: half the largest stress times its strain, kPa; `fastest`: largest
    rate of strain, 1/s; 0 where times are not known; `settings`: priors of the causes.
    """

    modes: tuple[str, ...]
    poisson: float
    invariant: float
    two_sided: bool
    paced: bool
    unloaded: bool
    shortest_s: float
    longest_s: float
    peak: float
    peak_energy: float
    fastest: float
    settings: MaterialSettings = DEFAULT.material


@dataclass(frozen=True)
class Cause(ABC):
    """One physical error of a simulation that a diagnosis can name as the cause of a misfit.

    Fields of an instance are its numbers: sizes, prior deviations, counts. What a class states of itself, as keywords
    behind its bases: `id` in answers and in ``[[effect]]`` tables; `family`, the kind of error that it is one of
    (`tissuereg.diagnosis.constancy`); `discrete`, keys of `Variant.settings` that the free parameters cannot change;
    `constant`, whether its change has one size in all parts of the data (that of a contact that opens, or of what
    slips, has not); `absolute`, whether what it changes is no multiple of Young's modulus, as its free parameters have
    it.
    """

    id: ClassVar[str]
    family: ClassVar[str]
    discrete: ClassVar[tuple[str, ...]] = ()
    constant: ClassVar[bool] = True
    absolute: ClassVar[bool] = False

    def __init_subclass__(
        cls,
        *,
        id: str | None = None,
        family: str | None = None,
        discrete: tuple[str, ...] | None = None,
        constant: bool | None = None,
        absolute: bool | None = None,
    ) -> None:
        """Keep what a cause states; refuse one without a family, which a diagnosis would miss when it names it."""
        stated = {"id": id, "family": family, "discrete": discrete, "constant": constant, "absolute": absolute}
        for key, value in stated.items():
            if value is not None:
                setattr(cls, key, value)
        if "id" in vars(cls) and not hasattr(cls, "family"):
            message = f"the cause '{cls.id}' must state its `family`"
            raise TypeError(message)

    @property
    def is_law(self) -> bool:
        """Whether it puts another law in place of the believed one, so that it excludes others that do."""
        return issubclass(EFFECTS[self.id], OtherLaw)

    @property
    def closed_form(self) -> bool:
        """Whether it is an error of the tracker, whose change is a closed form: computed at each call, never cached."""
        return issubclass(EFFECTS[self.id], ChainEffect)

    @abstractmethod
    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return the hypotheses of the cause in an experiment; none where it cannot occur or cannot be observed.

        All have the same number p of columns.
        """

    @abstractmethod
    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return the free parameters of the nonlinear fit: first guess, prior and step of each, and its effects.

        `variant`: hypothesis from which the fit starts, whose discrete choices the effects have; `amplitudes` (p,):
        fitted linear amplitudes of its columns, in prior standard deviations.
        """

    def alternatives(self, bench: Bench, variant: Variant) -> tuple[Variant, ...]:
        """Return hypotheses with other discrete choices, too like `variant` to be screened, to be fitted beside it."""
        return ()

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return the forms, formulas with free parameters, in which stress curves can show it; none by default."""
        return ()

    def believed(self, bench: Bench) -> bool:
        """Return whether the believed model has an effect of this cause already."""
        return any(effect.id == self.id for effect in bench.experiment.effects)

    def simulated(self, bench: Bench, tried: Iterable[tuple[str, Effect, Mapping[str, Any]]]) -> Iterator[Variant]:
        """Yield a hypothesis of positive amplitude, whose column is simulated, for each label, effect and settings.

        Effects that do not apply, or with which the body has no equilibrium, have none.
        """
        every = list(tried)
        changes = bench.changes([[effect] for _, effect, _ in every])
        for (label, _, settings), changed in zip(every, changes, strict=True):
            if changed is not None:
                yield Variant(label, changed[None], settings, positive=True)

    @abstractmethod
    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values`: its fitted parameters by key of the ``[[effect]]`` table."""


def free_parameters(
    coordinates: Iterable[tuple[float, float, float, float]],
    effects: Callable[[FloatArray, float], tuple[Effect, ...]],
    values: Callable[[FloatArray, float], Values] | None = None,
) -> FreeParameters:
    """Return k free parameters of a cause from four numbers for each: first guess, prior mean, deviation and step.

    `coordinates`: k rows of these numbers; the deviation is the prior standard deviation, the step that of difference
    quotients. `effects`, `values`: as in `FreeParameters`; by default values are the keys of the effect's table.
    """

    def stated(x: FloatArray, young: float) -> Values:
        return {key: value for key, value in effects(x, young)[0].table().items() if key != "id"}

    start, mean, deviation, step = np.array(list(coordinates), np.float64).reshape(-1, 4).T
    return FreeParameters(start, mean, deviation, effects, values or stated, step)


def curve_form(
    label: str,
    prior: Sequence[tuple[float, float]],
    effect: Callable[[FloatArray], Effect],
    starts: Sequence[tuple[float, ...]] = (),
) -> FreeParameters:
    """Return a form of a cause in curves, with k free parameters.

    `prior`: k pairs of prior mean and standard deviation; `effect`: takes the parameters (k,) and returns the change of
    the law; `starts`: first guesses; by default the prior mean.
    """
    guesses = np.array(starts or [tuple(mean for mean, _ in prior)], np.float64)
    # Fits to curves choose their own steps.
    coordinates = [(first, *one, np.nan) for first, one in zip(guesses[0], prior, strict=True)]
    made = free_parameters(coordinates, lambda x, young: (effect(x),))
    return replace(made, starts=guesses[1:], label=label)
