"""What the simulation of a body gets wrong, step by step."""

import platform
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg._version import __version__
from tissuereg.diagnose.advice import advise
from tissuereg.diagnose.answer import Diagnosis, Finding
from tissuereg.diagnose.bank import make_bank
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.correction import Correction, make_correction
from tissuereg.diagnose.discrepancy import describe
from tissuereg.diagnose.evidence import Null
from tissuereg.diagnose.findings import candidates_of, findings_of
from tissuereg.diagnose.fit import Target, fit
from tissuereg.diagnose.generic import generic_columns
from tissuereg.diagnose.left import left_of, looks_like
from tissuereg.diagnose.misfit import Battery, Misfit, smooth_subspaces
from tissuereg.diagnose.noise import Noise, estimate_noise
from tissuereg.diagnose.nuisances import Nuisances, make_nuisances
from tissuereg.diagnose.nulls import draw_nulls
from tissuereg.diagnose.refined import path_of, refined_predictions
from tissuereg.diagnose.screen import Screen
from tissuereg.diagnose.search import Search, search
from tissuereg.diagnose.signals import Layout
from tissuereg.diagnose.targets import target_rms
from tissuereg.diagnose.whereabouts import next_check
from tissuereg.effects import Effect, Stiffness
from tissuereg.experiment import Experiment

#: Misfit less likely than this is one.
MISFIT = 0.01

#: Causes that leave a misfit must explain this share of what the believed model leaves, of all of it and where it
#: stands out most, or nothing is named; of all of it alone where one gains far more than any rival.
EXPLAINED = 0.5


def diagnose_body(
    experiment: Experiment,
    *,
    seed: int,
    threads: int,
    keep: bool,
    element: str | None,
    progress: Callable[[str], None] | None,
) -> Diagnosis:
    """Return what the simulation of a body gets wrong; see `tissuereg.diagnose.diagnose`."""
    experiment = _own_modulus(experiment)
    said = experiment.simulated
    element = element or (said.element if said is not None and said.model == "plain" else "tet4")
    layout = Layout(experiment)
    noise = estimate_noise(experiment, layout)
    bench = Bench(experiment, layout, element=element, threads=threads)
    bank = make_bank(bench, keep=keep, progress=progress)
    believed = make_believed(bench, noise, keep=keep, progress=progress)
    target, nuisances, null = believed.target, believed.nuisances, believed.null
    generic = generic_columns(bench, float(noise.marker_std.mean()))
    if progress is not None:
        progress("screening")
    screen = Screen(bank, generic, noise, layout, target.correction, null)
    nulls = draw_nulls(screen, null, noise, layout, list(believed.mesh_errors), seed)
    found = search(target, screen, nulls.thresholds, progress=progress)
    battery = Battery(layout, smooth_subspaces(layout, bench.base, bench.extent, noise))
    before = target.null.reduced(found.base.residual)
    misfit = battery.judge(before, found.reduced, nulls.residuals)
    findings = findings_of(target, screen, found, nulls.thresholds)
    taken_back = bool(findings) and not _stands(misfit, found)
    if taken_back:
        # What was found is at best the nearest thing to what is there.
        findings, found = [], found.taken_back(target)
        misfit = battery.judge(before, found.reduced, nulls.residuals)
    verdict = _verdict(findings, misfit.p, taken_back=taken_back)
    effects: tuple[Effect, ...] = found.final.effects(bench.young)
    if abs(found.final.x[0]) > 1e-6 and found.final.covariance[0, 0] < (0.5 * bench.young_spread) ** 2:
        young = found.final.young(bench.young)
        if not any(isinstance(effect, Stiffness) for effect in effects):
            effects = (Stiffness(young_kpa=young), *effects)
    extended = replace(experiment, effects=(*experiment.effects, *effects))
    findings = _with_targets(findings, experiment, extended, element=element, threads=threads)
    following = advise(target, found.steps, findings)
    if verdict == "unexplained":
        following = next_check(bench, found.reduced, looks_like(screen, found))
    return Diagnosis(
        verdict=verdict,
        findings=tuple(findings),
        candidates=candidates_of(screen, found.steps[0]),
        p_misfit=misfit.p,
        left=left_of(layout, screen, found, misfit) if findings and misfit.p < MISFIT else None,
        discrepancy=describe(layout, found.base, found.final),
        extended=extended,
        next_experiment=following,
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


@dataclass(frozen=True, eq=False)
class Believed:
    """The believed model as it is held against the data.

    Attributes
    ----------
    target : Target
        What is fitted, the mesh's error corrected.
    nuisances : Nuisances
        What is fitted beside.
    null : Null
        All of them, the modulus among them.
    mesh_errors : ndarray of float64, shape (n_meshes, size)
        Other fine meshes less the one that corrects, mm and mN.
    """

    target: Target
    nuisances: Nuisances
    null: Null
    mesh_errors: FloatArray


def make_believed(
    bench: Bench, noise: Noise, *, keep: bool = True, progress: Callable[[str], None] | None = None
) -> Believed:
    """Return the believed model with its mesh's error corrected, and what is uncertain about it.

    Parameters
    ----------
    bench : Bench
        The believed model.
    noise : Noise
        Of the measurement.
    keep : bool
        Whether answers of fine meshes are kept in the cache, and read from it.
    progress : callable of str, optional
        Called with what is at work.

    Returns
    -------
    Believed

    Raises
    ------
    ConvergenceError
        If a frame finds no equilibrium on a fine mesh.
    """
    layout = bench.layout
    if bench.is_exact:
        fine, others = bench.base, np.zeros((0, layout.size))
    else:
        fine, others = refined_predictions(bench, path_of(bench.experiment) if keep else None, progress=progress)
    correction = make_correction(layout, bench.base, fine)
    nuisances = make_nuisances(bench, others - fine, correction)
    correction = _at_modulus(bench, noise, correction, nuisances)
    white = noise.whitened(correction.at_modulus(nuisances.columns), layout)
    target = Target(bench, noise, correction, Null(white[nuisances.but("stiffness")]))
    return Believed(target, nuisances, Null(white), others - fine)


def _at_modulus(bench: Bench, noise: Noise, correction: Correction, nuisances: Nuisances) -> Correction:
    """Return a correction with the modulus that forces ask for, if it scales them alone."""
    if not bench.scales_forces:
        return correction
    others = noise.whitened(correction.at_modulus(nuisances.columns[nuisances.but("stiffness")]), bench.layout)
    found = fit(Target(bench, noise, correction, Null(others)), [])
    return correction if found is None else replace(correction, modulus=found.young(1.0))


def _with_targets(
    findings: list[Finding], experiment: Experiment, extended: Experiment, *, element: str, threads: int
) -> list[Finding]:
    """Return findings with what they gain, all together, at inner targets; as they are where there are none."""
    if not findings or not experiment.targets:
        return findings
    gains = {
        "target_rms_base_mm": target_rms(experiment, element=element, threads=threads),
        "target_rms_named_mm": target_rms(extended, element=element, threads=threads),
    }
    return [replace(finding, held_out={**finding.held_out, **gains}) for finding in findings]


def _own_modulus(experiment: Experiment) -> Experiment:
    """Return an experiment whose material has the modulus that its effects state: fits and forces scale that one."""
    stated = [effect for effect in experiment.effects if isinstance(effect, Stiffness)]
    if not stated:
        return experiment
    young, before = stated[-1].young_kpa, float(experiment.material.young_array.mean())
    spread = None if experiment.young_std is None else experiment.young_std * young / before
    others = tuple(effect for effect in experiment.effects if not isinstance(effect, Stiffness))
    return replace(experiment, material=replace(experiment.material, young=young), young_std=spread, effects=others)


def _stands(misfit: Misfit, found: Search) -> bool:
    """Say whether findings may be named: they leave no misfit, explain enough of one, or beat all else by far."""
    if misfit.p >= MISFIT or min(misfit.explained, misfit.explained_there) >= EXPLAINED:
        return True
    return misfit.explained >= EXPLAINED and any(step.is_clear for step in found.steps)


def _verdict(findings: list[Finding], misfit: float, *, taken_back: bool) -> str:
    if not findings:
        return "consistent" if misfit >= MISFIT and not taken_back else "unexplained"
    return "group" if any(len(finding.group) > 1 for finding in findings) else "named"
