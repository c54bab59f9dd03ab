"""The base of every effect: a frozen record of checked keys that changes an experiment or what its tracker sees.

The keys of an effect are its fields, in the units that their names end in, declared by the functions of
`tissuereg._base.fields`: a table read from a file and a record made in Python obey one rule.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NoReturn

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.fields import CheckedRecord
from tissuereg.errors import ExperimentError, TissueRegError
from tissuereg.experiment.experiment import Experiment

#: Three lengths, angles or components.
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Effect(CheckedRecord):
    """One ``[[effect]]`` table.

    Raises
    ------
    ExperimentError
        If a key does not hold what it must.
    """

    error: ClassVar[type[TissueRegError]] = ExperimentError
    #: As in the table's key ``id``.
    id: ClassVar[str]
    #: Whether an experiment may have several.
    repeatable: ClassVar[bool] = False
    #: Whether its table holds a stress, which does not grow with Young's modulus.
    absolute: ClassVar[bool] = False

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
        """Return where markers truly are, (n_frames, n_markers, 3), mm, from where the tracker saw them.

        `seen`: places that the tracker saw, of that shape; `times` (n_frames,): s; `names`: of the markers.
        """
        raise NotImplementedError


def refuse(rule: str, found: object = None) -> NoReturn:
    """Raise an error that states what must hold and what was found."""
    message = rule if found is None else f"{rule}, got {found!r}"
    raise ExperimentError(message)


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
