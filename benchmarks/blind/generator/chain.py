"""Causes in actuators and tracker, put on stored fields: no solve of their own.

Each works on `Clean`: amplitudes first, places later. Sizes are continuous.
"""

from dataclasses import dataclass, field

import numpy as np


@dataclass
class Clean:
    """An experiment before noise: amplitudes (3, 12) of markers and of forces, later acts on places and forces."""

    amplitudes: np.ndarray
    force_amplitudes: np.ndarray
    acts: list = field(default_factory=list)
    cases: tuple = (0, 1, 2)
    force_acts: list = field(default_factory=list)


def rotation(vector_deg):
    """Return the rotation matrix of a vector in degrees."""
    vector = np.deg2rad(np.asarray(vector_deg, dtype=float))
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def frame(clean, rig, rng, size):
    """Another frame: rotation about the origin in degrees and shift in mm, each of length ``size`` (half for one)."""
    turn, shift = _unit(rng) * size * 0.7, _unit(rng) * size
    R = rotation(turn)
    clean.acts.append(lambda places, times: places @ R.T + shift)
    return {"rotation_deg": turn.tolist(), "shift_mm": shift.tolist()}


def scale(clean, rig, rng, size):
    """Lengths are off."""
    factor = 1 + size * rng.choice([-1, 1])
    clean.acts.append(lambda places, times: places * factor)
    return {"scale": factor, "origin_mm": [0.0, 0.0, 0.0]}


def latency(clean, rig, rng, size):
    """Markers are late."""
    from blind.generator.fields import case_amplitudes

    clean.amplitudes = case_amplitudes(size)
    return {"latency_s": size}


def marker_slip(clean, rig, rng, size):
    """One marker sits off its place from a time on."""
    index, offset, since = int(rng.integers(25)), _unit(rng) * size, float(rng.choice([13, 19, 31.5, 35, 41, 51, 53]))

    def act(places, times):
        out = places.copy()
        out[times >= since, index] += offset
        return out

    clean.acts.append(act)
    return {"marker": f"P{index + 1}", "offset_mm": offset.tolist(), "from_time_s": since}


def marker_creep(clean, rig, rng, size):
    """One marker creeps off its place within twelve seconds."""
    index, offset, since = int(rng.integers(25)), _unit(rng) * size, float(rng.choice([11, 14, 30, 33]))

    def act(places, times):
        out = places.copy()
        out[:, index] += np.clip((times - since) / 12.0, 0, 1)[:, None] * offset
        return out

    clean.acts.append(act)
    return {"marker": f"P{index + 1}", "offset_mm": offset.tolist(), "from_time_s": since, "form": "creeping"}


def marker_swap(clean, rig, rng, size):
    """Two markers are taken for each other from a time on."""
    one, other = (int(i) for i in rng.choice(25, 2, replace=False))
    since = float(rng.choice([12, 31, 36, 52]))

    def act(places, times):
        out, rows = places.copy(), times >= since
        out[rows, one], out[rows, other] = places[rows, other], places[rows, one]
        return out

    clean.acts.append(act)
    return {"markers": [f"P{one + 1}", f"P{other + 1}"], "from_time_s": since}


def actuator_gain(clean, rig, rng, size):
    """One actuator gives more or less than its command."""
    number, sign = int(rng.choice(clean.cases)), rng.choice([-1, 1])
    _gain(clean, number, lambda a: a * (1 + sign * size))
    return {"actuator": ("push_x", "push_y", "push_z")[number], "gain": 1 + sign * size}


def actuator_saturates(clean, rig, rng, size):
    """One actuator falls behind, more so at large strokes."""
    number = int(rng.choice(clean.cases))
    _gain(clean, number, lambda a: a * (1 - size * np.abs(a) ** 0.5))
    return {"actuator": ("push_x", "push_y", "push_z")[number], "gain": 1 - size, "form": "falls behind"}


def jam(clean, rig, rng, size):
    """Put an actuator off at one frame alone, by a share of its stroke."""
    number, step = int(rng.choice(clean.cases)), int(rng.integers(2, 9))
    for a in (clean.amplitudes, clean.force_amplitudes):
        a[number, step] -= size
    return {"actuator": number, "frame": step, "share": size}


def jitter(clean, rig, rng, size):
    """Let the tracker's clock jitter."""
    from blind.generator.rigs import CASE_TIMES, amplitude

    clean.amplitudes = np.stack([amplitude(CASE_TIMES + size * rng.normal(size=12)) for _ in range(3)])
    return {"seconds": size}


def cross_talk(clean, rig, rng, size):
    """Let a force sensor read a share of one axis on another, with a sign that depends on the axis."""
    a, b = rng.choice(3, 2, replace=False)

    def act(forces):
        out = forces.copy()
        out[:, a] += size * forces[:, b]
        return out

    clean.force_acts.append(act)
    return {"onto": int(a), "of": int(b), "share": size}


def _gain(clean, number, change):
    for name in ("amplitudes", "force_amplitudes"):
        values = getattr(clean, name).copy()
        values[number] = change(values[number])
        setattr(clean, name, values)


def _unit(rng):
    vector = rng.normal(size=3)
    return vector / np.linalg.norm(vector)


#: id -> list of (act, own form, smallest and largest size)
CAUSES = {
    "frame": [(frame, True, (0.05, 3.0))],
    "scale": [(scale, True, (2e-4, 0.02))],
    "latency": [(latency, True, (0.005, 0.6))],
    "marker_slip": [(marker_slip, True, (0.03, 4.0)), (marker_creep, False, (0.03, 4.0))],
    "marker_swap": [(marker_swap, True, (1.0, 1.0))],
    "actuator_gain": [(actuator_gain, True, (0.002, 0.15)), (actuator_saturates, False, (0.002, 0.15))],
}

#: The same, in no catalogue.
OUTSIDE = {
    "jam": [(jam, False, (0.01, 0.5))],
    "jitter": [(jitter, False, (0.01, 0.5))],
    "cross talk": [(cross_talk, False, (0.002, 0.15))],
}
