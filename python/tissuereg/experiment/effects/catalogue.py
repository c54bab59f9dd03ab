"""All effects by id, in the order in which they are applied."""

import contextlib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import MISSING, fields, replace
from typing import Any

from tissuereg._base.arrays import FloatArray
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
    """Return the effect that a table describes.

    Parameters
    ----------
    content : mapping of str to object
        Keys of an ``[[effect]]`` table, ``id`` among them.

    Returns
    -------
    Effect
        With its keys checked; `check_effects` checks that it fits an experiment.

    Raises
    ------
    ExperimentError
        If the id or a key is unknown, a key is missing or does not hold what it must.

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
    """Return effects in the order of application; several of one id keep theirs."""
    return sorted(effects, key=lambda effect: _ORDER.index(effect.id))


def check_effects(experiment: Experiment) -> None:
    """Refuse effects that do not fit their experiment or each other.

    Parameters
    ----------
    experiment : Experiment
        With its effects.

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


def extended(experiment: Experiment, element: str = "tet4") -> Experiment:
    """Return an experiment with the effects of body, supports and actuators worked into it.

    Parameters
    ----------
    experiment : Experiment
        With its effects.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements to be used.

    Returns
    -------
    Experiment
        Its remaining effects are those that the solver reads while it runs (memory, sliding) and those of the measuring
        chain. The same object if it has effects of the measuring chain alone, or none.

    Raises
    ------
    ExperimentError
        As `check_effects`.
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
    """Return where the tracker sees markers, errors of the measuring chain applied.

    Parameters
    ----------
    experiment : Experiment
        With its effects.
    places : ndarray of float64, shape (n_frames, n_markers, 3)
        Where markers are in the frames of a case, mm.
    times : ndarray of float64, shape (n_frames,)
        s.

    Returns
    -------
    ndarray of float64, shape (n_frames, n_markers, 3)
        mm.
    """
    for effect in _chain(experiment.effects):
        places = effect.seen(places, times, experiment.marker_names)
    return places


def true_markers(experiment: Experiment, seen: FloatArray, times: FloatArray) -> FloatArray:
    """Return where markers truly are, (n_frames, n_markers, 3), mm: all errors of the measuring chain are undone.

    `seen`: places that the tracker saw, of that shape; `times` (n_frames,): s.
    """
    for effect in reversed(_chain(experiment.effects)):
        seen = effect.undone(seen, times, experiment.marker_names)
    return seen


@contextlib.contextmanager
def _of_table(index: int, effect: Effect) -> Iterator[None]:
    """Name the table in every error about its effect."""
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
