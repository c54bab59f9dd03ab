"""Registers events with a method, honest and spoilt, and says what each answer is worth."""

import zlib
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

import tissuereg as tr
from learned.cases import STD, Case, demo, foreign, known, of_another_organ
from learned.spoilt import CHANGES, OF_SIMULATIONS, ONE_OFF, Change, honest
from tissuereg.errors import MarkerError
from tissuereg.parallel import Failed, Processes, in_order
from tissuereg.phantom import phantom_mesh, shipped_model_folder
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.settings import SmootherSettings

LEVELS = (0.5, 0.9, 0.95)


class WithoutSmoother(SmootherSettings):
    """No assimilation: members stay where the prior has them."""

    def alphas(self) -> tuple[float, ...]:
        """Return no inflation coefficient."""
        return ()


#: Methods by name: the shipped model, whether it is calibrated, and settings.
METHODS: dict[str, tuple[str, bool, SmootherSettings]] = {
    "shipped": ("phantom", True, SmootherSettings()),
    "graph": ("phantom-graph", True, SmootherSettings()),
    "not calibrated": ("phantom", False, SmootherSettings()),
    "without ES-MDA": ("phantom", True, WithoutSmoother()),
    "10 members": ("phantom", True, SmootherSettings(n_members=10)),
    "1,000 members": ("phantom", True, SmootherSettings(n_members=1000)),
}

#: Methods that are also asked with spoilt input, and on which share of the first one's events.
SPOILT = {"shipped": 1.0, "graph": 0.5, "not calibrated": 0.25}


@dataclass(frozen=True)
class Events:
    """Which events are asked.

    `data`: whose test split is known physics; `foreign`: folder of foreign pairs, from the file with number `first` on;
    `known`, `demo`: numbers of events; `others`: of each set by other methods than the shipped one; `off`: of each set
    with one marker that is off by a distance; `spoilt`: of each set in each other way.
    """

    data: Path
    foreign: Path
    first: int
    known: int = 500
    demo: int = 300
    others: int = 40
    off: int = 60
    spoilt: int = 20


@lru_cache(maxsize=1)
def sets(events: Events) -> dict[str, list[Case]]:
    """Return the sets of events by name, made once in a process."""
    mesh = phantom_mesh()
    return {
        "known": known(events.data, events.known),
        "foreign": foreign(mesh, events.foreign, events.first, given=True),
        "foreign, no simulation": foreign(mesh, events.foreign, events.first, given=False),
        "demo": demo(events.demo, given=True),
        "demo, no simulation": demo(events.demo, given=False),
        "another organ": of_another_organ(),
    }


def answer(model: Any, case: Case, wrong: int | None, smoother: SmootherSettings) -> dict[str, Any]:
    """Return what a registration is worth: errors in mm, shares of targets that regions hold, and what it says."""
    mesh = phantom_mesh()
    names = tuple(str(number) for number in range(len(case.reference)))
    try:
        result = tr.register(
            mesh,
            tr.Markers(case.reference, case.measured, STD, names),
            model=model,
            simulation=case.simulation,
            targets={str(number): place for number, place in enumerate(case.targets)},
            settings=tr.RegisterSettings(threads=1, smoother=smoother),
        )
    except MarkerError as error:
        return {"refused": type(error).__name__, "trusted": False}
    found = [result.target(str(number)) for number in range(len(case.targets))]
    true, shown = case.targets + case.moved, [one for one in found if one.flag is None]
    off = np.array([one.mean for one in found]) - true
    held = {
        level: [one.region(level).contains(place) for one, place in zip(found, true, strict=True)] for level in LEVELS
    }
    volumes = [float(np.prod(one.region(0.9).radii)) for one in found]
    dropped = {name for name, why in result.markers.dropped if why == "wrong"}
    row: dict[str, Any] = {
        "before_mm": float(np.linalg.norm(case.moved - case.start, axis=1).mean()),
        "after_mm": float(np.linalg.norm(off, axis=1).mean()),
        **{f"held{round(100 * level)}": float(np.mean(inside)) for level, inside in held.items()},
        "radius90_mm": float(np.mean(np.cbrt(volumes))),
        "trusted": bool(result.trust.ok),
        "p_value": result.trust.p_value,
        "flagged": 1.0 - len(shown) / len(found),
        "dropped": len(dropped),
        "reasons": sorted({reason.split(":")[0] for reason in result.trust.reasons}),
    }
    if wrong is not None:
        row["named"] = str(wrong) in dropped or any(f" {wrong} " in reason for reason in result.trust.reasons)
    # Half of the targets that the answer does not flag lie outside their regions, and nothing is said.
    outside = [not inside for inside, one in zip(held[0.9], found, strict=True) if one.flag is None]
    named = bool(dropped) if wrong is None else row["named"]
    row["silent"] = bool(result.trust.ok and not named and outside and np.mean(outside) >= 0.5)
    return row


@lru_cache
def _network(name: str, calibrated: bool) -> NetworkModel:
    """Return a shipped model of the phantom, kept for the process."""
    return NetworkModel(shipped_model_folder(name), phantom_mesh(), threads=1, calibrated=calibrated)


@dataclass(frozen=True)
class Job:
    """A registration: by which method, of which set, with which input, and the event's number in its set."""

    method: str
    set: str
    input: str
    number: int
    events: Events


def jobs_of(events: Events, methods: list[str]) -> list[Job]:
    """Return all jobs of some methods."""
    jobs = []
    for method in methods:
        for name, cases in sets(events).items():
            n = len(cases) if method == "shipped" else min(len(cases), events.others)
            strange = name == "another organ"
            if not strange or method in SPOILT:
                jobs += [Job(method, name, "honest", number, events) for number in range(n)]
            if strange or method not in SPOILT:
                continue
            changes = [*CHANGES, *(OF_SIMULATIONS if name == "foreign" else ())]
            for one in changes:
                n = max(1, round(SPOILT[method] * (events.off if one in ONE_OFF else events.spoilt)))
                jobs += [Job(method, name, one, i, events) for i in range(min(len(cases), n))]
    return jobs


def row_of(job: Job) -> dict[str, Any]:
    """Return the row of a job."""
    cases = sets(job.events)[job.set]
    change: Change = {**CHANGES, **OF_SIMULATIONS, "honest": honest}[job.input]
    # Every method gets the same input.
    rng = np.random.default_rng([44, zlib.crc32(f"{job.set}/{job.input}".encode()), job.number])
    case, wrong = change(cases[job.number], cases, rng)
    network, calibrated, smoother = METHODS[job.method]
    which = {"method": job.method, "set": job.set, "input": job.input, "event": job.number, "cluster": case.cluster}
    return {**which, **answer(_network(network, calibrated), case, wrong, smoother)}


def measure(events: Events, methods: list[str], n_jobs: int) -> list[dict[str, Any]]:
    """Return a row for every job of some methods, in their order, by `n_jobs` processes."""
    jobs, rows = jobs_of(events, methods), []
    with Processes(n_jobs) as executor:
        for outcome in in_order(executor.run(row_of, jobs)):
            if isinstance(outcome, Failed):
                raise outcome.error
            rows.append(outcome.result)
            if len(rows) % 500 == 0:
                print(f"{len(rows)} of {len(jobs)} registrations", flush=True)
    return rows
