"""The archive: one file a body, ``data/<body>.npz``, packed from one file an event below ``build/loadfree/events``."""

import json
from pathlib import Path

import numpy as np

from loadfree.generator.bodies import BODIES, DATA, read
from loadfree.generator.draw import N_EVENTS, plans
from loadfree.generator.events import Bench

#: Single events, not part of the repository.
EVENTS = Path(__file__).resolve().parents[3] / "build" / "loadfree" / "events"

#: Displacements are stored in steps of this size, as 16-bit numbers.
STEP_MM = 1e-3

FIELDS = ("nodes", "pool", "targets")


def path_of(plan):
    """Return where a single event lies."""
    return EVENTS / f"{plan.body}-{plan.number:02d}.npz"


def make_events(limit=N_EVENTS, report=print):
    """Solve every event that is not solved, event by event over all bodies; an unsolvable one leaves a note."""
    EVENTS.mkdir(parents=True, exist_ok=True)
    benches = {}
    for row in zip(*(plans(body)[:limit] for body in BODIES), strict=True):
        for plan in row:
            path = path_of(plan)
            if path.exists() or path.with_suffix(".failed").exists():
                continue
            if plan.body not in benches:
                benches[plan.body] = Bench(plan.body)
            make_event(benches[plan.body], plan, report)


def make_event(bench, plan, report=print):
    """Solve one event and store it."""
    path = path_of(plan)
    try:
        fields, told = bench.run(plan)
    except FloatingPointError as error:
        path.with_suffix(".failed").write_text(f"{error}\n", encoding="utf-8")
        report(f"{path.stem}: failed: {error}")
        return
    partial = path.with_suffix(".part.npz")
    np.savez_compressed(partial, told=np.array(json.dumps(told)), **fields)
    partial.rename(path)
    moved = np.linalg.norm(fields["pool"], axis=1)
    report(
        f"{path.stem}: {plan.kind}, {plan.difference}: {told['largest_mm']:.1f} mm, median of the pool "
        f"{np.median(moved):.2f} mm, {told['seconds']:.0f} s, {told['factorings']} factors, draw {told['draw']}"
    )


def pack(body):
    """Write the archive of a body from the events that are there; return how many they are."""
    stored = read(body)
    found = [path for plan in plans(body) if (path := path_of(plan)).exists()]
    events = [np.load(path) for path in found]
    arrays = {key: np.stack([_whole(event[key]) for event in events]) for key in FIELDS} if events else {}
    partial = DATA / f"{body}.part.npz"
    np.savez_compressed(
        partial,
        nodes_mm=stored.nodes_mm,
        tets=stored.tets,
        fixed_nodes=stored.fixed_nodes,
        pool_mm=stored.pool_mm,
        targets_mm=stored.targets_mm,
        step_mm=np.array(STEP_MM),
        told=np.array([str(event["told"]) for event in events]),
        **arrays,
    )
    partial.rename(DATA / f"{body}.npz")
    return len(events)


def _whole(values):
    steps = np.rint(values / STEP_MM)
    if np.abs(steps).max() > np.iinfo(np.int16).max:
        message = f"a displacement of {np.abs(values).max():.1f} mm is too large for 16 bits of {STEP_MM} mm"
        raise ValueError(message)
    return steps.astype(np.int16)
