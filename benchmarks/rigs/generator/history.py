"""Solves one truth of a rig over its load cases: what markers, targets and force sensors would see without noise."""

from dataclasses import dataclass

import numpy as np

from rigs.generator.newton import Tangent, step
from rigs.generator.rigs import CASE_TIMES, REST_TIMES, SHARES
from rigs.generator.truth import Truth, motion_of


@dataclass
class Clean:
    """Noise-free readings in every frame, rest case first.

    `places` (t, 40, 3), `targets` (t, 2, 3): mm; `forces` (t, pads, 3): mN on the body, nan of absent pads;
    `times` (t,): s; `labels`: case of each frame.
    """

    places: np.ndarray
    targets: np.ndarray
    forces: np.ndarray
    times: np.ndarray
    labels: list


class Course:
    """All frames of one rig under one truth.

    `solver`: NgSolver or SkSolver; `reads`: matrices of markers and targets; `near`: states of the null by case and
    share, to begin from, each with its tangent.
    """

    def __init__(self, rig, solver, reads, near=None):
        self.rig, self.solver, self.reads = rig, solver, reads
        self.near = near or {}
        self.states = {}
        skeleton = solver.skeleton
        self.held = np.any([skeleton.patch(hold.inside) for hold in rig.holds], axis=0)
        self.pads = {pad.name: skeleton.patch(pad.inside) for pad in rig.pads}
        self.corners = skeleton.corners() if not skeleton.nodal else np.ones(len(skeleton.places), dtype=bool)

    def run(self, truth: Truth):
        """Return the clean readings under a truth."""
        self.truth = truth
        self.solver.start(truth)
        self.resting = Tangent()
        rest = self._rest(np.zeros_like(self.solver.skeleton.places), 1.0, REST_TIMES[-1])
        rows = [(time, "rest", self._read(rest, {})) for time in REST_TIMES]
        if truth.growth is not None:
            rows = []
            for time in REST_TIMES:
                rest = self._rest(rest, 1.0, time)
                rows.append((time, "rest", self._read(rest, {})))
        for load in self.rig.loads:
            self.solver.refresh(rest)
            rest = self._rest(rest, 8.0, load.start)
            rows += self._case(load, rest)
        times, labels, read = zip(*rows, strict=True)
        places, targets, forces = (np.array([r[k] for r in read]) for k in range(3))
        return Clean(places, targets, forces, np.array(times), list(labels))

    def tangents(self):
        """Return every state that was reached, with its tangent."""
        found = {}
        for load in self.rig.loads:
            free = self._free(load.strokes)
            for (name, share), u in self.states.items():
                if name == load.name:
                    tangent = Tangent()
                    tangent.renew(self.solver, u, free)
                    found[name, share] = (u, tangent)
        return found

    def _free(self, pads):
        support = self.truth.support or {}
        off = support.get("off")
        free = np.ones((len(self.held), 3), dtype=bool)
        held = self.held
        if off is not None:
            skeleton = self.solver.skeleton
            held = np.any([skeleton.patch(lambda p, h=h: h.inside(p) & ~off(p)) for h in self.rig.holds], axis=0)
        if "springs" in support and not support.get("limit"):
            free[held, self.rig.holds[0].axis] = False
        elif "springs" not in support:
            free[held] = False
        for name in pads:
            free[self.pads[name]] = False
        return free

    def _rest(self, u, seconds, time):
        """Return the state without pads."""
        truth = self.truth
        if truth.weight is None and truth.growth is None and not truth.memory.carried:
            return np.zeros_like(u)
        self.solver.set_time(seconds, time)
        return step(self.solver, u, self._free(()), np.zeros_like(u), self.resting)

    def _given(self, load, share, rest):
        """Return the prescribed state of patches at a share of the stroke."""
        given = np.zeros_like(rest)
        places = self.solver.skeleton.places
        for name, stroke in load.strokes.items():
            pad = next(p for p in self.rig.pads if p.name == name)
            on = self.pads[name]
            shift, matrix = motion_of(self.truth, pad, share, stroke)
            corner = (on & self.corners)[:, None]
            moved = places @ matrix.T + np.where(corner, shift - matrix @ pad.centre, 0.0)
            given[on] = rest[on] + moved[on]
        given[self.held] = 0.0
        return given

    def _case(self, load, rest):
        timed = self.truth.timed
        free, tangent = self._free(load.strokes), Tangent()
        rows, u, before, states = [], rest, 0.0, {}
        if timed:
            self.solver.refresh(rest)
        for time, share in zip(CASE_TIMES, SHARES, strict=True):
            if timed:
                # Two steps a second while the load moves.
                for part in np.linspace(before, time, max(1, round(2 * (time - before))) + 1)[1:] if time else (0.0,):
                    if part != time and (2.5 < time < 8.5 or time > 10.5):
                        continue
                    now = float(np.interp(part, CASE_TIMES, SHARES))
                    self.solver.set_time(max(part - self._last, 1e-6) if time else 1.0, load.start + part)
                    u = step(self.solver, u, free, self._given(load, now, rest), tangent)
                    if time:
                        self.solver.keep(u)
                    self._last = part
                before = time
                rows.append((load.start + time, load.name, self._read(u, load.strokes)))
                continue
            if share not in states:
                if share == 0.0 and self.truth.motion is None:
                    states[share] = rest
                else:
                    begin, known = self.near.get((load.name, float(share)), (u, tangent))
                    aim = self._given(load, share, rest)
                    states[share] = step(self.solver, begin, free, aim, known.copy())
                self.states[load.name, float(share)] = states[share]
            u = states[share]
            rows.append((load.start + time, load.name, self._read(u, load.strokes)))
        return rows

    def _read(self, u, strokes):
        """Return markers, targets and forces of a state."""
        places = self.solver.skeleton.places + u
        forces = np.full((len(self.rig.pads), 3), np.nan)
        if strokes:
            r = self.solver.residual(u)
            for k, pad in enumerate(self.rig.pads):
                if pad.name in strokes:
                    forces[k] = r[self.pads[pad.name] & self.corners].sum(axis=0)
        return self.reads[0] @ places, self.reads[1] @ places, forces
