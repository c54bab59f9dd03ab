"""Diagnosis of a body: the sequence of steps from measurements to verdict, each a module (``docs/diagnose.md``)."""

import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Element
from tissuereg._base.machine import give_back
from tissuereg._base.provenance import warn
from tissuereg.diagnosis.advice import advise, describe, nearest_cause, next_check, residual_summary
from tissuereg.diagnosis.answer import BodyDiagnosis, DiagnosisDetails, Finding, to_check, verdict_of, versions_now
from tissuereg.diagnosis.bench import Bench, Targets
from tissuereg.diagnosis.candidates import without
from tissuereg.diagnosis.constancy import Constancy, FittedPart, Membership, fitted_parts, memberships
from tissuereg.diagnosis.correction import Correction, make_correction
from tissuereg.diagnosis.evidence import Null, rms
from tissuereg.diagnosis.fit import Fit, FitTarget, fit
from tissuereg.diagnosis.noise import (
    UNDERSTATED,
    Noise,
    UnderstatedNoise,
    estimate_noise,
    larger_noise,
    understated,
)
from tissuereg.diagnosis.nuisances import Nuisances, make_nuisances
from tissuereg.diagnosis.nulls import Battery, Misfit, Nulls, draw_nulls, smooth_subspaces
from tissuereg.diagnosis.outside import OUTSIDE, Outside, OutsideBank, nearest_of, outside_tests
from tissuereg.diagnosis.readings import RecordingSuspicion, suspect_recording
from tissuereg.diagnosis.refined import entry_of, refined_predictions, refined_targets, solvable
from tissuereg.diagnosis.screen import UNKNOWN, Bank, Screen, make_bank, make_outside
from tissuereg.diagnosis.search import Search, candidates_of, findings_of, possible_of, search
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings, NullSettings
from tissuereg.diagnosis.signals import SignalLayout, generic_columns
from tissuereg.errors import LockingWarning, UnitWarning
from tissuereg.experiment.effects import Effect, Stiffness
from tissuereg.experiment.experiment import Experiment


def diagnose_body(
    experiment: Experiment,
    *,
    seed: int,
    threads: int,
    keep: bool,
    element: Element | None,
    progress: Callable[[str], None] | None,
    settings: DiagnoseSettings,
) -> BodyDiagnosis:
    """Return the diagnosis of a body: the causes of the difference between its measurements and its simulation.

    `threads`: 0 takes all cores; `keep`: whether the cache is used; `element`: elements of the believed model, None for
    the default; `progress`: called with the name of the step that begins. Errors are those of
    `tissuereg.diagnosis.diagnose`.
    """
    experiment = _own_modulus(experiment)
    simulated = experiment.simulated
    plain = simulated is not None and simulated.model == "plain"
    if plain and simulated is not None and simulated.tables_sha256 is None:
        text = (
            "[simulated] has no `tables_sha256`, so that nothing tells whether it is about these tables; delete it if "
            "they were measured"
        )
        warn(text)
    element = element or (simulated.element if simulated is not None and plain else "tet4")
    layout = SignalLayout(experiment)
    noise = estimate_noise(experiment, layout, settings.noise)

    def said(step: str) -> None:
        give_back()
        if progress is not None:
            progress(step)

    said("units and axes")
    suspicions = suspect_recording(experiment, layout, element=element, threads=threads, settings=settings.readings)
    if any(one.log_odds is not None for one in suspicions):
        return _misread(experiment, suspicions, seed, settings)
    bench = Bench(experiment, layout, element=element, threads=threads, settings=settings, progress=said)
    _ = bench.base  # warnings of the believed model are the user's; those of trials are not
    with warnings.catch_warnings():
        for kind in (UnitWarning, LockingWarning):
            warnings.simplefilter("ignore", kind)
        if not bench.is_exact:
            whole, bench = bench, solvable(bench, keep=keep)
            if bench is not whole:
                noise = estimate_noise(bench.experiment, bench.layout, settings.noise)
        found = _searched(bench, noise, silent=bool(suspicions), seed=seed, keep=keep)
    return replace(found, suspicions=tuple(suspicions))


def _searched(bench: Bench, noise: Noise, *, silent: bool, seed: int, keep: bool) -> BodyDiagnosis:
    """Return the diagnosis of a recording that is read rightly; `silent`: no modulus follows from its forces."""
    experiment, layout = bench.experiment, bench.layout
    settings, rules = bench.settings, bench.settings.nulls
    bank = make_bank(bench, keep=keep)
    believed = make_believed(bench, noise, keep=keep)
    outside = cache(partial(make_outside, bench, keep=keep))
    judged = _judged(bank, believed, outside, silent=silent, seed=seed)
    if judged.misfit.p < rules.misfit:
        again = _with_larger_noise(bank, believed, judged, outside, silent=silent, seed=seed)
        if again is not None:
            believed, judged = again
    target, found, findings, misfit = believed.target, judged.found, judged.findings, judged.misfit
    larger = understated(experiment, target.noise, settings.noise)
    verdict = verdict_of(findings, misfit.p, withdrawn=judged.withdrawn or silent, level=rules.misfit)
    if verdict == "consistent" and larger:
        verdict = UNDERSTATED
    effects: tuple[Effect, ...] = found.final.effects(bench.young)
    known = np.sqrt(found.final.covariance[0, 0]) < settings.search.known_modulus * bench.young_spread
    if not silent and abs(found.final.x[0]) > 1e-6 and known:
        young = found.final.young(bench.young)
        if not any(isinstance(effect, Stiffness) for effect in effects):
            effects = (Stiffness(young_kpa=young), *effects)
    extended = replace(experiment, effects=(*experiment.effects, *effects))
    findings = _with_targets(findings, bench, effects)
    following = advise(target, found.steps, findings)
    if verdict == "unexplained":
        following = next_check(bench, found.reduced, _looks_like(judged, believed.null, outside, settings))
    if verdict == UNDERSTATED:
        following = _state_noise(larger)
    return BodyDiagnosis(
        verdict=verdict,
        understated=larger,
        findings=tuple(findings),
        candidates=candidates_of(judged.screen, found.steps[0]),
        possible=(*possible_of(found), *judged.weak),
        constancy=tuple(judged.tested),
        outside=tuple(judged.outside),
        p_misfit=misfit.p,
        left=residual_summary(layout, judged.screen, found, misfit, settings.report)
        if findings and misfit.p < rules.misfit
        else None,
        discrepancy=describe(layout, found.base, found.final, settings.report),
        extended=extended,
        next_experiment=following,
        seed=seed,
        versions=versions_now(),
        numbers=settings,
        details=DiagnosisDetails(found, target, believed.nuisances, judged.nulls.thresholds),
    )


def _looks_like(judged: "_Judged", null: Null, outside: Callable[[], Bank], settings: DiagnoseSettings) -> str:
    """Return in words which effect the data of an unexplained answer resemble most; empty where they resemble none."""
    least, screen, found = settings.report.looks_like, judged.screen, judged.found
    nearest = next((one.nearest for one in judged.outside if not one.holds), None)
    inside = UNKNOWN
    if nearest is None:
        inside, nats = nearest_cause(screen, found, least)
        kinds = OutsideBank(outside(), screen.white).evidence(found.base.residual, null, settings.outside)
        nearest = nearest_of({kind: other for kind, other in kinds.items() if other >= max(least, nats)})
    if nearest is not None:
        return f"outside the catalogue {OUTSIDE[nearest][0]} comes nearest"
    return "" if inside == UNKNOWN else f"the cause of the catalogue that comes nearest is '{inside}'"


@dataclass(frozen=True, eq=False)
class _Judged:
    """The search with a noise model, and the tests of what it found and of what it leaves."""

    screen: Screen
    nulls: Nulls
    found: Search
    #: The best fit, which `found` lacks where its findings are withdrawn.
    best: Fit
    findings: list[Finding]
    misfit: Misfit
    withdrawn: bool
    tested: list[Constancy]
    outside: list[Outside]
    #: Causes that are not probable enough beside these, as plain data for the answer.
    weak: list[dict[str, Any]]


def _judged(bank: Bank, believed: "BelievedModel", outside: Callable[[], Bank], *, silent: bool, seed: int) -> _Judged:
    """Return the causes found under the noise of a believed model; other arguments as for `_searched`."""
    target, null, noise = believed.target, believed.null, believed.target.noise
    bench, layout, settings = target.bench, target.bench.layout, target.bench.settings
    generic = generic_columns(layout, bench.base, bench.extent, float(noise.marker_std.mean()), settings)
    bench.progress("screening")
    screen = Screen(bank, generic, noise, layout, target.correction, null)
    nulls = draw_nulls(screen, null, noise, layout, list(believed.mesh_errors), seed, settings)
    found, parts, tested, given_up = _constant(believed, screen, nulls, seed)
    battery = Battery(layout, smooth_subspaces(layout, bench.base, bench.extent, noise, settings))
    before = target.null.reduced(found.base.residual)
    misfit = battery.judge(before, found.reduced, nulls.residuals)
    findings = findings_of(target, screen, found, nulls.thresholds)
    best, last, rules = found.final, found.target or target, settings.constancy
    members = memberships(parts, screen, rules)
    # A modulus beyond its prior, which then is the first finding, is no part of the fit.
    first = len(findings) - len(best.parts)
    findings = [replace(finding, membership=members.get(at - first)) for at, finding in enumerate(findings)]
    beside: list[Outside] = []
    if best.parts:
        rests = [without(last, best, part) for part in range(len(best.parts))]
        beside = outside_tests(last, best, rests, null, OutsideBank(outside(), screen.white))
        shared = [_beside(finding, one) for finding, one in zip(findings[first:], beside, strict=True)]
        findings = [*findings[:first], *shared]
    findings = [finding for finding in findings if not (silent and finding.id == "stiffness")]
    weak = [finding for finding in findings if finding.group_probability < settings.search.stated]
    enough = _explains_enough(misfit, settings.nulls)
    withdrawn = bool(findings) and not (enough and not weak and all(one.holds for one in tested))
    if withdrawn:
        # At best the findings are the causes most similar to the true one.
        findings, found = [], found.withdrawn(target)
        misfit = battery.judge(before, found.reduced, nulls.residuals)
    beaten = {one.id for one in beside if not one.holds}
    possible = [asdict(finding.as_possible()) for finding in weak if finding.id not in beaten]
    return _Judged(screen, nulls, found, best, findings, misfit, withdrawn, [*tested, *given_up], beside, possible)


def _constant(
    believed: "BelievedModel", screen: Screen, nulls: Nulls, seed: int
) -> tuple[Search, list[FittedPart], list[Constancy], list[Constancy]]:
    """Return the search, its fitted causes, and the constancy tests of these and of causes given up.

    A cause that is not constant is given up with those found after it: the search is repeated, and ends before its
    round. One of the first round is kept for the verdict.
    """
    target, rules = believed.target, believed.target.bench.settings.constancy
    most, given_up = target.bench.settings.search.most_causes, list[Constancy]()
    while True:
        found = search(target, screen, nulls.thresholds, most)
        parts = fitted_parts(found.target or target, found.final, believed.null, nulls.residuals, seed, rules)
        rounds = list(found.rounds())
        tested = [(rounds[part.number], one) for part in parts if (one := part.constancy(rules.level)) is not None]
        first = min((number for number, one in tested if not one.holds), default=0)
        if first == 0:
            return found, parts, [one for _, one in tested], given_up
        most, given_up = first, [*(one for number, one in tested if number >= first), *given_up]


def _beside(finding: Finding, outside: Outside) -> Finding:
    """Return a finding whose probability is shared with effects outside the catalogue."""
    alone = outside.holds_family
    share = outside.family_probability if alone else outside.probability
    own = finding.membership or Membership(finding.id, 1.0, outside.settings.constancy.member_level)
    return replace(
        finding,
        probability=finding.probability * outside.probability,
        group_probability=finding.group_probability * share,
        membership=replace(own, beaten=True) if alone else finding.membership,
    )


def _with_larger_noise(
    bank: Bank, believed: "BelievedModel", first: _Judged, outside: Callable[[], Bank], *, silent: bool, seed: int
) -> "tuple[BelievedModel, _Judged] | None":
    """Return model and answer under larger noise where that alone explains what the best fit leaves, else None."""
    target, best, bench = believed.target, first.best, believed.target.bench
    rows = np.concatenate([target.null.nuisances, target.slopes(best), first.screen.generic_white[-1]])
    noise = larger_noise(target.noise, bench.experiment, bench.layout, best.residual, rows, bench.settings.noise)
    if noise is None:
        return None
    bench.progress("noise larger than stated")
    other = believed.with_noise(noise)
    again = _judged(bank, other, outside, silent=silent, seed=seed)
    # A misfit that remains is no noise.
    return (other, again) if again.misfit.p >= bench.settings.nulls.misfit and not again.withdrawn else None


def _state_noise(larger: Sequence[UnderstatedNoise]) -> dict[str, Any]:
    """Return what to do about understated noise, as the next experiment of an answer."""
    write = " and ".join(f"{one.estimated:.3g} {one.unit} for {one.channel}" for one in larger)
    action = f"state a noise of {write}, or find out why it is larger than stated, then diagnose again"
    return to_check(action, "noise", larger[0].channel)


def _misread(
    experiment: Experiment, suspicions: Sequence[RecordingSuspicion], seed: int, settings: DiagnoseSettings
) -> BodyDiagnosis:
    """Return the answer for a recording that is probably misread: what to write, and no cause."""
    first = suspicions[0]
    return BodyDiagnosis(
        verdict="unexplained",
        findings=(),
        candidates=(),
        # No other recording of this body would misfit as much: the odds of the other reading say how much.
        p_misfit=0.0 if first.log_odds is None else float(np.exp(-first.log_odds)),
        discrepancy={},
        extended=experiment,
        next_experiment=to_check(f"{first.write}, then diagnose again", "input", ", ".join(first.files)),
        seed=seed,
        versions=versions_now(),
        suspicions=tuple(suspicions),
        numbers=settings,
    )


@dataclass(frozen=True, eq=False)
class BelievedModel:
    """The believed model, corrected for discretisation error, with its nuisance parameters.

    `target`: the input of fits; `nuisances`: with their columns; `null`: covariance of noise and all nuisances, the
    modulus included; `mesh_errors` (n_meshes, size): predictions on further fine meshes minus those on the mesh that
    corrects, mm and mN; `correction`: of the discretisation error, at the believed modulus.
    """

    target: FitTarget
    nuisances: Nuisances
    null: Null
    mesh_errors: FloatArray
    correction: Correction

    def with_noise(self, noise: Noise) -> "BelievedModel":
        """Return the same model and nuisances under another measurement noise."""
        bench = self.target.bench
        correction = _at_modulus(bench, noise, self.correction, self.nuisances)
        white = noise.whitened(correction.at_modulus(self.nuisances.columns), bench.layout)
        target = FitTarget(bench, noise, correction, Null(white[self.nuisances.but("stiffness")]))
        return replace(self, target=target, null=Null(white))


def make_believed(bench: Bench, noise: Noise, *, keep: bool = True) -> BelievedModel:
    """Return the believed model, corrected for discretisation error, with its nuisance parameters.

    `keep`: whether predictions on fine meshes and changes by the shape are read from and written to the cache. Raises
    `ConvergenceError` if a frame has no equilibrium on a fine mesh (`solvable`).
    """
    layout = bench.layout
    if bench.is_exact:
        fine, others = bench.base, np.zeros((0, layout.size))
    else:
        fine, others = refined_predictions(bench, entry_of(bench.experiment) if keep else None)
    corrected = bench.settings.model.corrected
    correction = make_correction(layout, bench.base, fine) if corrected else Correction(layout)
    nuisances = make_nuisances(bench, others - fine, correction, keep=keep)
    bare = Null(np.zeros((0, layout.size)))
    target = FitTarget(bench, noise, correction, bare)
    return BelievedModel(target, nuisances, bare, others - fine, correction).with_noise(noise)


def _at_modulus(bench: Bench, noise: Noise, correction: Correction, nuisances: Nuisances) -> Correction:
    """Return the correction at the modulus fitted to the data, if the modulus only scales forces; else unchanged."""
    if not bench.scales_forces:
        return correction
    others = noise.whitened(correction.at_modulus(nuisances.columns[nuisances.but("stiffness")]), bench.layout)
    found = fit(FitTarget(bench, noise, correction, Null(others)), [])
    return correction if found is None else replace(correction, modulus=found.young(1.0))


def _with_targets(findings: list[Finding], bench: Bench, effects: Sequence[Effect]) -> list[Finding]:
    """Return findings that also state the rms errors, mm, at measured inner targets, with and without all findings."""
    measured = {name: case.targets for name, case in bench.experiment.cases.items() if case.targets}
    if not findings or not measured:
        return findings
    base, named = target_rms(measured, *refined_targets(bench, effects))
    gains = {"target_rms_base_mm": base, "target_rms_named_mm": named}
    return [replace(finding, held_out={**finding.held_out, **gains}) for finding in findings]


def _own_modulus(experiment: Experiment) -> Experiment:
    """Return the experiment with the modulus of a `stiffness` effect moved into its material, where fits scale it."""
    stated = [effect for effect in experiment.effects if isinstance(effect, Stiffness)]
    if not stated:
        return experiment
    young, before = stated[-1].young_kpa, float(experiment.material.young_array.mean())
    spread = None if experiment.young_std is None else experiment.young_std * young / before
    others = tuple(effect for effect in experiment.effects if not isinstance(effect, Stiffness))
    return replace(experiment, material=replace(experiment.material, young=young), young_std=spread, effects=others)


def _explains_enough(misfit: Misfit, rules: NullSettings = DEFAULT.nulls) -> bool:
    """Return whether findings may be named: no misfit is left, or they explain enough of the believed model's."""
    return misfit.p >= rules.misfit or misfit.explained >= rules.explained


def target_rms(measured: Targets, *models: Targets | None) -> list[float | None]:
    """Return the rms error, mm, of each model's predictions over coordinates, frames and targets that all predict.

    It is None where nothing was measured, and for a model that has no predictions.
    """

    def errors(predicted: Targets) -> FloatArray:
        each = (predicted[case][name] - places for case, of in measured.items() for name, places in of.items())
        return np.concatenate([error.ravel() for error in each])

    found = [None if predicted is None else errors(predicted) for predicted in models]
    known = np.all([np.isfinite(error) for error in found if error is not None], axis=0)
    return [None if error is None or not known.any() else rms(error[known]) for error in found]
