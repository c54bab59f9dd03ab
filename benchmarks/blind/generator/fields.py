"""Stored solves as frames: what 60 markers, the targets and the pads' forces would show without noise, at any size."""

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from blind.generator.jobs import Job, hidden
from blind.generator.rigs import CASE_STARTS, CASE_TIMES, REST_TIMES, amplitude, make_rig

N_REST = len(REST_TIMES)
N_CASE = len(CASE_TIMES)

#: The clock: rest frames, then three cases.
TIMES = np.concatenate([REST_TIMES, *(start + CASE_TIMES for start in CASE_STARTS)])

#: Effects with a threshold: not taken below their smaller size.
ABRUPT = ("friction", "clean", "soft rest", "wall")


class NotReadyError(Exception):
    """A solve that the experiment needs is not done yet."""


@dataclass
class Frames:
    """Displacements of markers (42, 60, 3) and targets (42, n, 3) in mm, forces (42, 3) in mN (zero at rest)."""

    markers: np.ndarray
    targets: np.ndarray
    forces: np.ndarray

    def __add__(self, other):
        return Frames(*(getattr(self, k) + getattr(other, k) for k in ("markers", "targets", "forces")))

    def __mul__(self, share):
        return Frames(self.markers * share, self.targets * share, self.forces * share)

    def __sub__(self, other):
        return self + other * -1.0


def case_amplitudes(late=0.0):
    """Return the amplitudes (3, 12) of all frames, seen late by some seconds."""
    return np.tile(amplitude(CASE_TIMES - late), (3, 1))


@lru_cache(maxsize=64)
def stored(job):
    """Return the arrays of a job, or None if it is not done."""
    if not job.path.exists():
        return None
    with np.load(job.path) as file:
        return {key: file[key].astype(float) if file[key].dtype == np.float32 else file[key] for key in file.files}


def null_frames(rig, amplitudes=None):
    """Return the frames of a rig with nothing hidden."""
    if stored(Job(rig)) is None:
        raise NotReadyError
    return _elastic(stored(Job(rig)), case_amplitudes() if amplitudes is None else amplitudes, None)


def _elastic(found, amplitudes, below):
    """Return frames of an elastic solve; cases that it leaves out are those of ``below``."""
    states, names = found["states"], [str(c) for c in found["cases"]]
    parts = {}
    for key in ("markers", "targets", "forces"):
        values = found[key]
        rest = np.zeros((N_REST, *values.shape[2:]))
        if key != "forces":
            rest += values[0, 0]
        rows = [rest]
        for number, case in enumerate(("push_x", "push_y", "push_z")):
            if case in names:
                weights = _lagrange(states, amplitudes[number])
                rows.append(np.tensordot(weights, values[names.index(case)], axes=1))
            else:
                rows.append(getattr(below, key)[_rows(number)])
        parts[key] = np.concatenate(rows)
    return Frames(**parts)


def _rows(case):
    return slice(N_REST + N_CASE * case, N_REST + N_CASE * (case + 1))


def _lagrange(states, at):
    weights = np.ones((len(at), len(states)))
    for i, own in enumerate(states):
        for j, other in enumerate(states):
            if i != j:
                weights[:, i] *= (at - other) / (own - other)
    return weights


def _timed(found):
    parts = {}
    for key in ("markers", "targets", "forces"):
        rest = found.get(f"rest_{key}", np.zeros((N_REST, 3)))
        parts[key] = np.concatenate([rest, *found[key]])
    return Frames(**parts)


def differences(rig, group, index, amplitudes=None):
    """Return what a hidden effect changes at each of its sizes, a list of frames, or None if not all are done."""
    effect = hidden(group)[index]
    jobs = [Job(rig, group, index, size) for size in range(len(effect.sizes))]
    found = [stored(job) for job in (Job(rig), *jobs)]
    if any(f is None for f in found):
        return None
    if effect.timed:
        below = null_frames(rig)
        return [_timed(f) - below for f in found[1:]]
    amplitudes = case_amplitudes() if amplitudes is None else amplitudes
    below = null_frames(rig, amplitudes)
    return [_elastic(f, amplitudes, below) - below for f in found[1:]]


def sizes_range(effect):
    """Return the smallest and largest size at which an effect may be taken."""
    low, high = effect.sizes[0], effect.sizes[-1]
    return (low if effect.variant in ABRUPT or effect.id == "wall" or len(effect.sizes) == 1 else 0.12 * low, high)


def at_size(effect, changes, size):
    """Return the change at a size: a parabola through nothing at 0 and the two solves."""
    if len(effect.sizes) == 1:
        return changes[0]
    s1, s2 = effect.sizes
    return changes[0] * (size * (s2 - size) / (s1 * (s2 - s1))) + changes[1] * (size * (size - s1) / (s2 * (s2 - s1)))


@lru_cache(maxsize=32)
def rig_of(number):
    """Return a rig."""
    return make_rig(number)


def shown(frames, places, targets):
    """Return the frames with places (not displacements) of markers and targets."""
    return replace(frames, markers=frames.markers + places, targets=frames.targets + targets)
