"""Hidden effects of the catalogue: how each changes the truth, at a size, and the parameters for the answers.

A builder takes (bench, rng, size) and returns settings of Truth and parameters. What it draws must not depend on the
size, which is found afterwards. Sizes are one of which the effect is about 25 noise deviations long, and the largest.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from rigs.generator.truth import Memory

#: mN/mm^3 of 1 g/cm^3 under 9810 mm/s^2.
WEIGHT = 9.81e-3


@dataclass(frozen=True)
class Effect:
    """One way to hide a cause.

    `id`: of the catalogue, or the name of one outside it; `form`: which one; `sizes`: of about 25 noise deviations,
    and the largest; `codes`: solvers that have it; `forces`: whether they must be measured; `plain`: whether the
    believed law must be neo-Hookean; `own`: whether the catalogue has the same form; `holds`: `one` where it needs one
    support; `power`: of the size, with which the effect grows.
    """

    id: str
    form: str
    sizes: tuple
    build: Callable
    codes: tuple = ("ngsolve", "scikit-fem")
    forces: bool = False
    plain: bool = False
    own: bool = False
    holds: tuple = ()
    power: float = 1.0


NG = ("ngsolve",)


def unit(rng, bias=(1.0, 1.0, 1.0)):
    """Return a random direction."""
    v = rng.normal(size=3) * bias
    return v / np.linalg.norm(v)


def _stiffness(bench, rng, size):
    sign = 1 if rng.uniform() < 0.6 else -1
    relative = bench.rig.young[1] / bench.rig.young[0]
    factor = max(1 + sign * size * relative, 0.35) if sign > 0 else 1 / (1 + size * relative)
    return {"young": factor}, {"young_kpa": bench.rig.young[0] * factor}


def _poisson(bench, rng, size):
    nu = bench.rig.poisson
    nu = nu - size if nu > 0.43 or rng.uniform() < 0.5 else min(nu + 0.7 * size, 0.492)
    return {"poisson": nu}, {"poisson": nu}


def _law(name, key, **rest):
    def build(bench, rng, size):
        return {"law": (name, {key: size, **rest})}, {"form": name, key: size, **rest}

    return build


def _fibre(cubic):
    def build(bench, rng, size):
        direction = unit(rng)
        law = ("fibres", {"k": size, "cubic": cubic, "direction": direction.tolist()})
        return {"law": law}, {"k1_over_mu": size, "cubic": cubic, "direction": direction.tolist()}

    return build


def deep_point(bench, rng, low=0.35, high=0.75):
    """Return a point inside the body, within reach of a pad."""
    skeleton, rig = bench.solver.skeleton, bench.rig
    inner = skeleton.places[skeleton.tets[:, :4]].mean(axis=1)
    depth = skeleton.depth(rig)(inner)
    pad = rig.pads[int(rng.integers(len(rig.pads)))]
    away = np.linalg.norm(inner - pad.centre, axis=1)
    most = depth.max()
    # Elements are small beside pads: a cell of a coarse grid counts once.
    near = np.flatnonzero((depth > low * most) & (away < 1.6 * pad.reach + 0.25 * rig.body.size))
    if not len(near):
        near = np.flatnonzero(depth > low * most)
    _, first = np.unique(np.round(inner[near] / 4.0), axis=0, return_index=True)
    at = near[int(rng.choice(first))]
    return np.round(inner[at], 2), float(depth[at])


def blurred(distance, width):
    """Return 1 inside and 0 outside, with a ramp."""
    return np.clip(0.5 + distance / width, 0.0, 1.0)


def _inclusion(shape, sign=1.0, most=0.85):
    def build(bench, rng, size):
        centre, depth = deep_point(bench, rng)
        radius = float(np.clip(0.13 * bench.rig.body.size * rng.uniform(0.8, 1.2), 5.0, max(most * depth, 5.0)))
        axes, turn = np.ones(3), np.eye(3)
        if shape == "ellipsoid":
            axes, turn = rng.permutation([0.75, 1.0, 1.4]), Rotation.random(random_state=rng).as_matrix()
        contrast = 1.0 + size if sign > 0 else 1.0 / (1.0 + size)

        def factor(points):
            off = np.linalg.norm(((points - centre) @ turn) / (radius * axes), axis=-1)
            return 1.0 + (contrast - 1.0) * blurred((1 - off) * radius, 1.5)

        parameters = {"centre_mm": centre.tolist(), "semi_axes_mm": (radius * axes).tolist(), "contrast": contrast}
        return {"contrast": factor}, parameters

    return build


def _layer(graded, sign=1.0):
    def build(bench, rng, size):
        thickness = float(rng.uniform(0.06, 0.11) * bench.rig.body.size)
        depth = bench.solver.skeleton.depth(bench.rig)
        contrast = 1.0 + size if sign > 0 else 1.0 / (1.0 + size)

        def factor(points):
            deep = depth(points)
            share = np.exp(-((deep / thickness) ** 2)) if graded else blurred(thickness - deep, 1.5)
            return 1.0 + (contrast - 1.0) * share

        return {"contrast": factor}, {"thickness_mm": thickness, "contrast": contrast, "graded": graded}

    return build


def _relaxation(times):
    def build(bench, rng, size):
        shares = size * rng.dirichlet(4 * np.ones(len(times)))
        terms = tuple((float(g), t * float(rng.uniform(0.7, 1.4))) for g, t in zip(shares, times, strict=True))
        return {"memory": Memory(relaxing=terms)}, {"g": [g for g, _ in terms], "tau_s": [t for _, t in terms]}

    return build


def _rate(bench, rng, size):
    viscosity = size * bench.rig.young[0]
    return {"memory": Memory(viscosity=viscosity)}, {"viscosity_kpa_s": viscosity}


def _softening(unloading):
    def build(bench, rng, size):
        m = float(0.004 * bench.rig.young[0] * rng.uniform(0.6, 1.6))
        return {"memory": Memory(damage=(size, m, unloading))}, {"share": size, "m_kpa": m, "unloading": unloading}

    return build


def _set(bench, rng, size):
    return {"memory": Memory(kept=(size, None))}, {"fraction": size}


def _swelling(form):
    def build(bench, rng, size):
        sign = 1.0 if rng.uniform() < 0.6 else -1.0
        start, tau = float(rng.uniform(0, 15)), float(rng.uniform(15, 40))

        def growth(time, points):
            passed = max(time - start, 0.0)
            share = min(passed / 50.0, 1.0) if form == "linear" else 1 - np.exp(-passed / tau)
            return np.full(len(points), sign * size * share)

        return {"growth": growth}, {"linear_strain": sign * size, "from_time_s": start, "form": form}

    return build


def _drainage(times):
    def build(bench, rng, size):
        terms = tuple((size / len(times), t * float(rng.uniform(0.7, 1.4))) for t in times)
        return {"memory": Memory(draining=terms)}, {"share": size, "tau_s": [t for _, t in terms]}

    return build


def _gravity(bench, rng, size):
    down = unit(rng, (0.3, 0.3, 0.0)) * rng.uniform(0.0, 0.5) - [0, 0, 1.0]
    down /= np.linalg.norm(down)
    # Weight over modulus: a soft body sags more.
    g = size * bench.rig.young[0] / 10.0
    return {"weight": g * WEIGHT * down}, {"direction": down.tolist(), "g_mm_per_s2": 9810.0 * g}


def _springs(bench, rng, size):
    stiff = bench.rig.young[0] / (size * bench.rig.body.size)
    return {"support": {"springs": stiff}}, {"boundary": bench.rig.holds[0].name, "spring_kpa_per_mm": stiff}


def _detachment(bench, rng, size):
    rig, skeleton = bench.rig, bench.solver.skeleton
    hold = rig.holds[int(rng.integers(len(rig.holds)))]
    middles = skeleton.face_middles
    mine = middles[hold.inside(middles)]
    others = np.delete(np.arange(3), hold.axis)
    # The rim of the support on the side of a pad, or across.
    pad = rig.pads[int(rng.integers(len(rig.pads)))]
    way = (pad.centre - mine.mean(axis=0))[others]
    way = way / max(np.linalg.norm(way), 1e-9)
    turn = rng.uniform(-0.6, 0.6)
    way = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]) @ way
    centre = mine[np.argmax((mine - mine.mean(axis=0))[:, others] @ way)]
    radius = size * rig.body.size

    def off(points):
        return np.linalg.norm(points - centre, axis=-1) < radius

    answer = {"boundary": hold.name, "centre_mm": np.round(centre, 2).tolist(), "radius_mm": radius}
    return {"support": {"off": off}}, answer


def _some_pad(bench, rng):
    return bench.rig.pads[int(rng.integers(len(bench.rig.pads)))]


def _gain(bench, rng, size):
    pad = _some_pad(bench, rng)
    more = rng.uniform() < 0.5 or bench.rig.name.startswith("box")
    gain = 1.0 + size * (1 if more else -1)

    def motion(which, share, stroke):
        return (gain if which.name == pad.name else 1.0) * share * stroke, np.zeros((3, 3))

    return {"motion": motion}, {"actuator": pad.name, "gain": gain}


def _direction(bench, rng, size):
    pad = _some_pad(bench, rng)
    stroke = next(load.strokes[pad.name] for load in bench.rig.loads if pad.name in load.strokes)
    axis = np.cross(stroke, unit(rng))
    axis /= np.linalg.norm(axis)
    turn = Rotation.from_rotvec(np.deg2rad(size) * axis).as_matrix()

    def motion(which, share, stroke):
        return share * (turn @ stroke if which.name == pad.name else stroke), np.zeros((3, 3))

    return {"motion": motion}, {"actuator": pad.name, "rotation_deg": (size * axis).tolist()}


def _offset(bench, rng, size):
    pad = _some_pad(bench, rng)
    offset = size * unit(rng)

    def motion(which, share, stroke):
        return share * stroke + (offset if which.name == pad.name else 0.0), np.zeros((3, 3))

    return {"motion": motion}, {"actuator": pad.name, "offset_mm": offset.tolist()}


CATALOGUE = (
    Effect("stiffness", "", (4.0, 8.0), _stiffness, forces=True, own=True),
    Effect("poisson", "", (0.035, 0.09), _poisson, own=True),
    Effect("stiffening", "unsplit exponential", (0.3, 6.0), _law("exponential", "b"), plain=True),
    Effect("mooney", "unsplit", (0.35, 0.9), _law("second", "share"), NG, plain=True),
    Effect("asymmetry", "inverse stretches", (0.12, 1.0), _law("inverse", "share"), NG, plain=True),
    Effect("fibre", "square", (0.2, 2.0), _fibre(0.0), NG, plain=True),
    Effect("fibre", "cubic", (0.15, 2.0), _fibre(3.0), NG, plain=True),
    Effect("inclusion", "stiff ball", (1.0, 8.0), _inclusion("ball"), own=True),
    Effect("inclusion", "stiff turned ellipsoid", (1.0, 8.0), _inclusion("ellipsoid")),
    Effect("inclusion", "soft ball", (1.5, 8.0), _inclusion("ball", -1.0), own=True),
    Effect("layer", "sharp", (0.2, 4.0), _layer(False), own=True),
    Effect("layer", "graded", (0.2, 4.0), _layer(True)),
    Effect("layer", "soft", (0.25, 3.0), _layer(False, -1.0), own=True),
    Effect("relaxation", "two times", (0.05, 0.6), _relaxation((1.5, 6.0)), NG),
    Effect("relaxation", "one time", (0.04, 0.6), _relaxation((2.5,)), NG, own=True),
    Effect("rate", "linear", (0.05, 0.5), _rate, NG, own=True),
    Effect("softening", "first load too", (0.12, 0.7), _softening(False), NG),
    Effect("softening", "unloading", (0.1, 0.7), _softening(True), NG),
    Effect("set", "back stress", (0.06, 0.5), _set, NG),
    Effect("swelling", "linear", (0.003, 0.02), _swelling("linear"), NG, own=True),
    Effect("swelling", "saturating", (0.003, 0.02), _swelling("saturating"), NG),
    Effect("drainage", "two times", (0.3, 0.9), _drainage((1.5, 6.0)), NG),
    Effect("gravity", "", (0.08, 0.4), _gravity, own=True),
    Effect("reference", "", (0.08, 0.4), _gravity, own=True),
    Effect("sliding", "springs", (0.02, 0.2), _springs, own=True, holds=("one",)),
    Effect("detachment", "rim", (0.22, 0.6), _detachment, own=True, power=3.0),
    Effect("actuator_gain", "", (0.08, 0.3), _gain, own=True),
    Effect("actuator_direction", "", (6.0, 25.0), _direction, own=True),
    Effect("actuator_offset", "constant", (0.4, 2.5), _offset, own=True),
)
