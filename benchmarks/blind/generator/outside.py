"""Effects that are in no catalogue. Part of the sealed answers: whoever tunes a diagnoser does not read on."""

from dataclasses import dataclass

import numpy as np

from blind.generator.effects import Effect
from blind.generator.memory import Memory


def _gradient(rig, rng, size):
    direction = rng.normal(size=3) * [1, 1, 0.4]
    direction /= np.linalg.norm(direction) * 50.0

    def factor(points):
        return np.exp(size * (points @ direction))

    return {"contrast": factor}, {"log_change_over_50_mm": size}


def _rocking(rig, rng, size):
    axis = rng.normal(size=3)
    name = "push_x"
    axis -= axis @ rig.strokes[name] * rig.strokes[name] / (rig.strokes[name] @ rig.strokes[name])
    axis /= np.linalg.norm(axis)
    centre, full = np.asarray(rig.pads[name][0]), np.linalg.norm(rig.strokes[name])

    def motion(pad, points, stroke, time):
        angle = np.deg2rad(size) * np.linalg.norm(stroke) / full
        return stroke + angle * np.cross(axis, points - centre)

    return {"pad_motion": motion}, {"rocking_deg": size, "actuator": name}


def _wall(rig, rng, size):
    """Put a rigid wall near the body that it touches when it bulges; ``size``: how near, mm less than 1.2."""
    direction = -np.asarray(rig.strokes["push_x"])
    direction = direction / np.linalg.norm(direction)
    turned = np.array([-direction[1], direction[0], 0.0])
    reach = rig.shape.on_surface(np.array([turned]))[0] @ turned + 1.2 - size

    def touch(points, u, normal):
        gap = reach - (points + u) @ turned
        on = gap < 0
        traction = np.where(on, 120.0 * gap, 0.0)[..., None] * turned
        return traction, np.where(on, 120.0, 0.0)[..., None, None] * np.outer(turned, turned)

    return {"touch": touch}, {"nearer_mm": size}


def _thread(rig, rng, size):
    a = rig.shape.on_surface(np.array([[0.7, 0.4, 0.6]]))[0] * 0.9
    b = rig.shape.on_surface(np.array([[-0.3, 0.7, 0.6]]))[0] * 0.9
    return {"threads": [(a, b, size)]}, {"mN_per_mm": size}


def _peeling(rig, rng, size):
    def hold(name, distance, stroke):
        rim = 1.0 - size * min(stroke / 7.0, 1.2)
        return (distance < rim).astype(float)

    return {"pad_hold": hold}, {"share_of_radius": size}


def _creeping_base(rig, rng, size):
    direction = rng.normal(size=3) * [1, 1, 0.3]
    bend = direction / np.linalg.norm(direction)

    def motion(points, time):
        # The floor tilts and warps: one half goes, the other stays.
        share = np.clip(0.5 + points[:, 0] / 60.0, 0, 1)[:, None]
        return size * (time / 62.0) * share * bend

    return {"base_motion": motion, "memory": Memory(growth=lambda t: 0.0)}, {"creep_mm": size}


def _half_swelling(rig, rng, size):
    from blind.generator.solve import body_of

    body, *_ = body_of(rig)
    side = (body.points @ np.array([0.8, 0.6, 0.0]) > 0).astype(float)
    return ({"memory": Memory(growth=lambda t: size * side * np.clip(t / 62.0, 0, 1))}, {"linear_strain": size})


def _ratio_gradient(rig, rng, size):
    """Stiff columns: a wave of stiffness through the body."""
    wave = rng.normal(size=3)
    wave *= 2 * np.pi / 40.0 / np.linalg.norm(wave)
    return {"contrast": lambda points: np.exp(size * np.sin(points @ wave))}, {"log_amplitude": size}


SOLVED = (
    Effect("gradient", "", False, (0.3, 1.0), _gradient),
    Effect("rocking pad", "", False, (3.0, 10.0), _rocking, only="push_x"),
    Effect("wall", "", False, (0.9, 1.6), _wall),
    Effect("creeping base", "", False, (0.15, 0.6), _creeping_base, True),
    Effect("peeling pad", "", False, (0.1, 0.35), _peeling),
    Effect("half swelling", "", False, (0.002, 0.008), _half_swelling, True),
    Effect("stiffness wave", "", False, (0.4, 1.2), _ratio_gradient),
    Effect("thread", "", False, (1.0, 3.0), _thread),
)


@dataclass(frozen=True)
class Chain:
    """An effect of the measuring chain: (places (n_frames, 25, 3), times, case starts, rng, size) -> places."""

    id: str
    act: object
    sizes: tuple


def _lens(places, times, starts, rng, size):
    centre = places.mean(axis=(0, 1)) + rng.normal(size=3) * 4
    off = places - centre
    return places + size * off * ((off**2).sum(axis=-1, keepdims=True) / 50.0**2)


def _stale(places, times, starts, rng, size):
    """Frames come twice: the tracker repeats what it saw a frame before, in a share of the moving frames."""
    out = places.copy()
    moving = [i for i, t in enumerate(times) if any(1 <= t - s <= 2 or 9 <= t - s <= 10 for s in starts)]
    for i in rng.choice(moving, size=max(1, round(size * len(moving))), replace=False):
        out[i] = places[i - 1]
    return out


def _bursts(places, times, starts, rng, size):
    out = places.copy()
    for _ in range(3):
        first = rng.integers(6, len(times) - 4)
        wave = rng.normal(size=3)
        field = np.sin(places[0] @ (wave / 25.0))[:, None] * rng.normal(size=3)
        out[first : first + 3] += size * field
    return out


def _shimmer(places, times, starts, rng, size):
    """One side of the view breathes with a period of 7 s."""
    side = places[0] @ (rng.normal(size=3) / 40.0)
    return places + size * np.sin(2 * np.pi * times / 7.0)[:, None, None] * np.clip(side, 0, None)[
        None, :, None
    ] * rng.normal(size=3)


def _twice_noise(places, times, starts, rng, size):
    out = places.copy()
    out[:, rng.integers(places.shape[1])] += size * rng.normal(size=(len(times), 3))
    return out


def _bowed(places, times, starts, rng, size):
    """Two cameras disagree: depth is read wrong by the square of height."""
    out = places.copy()
    off = places - places.mean(axis=(0, 1))
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    return out + size * (off[..., 2:] / 25.0) ** 2 * axis


CHAIN = (
    Chain("lens", _lens, (0.001, 0.02)),
    Chain("stale frames", _stale, (0.15, 0.9)),
    Chain("noise bursts", _bursts, (0.02, 0.5)),
    Chain("shimmer", _shimmer, (0.02, 0.4)),
    Chain("one noisy marker", _twice_noise, (0.05, 0.4)),
    Chain("bowed view", _bowed, (0.03, 0.6)),
)
