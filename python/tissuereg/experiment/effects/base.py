"""The base of every effect: a frozen record of checked keys that changes an experiment or what its tracker sees.

The keys of an effect are its dataclass fields, in the units that their names end in; each field carries its own check
(`number`, `numbers`, `text`, `flag`), so that a table read from a file and a record made in Python obey one rule.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import MISSING, dataclass, field, fields
from typing import Any, ClassVar, NoReturn

import numpy as np

from tissuereg._base.arguments import is_number
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import ExperimentError
from tissuereg.experiment.experiment import Experiment

#: Three lengths, angles or components.
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Effect:
    """One ``[[effect]]`` table.

    Raises
    ------
    ExperimentError
        If a key does not hold what it must.
    """

    #: As in the table's key ``id``.
    id: ClassVar[str]
    #: Whether an experiment may have several.
    repeatable: ClassVar[bool] = False
    #: Whether its table holds a stress, which does not grow with Young's modulus.
    absolute: ClassVar[bool] = False

    def __post_init__(self) -> None:
        for key in fields(self):
            value = getattr(self, key.name)
            if value is not None or key.default is not None:
                object.__setattr__(self, key.name, key.metadata["check"](key.name, value))
        self.check()

    def check(self) -> None:
        """Refuse keys that contradict each other."""

    def fits(self, experiment: Experiment) -> None:
        """Refuse an experiment that lacks what this effect refers to.

        Parameters
        ----------
        experiment : Experiment
            With this effect among its effects.

        Raises
        ------
        ExperimentError
            If something is missing; the message states what is needed and what there is.
        """

    def applied(self, experiment: Experiment, element: str) -> Experiment:
        """Return the experiment with this effect applied.

        Parameters
        ----------
        experiment : Experiment
            What is believed so far.
        element : {"tet4", "tet4-averaged", "tet10"}
            Elements to be used.

        Returns
        -------
        Experiment
            For the solver.

        Raises
        ------
        ExperimentError
            If this release's solver does not run the effect.
        """
        raise NotImplementedError

    def table(self) -> dict[str, Any]:
        """Return the keys of the ``[[effect]]`` table, ``id`` first, absent ones left out."""
        content: dict[str, Any] = {"id": self.id}
        for key in fields(self):
            value = getattr(self, key.name)
            if value is not None:
                content[key.name] = list(value) if isinstance(value, tuple) else value
        return content


@dataclass(frozen=True, kw_only=True)
class ChainEffect(Effect):
    """An error of the marker tracker: it changes seen markers, not the body, its targets or forces."""

    def applied(self, experiment: Experiment, element: str) -> Experiment:
        """Return the experiment unchanged: the tracker does not act on the body."""
        return experiment

    def seen(self, places: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return where the tracker sees markers.

        Parameters
        ----------
        places : ndarray of float64, shape (n_frames, n_markers, 3)
            Where they are, mm; NaN = not known.
        times : ndarray of float64, shape (n_frames,)
            Frames of the case in s, increasing.
        names : sequence of str
            Of the markers.

        Returns
        -------
        ndarray of float64, shape (n_frames, n_markers, 3)
            mm.
        """
        raise NotImplementedError

    def undone(self, seen: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return where markers are, from where the tracker saw them: the inverse of `seen`."""
        raise NotImplementedError


def refuse(rule: str, found: object = None) -> NoReturn:
    """Raise an error that states what must hold and what was found."""
    message = rule if found is None else f"{rule}, got {found!r}"
    raise ExperimentError(message)


def number(
    meaning: str, *, above: float = -math.inf, least: float = -math.inf, below: float = math.inf, default: Any = MISSING
) -> Any:
    """Declare a key that holds a finite number, greater than `above`, at least `least`, less than `below`.

    `meaning` is one sentence for the page of the format, as in all that follow.
    """
    within, wanted = _range(above, least, below)

    def check(name: str, value: Any) -> float:
        if not (is_number(value) and within(float(value))):
            refuse(f"`{name}` must be a finite number{wanted}", value)
        return float(value)

    return _declared(check, f"number{wanted}", meaning, default)


def numbers(
    meaning: str,
    length: int | None = None,
    *,
    above: float = -math.inf,
    least: float = -math.inf,
    below: float = math.inf,
    directed: bool = False,
    default: Any = MISSING,
) -> Any:
    """Declare a key that holds a list of finite numbers in a range; `directed`: not all may be zero."""
    within, wanted = _range(above, least, below)
    size = "one or more" if length is None else str(length)

    def check(name: str, value: Any) -> tuple[float, ...]:
        values = value.tolist() if isinstance(value, np.ndarray) else value
        listed = isinstance(values, list | tuple) and len(values) == (length or max(1, len(values)))
        if not (listed and all(is_number(x) and within(float(x)) for x in values)):
            refuse(f"`{name}` must be a list of {size} finite numbers{wanted}", values)
        if directed and not any(values):
            refuse(f"`{name}` must have a length", values)
        return tuple(float(x) for x in values)

    words = "[x, y, z]" if length == 3 else f"list of {size} numbers"
    return _declared(check, f"{words}, each{wanted}" if wanted else words, meaning, default)


def text(meaning: str, *, among: Sequence[str] = (), default: Any = MISSING) -> Any:
    """Declare a key that holds a text, one of `among` where that is given."""

    def check(name: str, value: Any) -> str:
        if not (isinstance(value, str) and value.strip()):
            refuse(f"`{name}` must be a text", value)
        if among and value not in among:
            refuse(f"`{name}` must be one of {', '.join(among)}", value)
        return str(value)

    words = (
        " or ".join(f"`{word}`" for word in among)
        if len(among) < 5
        else f"one of {', '.join(f'`{word}`' for word in among)}"
    )
    return _declared(check, words or "text", meaning, default)


def texts(meaning: str, length: int) -> Any:
    """Declare a key that holds a list of different texts."""

    def check(name: str, value: Any) -> tuple[str, ...]:
        listed = isinstance(value, list | tuple) and all(isinstance(x, str) and x.strip() for x in value)
        if not (listed and len(value) == length == len(set(value))):
            refuse(f"`{name}` must be a list of {length} different texts", value)
        return tuple(value)

    return _declared(check, f"list of {length} texts", meaning, MISSING)


def flag(meaning: str, *, default: Any = MISSING) -> Any:
    """Declare a key that holds true or false."""

    def check(name: str, value: Any) -> bool:
        if not isinstance(value, bool):
            refuse(f"`{name}` must be true or false", value)
        return bool(value)

    return _declared(check, "`true` or `false`", meaning, default)


def _declared(check: Callable[[str, Any], Any], words: str, meaning: str, default: Any) -> Any:
    return field(default=default, metadata={"check": check, "words": words, "meaning": meaning})


def exactly_one(effect: Effect, *groups: tuple[str, ...]) -> None:
    """Refuse an effect unless exactly one group of keys is given, and given whole.

    Parameters
    ----------
    effect : Effect
        To be checked.
    *groups : tuple of str
        Keys that belong together.

    Raises
    ------
    ExperimentError
        If no group is complete, or keys of several are given.
    """
    given = [key for group in groups for key in group if getattr(effect, key) is not None]
    if given not in [list(group) for group in groups]:
        wanted = " or ".join(" and ".join(f"`{key}`" for key in group) for group in groups)
        refuse(f"either {wanted} must be given", ", ".join(given) or "none of them")


def rotation_from_vector(degrees: Vector) -> FloatArray:
    """Return the matrix of a rotation vector: axis times angle in degrees, right-handed, shape (3, 3)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(np.asarray(degrees), degrees=True).as_matrix())


def _range(above: float, least: float, below: float) -> tuple[Callable[[float], bool], str]:
    bounds = [
        f"greater than {above:g}" if above > -math.inf else "",
        f"at least {least:g}" if least > -math.inf else "",
        f"less than {below:g}" if below < math.inf else "",
    ]
    bound_text = " and ".join(bound for bound in bounds if bound)
    return (lambda value: value > above and value >= least and value < below), f" {bound_text}" if bound_text else ""
