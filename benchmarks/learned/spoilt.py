"""What is wrong with the input: a change of a case, by a random generator; the marker that is wrong, if one is."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from learned.cases import N_MARKERS, STD, Case

#: A case and others of its set, to the case as it is given, and the number of its wrong marker or None.
Change = Callable[[Case, list[Case], np.random.Generator], tuple[Case, int | None]]

#: By how much one marker is wrong, mm.
OFF_MM = (5.0, 10.0, 20.0, 40.0)

#: Standard deviation of each coordinate of markers that say nothing, mm.
_RANDOM_MM = 3.0


def honest(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, None]:
    """Nothing is wrong."""
    return case, None


def _one_off(off: float) -> Change:
    def change(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, int]:
        number = int(rng.integers(N_MARKERS))
        way, measured = rng.standard_normal(3), case.measured.copy()
        measured[number] += off * way / np.linalg.norm(way)
        return replace(case, measured=measured), number

    return change


def _swapped(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, None]:
    measured = case.measured.copy()
    both = rng.choice(N_MARKERS, 2, replace=False)
    measured[both] = measured[both[::-1]]
    return replace(case, measured=measured), None


def _stale(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, None]:
    measured = case.measured.copy()
    old = rng.choice(N_MARKERS, 3, replace=False)
    measured[old] = case.reference[old] + STD * rng.standard_normal((3, 3))
    return replace(case, measured=measured), None


def _random(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, None]:
    return replace(case, measured=case.reference + _RANDOM_MM * rng.standard_normal(case.reference.shape)), None


def _noisier(factor: float) -> Change:
    def change(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, None]:
        more = STD * np.sqrt(factor**2 - 1.0) * rng.standard_normal(case.measured.shape)
        return replace(case, measured=case.measured + more), None

    return change


def _in_centimetres(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, None]:
    return replace(case, reference=case.reference / 10.0, measured=case.measured / 10.0), None


def _reversed(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, None]:
    return replace(case, simulation=None if case.simulation is None else -case.simulation), None


def _of_another_event(case: Case, others: list[Case], rng: np.random.Generator) -> tuple[Case, None]:
    strangers = [one for one in others if one.cluster != case.cluster]
    return replace(case, simulation=strangers[int(rng.integers(len(strangers)))].simulation), None


#: One marker is off; by name.
ONE_OFF: dict[str, Change] = {f"one marker off by {off:g} mm": _one_off(off) for off in OFF_MM}

#: By name. Those of a simulation are only for sets with one of each event.
CHANGES: dict[str, Change] = {
    **ONE_OFF,
    "two markers swapped": _swapped,
    "three markers of before the motion": _stale,
    "random markers": _random,
    "noise three times as stated": _noisier(3.0),
    "noise ten times as stated": _noisier(10.0),
    "centimetres given as millimetres": _in_centimetres,
}
OF_SIMULATIONS: dict[str, Change] = {
    "the simulation reversed": _reversed,
    "the simulation of another event": _of_another_event,
}
