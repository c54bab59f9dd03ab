"""The archive, ``data/<body>.npz``, ``supports.npz`` and ``inner.npz``, packed from one file an event in ``build``."""

import json
from pathlib import Path

import numpy as np

from loadfree.generator import inner, supports
from loadfree.generator.bodies import BODIES, DATA, read
from loadfree.generator.draw import N_EVENTS, plans
from loadfree.generator.events import Bench

#: Single events, not part of the repository.
EVENTS = Path(__file__).resolve().parents[3] / "build" / "loadfree" / "events"

#: Further sets of events, on the meshes of ``data/<body>.npz``: bodies that are held elsewhere than the user states,
#: and such as are not as believed inside. By name: module, and what solves a plan.
SETS = {
    "supports": (supports, supports.SupportBench),
    "inner": (inner, lambda plan: inner.InnerBench(plan.body)),
}

#: Displacements are stored in steps of this size, as 16-bit numbers.
STEP_MM = 1e-3

FIELDS = ("nodes", "pool", "targets")


def path_of(plan):
    """Return where a single event lies."""
    return EVENTS / f"{plan.name}.npz"


def make_events(limit=N_EVENTS, report=print):
    """Solve every event that is not solved, event by event over all bodies; an unsolvable one leaves a note."""
    benches = {}
    for plan in _missing(zip(*(plans(body)[:limit] for body in BODIES), strict=True)):
        if plan.body not in benches:
            benches[plan.body] = Bench(plan.body)
        make_event(benches[plan.body], plan, report)


def make_set(name, report=print):
    """Solve every event of a further set that is not solved."""
    module, bench = SETS[name]
    for plan in _missing(zip(*(module.plans(body) for body in module.BODIES), strict=True)):
        make_event(bench(plan), plan, report)


def _missing(rows):
    """Yield plans that are not solved and have not failed."""
    EVENTS.mkdir(parents=True, exist_ok=True)
    for plan in (plan for row in rows for plan in row):
        path = path_of(plan)
        if not path.exists() and not path.with_suffix(".failed").exists():
            yield plan


def make_event(bench, plan, report=print):
    """Solve one event and store it."""
    path = path_of(plan)
    try:
        fields, description = bench.run(plan)
    except FloatingPointError as error:
        path.with_suffix(".failed").write_text(f"{error}\n", encoding="utf-8")
        report(f"{path.stem}: failed: {error}")
        return
    partial = path.with_suffix(".part.npz")
    np.savez_compressed(partial, told=np.array(json.dumps(description)), **fields)
    partial.rename(path)
    moved = np.linalg.norm(fields["pool"], axis=1)
    report(
        f"{path.stem}: {plan.kind}, {plan.difference}: {description['largest_mm']:.1f} mm, median of the pool "
        f"{np.median(moved):.2f} mm, {description['seconds']:.0f} s, {description['factorings']} factors, "
        f"draw {description['draw']}"
    )


def pack(body):
    """Write the archive of a body from the events that are there; return how many they are."""
    stored, events = read(body), _events(plans(body))
    mesh = {key: getattr(stored, key) for key in ("nodes_mm", "tets", "fixed_nodes", "pool_mm", "targets_mm")}
    _write(DATA / f"{body}.npz", mesh | events)
    return len(events["told"])


def pack_set(name):
    """Write the archive of a further set, keys by body; return how many events there are by body."""
    module, _ = SETS[name]
    events = {body: _events(module.plans(body)) for body in module.BODIES}
    _write(
        DATA / f"{name}.npz", {f"{body}_{key}": value for body, some in events.items() for key, value in some.items()}
    )
    return {body: len(some["told"]) for body, some in events.items()}


def _events(planned):
    """Return the arrays of those events that are there."""
    events = [np.load(path) for plan in planned if (path := path_of(plan)).exists()]
    arrays = {key: np.stack([_whole(event[key]) for event in events]) for key in FIELDS} if events else {}
    return {"told": np.array([str(event["told"]) for event in events])} | arrays


def _write(path, arrays):
    partial = path.with_suffix(".part.npz")
    np.savez_compressed(partial, step_mm=np.array(STEP_MM), **arrays)
    partial.rename(path)


def _whole(values):
    steps = np.rint(values / STEP_MM)
    if np.abs(steps).max() > np.iinfo(np.int16).max:
        message = f"a displacement of {np.abs(values).max():.1f} mm is too large for 16 bits of {STEP_MM} mm"
        raise ValueError(message)
    return steps.astype(np.int16)
