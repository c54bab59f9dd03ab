"""The base class of every effect: a frozen record of checked keys that changes an experiment or measured markers.

The keys of an effect are its fields, in the units that their names end in, declared by the functions of
`tissuereg._base.fields`: a table read from a file and a record made in Python obey the same rules.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NoReturn

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg._base.fields import CheckedRecord
from tissuereg.errors import ExperimentError, TissueRegError
from tissuereg.experiment.experiment import Experiment

#: Three lengths, angles or components.
Vector = tuple[float, float, float]


@dataclass(frozen=True, kw_only=True)
class Effect(CheckedRecord):
    """Base of all effects: one deviation of reality from the believed experiment, as an ``[[effect]]`` table states it.

    Raises
    ------
    ExperimentError
        If a field has a value that its declaration does not allow.
    """

    error: ClassVar[type[TissueRegError]] = ExperimentError
    #: As in the table's key ``id``.
    id: ClassVar[str]
    #: Whether an experiment may have several.
    repeatable: ClassVar[bool] = False
    #: Whether its table holds a stress, which does not grow with Young's modulus.
    absolute: ClassVar[bool] = False
    #: Whether a test of a specimen can show it.
    of_specimen: ClassVar[bool] = False

    def fits(self, experiment: Experiment) -> None:
        """Raise an error if an experiment lacks what this effect refers to, such as a marker or an actuator.

        Parameters
        ----------
        experiment : Experiment
            Experiment that has this effect among its effects.

        Raises
        ------
        ExperimentError
            If something is missing; the message states what is needed and what there is.
        """

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return a copy of an experiment that is changed as this effect states.

        Parameters
        ----------
        experiment : Experiment
            Believed experiment, to which earlier effects have been applied already.
        element : {"tet4", "tet4-averaged", "tet10"}
            Finite elements with which it will be simulated.

        Returns
        -------
        Experiment
            Changed experiment, for the solver.

        Raises
        ------
        ExperimentError
            If the solver of this release cannot simulate the effect.
        """
        raise NotImplementedError

    def table(self) -> dict[str, Any]:
        """Return the keys and values of the ``[[effect]]`` table: ``id`` first, keys that are None left out."""
        content: dict[str, Any] = {"id": self.id}
        for key in fields(self):
            value = getattr(self, key.name)
            if value is not None:
                content[key.name] = list(value) if isinstance(value, tuple) else value
        return content


@dataclass(frozen=True, kw_only=True)
class ChainEffect(Effect):
    """Base of errors of the marker tracker, which change measured markers, but not the body, its targets or forces."""

    def applied(self, experiment: Experiment, element: Element) -> Experiment:
        """Return the experiment unchanged: the tracker does not act on the body."""
        return experiment

    def seen(self, places: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the marker places that the tracker reports, which differ from the true ones by this error.

        Parameters
        ----------
        places : ndarray of float64, shape (n_frames, n_markers, 3)
            True places of the markers in mm; NaN where not known.
        times : ndarray of float64, shape (n_frames,)
            Times of the frames in s, increasing.
        names : sequence of str
            Names of the markers.

        Returns
        -------
        ndarray of float64, shape (n_frames, n_markers, 3)
            Reported places in mm.
        """
        raise NotImplementedError

    def undone(self, seen: FloatArray, times: FloatArray, names: Sequence[str]) -> FloatArray:
        """Return the true marker places, (n_frames, n_markers, 3), mm, from the places that the tracker reports.

        `seen`: reported places, of that shape, in mm; `times` (n_frames,): times of the frames, s; `names`: names of
        the markers.
        """
        raise NotImplementedError


def refuse(rule: str, found: object = None) -> NoReturn:
    """Raise an ExperimentError that states the rule that must hold and the value `found` instead, unless it is None."""
    message = rule if found is None else f"{rule}, got {found!r}"
    raise ExperimentError(message)


def exactly_one(effect: Effect, *groups: tuple[str, ...]) -> None:
    """Raise an error unless exactly one of several groups of fields of an effect is given, and that one completely.

    Parameters
    ----------
    effect : Effect
        Effect to be checked.
    *groups : tuple of str
        Names of fields that belong together, one tuple per group. A field counts as given unless it is None.

    Raises
    ------
    ExperimentError
        If no group is complete, or fields of more than one group are given.
    """
    given = [key for group in groups for key in group if getattr(effect, key) is not None]
    if given not in [list(group) for group in groups]:
        wanted = " or ".join(" and ".join(f"`{key}`" for key in group) for group in groups)
        refuse(f"either {wanted} must be given", ", ".join(given) or "none of them")


def rotation_from_vector(degrees: Vector) -> FloatArray:
    """Return the right-handed rotation matrix, shape (3, 3), of a rotation vector: axis times angle in degrees."""
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_rotvec(np.asarray(degrees), degrees=True).as_matrix())
