"""The list of experiments. Names and seeds are hashes, so that a name reveals nothing and does not change."""

import hashlib

import numpy as np

from blind.generator import chain, outside
from blind.generator.cases import Plan
from blind.generator.jobs import hidden, rank_within
from blind.generator.rigs import N_RIGS

LEVELS = (3.0, 5.0, 8.0, 13.0, 21.0, 50.0)
N_NULLS = 200


def all_plans():
    """Return the plans, named."""
    plans = [*_nulls(), *_singles(), *_outside(), *_composites(), *_tied(), *_fine()]
    names = set()
    for plan in plans:
        text = "/".join(map(str, (plan.kind, plan.rig, plan.parts, plan.level)))
        copies = 0
        while (name := _digest(f"{text}/{copies}")) in names:
            copies += 1
        names.add(name)
        plan.name, plan.seed = f"b{name}", int(name, 16)
        rng = np.random.default_rng([31, plan.seed])
        if plan.kind not in ("null", "tied"):
            plan.forces = bool(rng.uniform() < 0.85) if plan.kind != "single" or plan.level != 50.0 else True
            plan.noise = str(rng.choice(["white", "ar1", "common"], p=[0.7, 0.15, 0.15]))
            plan.mesh = plan.mesh or int(rng.integers(3))
    return plans


def _digest(text):
    return hashlib.sha256(text.encode()).hexdigest()[:8]


def _plan(rig, kind, parts=(), level=None, **rest):
    return Plan("", 0, rig, kind, tuple(parts), level, **rest)


def _nulls():
    for k in range(N_NULLS):
        sort = k // 50
        noise = ("ar1", "common")[k % 2] if sort == 1 else "white"
        nuisance = (1.0, 1.0, 2.0, 0.0)[sort]
        weight = k % 14 in (0, 1) and k % 3 == 0
        yield _plan(
            k % N_RIGS, "null", noise=noise, nuisance=nuisance, mesh=k % 3, forces=k % 5 != 4, believed_weight=weight
        )


def _singles():
    for index in range(len(hidden("catalogue"))):
        rigs = (0, 1, 2) if rank_within(index) % 2 == 0 else (1, 0, 3)
        for rig, levels in zip(rigs, (LEVELS, (8.0, 13.0, 21.0), (8.0, 21.0)), strict=True):
            for level in levels:
                yield _plan(rig, "single", [("catalogue", index)], level)
    for cause, variants in chain.CAUSES.items():
        for which in range(len(variants)):
            levels = LEVELS if cause != "marker_swap" else (None, None)
            for level in levels:
                yield _plan(which % 2, "single", [("chain", cause, which)], level)
            for rig in (2, 3):
                for level in (8.0, 13.0, 21.0) if cause != "marker_swap" else (None,):
                    yield _plan(rig, "single", [("chain", cause, which)], level)
    for rig, level in ((0, 5.0), (1, 8.0), (2, 8.0), (3, 13.0)):
        yield _plan(rig, "single", [("stiffness",)], level)
    for rig, level in ((0, 5.0), (1, 8.0), (0, 13.0), (1, 21.0), (0, 21.0), (1, 50.0)):
        yield _plan(rig, "single", [("reference",)], level, believed_weight=True)


def _outside():
    for index in range(len(outside.SOLVED)):
        for rig in (0, 1):
            for level in (8.0, 13.0, 21.0):
                yield _plan(rig, "outside", [("outside", index)], level)
    for index in range(len(outside.CHAIN)):
        for rig, level in ((0, 13.0), (1, 21.0), (2, 30.0)):
            yield _plan(rig, "outside", [("view", index)], level)
    for cause in chain.OUTSIDE:
        for rig, level in ((0, 13.0), (1, 21.0), (3, 30.0)):
            yield _plan(rig, "outside", [("odd", cause, 0)], level)


def _composites():
    for index in range(len(hidden("pairs"))):
        for rig, level in ((0, 50.0), (1, 80.0)):
            yield _plan(rig, "pair", [("pairs", index)], level)
    rng = np.random.default_rng(77)
    chains = ["scale", "latency", "marker_slip", "actuator_gain", "frame"]
    timed = {i for i, e in enumerate(hidden("catalogue")) if e.timed}
    for k in range(24):
        index = int(rng.integers(len(hidden("catalogue"))))
        cause = chains[k % 5]
        if index in timed and cause in ("latency", "actuator_gain"):
            cause = "marker_slip"
        rig = (0, 1)[rank_within(index) % 2]
        yield _plan(rig, "pair", [("catalogue", index), ("chain", cause, 0)], 21.0)
    for _ in range(8):
        index = int(rng.integers(len(hidden("catalogue"))))
        rig = (0, 1)[rank_within(index) % 2]
        yield _plan(rig, "pair", [("catalogue", index), ("chain", "scale", 0), ("chain", "marker_slip", 0)], 30.0)


def _tied():
    poor = {"forces": False, "only_first_case": True}
    for level in (6.0, 9.0, 13.0):
        for index in range(len(hidden("catalogue"))):
            yield _plan((0, 1)[rank_within(index) % 2], "tied", [("catalogue", index)], level, **poor)
        for rig in (0, 1):
            yield _plan(rig, "tied", [("chain", "actuator_gain", 0)], level, **poor)


def _fine():
    for rig in range(8):
        yield _plan(rig, "null", mesh=-1)
    order = [i for i in range(len(hidden("catalogue"))) if rank_within(i) == 0][:16]
    for k, index in enumerate(order):
        yield _plan(0, "fine", [("catalogue", index)], (13.0, 21.0)[k % 2], mesh=-1)
