"""Counts behind docs/material.md: synthetic material tests with and without hidden effects, many seeds.

    python -m diagnosis.material [--seeds 4] [--null-seeds 40] [--only WORD] [--json FILE]

Data come from `tests/support/material_curves.py` (textbook formulas of an incompressible solid, laws among them that
the package does not own); white noise of 1 % of a curve's peak, specimens that differ by 5 %, a believed modulus that
is off by 25 % (standard deviation 30 %).
"""

import argparse
import json
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np

from support import material_curves as made
from support.material_curves import believed, histories, in_modes
from tissuereg.diagnosis.material import diagnose_material
from tissuereg.experiment.material_experiment import Curve

PLAIN = ("plain",)
Maker = Callable[[np.random.Generator], list[Curve]]


def relaxing(kernel, law=PLAIN):
    """Return the answer of a relaxing solid."""
    return lambda mode, times, strain: made.relaxed(law, mode, times, strain, kernel)


def cycled(answer, **options) -> Maker:
    """Return a maker of curves along loading and unloading at one rate."""
    return lambda rng: histories(rng, answer, path="cycles", rates=(0.01,), **options)


BARS = ("tension", "compression")
PRONY = made.prony((0.4, 8.0))
PAIR_FUNG = relaxing(PRONY, ("fung", 2.0))
PAIR_OGDEN = relaxing(PRONY, ("ogden", -12.0))
NULLS: dict[str, Maker] = {
    "three modes": lambda rng: in_modes(rng, PLAIN),
    "three modes, three specimens": lambda rng: in_modes(rng, PLAIN, specimens=("a", "b", "c")),
    "compression, two specimens": lambda rng: in_modes(rng, PLAIN, modes=("compression",), specimens=("a", "b")),
    "holds at two rates": lambda rng: histories(rng, lambda m, t, e: made.elastic(PLAIN, m, e)),
    "cycles": cycled(lambda m, t, e: made.elastic(PLAIN, m, e)),
}
HIDDEN: dict[str, tuple[set[str], Maker]] = {
    "stiffening (Fung)": ({"stiffening"}, lambda rng: in_modes(rng, ("fung", 1.0))),
    "stiffening (Gent)": ({"stiffening"}, lambda rng: in_modes(rng, ("gent", 1.0))),
    "stiffening, one mode": (
        {"stiffening"},
        lambda rng: in_modes(rng, ("gent", 0.8), modes=("compression",), specimens=("a", "b", "c")),
    ),
    "second invariant": ({"mooney"}, lambda rng: in_modes(rng, ("mooney", 0.7))),
    "asymmetry (-15)": ({"asymmetry"}, lambda rng: in_modes(rng, ("ogden", -15.0))),
    "asymmetry (-6)": ({"asymmetry"}, lambda rng: in_modes(rng, ("ogden", -6.0))),
    "asymmetry (12)": ({"asymmetry"}, lambda rng: in_modes(rng, ("ogden", 12.0))),
    "fibres": ({"fibre"}, lambda rng: in_modes(rng, ("fibre", 1.0, 1.0))),
    "modulus x 4.5": ({"stiffness"}, lambda rng: in_modes(rng, PLAIN, mu=4.5 * made.MU)),
    "relaxation, one time": ({"relaxation"}, lambda rng: histories(rng, relaxing(PRONY))),
    "relaxation, power law": (
        {"relaxation"},
        lambda rng: histories(rng, relaxing(lambda t: (1.0 + t) ** -0.12)),
    ),
    "relaxation, 12 %": ({"relaxation"}, lambda rng: histories(rng, relaxing(made.prony((0.12, 8.0))))),
    "viscosity": ({"rate"}, lambda rng: histories(rng, lambda m, t, e: made.viscous(m, t, e, 2.0))),
    "softening": ({"softening"}, cycled(lambda m, t, e: made.softened(m, e, 2.5, 0.15))),
    "set": ({"set"}, cycled(lambda m, t, e: made.left_strained(m, e, 0.12), modes=BARS)),
    "relaxation and stiffening": (
        {"relaxation", "stiffening"},
        lambda rng: histories(rng, PAIR_FUNG, modes=BARS),
    ),
    "relaxation and asymmetry": (
        {"relaxation", "asymmetry"},
        lambda rng: histories(rng, PAIR_OGDEN, modes=BARS),
    ),
}
OUTSIDE = {
    "yield": lambda m, e, p: np.sign(p) * np.minimum(np.abs(p), 0.55 * np.abs(p).max()),
    "a grip that slips": lambda m, e, p: np.where(np.abs(e) > 0.5 * np.abs(e).max(), 0.7 * p, p),
    "a load cell's offset": lambda m, e, p: p + {"tension": 0.4, "simple-shear": -0.3}.get(m, 0.0) * np.ptp(p),
    "a wave along the path": lambda m, e, p: p + 0.15 * np.abs(p).max() * np.sin(14.0 * np.abs(e) / np.abs(e).max()),
    "a factor a mode": lambda m, e, p: p * {"tension": 1.4, "simple-shear": 0.75}.get(m, 1.0),
}


def outcome(maker: Maker, seed: int) -> tuple[str, list[list[str]]]:
    """Return verdict and groups of one experiment."""
    rng = np.random.default_rng(seed)
    young = 10.0 * float(np.exp(0.25 * rng.standard_normal()))
    answer = diagnose_material(believed(maker(rng), young), seed=seed).to_json()
    return answer["verdict"], [cause["group"] for cause in answer["causes"]]


def judged(truth: set[str], groups: list[list[str]]) -> str:
    """Return ``exact``, ``in group``, ``missed`` or ``wrong``."""
    if any(not truth & set(group) for group in groups) or len(groups) > len(truth):
        return "wrong"
    found = {id for group in groups for id in group}
    if not truth <= found:
        return "missed"
    return "exact" if {group[0] for group in groups} == truth else "in group"


def main() -> int:
    """Run, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=4, help="of every hidden effect")
    parser.add_argument("--null-seeds", type=int, default=40, help="of every experiment without an effect")
    parser.add_argument("--only", default="", help="a word in the names of those to run")
    parser.add_argument("--json", type=Path, help="file for the counts")
    options = parser.parse_args()
    rows: dict[str, dict[str, int]] = {}

    def count(name: str, n: int, verdict_of: Callable[[int], str]) -> None:
        if options.only in name:
            verdicts = [verdict_of(seed) for seed in range(n)]
            rows[name] = {verdict: verdicts.count(verdict) for verdict in dict.fromkeys(verdicts)}
            print(f"{name:45s} {rows[name]}", flush=True)

    for name, maker in NULLS.items():
        count(f"null: {name}", options.null_seeds, lambda seed, maker=maker: outcome(maker, seed)[0])
    for name, (truth, maker) in HIDDEN.items():
        count(f"hidden: {name}", options.seeds, lambda seed, t=truth, maker=maker: judged(t, outcome(maker, seed)[1]))
    for name, change in OUTSIDE.items():
        maker = lambda rng, change=change: in_modes(rng, PLAIN, change=change)  # noqa: E731
        count(f"outside: {name}", options.seeds, lambda seed, maker=maker: outcome(maker, seed)[0])
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
