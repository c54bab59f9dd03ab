"""Hidden effects that need a solve of their own: physics of the data at a size, and parameters for the answer sheet.

Each entry: id, variant, whether the fit owns the form, two sizes, and a builder (rig, rng, size) -> (Physics settings,
parameters). Draws must not depend on the size: the two sizes are the same effect, smaller and larger.
"""

from dataclasses import dataclass

import numpy as np

from blind.generator.base import Detached, Friction, Springs
from blind.generator.laws import Law
from blind.generator.memory import Memory

#: mN/mm^3 of 1 g/cm^3 under 9810 mm/s^2.
WEIGHT = 9.81e-3


@dataclass
class Effect:
    """One way to hide a cause; ``only`` is the case that alone is changed."""

    id: str
    variant: str
    own_form: bool
    sizes: tuple
    build: object
    timed: bool = False
    only: str | None = None


def _poisson(sign):
    def build(rig, rng, size):
        nu = rig.poisson + sign * size
        return {"poisson": nu}, {"poisson": nu}

    return build


def _law(name, key, id_law, **rest):
    def build(rig, rng, size):
        return {"law": Law(name, {key: size, **rest})}, {"law": id_law, key: size, "form": name}

    return build


def _ogden(rig, rng, size):
    return {"law": Law("ogden", {"alpha": 2.0 - size})}, {"law": "ogden", "alpha": [2.0 - size], "form": "unsplit"}


def _fibre(dispersion, tension_only=True):
    def build(rig, rng, size):
        angle, rise = rng.uniform(0, np.pi), rng.uniform(-0.4, 0.4)
        a = [np.cos(angle) * np.cos(rise), np.sin(angle) * np.cos(rise), np.sin(rise)]
        shape = {"k1": size, "k2": 1.5, "dispersion": dispersion, "tension_only": tension_only}
        return {"law": Law("fibre", shape, tuple(a))}, {
            "k1_over_mu": size,
            "k2": 1.5,
            "direction": a,
            "tension_only": tension_only,
            "dispersion": dispersion,
        }

    return build


def _between(rig, rng):
    """Return a centre between a pad and the middle, in reach of markers."""
    name = rng.choice(list(rig.pads))
    centre, _ = rig.pads[name]
    along = rng.normal(size=3) * 9.0
    point = np.asarray(centre) * rng.uniform(0.6, 0.72) + along * [1, 1, 0.5]
    point[2] = max(point[2], 11.0)
    return np.round(point, 2)


def _inclusion(shape, sign=1.0):
    def build(rig, rng, size):
        centre = _between(rig, rng)
        radius = rng.uniform(7.0, 10.0)
        axes = radius * np.ones(3) if shape == "ball" else radius * rng.permutation([0.7, 1.0, 1.45])
        contrast = 1.0 + sign * size

        def factor(points):
            off = np.linalg.norm((points - centre) / axes, axis=-1)
            inside = np.clip(0.5 + (1 - off) * radius / 2.5, 0.0, 1.0)
            return 1.0 + (contrast - 1.0) * inside

        return {"contrast": factor}, {"centre_mm": centre.tolist(), "semi_axes_mm": axes.tolist(), "contrast": contrast}

    return build


def _layer(graded):
    def build(rig, rng, size):
        thickness = rng.uniform(4.0, 8.0)

        def factor(points):
            depth = rig.shape.depth(points)
            if graded:
                return 1.0 + size * np.exp(-((depth / thickness) ** 2))
            return 1.0 + size * np.clip(0.5 + (thickness - depth) / 2.5, 0.0, 1.0)

        return {"contrast": factor}, {"thickness_mm": thickness, "contrast": 1.0 + size, "graded": graded}

    return build


def _relaxation(times, shares):
    def build(rig, rng, size):
        terms = tuple((size * s, t) for s, t in zip(shares, times, strict=True))
        return {"memory": Memory(relaxing=terms)}, {"g": [g for g, _ in terms], "tau_s": list(times), "part": "whole"}

    return build


def _rate(power):
    def build(rig, rng, size):
        return {"memory": Memory(viscosity=size, rate_power=power)}, {"viscosity_kpa_s": size, "power": power}

    return build


def _softening(kind):
    def build(rig, rng, size):
        if kind == "simo":
            return {"memory": Memory(softening=("simo", size, 0.15))}, {"share": size, "m_kpa": 0.15, "form": "simo"}
        return (
            {"memory": Memory(softening=("ogden-roxburgh", 1 / size, 0.1, 0.1))},
            {"r": 1 / size, "m_kpa": 0.1, "beta": 0.1},
        )

    return build


def _set(rig, rng, size):
    return {"memory": Memory(set_share=size)}, {"fraction": size}


def _gravity(rig, rng, size):
    tilt = rng.normal(size=3) * [0.25, 0.25, 0.0] - [0, 0, 1.0]
    down = tilt / np.linalg.norm(tilt)
    return (
        {"weight": tuple(size * WEIGHT * down)},
        {"direction": down.tolist(), "g_mm_per_s2": 9810.0 * size, "in_reference": False},
    )


def _sliding(kind):
    def build(rig, rng, size):
        if kind == "springs":
            return {"base": Springs(1.0 / size)}, {"boundary": "base", "spring_kpa_per_mm": 1.0 / size}
        return ({"base": Friction(1.0 - size, 1.5)}, {"boundary": "base", "friction": 1.0 - size, "preload_kpa": 1.5})

    return build


def _detachment(soft):
    def build(rig, rng, size):
        name = rng.choice(["push_x", "push_y"])
        towards = np.asarray(rig.pads[name][0]) * [1, 1, 0]
        turn = rng.uniform(-0.5, 0.5) + (np.pi if rng.uniform() < 0.4 else 0.0)
        c, s = np.cos(turn), np.sin(turn)
        direction = np.array([c * towards[0] - s * towards[1], s * towards[0] + c * towards[1], 0.0])
        centre = rig.shape.on_surface(direction)

        def part(points):
            return np.linalg.norm(points - centre, axis=-1) < size

        return (
            {"base": Detached(part, soft)},
            {"boundary": "base", "centre_mm": centre.tolist(), "radius_mm": size, "soft_kpa_per_mm": soft},
        )

    return build


def _direction(name):
    def build(rig, rng, size):
        axis = np.cross(rig.strokes[name], rng.normal(size=3))
        axis /= np.linalg.norm(axis)
        angle = np.deg2rad(size)

        def motion(pad, points, stroke, time):
            across = np.cross(axis, stroke)
            return np.cos(angle) * np.asarray(stroke) + np.sin(angle) * across

        return {"pad_motion": motion}, {"actuator": name, "rotation_deg": (size * axis).tolist()}

    return build


def _shift(name):
    def build(rig, rng, size):
        centre = np.asarray(rig.pads[name][0])
        side = np.cross(centre, rng.normal(size=3))
        side *= size / np.linalg.norm(side)
        shift = rig.shape.on_surface(centre + side) - centre
        return {"pad_shift": {name: shift}}, {"actuator": name, "shift_mm": shift.tolist()}

    return build


def _swelling(kind):
    def build(rig, rng, size):
        if kind == "linear":

            def growth(t):
                return size * np.clip(t / 62.0, 0, 1)
        else:

            def growth(t):
                return size * (1 - np.exp(-t / 18.0))

        return (
            {"memory": Memory(growth=growth)},
            {"linear_strain": size, "from_time_s": 0.0, "to_time_s": 62.0, "form": kind},
        )

    return build


def _drainage(times, shares):
    def build(rig, rng, size):
        terms = tuple((size * s, t) for s, t in zip(shares, times, strict=True))
        return {"memory": Memory(draining=terms)}, {"share": size, "tau_s": list(times)}

    return build


CATALOGUE = (
    Effect("inclusion", "ball", True, (1.0, 4.0), _inclusion("ball")),
    Effect("inclusion", "ellipsoid", False, (1.0, 4.0), _inclusion("ellipsoid")),
    Effect("stiffening", "fung", False, (1.0, 4.0), _law("fung", "b", "fung")),
    Effect("poisson", "lower", True, (0.03, 0.09), _poisson(-1.0)),
    Effect("poisson", "higher", True, (0.008, 0.02), _poisson(1.0)),
    Effect("layer", "sharp", True, (0.5, 2.0), _layer(False)),
    Effect("layer", "graded", False, (0.5, 2.0), _layer(True)),
    Effect("sliding", "springs", True, (0.05, 0.4), _sliding("springs")),
    Effect("sliding", "friction", False, (0.4, 0.75), _sliding("friction"), True),
    Effect("relaxation", "one", True, (0.12, 0.4), _relaxation((1.5,), (1.0,)), True),
    Effect("relaxation", "three", False, (0.12, 0.45), _relaxation((0.4, 2.0, 9.0), (0.3, 0.4, 0.3)), True),
    Effect("fibre", "one family", True, (0.15, 0.6), _fibre(0.0)),
    Effect("fibre", "dispersed", False, (0.2, 0.8), _fibre(0.12)),
    Effect("detachment", "clean", True, (14.0, 26.0), _detachment(0.0)),
    Effect("detachment", "soft rest", False, (14.0, 26.0), _detachment(0.15)),
    Effect("gravity", "weight", True, (0.05, 0.2), _gravity),
    Effect("actuator_direction", "push_x", True, (2.0, 8.0), _direction("push_x"), only="push_x"),
    Effect("actuator_direction", "push_z", True, (2.0, 8.0), _direction("push_z"), only="push_z"),
    Effect("actuator_offset", "push_y", True, (0.8, 3.0), _shift("push_y"), only="push_y"),
    Effect("asymmetry", "one-sided", False, (0.3, 1.2), _law("one_sided", "extra", "ogden")),
    Effect("asymmetry", "ogden", False, (3.0, 10.0), _ogden),
    Effect("mooney", "unsplit", False, (0.3, 0.9), _law("mooney", "share", "mooney-rivlin")),
    Effect("set", "share", True, (0.05, 0.2), _set, True),
    Effect("softening", "simo", False, (0.15, 0.5), _softening("simo"), True),
    Effect("softening", "ogden-roxburgh", True, (0.25, 0.7), _softening("ogden-roxburgh"), True),
    Effect("rate", "power", False, (0.3, 1.5), _rate(0.6), True),
    Effect("rate", "linear", True, (0.3, 1.5), _rate(1.0), True),
    Effect("swelling", "exponential", False, (0.001, 0.005), _swelling("exponential"), True),
    Effect("swelling", "linear", True, (0.001, 0.005), _swelling("linear"), True),
    Effect("drainage", "two times", False, (0.2, 0.7), _drainage((0.8, 5.0), (0.5, 0.5)), True),
    Effect("drainage", "one time", True, (0.2, 0.7), _drainage((2.5,), (1.0,)), True),
    Effect("stiffening", "veronda", True, (1.0, 3.0), _law("veronda_split", "b", "veronda-westmann")),
)
