"""What the simulation of a body gets wrong, step by step."""

import platform
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg._version import __version__
from tissuereg.diagnose.advice import advise
from tissuereg.diagnose.answer import Diagnosis, Finding
from tissuereg.diagnose.bank import make_bank
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes import CAUSES
from tissuereg.diagnose.correction import Correction, make_correction
from tissuereg.diagnose.discrepancy import describe
from tissuereg.diagnose.evidence import Null
from tissuereg.diagnose.fit import Target, fit
from tissuereg.diagnose.generic import generic_columns
from tissuereg.diagnose.misfit import Battery, smooth_subspaces
from tissuereg.diagnose.noise import Noise, estimate_noise
from tissuereg.diagnose.nuisances import Nuisances, make_nuisances
from tissuereg.diagnose.nulls import draw_nulls
from tissuereg.diagnose.proof import BEFORE, BELIEVED, GENERIC, NAMED
from tissuereg.diagnose.refined import path_of, refined_predictions
from tissuereg.diagnose.screen import UNKNOWN, Screen, probabilities
from tissuereg.diagnose.search import SEPARABLE, Search, Step, asked_of, search
from tissuereg.diagnose.signals import Layout
from tissuereg.diagnose.targets import target_rms
from tissuereg.effects import Effect, Stiffness
from tissuereg.experiment import Experiment

#: Misfit less likely than this is one.
MISFIT = 0.01

#: Causes that leave a misfit must explain this share of what the believed model leaves, or nothing is named.
EXPLAINED = 0.5

#: A misfit less likely than this is clear: that share must be explained where it stands out most, too. What a mesh
#: leaves of a strong effect is less clear.
CLEAR = 0.001

#: The modulus is a finding beyond this many prior deviations.
STIFFNESS = 3.0

#: Ids in one group at most.
MOST_IN_GROUP = 3

#: A cause is in the group of the one found if it passes the threshold too, or is this share as likely.
AS_LIKELY = 0.1

#: Log Bayes factors are divided by this before they become probabilities: the models of mesh error and noise are not
#: exact.
TEMPER = 2.0

#: Share of a cause's probability that goes to something outside the catalogue that looks like it, which no evidence
#: tells: of 159 findings surer than 0.8 on the blind bench seven were such effects.
LOOK_ALIKE = 0.04


def diagnose_body(
    experiment: Experiment,
    *,
    seed: int,
    threads: int,
    keep: bool,
    element: str,
    progress: Callable[[str], None] | None,
) -> Diagnosis:
    """Return what the simulation of a body gets wrong; see `tissuereg.diagnose.diagnose`."""
    layout = Layout(experiment)
    noise = estimate_noise(experiment, layout)
    bench = Bench(experiment, layout, element=element, threads=threads)
    bank = make_bank(bench, keep=keep, progress=progress)
    fine, others = refined_predictions(bench, path_of(experiment) if keep else None, progress=progress)
    correction = make_correction(layout, bench.base, fine)
    nuisances = make_nuisances(bench, others - fine)
    correction = _at_modulus(bench, noise, correction, nuisances)
    white = noise.whitened(correction.of_columns(nuisances.columns), layout)
    null, rest = Null(white), Null(white[nuisances.but("stiffness")])
    generic = generic_columns(bench, float(noise.marker_std.mean()))
    if progress is not None:
        progress("screening")
    screen = Screen(bank, generic, noise, layout, correction, null)
    nulls = draw_nulls(screen, null, noise, layout, list(others - fine), seed)
    target = Target(bench, noise, correction, rest)
    found = search(target, screen, nulls.thresholds, progress=progress)
    battery = Battery(layout, smooth_subspaces(layout, bench.base, bench.extent, noise))
    before = target.null.reduced(found.base.residual)
    misfit = battery.judge(before, found.reduced, nulls.residuals)
    findings = _findings(target, found, nulls.thresholds)
    share = min(misfit.explained, misfit.explained_there) if misfit.p < CLEAR else misfit.explained
    if misfit.p < MISFIT and share < EXPLAINED:
        # What was found is at best the nearest thing to what is there.
        findings, found = [], found.taken_back(target)
        misfit = battery.judge(before, found.reduced, nulls.residuals)
    verdict = _verdict(findings, misfit.p)
    effects: tuple[Effect, ...] = found.final.effects(bench.young)
    if abs(found.final.x[0]) > 1e-6 and found.final.covariance[0, 0] < (0.5 * bench.young_spread) ** 2:
        young = found.final.young(bench.young)
        if not any(isinstance(effect, Stiffness) for effect in effects):
            effects = (Stiffness(young_kpa=young), *effects)
    extended = replace(experiment, effects=(*experiment.effects, *effects))
    findings = _with_targets(findings, experiment, extended, threads)
    return Diagnosis(
        verdict=verdict,
        findings=tuple(findings),
        candidates=_candidates(screen, found.steps[0]),
        p_misfit=misfit.p,
        discrepancy=describe(layout, noise, found.base, found.final),
        extended=extended,
        next_experiment=advise(target, found.steps, findings),
        seed=seed,
        versions={"tissuereg": __version__, "numpy": np.__version__, "python": platform.python_version()},
        details={
            "search": found,
            "layout": layout,
            "noise": noise,
            "target": target,
            "nuisances": nuisances,
            "thresholds": nulls.thresholds,
        },
    )


def _at_modulus(bench: Bench, noise: Noise, correction: Correction, nuisances: Nuisances) -> Correction:
    """Return a correction with the modulus that forces ask for, if it scales them alone."""
    if not bench.scales_forces:
        return correction
    others = noise.whitened(correction.of_columns(nuisances.columns[nuisances.but("stiffness")]), bench.layout)
    found = fit(Target(bench, noise, correction, Null(others)), [])
    return correction if found is None else replace(correction, modulus=found.young(1.0))


def _with_targets(findings: list[Finding], experiment: Experiment, extended: Experiment, threads: int) -> list[Finding]:
    """Return findings with what they gain, all together, at inner targets; as they are where there are none."""
    if not findings or not experiment.targets:
        return findings
    gains = {
        "target_rms_base_mm": target_rms(experiment, threads),
        "target_rms_named_mm": target_rms(extended, threads),
    }
    return [replace(finding, held_out={**finding.held_out, **gains}) for finding in findings]


def _verdict(findings: list[Finding], misfit: float) -> str:
    if not findings:
        return "consistent" if misfit > MISFIT else "unexplained"
    return "group" if any(len(finding.group) > 1 for finding in findings) else "named"


def _findings(target: Target, found: Search, thresholds: Mapping[str, float]) -> list[Finding]:
    findings = []
    young = target.bench.young
    for part, step in enumerate(step for step in found.steps if step.found is not None):
        top = step.found
        assert top is not None  # of those steps
        # Parameters are those of the model with all causes found.
        values, deviations = found.final.values(part, young)
        chances = _chances(step)
        asked = asked_of(thresholds, further=part > 0)
        findings.append(
            Finding(
                id=top.id,
                group=group_of(step, thresholds[top.id]),
                probability=chances.get(top.id, 0.0),
                log_bayes_factor=top.gain,
                threshold=asked[top.id],
                parameters=values,
                deviations=deviations,
                held_out=_held_out(target, step),
                sentence=CAUSES[top.id].sentence(values),
            )
        )
    stiff = _stiffness(target, found)
    return ([stiff] if stiff is not None else []) + findings


def group_of(step: Step, threshold: float) -> tuple[str, ...]:
    """Return the cause that a step found, and those that cannot be told from it, likeliest first.

    Parameters
    ----------
    step : Step
        With a cause found.
    threshold : float
        Of that cause, nats.

    Returns
    -------
    tuple of str
        `MOST_IN_GROUP` ids at most.
    """
    top = step.found
    assert top is not None  # as asked
    as_likely = step.close(-TEMPER * np.log(AS_LIKELY))
    close = [c.id for c in step.close(0.5 * SEPARABLE**2) if c.gain > threshold or c in as_likely]
    return (top.id, *close)[:MOST_IN_GROUP]


def _gains(step: Step) -> dict[str, float]:
    """Return log Bayes factors of all causes in a step: of the fitted ones by their fits, of others by the screen."""
    screened = {name: screened.log_bayes_factor for name, screened in step.screened.items()}
    return screened | {candidate.id: candidate.gain for candidate in step.candidates}


def _chances(step: Step) -> dict[str, float]:
    """Return the probabilities of all causes in a step."""
    gains = _gains(step)
    if step.found is not None:
        # A proof on held-out data has told cause and patch apart.
        gains[UNKNOWN] = min(gains[UNKNOWN], step.found.gain - float(_margin(step)))
    chances = probabilities(gains, TEMPER)
    own = {name: chances[name] for name in CAUSES if name in chances}
    unknown = chances[UNKNOWN] + LOOK_ALIKE * sum(own.values())
    return {**chances, **{name: (1.0 - LOOK_ALIKE) * chance for name, chance in own.items()}, UNKNOWN: unknown}


def _margin(step: Step) -> float:
    assert step.proof is not None  # found causes were proved
    density = step.proof.log_density.sum(axis=1)
    return float(density[NAMED] - density[GENERIC])


def _stiffness(target: Target, found: Search) -> Finding | None:
    """Return the modulus as a finding where it lies beyond its prior and the data tell it."""
    final, believed = found.final, target.bench.young
    excess = float(np.expm1(final.x[0])) / target.bench.young_spread
    spread = float(np.sqrt(final.covariance[0, 0])) / target.bench.young_spread
    if abs(excess) < STIFFNESS or spread > 0.3 or "stiffness" in final.ids:
        return None
    young = final.young(believed)
    values = {"young_kpa": young}
    gain = 0.5 * (excess**2 - STIFFNESS**2)
    return Finding(
        id="stiffness",
        group=("stiffness",),
        probability=float((1.0 - LOOK_ALIKE) / (1.0 + np.exp(-gain / TEMPER))),
        log_bayes_factor=0.5 * excess**2,
        threshold=0.5 * STIFFNESS**2,
        parameters=values,
        deviations={"young_kpa": young * float(np.sqrt(final.covariance[0, 0]))},
        held_out={},
        sentence=CAUSES["stiffness"].sentence(values),
    )


def _held_out(target: Target, step: Step) -> dict[str, object]:
    """Return the figures of a finding's proof: residuals in mm, and over their noise with forces."""
    assert step.proof is not None  # found causes were proved
    assert step.figures is not None
    layout, noise = target.bench.layout, target.noise
    markers = layout.of_markers() & layout.seen
    chi = [_rms(row[layout.seen & np.isfinite(row)]) for row in step.figures.left]
    typical = float(noise.marker_std.mean())
    rms = [typical * _rms(row[markers & np.isfinite(row)]) for row in step.figures.left]
    return {
        "rms_base_mm": rms[BELIEVED],
        "rms_named_mm": rms[NAMED],
        "rms_generic_mm": rms[GENERIC],
        "noise_mm": typical,
        "chi_base": chi[BELIEVED],
        "chi_named": chi[NAMED],
        "chi_generic": chi[GENERIC],
        "log_density_gain": float(step.proof.log_density[NAMED].sum() - step.proof.log_density[BEFORE].sum()),
        "cases": list(step.figures.blocks),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _candidates(screen: Screen, first: Step) -> tuple[dict[str, Any], ...]:
    """Return every id that was tried in the first step, likeliest first."""
    chances, gains = _chances(first), _gains(first)
    rows: list[dict[str, Any]] = []
    for name in [*CAUSES, UNKNOWN]:
        if name in gains:
            best = first.screened[name].best
            seen = screen.detectability(name, best, first.screened[name].amplitudes) if best is not None else 0.0
            rows.append(
                {
                    "id": name,
                    "probability": chances.get(name, 0.0),
                    "log_bayes_factor": gains[name],
                    "detectability": seen,
                }
            )
    return tuple(sorted(rows, key=lambda row: -float(row["log_bayes_factor"])))
