"""Hidden effects that no catalogue holds. Part of the sealed answers: whoever tunes a diagnoser does not read on."""

import numpy as np
from scipy.spatial.transform import Rotation

from rigs.generator.effects import NG, Effect, blurred, deep_point, unit
from rigs.generator.truth import Memory


def _wall(bench, rng, size):
    """Put a stiff wall before a part of the free skin that bulges towards it."""
    places, normals, moved = bench.bulge()
    # The wall is a plane: the rest of the body must lie behind it.
    behind = np.array([((places - p) @ n).max() < 1.0 for p, n in zip(places, normals, strict=True)])
    speed = np.where(behind, (moved * normals).sum(axis=1), -1.0)
    at = int(np.argmax(speed))
    normal = normals[at]
    place = float(places[at] @ normal + (1.0 - size) * speed[at])
    return {"wall": (normal, place, 3.0 * bench.rig.young[0])}, {"normal": normal.tolist(), "share_of_bulge": size}


def _thread(bench, rng, size):
    point, _ = deep_point(bench, rng, 0.4)
    radius = 0.05 * bench.rig.body.size

    def near(points):
        return np.exp(-(((points - point) / radius) ** 2).sum(axis=-1))

    stiff = size * bench.rig.young[0] / bench.rig.body.size
    return {"thread": (near, stiff)}, {"point_mm": point.tolist(), "kpa_per_mm": stiff}


def _gradient(bench, rng, size):
    rig = bench.rig
    middle, way = (rig.body.low + rig.body.high) / 2, unit(rng) / rig.body.size
    return {"contrast": lambda p: np.exp(size * (p - middle) @ way)}, {"log_change_over_size": size}


def _rod(bench, rng, size):
    """Put a stiff rod through the whole body."""
    point, _ = deep_point(bench, rng, 0.6)
    way, radius = unit(rng), 0.05 * bench.rig.body.size

    def factor(points):
        arms = points - point
        off = np.linalg.norm(arms - (arms @ way)[..., None] * way, axis=-1)
        return 1.0 + size * blurred(radius - off, 1.5)

    return {"contrast": factor}, {"point_mm": point.tolist(), "way": way.tolist(), "contrast": 1 + size}


def _peeling(bench, rng, size):
    stiff = 300.0 * bench.rig.young[0] / bench.rig.body.size
    limit = 1.2e-4 * bench.rig.body.size / size
    return {"support": {"springs": stiff, "limit": limit}}, {"kpa_per_mm": stiff, "limit_mm": limit}


def _rocking(bench, rng, size):
    pad = bench.rig.pads[int(rng.integers(len(bench.rig.pads)))]
    axis = np.cross(pad.normal, unit(rng))
    axis /= np.linalg.norm(axis)

    def motion(which, share, stroke):
        if which.name != pad.name:
            return share * stroke, np.zeros((3, 3))
        turn = Rotation.from_rotvec(np.deg2rad(size) * share * axis).as_matrix()
        return share * stroke, turn - np.eye(3)

    return {"motion": motion}, {"actuator": pad.name, "rotation_deg": (size * axis).tolist()}


def _twist(bench, rng, size):
    pad = bench.rig.pads[int(rng.integers(len(bench.rig.pads)))]

    def motion(which, share, stroke):
        if which.name != pad.name:
            return share * stroke, np.zeros((3, 3))
        # It turns more than in proportion.
        turn = Rotation.from_rotvec(np.deg2rad(size) * share**2 * pad.normal).as_matrix()
        return share * stroke, turn - np.eye(3)

    return {"motion": motion}, {"actuator": pad.name, "twist_deg": size}


def _slip(bench, rng, size):
    """Let every pad slip along the skin once it has moved half its way."""

    def motion(which, share, stroke):
        along = stroke - (stroke @ which.normal) * which.normal
        kept = min(share, 0.5) + (1.0 - size) * max(share - 0.5, 0.0)
        return share * (stroke - along) + kept * along, np.zeros((3, 3))

    return {"motion": motion}, {"lost": size}


def _plastic(bench, rng, size):
    point, _ = deep_point(bench, rng, 0.3)
    radius = 0.17 * bench.rig.body.size

    def mask(points):
        return blurred(radius - np.linalg.norm(points - point, axis=-1), 2.0)

    return {"memory": Memory(kept=(size, mask))}, {"point_mm": point.tolist(), "radius_mm": radius, "share": size}


def _local_swelling(bench, rng, size):
    point, _ = deep_point(bench, rng, 0.3)
    radius = 0.2 * bench.rig.body.size

    def growth(time, points):
        return size * min(time / 60.0, 1.0) * blurred(radius - np.linalg.norm(points - point, axis=-1), 4.0)

    return {"growth": growth}, {"point_mm": point.tolist(), "radius_mm": radius, "linear_strain": size}


def _bands(bench, rng, size):
    wave = unit(rng) * 2 * np.pi / (0.45 * bench.rig.body.size)
    return {"contrast": lambda p: np.exp(size * np.sin(p @ wave))}, {"log_amplitude": size}


def _stiff_and_soft(bench, rng, size):
    one, depth = deep_point(bench, rng, 0.4)
    far = max((deep_point(bench, rng, 0.4)[0] for _ in range(12)), key=lambda p: np.linalg.norm(p - one))
    radius = float(np.clip(0.14 * bench.rig.body.size, 5.0, max(depth, 5.0)))

    def factor(points):
        inside = [blurred(radius - np.linalg.norm(points - c, axis=-1), 1.5) for c in (one, far)]
        return np.exp(np.log(1 + size) * (inside[0] - inside[1]))

    return {"contrast": factor}, {"stiff_mm": one.tolist(), "soft_mm": far.tolist(), "contrast": 1 + size}


OUTSIDE = (
    Effect("wall", "", (0.4, 0.85), _wall, NG),
    Effect("thread", "", (3.0, 60.0), _thread, NG),
    Effect("gradient", "", (0.8, 2.0), _gradient),
    Effect("stiff rod", "", (4.0, 30.0), _rod),
    Effect("peeling support", "", (0.6, 4.0), _peeling, NG),
    Effect("rocking pad", "", (6.0, 20.0), _rocking),
    Effect("twisting pad", "", (12.0, 40.0), _twist),
    Effect("slipping pads", "", (0.4, 1.0), _slip),
    Effect("local plasticity", "", (0.3, 0.8), _plastic, NG),
    Effect("local swelling", "", (0.02, 0.08), _local_swelling, NG),
    Effect("bands of stiffness", "", (0.7, 1.6), _bands),
    Effect("stiff and soft ball", "", (4.0, 12.0), _stiff_and_soft),
)
