"""Makes the experiments of a rig: solves the truths, finds sizes of effects, stores cases and answers."""

import time

import numpy as np

from rigs.generator.cases import force_noise, length_of, measured_norm, write_case, young_factor
from rigs.generator.jobs import BUILD, Bench, keep, stored, write_mesh
from rigs.generator.newton import NoEquilibriumError
from rigs.generator.plans import all_plans, effects_of
from rigs.generator.rigs import make
from rigs.generator.truth import Memory, Truth

#: Sizes of the pairs on boxes: gain and contrast less one.
BOX_SIZES = (0.15, 3.0)

#: Each cause of a pair is alone of this length.
ALONE = 35.0


def joined(settings):
    """Return the settings of Truth of several effects together."""
    found = {}
    for one in settings:
        for key, value in one.items():
            if key == "contrast" and key in found:
                before = found[key]
                found[key] = lambda p, a=before, b=value: a(p) * b(p)
            elif key == "memory" and key in found:
                old = found[key]
                found[key] = Memory(
                    old.relaxing or value.relaxing,
                    old.draining or value.draining,
                    old.viscosity or value.viscosity,
                    old.damage or value.damage,
                    old.kept or value.kept,
                )
            elif key == "support" and key in found:
                found[key] = {**found[key], **value}
            else:
                found[key] = value
    return found


def _built(bench, plan, sizes):
    parts = [e.build(bench, plan.rng(k), s) for k, (e, s) in enumerate(zip(effects_of(plan), sizes, strict=True))]
    return joined([settings for settings, _ in parts]), [parameters for _, parameters in parts]


def _factor(bench, clean, level):
    """Return the factor on the noise, half to twice, at which a change is as long as its level asks."""
    factors = np.geomspace(0.5, 2.0, 41)
    lengths = np.array([length_of(bench.rig, clean, bench.null, f) for f in factors])
    return float(np.exp(np.interp(-np.log(level), -np.log(lengths), np.log(factors))))


def _try(bench, plan, sizes, factor):
    """Return readings, parameters and length; a size that has no equilibrium is halved."""
    for _ in range(4):
        settings, parameters = _built(bench, plan, sizes)
        try:
            clean = bench.solve(Truth(**settings))
        except NoEquilibriumError:
            sizes = tuple(0.55 * s for s in sizes)
            continue
        return clean, parameters, length_of(bench.rig, clean, bench.null, factor), sizes
    raise NoEquilibriumError


def solve(bench, plan):
    """Solve the truth of a plan at the size that its level asks for; store the readings."""
    begun = time.perf_counter()
    effects = effects_of(plan)
    factor = float(2 ** plan.rng(90).uniform(-0.9, 0.9))
    sizes = tuple(e.sizes[0] for e in effects)
    alone = []
    if plan.kind == "null" or effects[0].id == "stiffness":
        clean, length = bench.null, 0.0
        if plan.kind != "null":
            sizes = (float(plan.rng(91).uniform(*effects[0].sizes)),)
        _, parameters = _built(bench, plan, sizes)
    elif plan.rig.startswith("box"):
        clean, parameters, length, sizes = _try(bench, plan, BOX_SIZES, factor)
    elif plan.kind == "pair":
        wanted = []
        for k, effect in enumerate(effects):
            # What a part draws depends on its place in the pair.
            settings, _ = effect.build(bench, plan.rng(k), sizes[k])
            d = length_of(bench.rig, bench.solve(Truth(**settings)), bench.null, factor)
            wanted.append(min(sizes[k] * (ALONE / max(d, 1e-6)) ** (1 / effect.power), effect.sizes[1]))
            alone.append(d * (wanted[-1] / sizes[k]) ** effect.power)
        clean, parameters, length, sizes = _try(bench, plan, tuple(wanted), factor)
    else:
        first = sizes[0] * float(np.clip(plan.level / 25.0, 0.3, 2.5)) ** (1 / effects[0].power)
        clean, parameters, length, sizes = _try(bench, plan, (min(first, effects[0].sizes[1]),), factor)
        for _ in range(1 if Truth(**_built(bench, plan, sizes)[0]).timed else 2):
            scale = plan.level / max(length, 1e-6)
            if 0.6 <= scale <= 1.6 or (scale > 1 and sizes[0] >= 0.999 * effects[0].sizes[1]):
                break
            clean, parameters, length, sizes = _try(
                bench, plan, (min(sizes[0] * scale ** (1 / effects[0].power), effects[0].sizes[1]),), factor
            )
    if plan.level and plan.kind != "pair" and length:
        # The noise takes what the size left over.
        factor = _factor(bench, clean, plan.level)
        length = length_of(bench.rig, clean, bench.null, factor)
    summary = {
        "kind": plan.kind,
        "cause": [e.id for e in effects] if plan.kind in ("single", "pair") else [],
        "outside": [e.id for e in effects] if plan.kind == "outside" else [],
        "forms": [e.form for e in effects],
        "own_form": [e.own for e in effects],
        "parameters": parameters,
        "sizes": sizes,
        "level": plan.level if length and abs(length / (plan.level or 1) - 1) < 0.05 else None,
        "detectability": length,
        "of_markers": measured_norm(bench.rig, clean, bench.null) / factor,
        "alone": alone,
        "noise_factor": factor,
        "std_mn": force_noise(bench.null),
        "code": bench.solver.code,
        "n_nodes": len(bench.solver.skeleton.places),
        "seconds": time.perf_counter() - begun,
    }
    keep(plan.rig, plan.key, clean, summary)
    return summary


def write(plan):
    """Store the case of a plan whose readings are there; return its answer, or None."""
    found = stored(plan.rig, plan.key)
    if found is None:
        return None
    clean, summary = found
    rig, rng = make(plan.rig), plan.rng(95)
    share = young_factor(rig, rng)
    gravity = None
    if "stiffness" in summary["cause"]:
        share = summary["parameters"][0]["young_kpa"] / rig.young[0]
    if "reference" in summary["cause"]:
        gravity = dict(summary["parameters"][0])
        gravity["g_mm_per_s2"] *= share
    write_case(plan.name, rig, clean, share, summary["noise_factor"], summary["std_mn"], rng, gravity)
    return {
        **{k: summary[k] for k in ("kind", "cause", "outside", "forms", "own_form", "parameters", "level")},
        **{k: summary[k] for k in ("detectability", "of_markers", "alone", "code", "n_nodes")},
        "young_kpa": rig.young[0] * share,
        "group_ok": sorted(summary["cause"]),
        "std_mm": 0.1 * summary["noise_factor"],
        "forces_given": rig.forces,
        "body": rig.body.kind,
        "readings": sorted({pad.reading for pad in rig.pads}),
        "law": rig.law[0],
    }


def run(rigs, report=print, kinds=("null", "single", "outside", "pair"), most=10**9):
    """Solve what is missing on the given rigs."""
    by_rig = {}
    for plan in all_plans():
        failed = BUILD / "clean" / plan.rig / f"{plan.key}.failed"
        done = (BUILD / "clean" / plan.rig / f"{plan.key}.npz").exists() or failed.exists()
        if plan.rig in rigs and plan.kind in kinds and not done:
            by_rig.setdefault(plan.rig, []).append(plan)
    for name in [n for n in rigs if n in by_rig]:
        begun = time.perf_counter()
        # The factors of the rig before are given back first.
        bench = None
        bench = Bench(name)
        write_mesh(bench.rig)
        report(f"{name}: {bench.rig.body.kind}, {bench.solver.code}, {time.perf_counter() - begun:.0f} s")
        for plan in by_rig[name][:most]:
            try:
                summary = solve(bench, plan)
            except (NoEquilibriumError, ValueError) as error:
                failed = BUILD / "clean" / name / f"{plan.key}.failed"
                failed.parent.mkdir(parents=True, exist_ok=True)
                failed.write_text(repr(error), encoding="utf-8")
                report(f"  {plan.key}: {error!r}")
                continue
            report(
                f"  {plan.key} {'+'.join(summary['cause'] or summary['outside'])}: d {summary['detectability']:.1f} "
                f"(level {plan.level}), sizes {np.round(summary['sizes'], 4)}, {summary['seconds']:.0f} s"
            )
