"""One solve of a rig with a hidden effect at a size -> places of markers and targets, pad forces; no noise."""

import time as clock

import numpy as np

from blind.generator.mesh import Grid, data_mesh
from blind.generator.rigs import CASE_STARTS, CASE_TIMES, REST_TIMES, amplitude
from blind.generator.solver import Body, Physics, Run

#: Amplitudes of elastic solves: what a quadratic or cubic in the amplitude needs.
STATES = (0.25, 0.5, 0.75, 1.0)
EXTRA_STATE = 1.2

#: Modulus of all solves; without weight it scales forces alone.
YOUNG = 10.0

#: Seconds after a case's beginning at which a body with memory is solved: half of the frames' step where it moves.
STEPS = np.array([0.5, 1.0, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.5, 8.0, 8.5, 9.0, 9.5, 10.0, 10.5, 11.0])

_BODIES = {}


def body_of(rig, shifts=()):
    """Return the data's body of a rig; pads may be shifted: ((name, shift), ...)."""
    key = (rig.number, tuple((n, tuple(s)) for n, s in shifts))
    if key not in _BODIES:
        _BODIES.clear()
        moved = dict(shifts)
        spots = [(np.asarray(c) + np.asarray(moved.get(n, 0.0)), r) for n, (c, r) in rig.pads.items()]
        mesh, _ = data_mesh(rig.shape, Grid(7, 3, 3, turn=rig.turn, rim_edge=4.0, seed=rig.number), spots)
        body = Body(mesh)
        seen = body.interpolation(rig.places, on_skin=True)
        inner = body.interpolation(np.array(list(rig.targets.values())), on_skin=False)
        _BODIES[key] = (body, seen, inner)
    return _BODIES[key]


def solve(rig, settings, timed=False, only=None, extra=False):
    """Return arrays by name.

    Elastic: ``markers`` (n_cases, n_states, 60, 3), ``targets``, ``forces`` (n_cases, n_states, 3): displacements and
    forces at amplitudes ``states``, the first of which is 0. Timed: the same at frames; ``rest_markers``,
    ``rest_targets``.
    """
    begun = clock.time()
    physics = Physics(young=YOUNG, **({"poisson": rig.poisson} | settings))
    body, seen, inner = body_of(rig, tuple(physics.pad_shift.items()))
    run = Run(body, physics, rig.pads)
    record = {"markers": [], "targets": [], "forces": []}
    if timed:
        found = _timed(rig, run, seen, inner, record)
    else:
        names = [only] if only else list(rig.pads)
        states = (*STATES, EXTRA_STATE) if extra else STATES
        run.step(0.0)
        start = run.u
        for name in names:
            run.u = start
            run.bond(name)
            rows = [_seen(run, seen, inner)]
            for state in states:
                run.step(run.clock + 1.0, state * rig.strokes[name])
                rows.append(_seen(run, seen, inner))
            for key, values in zip(record, zip(*rows, strict=True), strict=True):
                record[key].append(np.array(values))
        found = {key: np.array(values) for key, values in record.items()}
        found["states"] = np.array([0.0, *states])
        found["cases"] = np.array(names)
    run.factor.free()
    found["seconds"] = np.array(clock.time() - begun)
    found["factorings"] = np.array(run.counts["factorings"])
    return found


def _seen(run, seen, inner):
    return seen @ run.u, inner @ run.u, run.pad_force() if run.pad else np.zeros(3)


def _timed(rig, run, seen, inner, record):
    run.step(0.0)
    rest = []
    for t in REST_TIMES:
        if t > 0:
            run.step(t)
        rest.append(_seen(run, seen, inner))
    for name, start in zip(rig.pads, CASE_STARTS, strict=True):
        run.bond(None)
        for t in (0.5 * (run.clock + start), start):
            run.step(t)
        run.bond(name)
        rows = [_seen(run, seen, inner)]
        for t in STEPS:
            run.step(start + t, amplitude(t) * rig.strokes[name])
            if t in CASE_TIMES:
                rows.append(_seen(run, seen, inner))
            elif t == 6.5:
                before = _seen(run, seen, inner)
            if t == 5.0:
                five = rows[-1]
            if t == 8.0:
                # Frames at 6 and 7 s lie between solved moments of the hold, where all is smooth and slow.
                eight = rows.pop()
                rows.append(tuple(a + (b - a) * 2 / 3 for a, b in zip(five, before, strict=True)))
                rows.append(tuple(a + (b - a) / 3 for a, b in zip(before, eight, strict=True)))
                rows.append(eight)
        for key, values in zip(record, zip(*rows, strict=True), strict=True):
            record[key].append(np.array(values))
    found = {key: np.array(values) for key, values in record.items()}
    found["rest_markers"] = np.array([r[0] for r in rest])
    found["rest_targets"] = np.array([r[1] for r in rest])
    found["cases"] = np.array(list(rig.pads))
    return found
