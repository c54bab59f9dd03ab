"""Rigs, drawn from their numbers: body, support, pads and how the user reads them, load cases, noise, belief."""

import hashlib
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from rigs.generator.bodies import DRAWN, Body, box_of
from rigs.generator.meshing import skin_of

N_DRAWN, N_BOX = 24, 10
#: Rigs that were drawn after both halves had been asked.
N_THIRD = 16

#: Frames of a load case, s after its beginning, and the share of the stroke at them: 2 s up, hold, 2 s down, rest.
CASE_TIMES = np.array([0.0, 1.0, 2.0, 3.0, 5.0, 8.0, 9.0, 10.0, 12.0])
SHARES = np.interp(CASE_TIMES, [0.0, 2.0, 8.0, 10.0], [0.0, 1.0, 1.0, 0.0])
REST_TIMES = np.arange(6.0)
FIRST, EVERY = 10.0, 20.0


@dataclass
class Pad:
    """A patch of the skin that is moved.

    `centre`, `normal`, `along` (3,): its place, outward normal and long axis; `outline`: round, square or long; `half`
    (2,): half its lengths, mm; `reading`: how the user describes it, of ball, box, nodes, triangles, imprint.
    """

    name: str
    centre: np.ndarray
    normal: np.ndarray
    along: np.ndarray
    outline: str
    half: np.ndarray
    flat: bool
    reading: str = "nodes"

    @property
    def reach(self):
        """Largest distance of its rim from its centre, mm."""
        return float(self.half[0] if self.outline == "round" else np.hypot(*self.half))

    def inside(self, points, grown=0.0):
        """Return which points (n, 3) of the skin lie in it, or within `grown` mm of it."""
        arms = points - self.centre
        off = arms @ self.normal
        near = np.abs(off) < 0.8 * self.reach + 1e-6
        if self.outline == "round":
            return near & (np.linalg.norm(arms, axis=-1) <= self.half[0] + grown + 1e-6)
        u, v = arms @ self.along, arms @ np.cross(self.normal, self.along)
        return near & (np.abs(u) <= self.half[0] + grown + 1e-6) & (np.abs(v) <= self.half[1] + grown + 1e-6)


@dataclass
class Hold:
    """A patch that is held: where axis `axis` is `place`, and, of a part, where x is below `until`."""

    name: str
    axis: int
    place: float
    until: float | None = None

    def inside(self, points, grown=0.0):
        """Return which points lie in it."""
        found = np.abs(points[..., self.axis] - self.place) < 1e-4
        return found if self.until is None else found & (points[..., 0] <= self.until + grown + 1e-6)


@dataclass
class Load:
    """A load case: strokes (3,) by pad, mm."""

    name: str
    start: float
    strokes: dict


@dataclass
class Rig:
    """What stays the same over the experiments of one rig."""

    name: str
    number: int
    body: Body
    law: tuple
    young: tuple
    poisson: float
    holds: list
    pads: list
    loads: list
    n_markers: int
    n_targets: int
    solver: str
    forces: bool
    stated_edges: bool
    user_nodes: int
    factor: float = 1.0
    read_error: dict = field(default_factory=dict)

    def rng(self, *what):
        """Return a generator of random numbers for one purpose."""
        return np.random.default_rng([self.number, *what])


#: Draws before these cannot be meshed.
FIRST_DRAW = {8: 1}

LAWS = (("neo-hookean", {}), ("mooney-rivlin", {"share": 0.3}), ("fung", {"b": 1.5}))


def names():
    """Return the names of all rigs of the two halves."""
    drawn = [f"rig-{k + 1:02d}" for k in range(N_DRAWN)]
    return drawn + [f"box-{k + 1:02d}" for k in range(N_BOX)]


def third():
    """Return the names of the rigs of the third draw."""
    return [f"rig-{N_DRAWN + k + 1:02d}" for k in range(N_THIRD)]


def halves():
    """Return the half of every rig: the rigs of one kind in the order of the SHA-256 of their names, one half each.

    The rigs drawn later are a part of their own.
    """
    found = dict.fromkeys(third(), "third")
    for kind in ("rig", "box"):
        some = sorted((n for n in names() if n.startswith(kind)), key=lambda n: hashlib.sha256(n.encode()).hexdigest())
        found |= {name: "dev" if k < len(some) / 2 else "sealed" for k, name in enumerate(some)}
    return found


@cache
def make(name):
    """Return a rig by its name."""
    kind, number = name.split("-")
    return draw_box(int(number)) if kind == "box" else draw(int(number))


def draw(number):
    """Return the rig of a number, drawn at random until its pads find room."""
    for attempt in range(FIRST_DRAW.get(number, 0), 40):
        rng = np.random.default_rng([90210, number, attempt])
        kind = list(DRAWN)[(5 * number + int(number > 11)) % len(DRAWN)]
        body = DRAWN[kind](rng)
        holds = _holds(body, rng)
        pads = _pads(body, holds, rng)
        if pads is not None:
            break
    else:
        message = f"rig {number} must have room for its pads"
        raise ValueError(message)
    law = LAWS[0] if number % 4 else LAWS[1 + (number // 4) % 2]
    young = float(np.round(np.exp(rng.uniform(np.log(3.5), np.log(50.0))), 1))
    return Rig(
        f"rig-{number:02d}",
        number,
        body,
        law,
        (young, round(float(young * rng.choice([0.15, 0.2, 0.3])), 3)),
        float(np.round(rng.uniform(0.40, 0.48), 2)),
        holds,
        pads,
        _loads(body, pads, rng),
        int(rng.choice([3, 5, 8, 10, 12, 16, 20, 25])),
        int(rng.integers(1, 3)),
        "scikit-fem" if number % 2 else "ngsolve",
        bool(rng.uniform() < 0.8),
        bool(rng.uniform() < 0.5),
        int(rng.integers(520, 860)),
    )


def _holds(body, rng):
    how = str(rng.choice(body.holds))
    low, high = body.low, body.high
    if how == "base":
        return [Hold("base", 2, 0.0)]
    if how == "part":
        return [Hold("base", 2, 0.0, round(float(low[0] + rng.uniform(0.55, 0.75) * (high[0] - low[0])), 1))]
    left = Hold("left", 0, float(low[0]))
    return [left] if how == "side" else [left, Hold("right", 0, float(high[0]))]


def _pads(body, holds, rng):
    """Return pads where the skin is smooth and free, or None where there is no room."""
    centres, normals, corners = skin_of(body.solid, 5.0)
    held = np.any([hold.inside(corners).all(axis=1) for hold in holds], axis=0)
    below = np.abs(corners[:, :, 2]).max(axis=1) < 1e-4
    pads = []
    for k in range(int(rng.choice([1, 2, 2, 3, 3]))):
        for _ in range(300):
            reach = float(np.round(np.clip(rng.uniform(0.11, 0.17) * body.size, 5.5, 13.0), 1))
            at = rng.choice(np.flatnonzero(~held & ~below))
            near = np.linalg.norm(centres - centres[at], axis=1) < 1.35 * reach + 2.5
            alike = (normals[near] @ normals[at]).min()
            if alike < 0.75 or near[held].any() or near[below].any():
                continue
            if any(np.linalg.norm(centres[at] - p.centre) < 1.2 * reach + p.reach + 5.0 for p in pads):
                continue
            flat = bool(alike > 0.99999)
            outline = str(rng.choice(["round", "round", "square", "long"])) if flat else "round"
            pads.append(_pad(f"pad{k + 1}", centres[at], normals[at], reach, outline, flat, rng))
            break
        else:
            return None
    return pads


def _pad(name, centre, normal, reach, outline, flat, rng):
    level = np.abs(normal).max() > 0.99999
    aside = np.eye(3)[np.argmin(np.abs(normal))]
    along = aside - (aside @ normal) * normal
    along /= np.linalg.norm(along)
    if outline != "round" and not level:
        turn = rng.uniform(0, np.pi)
        along = np.cos(turn) * along + np.sin(turn) * np.cross(normal, along)
    half = {"round": (reach, reach), "square": (0.75 * reach, 0.75 * reach), "long": (1.05 * reach, 0.55 * reach)}
    if outline == "round":
        reading = str(rng.choice(["ball", "ball", "nodes", "triangles", "imprint"]))
    else:
        ways = ["nodes", "triangles", "imprint"] + (["box"] if level else [])
        reading = str(rng.choice(ways))
    return Pad(
        name, np.round(centre, 3) if flat else centre, normal, along, outline, np.array(half[outline]), flat, reading
    )


def _loads(body, pads, rng):
    """Return two to four load cases: one a pad, then shear or two pads together."""
    loads = []

    def stroke(pad, how):
        size = min(rng.uniform(0.06, 0.14) * body.size, 0.75 * pad.reach)
        tilt = rng.normal(size=3)
        tilt -= (tilt @ pad.normal) * pad.normal
        tilt /= np.linalg.norm(tilt)
        if how == "push":
            lean = np.deg2rad(rng.uniform(0, 25))
            return np.round(size * (-np.cos(lean) * pad.normal + np.sin(lean) * tilt), 3)
        if how == "pull":
            return np.round(0.7 * size * pad.normal, 3)
        return np.round(0.8 * size * (tilt - 0.3 * pad.normal), 3)

    loads += [(f"{pad.name}_push", {pad.name: stroke(pad, "push")}) for pad in pads]
    extra = int(rng.integers(2, 5)) - len(loads)
    ways = [("shear", 0), ("pull", 0)] if len(pads) == 1 else [("both", 0), ("shear", 1), ("pull", 0)]
    for how, k in ways[: max(extra, 2 - len(loads), 0)]:
        if how == "both":
            loads.append(("both", {p.name: np.round(0.8 * stroke(p, "push"), 3) for p in pads[:2]}))
        else:
            loads.append((f"{pads[k].name}_{how}", {pads[k].name: stroke(pads[k], how)}))
    return [Load(name, FIRST + EVERY * k, strokes) for k, (name, strokes) in enumerate(loads)]


def draw_box(number):
    """Return a box held at its base whose pads are given as nodes in a ball, by triangles or by a mesh that has them.

    The first is 80 x 60 x 40 mm with a pad of 9 mm at its top and one at a side; the others are its neighbours.
    """
    rng = np.random.default_rng([80604, number])
    own = number > 1
    size = np.array([80.0, 60.0, 40.0])
    if own:
        size = np.round(size * rng.uniform(0.8, 1.3, 3), 0)
    body = box_of(size)
    radius = float(np.round(rng.uniform(8.0, 10.0), 1)) if own else 9.0
    spots = [
        ("top", np.array([0.5, 0.5, 1.0]), np.array([0.0, 0.0, 1.0])),
        ("side", np.array([1.0, 0.5, 0.55]), np.array([1.0, 0.0, 0.0])),
        ("front", np.array([0.45, 0.0, 0.5]), np.array([0.0, -1.0, 0.0])),
    ]
    n_pads = 2 if not own else int(rng.integers(2, 4))
    reading = "ball" if number < 5 else ("triangles", "imprint")[number % 2]
    pads = []
    for name, share, normal in spots[:n_pads]:
        moved = rng.uniform(-0.08, 0.08, 3) * (1 - np.abs(normal)) if own else 0.0
        pads.append(
            Pad(
                name,
                np.round((share + moved) * size, 2),
                normal,
                np.roll(np.abs(normal), 1),
                "round",
                np.array([radius, radius]),
                True,
                reading,
            )
        )
    loads = []
    for k, pad in enumerate(pads):
        lean = np.roll(np.abs(pad.normal), 1)
        stroke = np.round(rng.uniform(4.5, 6.0) * (-pad.normal + rng.uniform(0.0, 0.4) * own * lean), 2)
        loads.append(Load(f"push_{pad.name}", FIRST + EVERY * k, {pad.name: stroke}))
    loads.append(Load("shear", FIRST + EVERY * len(pads), {"top": np.round(5.0 * np.array([0.9, 0.3, -0.3]), 2)}))
    rig = Rig(
        f"box-{number:02d}",
        100 + number,
        body,
        LAWS[0],
        (10.0, 3.0),
        0.45,
        [Hold("base", 2, 0.0)],
        pads,
        loads,
        (12, 3, 8, 16, 4, 10, 6, 14, 5, 12)[number - 1],
        1,
        "scikit-fem" if number % 2 == 0 else "ngsolve",
        True,
        False,
        700,
    )
    if number == 1:
        rig.factor = 1.2
    if reading == "ball":
        rig.read_error = {pad.name: float(rng.uniform(-0.04, 0.04)) for pad in pads}
    return rig
