"""Experiments from stored fields: what is hidden, how much of it, which markers, which noise; and their answers."""

from dataclasses import dataclass, field

import numpy as np

from blind.generator import chain, outside
from blind.generator.fields import (
    CASE_STARTS,
    N_CASE,
    N_REST,
    TIMES,
    NotReadyError,
    at_size,
    case_amplitudes,
    differences,
    null_frames,
    rig_of,
    sizes_range,
)
from blind.generator.jobs import Job, hidden
from blind.generator.rigs import YOUNG
from blind.generator.solve import YOUNG as SOLVED_YOUNG

STD_MM, STD_MN = 0.05, 5.0
FRAME_MM, FRAME_DEG = 0.02, 0.02
CASES = ("push_x", "push_y", "push_z")

#: Noise may be scaled by these factors to reach a detectability.
NOISE_RANGE = (0.4, 4.0)


@dataclass
class Plan:
    """One experiment to be made: everything is drawn from its seed."""

    name: str
    seed: int
    rig: int
    kind: str  # null, single, outside, pair, tied, fine
    #: Hidden parts: (list, index) for a solved one, ("chain" or "odd", id, which), ("view", index), ("stiffness",) ...
    parts: tuple = ()
    #: Wanted detectability of the whole, or None: sizes and noise as they are.
    level: float | None = None
    forces: bool = True
    only_first_case: bool = False
    noise: str = "white"
    nuisance: float = 1.0
    mesh: int = 0  # which of the rig's user meshes; -1: 4,000 nodes
    believed_weight: bool = False


@dataclass
class Experiment:
    """What is measured, and the truth."""

    plan: Plan
    toml: str
    arrays: dict
    answer: dict = field(default_factory=dict)


class OutOfReachError(Exception):
    """No size and noise in range has the wanted detectability."""


def make(plan):
    """Return an experiment; raises NotReadyError or OutOfReachError."""
    rng = np.random.default_rng([4711, plan.seed])
    rig = rig_of(plan.rig)
    chosen = rng.permutation(60)[:25]
    cases = (0,) if plan.only_first_case else (0, 1, 2)
    view = View(rig, chosen, cases, plan.forces)
    share = 1.0 + 0.3 * rng.choice([-1, 1]) * 2.0 if plan.nuisance == 2.0 else _young_share(rng)
    share = max(share, 0.45) if plan.nuisance else 1.0
    weight = _weight(plan, rng)
    hidden_parts = [Part(plan, p, rig, np.random.default_rng([plan.seed, k])) for k, p in enumerate(plan.parts)]
    sizes, factor = _sizes(plan, view, hidden_parts, weight, rng)
    clean, summary = view.clean(hidden_parts, sizes, weight)
    if plan.parts and plan.parts[0] == ("stiffness",):
        share = summary["stiffness"]["young_kpa"] / SOLVED_YOUNG
    vector = view.whitened(clean, view.clean([], [], weight)[0], factor, weight)
    alone = [
        view.norm(view.clean([p], [s], weight)[0], view.clean([], [], weight)[0], factor, weight)
        for p, s in zip(hidden_parts, sizes, strict=True)
    ]
    measured = _measure(plan, rig, view, clean, share, factor, rng)
    toml = _toml(plan, rig, chosen, factor, weight, share)
    answer = {
        "cause": sorted({p.cause for p in hidden_parts if p.catalogue}),
        "outside": [p.cause for p in hidden_parts if not p.catalogue],
        "kind": plan.kind,
        "parameters": {p.cause: _scaled(summary[p.cause], share) for p in hidden_parts}
        | {"young_kpa": SOLVED_YOUNG * share},
        "own_form": all(p.own_form for p in hidden_parts),
        "catalogue": all(p.catalogue for p in hidden_parts),
        "detectability": float(np.linalg.norm(vector)),
        "detectability_alone": [float(a) for a in alone],
        "level": plan.level,
        "std_mm": STD_MM * factor,
        "noise": plan.noise,
        "forces_given": plan.forces,
        "rig": plan.rig,
        "fine": plan.mesh == -1,
        "effect_rms_mm": float(np.sqrt((view.marker_part(clean, weight) ** 2).mean())),
    }
    answer["near"] = ties(view, hidden_parts, vector, factor, weight) if plan.kind in ("single", "tied", "fine") else []
    answer |= _accepted(plan, answer)
    return Experiment(plan, toml, measured, answer)


def _young_share(rng):
    return float(np.clip(1.0 + YOUNG[1] / YOUNG[0] * rng.normal(), 0.55, 1.6))


def _weight(plan, rng):
    """Return (change of fields, weight share, direction) of the believed weight, or None."""
    if not plan.believed_weight:
        return None
    index = next(i for i, e in enumerate(hidden("catalogue")) if e.id == "gravity")
    changes = differences(plan.rig, "catalogue", index)
    if changes is None:
        raise NotReadyError
    effect = hidden("catalogue")[index]
    size = float(rng.uniform(0.05, 0.12))
    _, summary = effect.build(rig_of(plan.rig), Job(plan.rig, "catalogue", index, 0).rng(), size)
    return at_size(effect, changes, size), summary


class Part:
    """One hidden thing."""

    def __init__(self, plan, spec, rig, rng):
        self.spec, self.rig, self.plan = spec, rig, plan
        self._seed = int(rng.integers(2**31))
        kind = spec[0]
        self.catalogue = True
        if kind in ("catalogue", "outside", "pairs"):
            self.effect = hidden(kind)[spec[1]]
            self.cause, self.own_form = self.effect.id, self.effect.own_form
            self.catalogue = kind != "outside"
            self.range = sizes_range(self.effect)
            self.changes = differences(rig.number, kind, spec[1])
            if self.changes is None:
                raise NotReadyError
        elif kind in ("chain", "odd"):
            table = chain.CAUSES if kind == "chain" else chain.OUTSIDE
            self.act, self.own_form, self.range = table[spec[1]][spec[2]]
            self.cause, self.catalogue = spec[1], kind == "chain"
        elif kind == "view":
            self.effect = outside.CHAIN[spec[1]]
            self.cause, self.own_form, self.catalogue, self.range = self.effect.id, False, False, self.effect.sizes
        else:  # stiffness, reference
            self.cause, self.own_form = kind, True
            self.range = (9.5, 60.0) if kind == "stiffness" else (1.0, 1.0)

    def rng(self):
        """Return the generator of the case's random numbers, from its start."""
        return np.random.default_rng(self._seed)


class View:
    """What one experiment sees of a rig: 25 markers, some cases, with or without forces."""

    def __init__(self, rig, chosen, cases, forces):
        self.rig, self.chosen, self.cases, self.forces = rig, chosen, cases, forces
        self.rows = np.concatenate([np.arange(N_REST), *(N_REST + N_CASE * c + np.arange(N_CASE) for c in cases)])
        self.force_rows = self.rows[N_REST:]

    def clean(self, parts, sizes, weight):
        """Return (places (n, 25, 3), targets, forces (m, 3)) without noise, with some hidden parts; and these."""
        rig = self.rig
        state = chain.Clean(case_amplitudes(), case_amplitudes(), cases=self.cases)
        summary, late = {}, []
        for part, size in zip(parts, sizes, strict=True):
            if part.spec[0] in ("chain", "odd"):
                summary[part.cause] = part.act(state, rig, part.rng(), size)
        frames = null_frames(rig.number, state.amplitudes)
        force_frames = null_frames(rig.number, state.force_amplitudes)
        factor = 1.0
        for part, size in zip(parts, sizes, strict=True):
            kind = part.spec[0]
            if kind in ("catalogue", "outside", "pairs"):
                change = at_size(part.effect, part.changes, size)
                frames, force_frames = frames + change, force_frames + change
                if kind == "pairs":
                    summary[part.cause] = part.effect.build(rig, Job(rig.number, kind, part.spec[1], 0).rng(), size)[1]
                else:
                    summary[part.cause] = part.effect.build(rig, Job(rig.number, kind, part.spec[1], 0).rng(), size)[1]
            elif kind == "view":
                summary[part.cause] = {"size": size}
                late.append((part, size))
            elif kind == "stiffness":
                factor = size / SOLVED_YOUNG
                summary["stiffness"] = {"young_kpa": size}
            elif kind == "reference":
                summary["reference"] = {
                    "in_reference": True,
                    **{k: v for k, v in weight[1].items() if k != "in_reference"},
                }
        if weight is not None and not any(p.spec[0] == "reference" for p in parts):
            frames, force_frames = frames + weight[0], force_frames + weight[0]
        places = rig.places[self.chosen] + frames.markers[:, self.chosen]
        for part, size in late:
            places = part.effect.act(places, TIMES, CASE_STARTS, part.rng(), size)
        for act in state.acts:
            places = act(places, TIMES)
        forces = factor * force_frames.forces
        for act in state.force_acts:
            forces = act(forces)
        targets = np.array(list(rig.targets.values())) + force_frames.targets
        return (places[self.rows], targets[self.rows], forces[self.force_rows]), summary

    def marker_part(self, clean, weight):
        """Return what the hidden changes in places."""
        return clean[0] - self.clean([], [], weight)[0][0]

    def whitened(self, clean, below, factor, weight):
        """Return the difference in units of noise, nuisances (stiffness, rigid frame) taken out by their priors."""
        parts = [(clean[0] - below[0]).ravel() / (STD_MM * factor)]
        if self.forces:
            parts.append((clean[2] - below[2]).ravel() / (STD_MN * factor))
        r = np.concatenate(parts)
        N = self.nuisances(below, factor, weight)
        # (I + N N^T)^(-1/2) through the small matrix N^T N.
        values, vectors = np.linalg.eigh(N.T @ N)
        keep = values > 1e-12 * max(values.max(), 1.0)
        U = N @ vectors[:, keep] / np.sqrt(values[keep])
        return r - U @ ((1 - 1 / np.sqrt(1 + values[keep])) * (U.T @ r))

    def norm(self, clean, below, factor, weight):
        """Return the detectability."""
        return np.linalg.norm(self.whitened(clean, below, factor, weight))

    def nuisances(self, below, factor, weight):
        """Return columns of one prior standard deviation each."""
        places, _, forces = below
        shape = places.shape
        columns = []
        for axis in range(3):
            shift = np.zeros(shape)
            shift[..., axis] = FRAME_MM
            turn = np.cross(np.eye(3)[axis], places) * np.deg2rad(FRAME_DEG)
            columns += [(shift, None), (turn, None)]
        young = -weight[0].markers[self.rows][:, self.chosen] * 0.3 if weight is not None else np.zeros(shape)
        columns.append((young, forces * YOUNG[1] / YOUNG[0]))
        out = []
        for places_part, force_part in columns:
            column = [places_part.ravel() / (STD_MM * factor)]
            if self.forces:
                force_part = np.zeros_like(forces) if force_part is None else force_part
                column.append(force_part.ravel() / (STD_MN * factor))
            out.append(np.concatenate(column))
        return np.stack(out, axis=1)


def _sizes(plan, view, parts, weight, rng):
    """Return sizes of the hidden parts and the factor of the noise that give the wanted detectability.

    The noise is drawn first; sizes follow, and where they do not suffice the noise changes. Of several parts each gets
    the wanted detectability by itself.
    """
    factor = float(rng.choice((1.0, 2.0, 4.0), p=(0.25, 0.35, 0.4)))
    if not parts:
        return [], factor
    if plan.level is None:
        return [p.range[0] * (p.range[1] / p.range[0]) ** float(rng.uniform(0.6, 0.95)) for p in parts], factor
    sizes = [_size(plan.level, view, part, weight, factor) for part in parts]
    if len(parts) > 1:
        return sizes, factor
    below = view.clean([], [], weight)[0]
    for _ in range(30):  # priors do not scale with the noise: a fixed point
        d = view.norm(view.clean(parts, sizes, weight)[0], below, factor, weight)
        if abs(d / plan.level - 1) < 0.02:
            return sizes, factor
        factor = factor * d / plan.level
        if not NOISE_RANGE[0] <= factor <= NOISE_RANGE[1]:
            break
    raise OutOfReachError


def _size(level, view, part, weight, factor):
    below = view.clean([], [], weight)[0]

    def detectability(size):
        return view.norm(view.clean([part], [size], weight)[0], below, factor, weight)

    low, high = part.range
    if detectability(low) >= level:
        return low
    if detectability(high) <= level:
        return high
    for _ in range(24):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if detectability(middle) < level else (low, middle)
    return float(np.sqrt(low * high))


def ties(view, parts, vector, factor, weight):
    """Return ids that cannot be distinguished from the hidden cause here: they explain all but a length of 4 of it."""
    below = view.clean([], [], weight)[0]
    found = set()
    own = {p.cause for p in parts}
    rng = np.random.default_rng(5)
    columns = {}
    for index, effect in enumerate(hidden("catalogue")):
        changes = differences(view.rig.number, "catalogue", index)
        if effect.id in own or changes is None:
            continue
        part = Part(None, ("catalogue", index), view.rig, rng)
        columns.setdefault(effect.id, []).append([view.clean([part], [s], weight)[0] for s in effect.sizes])
    for cause, acts in chain.CAUSES.items():
        if cause in own or cause in ("marker_swap", "marker_slip"):
            continue
        for seed in range(3 if cause == "actuator_gain" else 1):
            part = Part(None, ("chain", cause, 0), view.rig, np.random.default_rng(seed))
            columns.setdefault(cause, []).append([view.clean([part], [acts[0][2][1] * 0.3], weight)[0]])
    for cause, variants in columns.items():
        for variant in variants:
            block = np.stack([view.whitened(v, below, factor, weight) for v in variant], axis=1)
            basis = np.linalg.qr(block)[0]
            if np.linalg.norm(vector - basis @ (basis.T @ vector)) < min(4.0, 0.7 * np.linalg.norm(vector)):
                found.add(cause)
    return sorted(found)


#: Causes whose data look alike by their nature: a fast relaxation and a viscosity, the shape of an isotropic law.
SISTERS = {
    "relaxation": ("rate",),
    "rate": ("relaxation",),
    "stiffening": ("mooney", "asymmetry"),
    "mooney": ("stiffening", "asymmetry"),
    "asymmetry": ("mooney", "stiffening"),
}


def _accepted(plan, answer):
    causes = []
    for cause in answer["cause"]:
        causes += cause.split("+")
    d = answer["detectability"]
    group = set(causes) | set(answer["near"])
    near_miss = sorted({s for c in causes for s in SISTERS.get(c, ())} - group)
    if answer["outside"]:
        verdicts = ["unexplained"] if d >= 8 else ["unexplained", "consistent"]
    elif not causes:
        verdicts = ["consistent"]
    else:
        verdicts = ["named", "group"] if d >= 8 else ["named", "group", "consistent"]
    return {
        "cause": causes,
        "group_ok": sorted(group),
        "near_miss": near_miss,
        "verdict_ok": verdicts,
        "separable": not answer["near"],
    }


def _scaled(summary, share):
    """Return parameters that are stresses in the case's own modulus."""
    summary = dict(summary)
    for key in ("viscosity_kpa_s", "m_kpa", "spring_kpa_per_mm", "preload_kpa", "soft_kpa_per_mm", "g_mm_per_s2"):
        if key in summary:
            summary[key] = summary[key] * share
    return {k: (_scaled(v, share) if isinstance(v, dict) else v) for k, v in summary.items()}


def _measure(plan, rig, view, clean, share, factor, rng):
    """Return measured arrays: noise and nuisances on the clean ones."""
    places, targets, forces = clean
    frame = plan.nuisance
    turn, shift = frame * FRAME_DEG * rng.normal(size=3), frame * FRAME_MM * rng.normal(size=3)
    if plan.nuisance == 2.0:
        turn, shift = 2 * FRAME_DEG * np.sign(turn) / np.sqrt(3), 2 * FRAME_MM * np.sign(shift) / np.sqrt(3)
    seen = places @ chain.rotation(turn).T + shift
    seen = seen + STD_MM * factor * _noise(plan.noise, seen.shape, TIMES[view.rows], rng)
    if plan.noise != "white" and plan.kind != "null" and rng.uniform() < 0.3:
        seen[rng.uniform(size=seen.shape[:2]) < 0.01] = np.nan
    scale = share if not (plan.parts and plan.parts[0] == ("stiffness",)) else 1.0
    return {
        "markers": seen,
        "targets": targets + STD_MM * rng.normal(size=targets.shape),
        "forces": scale * forces + STD_MN * factor * rng.normal(size=forces.shape),
        "rows": view.rows,
        "chosen": view.chosen,
    }


def _noise(kind, shape, times, rng):
    """Return noise of variance 1: white, correlated in time (AR(1) a marker component), or with a common mode."""
    if kind == "white":
        return rng.normal(size=shape)
    rho = float(rng.uniform(0.3, 0.7))
    step = rho ** np.maximum(np.diff(times, prepend=times[0] - 1e3), 0.0)

    def chained(size):
        out = np.empty((len(times), *size))
        value = rng.normal(size=size)
        for k, r in enumerate(step):
            value = r * value + np.sqrt(1 - r**2) * rng.normal(size=size)
            out[k] = value
        return out

    if kind == "ar1":
        return chained(shape[1:])
    common = float(rng.uniform(0.3, 0.6))
    return common * chained((1, 3)) + np.sqrt(1 - common**2) * rng.normal(size=shape)


def _toml(plan, rig, chosen, factor, weight, share):
    lines = [
        f'name = "{plan.name}"',
        "",
        "[mesh]",
        'file = "mesh.vtu"',
        "",
        "[material]",
        'law = "neo-hookean"',
        f"young_kpa = [{YOUNG[0]}, {YOUNG[1]}]",
        f"poisson = {rig.poisson}",
        "density_g_per_cm3 = 1.0",
        "",
    ]
    if weight is not None:
        summary = weight[1]
        direction = ", ".join(f"{x:.6f}" for x in summary["direction"])
        lines += [
            "[gravity]",
            f"direction = [{direction}]",
            f"g_mm_per_s2 = {summary['g_mm_per_s2'] * share:.4f}",
            "in_reference = false",
            "",
        ]
    lines += [
        "[[boundary]]",
        'name = "base"',
        "nodes = { plane = [0.0, 0.0, 1.0, 0.0], tolerance_mm = 0.1 }",
        'kind = "fixed"',
        "",
    ]
    for name, (centre, radius) in rig.pads.items():
        if plan.only_first_case and name != "push_x":
            continue
        spot = ", ".join(f"{x:.3f}" for x in centre)
        lines += [
            "[[actuator]]",
            f'name = "{name}"',
            f"nodes = {{ centre_mm = [{spot}], radius_mm = {radius} }}",
            'kind = "displacement"',
            'contact = "bonded"',
            "",
        ]
    if plan.forces:
        lines += ["[forces]", f"std_mN = {STD_MN * factor:.5g}", ""]
    lines += ["[markers]", f"std_mm = {STD_MM * factor:.5g}", 'rest_case = "rest"', "", "[markers.reference]"]
    for number, place in enumerate(rig.places[chosen]):
        lines.append(f"P{number + 1} = [{place[0]:.3f}, {place[1]:.3f}, {place[2]:.3f}]")
    for name, place in rig.targets.items():
        lines += ["", "[[target]]", f'name = "{name}"', f"reference = [{place[0]:.3f}, {place[1]:.3f}, {place[2]:.3f}]"]
    return "\n".join(lines) + "\n"
