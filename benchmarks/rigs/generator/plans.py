"""Which experiments are made on which rig. Part of the sealed answers: whoever tunes a diagnoser does not read on."""

import hashlib
import json
from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from rigs.generator.cases import DATA
from rigs.generator.effects import CATALOGUE
from rigs.generator.outside import OUTSIDE
from rigs.generator.rigs import halves, make, names, third

RIGS = DATA / "rigs.json"
LEVELS = (8.0, 13.0, 21.0, 50.0)
#: How many rigs each cause is hidden on, and how many effects outside the catalogue there are.
EACH, N_OUTSIDE = 3, 16

PAIRS = (
    ("inclusion", "actuator_gain"),
    ("layer", "detachment"),
    ("stiffening", "actuator_direction"),
    ("poisson", "inclusion"),
    ("gravity", "inclusion"),
    ("sliding", "layer"),
    ("relaxation", "inclusion"),
    ("swelling", "actuator_gain"),
    ("fibre", "detachment"),
    ("softening", "layer"),
    ("actuator_offset", "layer"),
    ("rate", "gravity"),
)


@dataclass(frozen=True)
class Plan:
    """One experiment: `parts` are (list, index) of its effects; `level`: the wanted length of the effect."""

    rig: str
    kind: str
    parts: tuple
    level: float | None
    seed: int

    @property
    def key(self):
        """Name of the file of clean readings."""
        words = [f"{which}{index}" for which, index in self.parts]
        return "-".join([self.kind, *words])

    @property
    def name(self):
        """Name of the case, which tells nothing."""
        return f"{self.rig}-{hashlib.sha256(f'rigs/{self.rig}/{self.key}'.encode()).hexdigest()[:5]}"

    def rng(self, what):
        """Return a generator of random numbers for one purpose."""
        return np.random.default_rng([self.seed, what])


def effects_of(plan):
    """Return the effects of a plan."""
    return [{"catalogue": CATALOGUE, "outside": OUTSIDE}[which][index] for which, index in plan.parts]


def suits(effect, rig):
    """Return whether an effect can be made on a rig."""
    if rig.solver not in effect.codes or (effect.forces and not rig.forces):
        return False
    return not (effect.plain and rig.law[0] != "neo-hookean") and not (effect.holds and len(rig.holds) > 1)


def summaries():
    """Return what plans depend on, by rig, from the file in which it writes what is missing."""
    rows = json.loads(RIGS.read_text(encoding="utf-8")) if RIGS.exists() else {}
    missing = [name for name in [*names(), *third()] if name not in rows]
    if missing:
        RIGS.parent.mkdir(parents=True, exist_ok=True)
        rows |= {name: _summary(make(name)) for name in missing}
        lines = [f" {json.dumps(name)}: {json.dumps(row)}" for name, row in rows.items()]
        RIGS.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    return {name: SimpleNamespace(**row) for name, row in rows.items()}


def _summary(rig):
    pads = [{"outline": p.outline, "half_mm": np.round(p.half, 3).tolist(), "reading": p.reading} for p in rig.pads]
    return {
        "body": rig.body.kind,
        "size_mm": np.round(rig.body.high - rig.body.low, 1).tolist(),
        "solver": rig.solver,
        "law": list(rig.law),
        "young_kpa": list(rig.young),
        "poisson": rig.poisson,
        "holds": [hold.name for hold in rig.holds],
        "pads": pads,
        "loads": [load.name for load in rig.loads],
        "markers": rig.n_markers,
        "forces": rig.forces,
    }


def all_plans():
    """Return all experiments: nulls, single effects, effects outside the catalogue, pairs, those of the boxes."""
    rng = np.random.default_rng(20270)
    rigs = summaries()
    half, drawn = halves(), [name for name in names() if name.startswith("rig")]
    plans = [Plan(name, "null", (), None, 1000 + k) for k, name in enumerate(names())]
    load = dict.fromkeys(drawn, 0)
    seed = iter(range(2000, 9000))

    def place(effects, taken, wanted):
        some = [n for n in drawn if all(suits(e, rigs[n]) for e in effects) and n not in taken]
        preferred = [n for n in some if half[n] == wanted] or some
        least = min(load[n] for n in preferred)
        chosen = str(rng.choice([n for n in preferred if load[n] == least]))
        load[chosen] += 1
        taken.add(chosen)
        return chosen

    ids = list(dict.fromkeys(effect.id for effect in CATALOGUE))
    for turn in range(EACH):
        for number, cause in enumerate(ids):
            forms = [k for k, effect in enumerate(CATALOGUE) if effect.id == cause]
            index = forms[turn % len(forms)]
            taken = {p.rig for p in plans if p.kind == "single" and CATALOGUE[p.parts[0][1]].id == cause}
            rig = place([CATALOGUE[index]], taken, ("dev", "sealed")[(turn + number) % 2])
            # The first form of the rule gave each half two of the levels; what was solved by then stays.
            level = LEVELS[(turn + (number if half[rig] == "dev" else number // 2)) % 4]
            plans.append(Plan(rig, "single", (("catalogue", index),), level, next(seed)))
    for number in range(N_OUTSIDE):
        index = number % len(OUTSIDE)
        taken = {p.rig for p in plans if p.kind == "outside" and p.parts[0][1] == index}
        rig = place([OUTSIDE[index]], taken, ("dev", "sealed")[(number + number // len(OUTSIDE)) % 2])
        plans.append(Plan(rig, "outside", (("outside", index),), LEVELS[1 + number % 3], next(seed)))
    for number, pair in enumerate(PAIRS):
        parts = tuple(("catalogue", next(k for k, e in enumerate(CATALOGUE) if e.id == cause)) for cause in pair)
        rig = place([CATALOGUE[k] for _, k in parts], set(), ("dev", "sealed")[number % 2])
        plans.append(Plan(rig, "pair", parts, 50.0, next(seed)))
    boxes = [name for name in names() if name.startswith("box")]
    gain, ball = (next(k for k, e in enumerate(CATALOGUE) if e.id == c) for c in ("actuator_gain", "inclusion"))
    parts = (("catalogue", gain), ("catalogue", ball))
    plans += [Plan(name, "pair", parts, None, next(seed)) for name in boxes]
    return plans + _third_plans(rigs)


def _third_plans(rigs):
    """Return the experiments of the third draw: nulls, every effect outside the catalogue twice, inclusions."""
    rng, load, seed = np.random.default_rng(20271), dict.fromkeys(third(), 0), iter(range(12000, 19000))
    plans = [Plan(name, "null", (), None, 11000 + k) for k, name in enumerate(third())]
    balls = [k for k, effect in enumerate(CATALOGUE) if effect.id == "inclusion"]
    wanted = [("outside", k % len(OUTSIDE), LEVELS[1 + k % 3]) for k in range(2 * len(OUTSIDE))]
    wanted += [("catalogue", balls[k % len(balls)], LEVELS[k % 4]) for k in range(8)]
    # Effects that one code alone can make choose first.
    order = sorted(wanted, key=lambda one: len({"catalogue": CATALOGUE, "outside": OUTSIDE}[one[0]][one[1]].codes))
    for which, index, level in order:
        effect = {"catalogue": CATALOGUE, "outside": OUTSIDE}[which][index]
        taken = {p.rig for p in plans if p.parts == ((which, index),)}
        some = [n for n in third() if suits(effect, rigs[n]) and n not in taken]
        least = min(load[n] for n in some)
        rig = str(rng.choice([n for n in some if load[n] == least]))
        load[rig] += 1
        plans.append(Plan(rig, "outside" if which == "outside" else "single", ((which, index),), level, next(seed)))
    return plans
