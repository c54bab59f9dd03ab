"""Rigs: body, pads, what is believed, the user's mesh, places of markers and targets, drawn from the rig's number."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from blind.generator.shapes import Shape, half_ball, jittered, tets_from_bricks, volumes

RIGS = Path(__file__).resolve().parent.parent / "data" / "rigs.json"

#: Seconds of a case's frames, and its ramp: 2 s up, 6 s hold, 2 s down, 2 s rest.
CASE_TIMES = np.arange(12.0)
REST_TIMES = np.arange(6.0)
CASE_STARTS = (10.0, 30.0, 50.0)
YOUNG = (10.0, 3.0)

#: Markers stored for each rig; an experiment shows 25 of them.
N_PLACES = 60

#: The first four carry effects, the others carry nulls.
N_RIGS = 14


def amplitude(t):
    """Return the share of the stroke at seconds after a case's beginning."""
    return np.interp(t, [0.0, 2.0, 8.0, 10.0], [0.0, 1.0, 1.0, 0.0])


@dataclass
class Rig:
    """What stays the same over many experiments."""

    number: int
    shape: Shape
    poisson: float
    pads: dict  # name -> (centre, radius)
    strokes: dict  # name -> (3,)
    places: np.ndarray  # (60, 3) on the surface
    targets: dict
    turn: float


def make_rig(number):
    """Return a rig by number: rigs are drawn once and kept, since stored solves speak of their places."""
    kept = json.loads(RIGS.read_text(encoding="utf-8")) if RIGS.exists() else []
    if number >= len(kept):
        return draw_rig(number)
    summary = kept[number]
    return Rig(
        number,
        Shape(tuple(summary["axes"]), summary["power"], tuple(tuple(wave) for wave in summary["waves"])),
        summary["poisson"],
        {name: (np.array(centre), radius) for name, (centre, radius) in summary["pads"].items()},
        {name: np.array(stroke) for name, stroke in summary["strokes"].items()},
        np.array(summary["places"]),
        {name: np.array(place) for name, place in summary["targets"].items()},
        summary["turn"],
    )


def draw_rig(number):
    """Return a new rig, drawn from its number."""
    rng = np.random.default_rng([2031, number])
    if number == 0:
        shape = Shape((60.0, 60.0, 50.0))
    elif number % 3 == 1:
        shape = Shape(
            tuple(rng.uniform([48, 42, 36], [58, 52, 46])),
            power=rng.uniform(3.0, 3.8),
            waves=((0.02, *rng.normal(size=3) * 2),),
        )
    else:
        shape = Shape(
            tuple(rng.uniform([54, 50, 42], [66, 62, 54])),
            power=rng.uniform(1.9, 2.4),
            waves=((rng.uniform(0.01, 0.035), *rng.normal(size=3) * 2),),
        )
    poisson = 0.45 if number == 0 else float(np.round(rng.uniform(0.40, 0.47), 2))
    angles = np.deg2rad(np.array([0.0, 90.0]) + rng.uniform(-15, 15, 2) + (rng.uniform(0, 360) if number else 0.0))
    rises = np.deg2rad(rng.uniform(18, 28, 2))
    radius = float(np.round(rng.uniform(8.0, 9.5), 1)) if number else 9.0
    size = float(np.mean(shape.axes)) / 57
    pads, strokes = {}, {}
    for name, angle, rise in zip(("push_x", "push_y"), angles, rises, strict=True):
        outward = np.array([np.cos(angle) * np.cos(rise), np.sin(angle) * np.cos(rise), np.sin(rise)])
        pads[name] = (np.round(shape.on_surface(outward), 3), radius)
        strokes[name] = np.round(-7.0 * size * np.array([np.cos(angle), np.sin(angle), 0.0]), 4)
    tilt = rng.uniform(-0.15, 0.15, 2)
    pads["push_z"] = (np.round(shape.on_surface(np.array([tilt[0], tilt[1], 1.0])), 3), radius)
    strokes["push_z"] = np.round(np.array([0.0, 0.0, -5.0 * size]), 4)
    places = _places(shape, pads, rng)
    low, high = (0.25, 0.6)
    targets = {}
    for name in ("lesion", "vessel")[: 1 + number % 2]:
        direction = rng.normal(size=3)
        direction[2] = abs(direction[2]) + 0.3
        targets[name] = np.round(rng.uniform(low, high) * shape.on_surface(direction), 3)
    return Rig(number, shape, poisson, pads, strokes, places, targets, float(rng.uniform(0.2, 1.4)))


def user_mesh(rig, variant):
    """Return nodes and tets that a user brings: variants of about 600 nodes, or of 4,000 (-1), finer under the pads."""
    from blind.generator.mesh import refined

    grid, longest = {-1: ((12, 6, 6), 5.0), 0: ((5, 3, 3), 7.5), 1: ((5, 3, 3), 9.0), 2: ((6, 3, 3), 9.0)}[variant]
    rng = np.random.default_rng([77, rig.number, variant + 1])
    while True:  # a flat brick may be cut the wrong way
        ball, bricks = half_ball(*grid, turn=rng.uniform(0, 1.5))
        tets = tets_from_bricks(ball, bricks, rng)
        if volumes(rig.shape.in_body(ball), tets).min() > 0:
            break
    nodes = jittered(rig.shape, ball, tets, rng, 0.12)
    spots = list(rig.pads.values())
    for edge in (longest, 0.8 * longest, 0.65 * longest):
        mesh = refined(rig.shape, nodes, tets, spots, edge, edge)
        skin = mesh.p[:, np.unique(mesh.facets[:, mesh.boundary_facets()])].T
        if all((np.linalg.norm(skin - centre, axis=1) <= radius).sum() >= 3 for centre, radius in spots):
            break
    nodes, tets = np.round(mesh.p.T, 5), mesh.t.T.copy()
    turned = volumes(nodes, tets) < 0
    tets[turned] = tets[turned][:, [0, 1, 3, 2]]
    return nodes, tets


def _places(shape, pads, rng):
    """Return places of markers, spread over the free surface, off the pads and the rim."""
    found = []
    while len(found) < N_PLACES:
        best, gap = None, -1.0
        for _ in range(40):
            direction = rng.normal(size=3)
            direction[2] = abs(direction[2])
            point = shape.on_surface(direction)
            if point[2] < 3.5 or any(np.linalg.norm(point - c) < r + 2.0 for c, r in pads.values()):
                continue
            distance = min((np.linalg.norm(point - p) for p in found), default=99.0)
            if distance > gap:
                best, gap = point, distance
        if best is not None:
            found.append(np.round(best, 3))
    order = rng.permutation(N_PLACES)
    return np.array(found)[order]
