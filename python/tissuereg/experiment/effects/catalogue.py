"""All effects by their ``id``, in the order in which they are applied to an experiment."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, replace
from typing import Any

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg.errors import ExperimentError
from tissuereg.experiment.effects.actuators import ActuatorDirection, ActuatorGain, ActuatorOffset
from tissuereg.experiment.effects.base import ChainEffect, Effect, refuse
from tissuereg.experiment.effects.chain import Frame, Latency, MarkerSlip, MarkerSwap, Scale
from tissuereg.experiment.effects.elastic import Asymmetry, Fibre, Mooney, OtherLaw, Poisson, Stiffening, Stiffness
from tissuereg.experiment.effects.history import Drainage, Memory, Rate, Relaxation, Set, Softening, Swelling
from tissuereg.experiment.effects.regions import Inclusion, Layer
from tissuereg.experiment.effects.supports import Detachment, Gravity, Reference, Sliding
from tissuereg.experiment.experiment import Experiment

#: What a body is made of, what it remembers, its weight; its supports; its actuators; the marker tracker.
EFFECTS: dict[str, type[Effect]] = {
    effect.id: effect
    for effect in (
        Stiffness, Poisson, Stiffening, Mooney, Asymmetry, Fibre,
        Inclusion, Layer,
        Relaxation, Rate, Softening, Set, Swelling, Drainage,
        Gravity, Reference,
        Sliding, Detachment,
        ActuatorGain, ActuatorDirection, ActuatorOffset,
        Frame, Scale, Latency, MarkerSlip, MarkerSwap,
    )
}  # fmt: skip

_ORDER = list(EFFECTS)

#: Uncertainties that `diagnose` fits together with the causes, never an effect that a table may hold.
_NUISANCES = ("drift", "mesh_error")


def effect_from_table(content: Mapping[str, Any]) -> Effect:
    """Return the effect that an ``[[effect]]`` table describes.

    Parameters
    ----------
    content : mapping of str to object
        Keys of an ``[[effect]]`` table, ``id`` among them.

    Returns
    -------
    Effect
        Effect whose values have been checked; `check_effects` checks whether it fits an experiment.

    Raises
    ------
    ExperimentError
        If the id or a key is unknown, a key is missing, or a value is not allowed.

    Examples
    --------
    >>> effect_from_table({"id": "stiffness", "young_kpa": 12.0})
    Stiffness(young_kpa=12.0)
    """
    kind = _kind(content.get("id"))
    known = {key.name: key.default for key in fields(kind)}
    given = {key: value for key, value in content.items() if key != "id"}
    unknown = sorted(set(given) - set(known))
    if unknown:
        refuse(f"effect '{kind.id}' must have only the keys {', '.join(known)}", ", ".join(unknown))
    for key, default in known.items():
        if default is MISSING and key not in given:
            refuse(f"`{key}` must be given for effect '{kind.id}'")
    return kind(**given)


def ordered(effects: Iterable[Effect]) -> list[Effect]:
    """Return effects in the order in which they are applied; effects of the same id keep their order."""
    return sorted(effects, key=lambda effect: _ORDER.index(effect.id))


def check_effects(experiment: Experiment) -> None:
    """Raise an error if effects of an experiment do not fit it or each other.

    Parameters
    ----------
    experiment : Experiment
        Experiment with its effects.

    Raises
    ------
    ExperimentError
        If an effect does not fit; the message states what must hold and names the table by its number and id.
    """
    laws = [i for i, effect in enumerate(experiment.effects) if isinstance(effect, OtherLaw)]
    for i, effect in enumerate(experiment.effects):
        with _of_table(i, effect):
            if not effect.repeatable and effect.id in [other.id for other in experiment.effects[:i]]:
                refuse(f"there must be one effect '{effect.id}' at most")
            if i in laws[1:]:
                refuse("there must be one other law at most, effects stiffening, mooney and asymmetry together")
            effect.fits(experiment)


def extended(experiment: Experiment, element: Element = "tet4") -> Experiment:
    """Return an experiment whose body, supports and actuators are changed as its effects state.

    Parameters
    ----------
    experiment : Experiment
        Believed experiment with its effects.
    element : {"tet4", "tet4-averaged", "tet10"}
        Finite elements with which it will be simulated.

    Returns
    -------
    Experiment
        Changed experiment. It keeps the effects that the solver reads while it runs (those of the load history, and
        sliding) and the errors of the marker tracker. If it has no other effects than errors of the tracker, the same
        object is returned.

    Raises
    ------
    ExperimentError
        If an effect does not fit the experiment or another effect.
    """
    check_effects(experiment)
    rest = tuple(effect for effect in ordered(experiment.effects) if isinstance(effect, ChainEffect | Memory | Sliding))
    if all(isinstance(effect, ChainEffect) for effect in experiment.effects):
        return experiment
    number = {id(effect): i for i, effect in enumerate(experiment.effects)}
    for effect in ordered(experiment.effects):
        with _of_table(number[id(effect)], effect):
            experiment = effect.applied(experiment, element)
    return replace(experiment, effects=rest)


def seen_markers(experiment: Experiment, places: FloatArray, times: FloatArray) -> FloatArray:
    """Return the marker places that the tracker reports, which differ from the true ones by the errors of the tracker.

    Parameters
    ----------
    experiment : Experiment
        Experiment with its effects, of which those of the tracker are used.
    places : ndarray of float64, shape (n_frames, n_markers, 3)
        True places of the markers in the frames of one load case, mm.
    times : ndarray of float64, shape (n_frames,)
        Times of the frames, s.

    Returns
    -------
    ndarray of float64, shape (n_frames, n_markers, 3)
        Reported places, mm.
    """
    for effect in _chain(experiment.effects):
        places = effect.seen(places, times, experiment.marker_names)
    return places


def true_markers(experiment: Experiment, seen: FloatArray, times: FloatArray) -> FloatArray:
    """Return the true marker places, (n_frames, n_markers, 3), mm: all errors of the tracker are undone.

    `seen`: places that the tracker reports, of that shape, mm; `times` (n_frames,): times of the frames, s.
    """
    for effect in reversed(_chain(experiment.effects)):
        seen = effect.undone(seen, times, experiment.marker_names)
    return seen


@contextlib.contextmanager
def _of_table(index: int, effect: Effect) -> Iterator[None]:
    """Add the number and the id of the ``[[effect]]`` table to an ExperimentError that the block raises."""
    try:
        yield
    except ExperimentError as error:
        place = f"[[effect]] number {index + 1}"
        message = f"{error} in {place} ('{effect.id}')"
        raise ExperimentError(message, where=place) from error


def _chain(effects: Sequence[Effect]) -> list[ChainEffect]:
    return [effect for effect in ordered(effects) if isinstance(effect, ChainEffect)]


def _kind(identity: object) -> type[Effect]:
    if identity is None:
        refuse("`id` must be given")
    if identity in _NUISANCES:
        refuse(
            "`id` must be a cause; this one is an uncertainty that is fitted with the causes, not an effect", identity
        )
    if not isinstance(identity, str) or identity not in EFFECTS:
        refuse(f"`id` must be one of {', '.join(EFFECTS)}", identity)
    return EFFECTS[identity]
