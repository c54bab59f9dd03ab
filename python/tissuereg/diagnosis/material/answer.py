"""The diagnosis of a material test, as a record: findings, errors on held-out data, sentences."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.answer import Accepted, Diagnosis, Finding, to_check, versions_now
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.evidence import rms
from tissuereg.diagnosis.fit import effects_of
from tissuereg.diagnosis.material.advice import best_test
from tissuereg.diagnosis.material.fit import MaterialFit, extended
from tissuereg.diagnosis.material.report import material_page
from tissuereg.diagnosis.material.search import MaterialFinding
from tissuereg.diagnosis.material.verdict import SelectionOutcome
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.elastic import Fibre
from tissuereg.experiment.effects.history import Relaxation
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MaterialDiagnosis(Diagnosis):
    """The diagnosis of a material test: a `Diagnosis` with stresses in kPa in place of lengths.

    Attributes
    ----------
    extended : MaterialExperiment
        The experiment with the causes found as effects; the same as `experiment` where none was named.
    experiment : MaterialExperiment
        Believed law and measured curves.
    held_out : dict
        Errors of the believed law, with the findings, and with a generic misfit, on data that were left out of the fit:
        ``unit`` (what was left out), ``cases``, and of each ``by_case``.
    explained : float or None
        Share of the misfit that the best causes explain, named or not; None where there are none.
    sentences : tuple of str
        The answer in words.
    outcome : SelectionOutcome
        All intermediate results, for further work in Python.
    """

    extended: MaterialExperiment
    experiment: MaterialExperiment
    held_out: dict[str, Any]
    explained: float | None
    sentences: tuple[str, ...]
    outcome: SelectionOutcome

    @property
    def provisional(self) -> bool:
        """Whether only the last part of the curves could be held out."""
        return self.outcome.bench.unit == "part"

    def _own_json(self) -> dict[str, Any]:
        errors, refined = self.outcome.bench.errors, self.outcome.refined
        return {
            "kind": "material-test",
            "explained": self.explained,
            "held_out": self.held_out,
            "noise": {
                "std_kpa": dict(zip(_names(self.experiment.curves), errors.std.tolist(), strict=True)),
                "specimen_factor": errors.factor,
                "along_curve": errors.along,
                "repeats": errors.repeats,
            },
            "sentences": list(self.sentences),
            "weighting": None if refined is None else refined.weighting,
            "settings": self.numbers.to_json({}),
        }

    def _page(self, folder: Path) -> str:
        return material_page(self, folder)


def diagnosis_of(experiment: MaterialExperiment, outcome: SelectionOutcome, seed: int) -> MaterialDiagnosis:
    """Return the diagnosis that follows from all steps.

    `experiment`: believed law and measured curves; `outcome`: result of all steps; `seed`: seed of the simulated null
    experiments.
    """
    refined = outcome.refined
    held_out = _held_out(outcome)
    parameters = {} if refined is None else parameters_of(refined.fit)
    findings = tuple(_finding(outcome, one, parameters[one.id], held_out) for one in outcome.findings)
    return MaterialDiagnosis(
        verdict=outcome.verdict,
        findings=findings,
        candidates=tuple(asdict(one) for one in outcome.candidates),
        p_misfit=outcome.p_misfit,
        discrepancy=_discrepancy(outcome),
        extended=experiment if refined is None else extended(experiment, refined.fit),
        next_experiment=_next(experiment, outcome),
        seed=seed,
        versions=versions_now(),
        possible=tuple(asdict(one) for one in outcome.possible),
        numbers=outcome.bench.problem.settings,
        experiment=experiment,
        held_out=held_out,
        explained=outcome.explained if outcome.known.ids else None,
        sentences=tuple(_sentences(outcome, [finding.sentence for finding in findings])),
        outcome=outcome,
    )


def _finding(
    outcome: SelectionOutcome, found: MaterialFinding, pairs: dict[str, list[float]], held_out: dict[str, Any]
) -> Finding:
    """Return a finding as a record; `pairs`: value and standard deviation of its parameters, by key."""
    return Finding(
        **{one.name: getattr(found, one.name) for one in fields(Accepted)},
        parameters={key: value for key, (value, _) in pairs.items()},
        deviations={key: deviation for key, (_, deviation) in pairs.items()},
        held_out=held_out,
        sentence=_sentence(outcome, found),
    )


def parameters_of(fit: MaterialFit) -> dict[str, dict[str, list[float]]]:
    """Return the value and the standard deviation of every parameter of each cause found.

    `fit`: fit of all causes together. Result: by id, then by key of the effect's table; deviations follow from the
    fit's covariance by linear propagation.
    """
    plain = [_numbers(effect) for effect in fit.effects]
    columns: list[list[FloatArray]] = [[] for _ in plain]
    for i, std in enumerate(np.sqrt(np.diag(fit.covariance))):
        moved = fit.x.copy()
        moved[i] += 1e-3 * std
        for column, before, effect in zip(
            columns, plain, effects_of(fit.parts, moved, float(np.exp(moved[0]))), strict=True
        ):
            after = _numbers(effect)
            column.append(np.array([(after[key] - before[key]) / (1e-3 * std) for key in before]))
    parameters = {}
    for id, before, column in zip(fit.ids, plain, columns, strict=True):
        slopes = np.stack(column, axis=1)
        spread = np.sqrt(np.einsum("pi,ij,pj->p", slopes, fit.covariance, slopes))
        parameters[id] = {key: [value, float(s)] for (key, value), s in zip(before.items(), spread, strict=True)}
    return parameters


def _numbers(effect: Effect) -> dict[str, float]:
    """Return the numbers of an effect's ``[[effect]]`` table by key; entries of a list have keys like ``tau_s_1``."""
    numbers: dict[str, float] = {}
    for key, value in effect.table().items():
        if isinstance(value, list):
            numbers |= {f"{key}_{i + 1}": float(v) for i, v in enumerate(value)}
        elif isinstance(value, float):
            numbers[key] = value
    return numbers


def _held_out(outcome: SelectionOutcome) -> dict[str, Any]:
    models, cases = outcome.held_out, list(outcome.held_out["base"].rms)
    return {
        "unit": outcome.bench.unit,
        "cases": cases,
        **{f"rms_{key}_kpa": one.rms_all for key, one in models.items()},
        "noise_kpa": float(np.sqrt(np.mean(np.diag(outcome.bench.noise)))),
        **{f"chi_{key}": one.chi for key, one in models.items()},
        "by_case": {case: {f"rms_{key}_kpa": one.rms.get(case) for key, one in models.items()} for case in cases},
    }


def _discrepancy(outcome: SelectionOutcome) -> dict[str, Any]:
    """Return, in JSON's types, the believed law's misfit (kPa, noise deviations), and where and when it is largest."""
    data = outcome.bench.problem.data
    residual = data.stress - data.modelled(outcome.believed.model)
    chi = residual / np.sqrt(np.diag(outcome.bench.noise))
    sizes = {
        name: rms(chi[data.curve_of == i]) for i, name in enumerate(_names(data.curves)) if (data.curve_of == i).any()
    }
    worst = sorted(sizes, key=lambda name: -sizes[name])[:2]
    modes = np.array(data.modes)
    under = max(dict.fromkeys(modes.tolist()), key=lambda mode: float(np.mean(chi[modes == mode] ** 2)))
    return {
        "rms_kpa": rms(residual),
        "in_sigma": rms(chi),
        "where": worst,
        "when": _when(outcome, chi),
        "under": under,
    }


def _names(curves: Sequence[Curve]) -> list[str]:
    """Return the name of each curve; curves of the same name are numbered from 1 on."""
    seen: Counter[str] = Counter()
    several = Counter(curve.name for curve in curves)
    names = []
    for curve in curves:
        seen[curve.name] += 1
        names.append(curve.name if several[curve.name] == 1 else f"{curve.name}, number {seen[curve.name]}")
    return names


def _when(outcome: SelectionOutcome, chi: FloatArray) -> str:
    data = outcome.bench.problem.data
    parts: dict[str, BoolArray] = {"at small strain": np.abs(data.strain) < 1 / 3}
    parts["at middle strain"] = (np.abs(data.strain) >= 1 / 3) & (np.abs(data.strain) < 2 / 3)
    parts["at large strain"] = np.abs(data.strain) >= 2 / 3
    held, back = [], []
    for curve, rows in zip(data.curves, data.rows, strict=True):
        moves = np.diff(np.abs(curve.strains), prepend=0.0)
        still = np.abs(moves) < 1e-3 * np.abs(curve.strains).max()
        held.append(still[rows])
        back.append((moves < 0)[rows] & ~still[rows])
    parts["while the strain is held"], parts["while unloading"] = np.concatenate(held), np.concatenate(back)
    seen = {name: float(np.mean(chi[rows] ** 2)) for name, rows in parts.items() if rows.sum() >= 3}
    return max(seen, key=lambda name: seen[name])


def _sentence(outcome: SelectionOutcome, finding: MaterialFinding) -> str:
    assert outcome.refined is not None  # there is a finding
    fit = outcome.refined.fit
    place = fit.ids.index(finding.id)
    effect = fit.effects[place]
    sentence = CAUSES[finding.id].sentence(effect.table())
    if isinstance(effect, Fibre):
        sentence += f" They lie {fit.parts[place].free_parameters.label}."
    if isinstance(effect, Relaxation):
        sentence += f" Instantaneous Young's modulus: {np.exp(fit.x[0]):.3g} kPa."
    if len(finding.group) > 1:
        tied = " or ".join(finding.group[1:])
        largest = max(finding.separability.values())
        needed = f"separability {largest:.1f}, {outcome.bench.problem.settings.search.separable:g} are needed"
        sentence += f" These data cannot distinguish it from {tied} ({needed})."
    return sentence


def _sentences(outcome: SelectionOutcome, of_findings: Sequence[str]) -> list[str]:
    base, named = outcome.held_out["base"], outcome.held_out["named"]
    sentences = list(of_findings)
    if outcome.verdict == "consistent":
        return [f"The believed law explains these curves within their noise (p = {outcome.p_misfit:.2g})."]
    if outcome.verdict == "unexplained":
        nearest = [c.id for c in outcome.candidates if c.id != "unknown"][:2]
        share = f" The best of them explain {outcome.explained:.0%} of the misfit." if outcome.known.ids else ""
        return [
            "The believed law does not explain these curves, nor does any cause of the catalogue; "
            f"the nearest are {' and '.join(nearest) or 'none'}.{share}"
        ]
    what = {"part": "the last part of each curve", "mode": "a mode", "rate": "a rate", "specimen": "a specimen"}
    change = f"from {base.rms_all:.3g} to {named.rms_all:.3g} kPa"
    sentences.append(f"The prediction error of {what[outcome.bench.unit]} that is held out changes {change}.")
    if outcome.p_misfit <= outcome.bench.problem.settings.nulls.misfit:
        sentences.append(f"A misfit beyond the noise remains: {outcome.explained:.0%} of it are explained.")
        assert outcome.refined is not None  # there are findings
        sentences.append(
            f"The form found has a model error of some {outcome.refined.form_error:.1%} of the stress; the stated "
            "deviations include it for the modes, rates and strains tested."
        )
    if outcome.bench.unit == "part":
        sentences.append(
            "Only the last part of the curves could be held out: provisional until another mode, rate or specimen is "
            "tested; the stated deviations do not cover those."
        )
    return sentences


def _again(outcome: SelectionOutcome) -> dict[str, Any]:
    """Return, in JSON's types, the advice to repeat the mode and the part of a curve with the largest residual."""
    worst = _discrepancy(outcome)
    mode, curves = worst["under"].replace("-", " "), outcome.bench.problem.data.curves
    others = len({curve.specimen for curve in curves if curve.mode == worst["under"]}) > 1
    with_what = "a further specimen" if others else "another specimen"
    action = (
        f"measure {mode} again with {with_what}, with more rows {worst['when']}: the residual is largest there, worst "
        f"in {' and '.join(worst['where'])}; a deviation that does not repeat is no property of the material"
    )
    return to_check(action, "mode", worst["under"], where=worst["where"], when=worst["when"])


def _next(experiment: MaterialExperiment, outcome: SelectionOutcome) -> dict[str, Any] | None:
    """Return, in JSON's types, the test that distinguishes causes of a group; None where there is no such test.

    Where no cause explains the curves, it is the advice to repeat a test.
    """
    if outcome.verdict == "unexplained":
        return _again(outcome)
    for finding in outcome.findings:
        for rival in finding.group[1:]:
            other = finding.rivals[rival].fit.model
            advice = best_test(
                experiment, outcome.scene, outcome.known.fit.model, other, outcome.bench.problem.settings.material
            )
            if advice is not None:
                return {
                    "action": advice.action,
                    "separates": [[finding.id, rival]],
                    "separability": advice.separability,
                }
    return None
