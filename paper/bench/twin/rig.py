"""What a rig is: everything that differs from the believed model, drawn from a scenario and a seed."""

from dataclasses import dataclass, replace

import numpy as np

from tissuereg.phantom.breast import BREAST, inside_breast

#: Actuators by scenario: along x; along x and y.
SCENARIOS = {1: ("x",), 2: ("x", "y")}

#: Seeds of the rigs that are reported, and by scenario of those on which every method is tuned.
SEEDS, DEVELOPMENT_SEEDS = range(12), {1: range(101, 106), 2: range(101, 105)}

#: Rigs whose pairs of simulation and truth calibrate a model (`twin.pairs`).
PAIR_SEEDS = range(1000, 1050)

RADIUS = BREAST.radius_mm
N_MARKERS, N_INNER = 15, 200

#: Time between frames, s, and the pushes: their shares of the strokes, and seconds in, held, and out.
FRAME_S = 0.025
PUSHES, IN_S, HELD_S, OUT_S = (0.4, 0.7, 1.0), 0.9, 0.3, 0.8

#: Depth of the buried sensor below the skin and height above the base at least, and of other inner points, mm.
_SENSOR_DEPTH, _SENSOR_HEIGHT, _INNER_DEPTH = 14.0, 12.0, 4.0

#: Markers lie this far above the base and off the rim of every pad, mm.
_MARKER_HEIGHT, _OFF_PAD = 6.0, 3.0

#: How well the actuators' pose is known: standard deviations of place (mm) and of each angle (degrees).
_PLACE_MM, _ANGLE_DEG = 1.5, 2.0


@dataclass(frozen=True)
class Actuator:
    """A linear actuator whose pad sticks to the skin; lengths in mm.

    Parameters
    ----------
    centre, direction : ndarray of float64, shape (3,)
        Where its pad touches the undeformed skin and its unit direction, in truth.
    known_centre, known_direction : ndarray of float64, shape (3,)
        The same as a user knows them.
    radius, stroke : float
        Radius of the pad, and the largest stroke.
    """

    centre: np.ndarray
    direction: np.ndarray
    known_centre: np.ndarray
    known_direction: np.ndarray
    radius: float
    stroke: float


@dataclass(frozen=True)
class Rig:
    """A rig; lengths in mm, moduli in kPa, stiffness of the base along it and across it in kPa/mm."""

    scenario: int
    seed: int
    actuators: tuple[Actuator, ...]
    young: float
    poisson: float
    alpha: float
    inclusion_centre: np.ndarray
    inclusion_radius: float
    inclusion_contrast: float
    base_along: float
    base_across: float

    @property
    def name(self):
        """Name of the rig's file."""
        return f"scenario{self.scenario}-{self.seed:02d}"

    def contrast(self, points):
        """Return the factor on Young's modulus at points (..., 3): smooth over a millimetre."""
        off = np.linalg.norm(points - self.inclusion_centre, axis=-1) - self.inclusion_radius
        return 1.0 + (self.inclusion_contrast - 1.0) * 0.5 * (1.0 - np.tanh(off))


def draw(scenario, seed):
    """Return the rig of a scenario and a seed."""
    rng = np.random.default_rng([27, scenario, seed])
    return Rig(
        scenario=scenario,
        seed=seed,
        actuators=tuple(_actuator(rng, axis, scenario) for axis in SCENARIOS[scenario]),
        young=float(np.exp(rng.uniform(np.log(5.0), np.log(20.0)))),
        poisson=float(rng.uniform(0.465, 0.485)),
        alpha=float(rng.uniform(5.0, 10.0)),
        inclusion_centre=_inside(rng, 1, 13.0, 14.0)[0],
        inclusion_radius=float(rng.uniform(7.0, 11.0)),
        inclusion_contrast=float(rng.uniform(3.0, 8.0)),
        base_along=float(np.exp(rng.uniform(np.log(0.7), np.log(3.0)))),
        base_across=float(np.exp(rng.uniform(np.log(1.0), np.log(4.0)))),
    )


def pushes():
    """Return the share of the strokes at every frame, (n_frames,): growing pushes, smooth at both ends."""
    rise = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, round(IN_S / FRAME_S) + 1) * FRAME_S / IN_S)
    fall = 0.5 + 0.5 * np.cos(np.pi * np.arange(1, round(OUT_S / FRAME_S) + 1) * FRAME_S / OUT_S)
    held = np.ones(round(HELD_S / FRAME_S))
    return np.concatenate([share * part for share in PUSHES for part in (rise, held, fall)])


def points(rig, nodes, skin):
    """Return places of markers (15, 3), of the sensor (3,) and of other inner points (200, 3).

    Parameters
    ----------
    rig : Rig
    nodes : ndarray of float64, shape (n, 3)
    skin : ndarray of int, shape (k, 3)
        Triangles of the free surface; markers lie in them.
    """
    rng = np.random.default_rng([28, rig.scenario, rig.seed])
    corners = nodes[skin[rng.choice(len(skin), 2000)]]
    candidates = np.einsum("tc,tcx->tx", rng.dirichlet((2.0, 2.0, 2.0), len(corners)), corners)
    free = candidates[:, 2] > _MARKER_HEIGHT
    for actuator in rig.actuators:
        for centre in (actuator.centre, actuator.known_centre):
            free &= np.linalg.norm(candidates - centre, axis=1) > actuator.radius + _OFF_PAD
    # Spread over the skin: each the farthest of random candidates.
    rest = candidates[free][:400]
    markers = [rest[0]]
    while len(markers) < N_MARKERS:
        gap = np.linalg.norm(rest[:, None] - np.array(markers)[None], axis=2).min(axis=1)
        markers.append(rest[np.argmax(gap)])
    sensor = _inside(rng, 1, _SENSOR_DEPTH, _SENSOR_HEIGHT)[0]
    return np.array(markers), sensor, _inside(rng, N_INNER, _INNER_DEPTH, _INNER_DEPTH)


def _actuator(rng, axis, scenario):
    angle = np.deg2rad({"x": 0.0, "y": 90.0}[axis] + rng.uniform(-12.0, 12.0))
    out = np.array([np.cos(angle), np.sin(angle), 0.0])
    known = _skin_point(out, rng.uniform(16.0, 26.0))
    direction = -np.eye(3)["xy".index(axis)]
    true, true_direction = _off_pose(rng, known, direction)
    return Actuator(
        true,
        true_direction,
        known,
        direction,
        radius=float(rng.uniform(13.0, 17.0)),
        stroke=float(rng.uniform(15.0, 20.0) if scenario == 1 else rng.uniform(12.0, 17.0)),
    )


def about_known_pose(actuator, rng):
    """Return an actuator whose true pose is drawn anew about the known one."""
    centre, direction = _off_pose(rng, actuator.known_centre, actuator.known_direction)
    return replace(actuator, centre=centre, direction=direction)


def _off_pose(rng, known, direction):
    """Return a place on the skin and a direction as far from known ones as poses are uncertain."""
    turn = np.deg2rad(_ANGLE_DEG) * rng.standard_normal(3)
    turned = direction + np.cross(turn, direction)
    off = known + _PLACE_MM * rng.standard_normal(3)
    place = _skin_point(off * [1, 1, 0] / np.hypot(*off[:2]), off[2])
    return place, turned / np.linalg.norm(turned)


def _skin_point(out, height):
    """Return the point of the skin at a height, in a horizontal direction from the axis."""
    near, far = 0.0, 2.0 * RADIUS
    for _ in range(60):
        middle = 0.5 * (near + far)
        inside = inside_breast((middle * out + [0.0, 0.0, height])[None])[0] > 0.0
        near, far = (middle, far) if inside else (near, middle)
    return near * out + np.array([0.0, 0.0, height])


def _inside(rng, count, depth, height):
    """Return points drawn evenly from the body, this deep below the skin and high above the base, mm."""
    found = []
    while len(found) < count:
        point = rng.uniform([-RADIUS, -1.2 * RADIUS, height], [RADIUS, 1.2 * RADIUS, RADIUS])
        around = point + depth * _DIRECTIONS
        if (inside_breast(around) > 0.0).all():
            found.append(point)
    return np.array(found)


_DIRECTIONS = np.array([[i, j, k] for i in (-1, 0, 1) for j in (-1, 0, 1) for k in (0, 1) if i or j or k], dtype=float)
_DIRECTIONS /= np.linalg.norm(_DIRECTIONS, axis=1)[:, None]
