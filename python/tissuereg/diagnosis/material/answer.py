"""The diagnosis of a material test, as a record: findings, errors on held-out data, sentences."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.answer import Accepted, Diagnosis, Finding
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.evidence import rms
from tissuereg.diagnosis.fit import effects_of
from tissuereg.diagnosis.material.bench import CurveBench
from tissuereg.diagnosis.material.data import Data
from tissuereg.diagnosis.material.fit import HeldOutErrors, Hypothesis, MaterialFit
from tissuereg.diagnosis.material.refine import Refined
from tissuereg.diagnosis.material.report import material_page
from tissuereg.diagnosis.material.search import MaterialFinding
from tissuereg.experiment.effects import Effect
from tissuereg.experiment.effects.elastic import Fibre, OtherLaw
from tissuereg.experiment.effects.history import Relaxation
from tissuereg.experiment.material_experiment import Curve, MaterialExperiment


@dataclass(frozen=True, eq=False)
class SelectionOutcome:
    """What the steps of a diagnosis of material tests found, from which its answer and report are made.

    `bench`: rows, covariances and the parts that are held out; `threshold`: log Bayes factor that a first cause must
    exceed, nats; `known`: the believed law with the causes found; `believed`: the believed law, fitted with independent
    rows; `explained`: share of the misfit (in squared units of noise) that the causes explain; NaN without any;
    `refined`: the reported fit of the causes; None where none is stated; `held_out`: errors on held-out data of the
    believed law (``base``), with the findings (``named``), and with a generic misfit (``generic``).
    """

    bench: CurveBench
    threshold: float
    known: Hypothesis
    believed: MaterialFit
    explained: float
    refined: Refined | None
    held_out: dict[str, HeldOutErrors]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MaterialDiagnosis(Diagnosis):
    """The diagnosis of a material test: a `Diagnosis` with stresses in kPa in place of lengths.

    Attributes
    ----------
    extended : MaterialExperiment
        The experiment with the causes found as effects; the same as `experiment` where none was named.
    experiment : MaterialExperiment
        Believed law and measured curves.
    outcome : SelectionOutcome
        All intermediate results, for further work in Python.
    """

    extended: MaterialExperiment
    experiment: MaterialExperiment
    outcome: SelectionOutcome

    @property
    def held_out(self) -> dict[str, Any]:
        """Errors of the believed law, with the findings, and with a generic misfit, on data left out of the fit.

        They are ``unit`` (what was left out), ``cases``, and of each ``by_case``.
        """
        return _held_out(self.outcome)

    @property
    def explained(self) -> float | None:
        """Share of the misfit that the best causes explain, named or not; None where there are none."""
        return self.outcome.explained if self.outcome.known.ids else None

    @property
    def provisional(self) -> bool:
        """Whether only the last part of the curves could be held out."""
        return self.outcome.bench.unit == "part"

    @property
    def sentences(self) -> tuple[str, ...]:
        """The answer in words."""
        outcome = self.outcome
        if self.verdict == "consistent":
            return (f"The believed law explains these curves within their noise (p = {self.p_misfit:.2g}).",)
        if outcome.refined is None:
            none = "The believed law does not explain these curves, nor does any cause of the catalogue"
            nearest = [c["id"] for c in self.candidates if c["id"] != "unknown"][:2]
            share = f" The best of them explain {outcome.explained:.0%} of the misfit." if outcome.known.ids else ""
            return (f"{none}; the nearest are {' and '.join(nearest) or 'none'}.{share}",)
        base, named, unit = outcome.held_out["base"], outcome.held_out["named"], outcome.bench.unit
        what = "the last part of each curve" if unit == "part" else f"a {unit}"
        change = f"from {base.rms_all:.3g} to {named.rms_all:.3g} kPa"
        sentences = [finding.sentence for finding in self.findings]
        sentences.append(f"The prediction error of {what} that is held out changes {change}.")
        if self.p_misfit < outcome.bench.settings.nulls.misfit:
            sentences += [
                f"A misfit beyond the noise remains: {outcome.explained:.0%} of it are explained.",
                f"The form found has a model error of some {outcome.refined.form_error:.1%} of the stress; the stated "
                "deviations include it for the modes, rates and strains tested.",
            ]
        if unit == "part":
            sentences.append(
                "Only the last part of the curves could be held out: provisional until another mode, rate or specimen "
                "is tested; the stated deviations do not cover those."
            )
        return tuple(sentences)

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


def extended_by(experiment: MaterialExperiment, fit: MaterialFit) -> MaterialExperiment:
    """Return the experiment with the causes found; the modulus is the fitted one, unless it is itself a finding."""
    ids, law = {effect.id for effect in fit.effects}, any(isinstance(effect, OtherLaw) for effect in fit.effects)
    kept = [old for old in experiment.effects if old.id not in ids and not (law and isinstance(old, OtherLaw))]
    changed = replace(experiment, effects=(*kept, *fit.effects))
    if any(effect.id == "stiffness" for effect in changed.effects):
        return changed
    young = float(np.exp(fit.x[0]))
    std = young * float(np.sqrt(fit.covariance[0, 0]))
    return replace(changed, material=replace(experiment.material, young=young), young_std=std)


def finding_of(outcome: SelectionOutcome, fit: MaterialFit, found: MaterialFinding) -> Finding:
    """Return an accepted cause as a finding; `fit`: the reported one."""
    pairs = parameters_of(fit)[found.id]
    return Finding(
        **{one.name: getattr(found, one.name) for one in fields(Accepted)},
        parameters={key: value for key, (value, _) in pairs.items()},
        deviations={key: deviation for key, (_, deviation) in pairs.items()},
        held_out=_held_out(outcome),
        sentence=_sentence(outcome, fit, found),
    )


def parameters_of(fit: MaterialFit) -> dict[str, dict[str, list[float]]]:
    """Return value and standard deviation (by linear propagation) of all parameters, by id and key of the table."""

    def numbers(x: FloatArray) -> list[dict[str, float]]:
        return [_numbers(effect) for effect in effects_of(fit.parts, x, float(np.exp(x[0])))]

    steps = 1e-3 * np.sqrt(np.diag(fit.covariance))
    moved = [numbers(fit.x + row) for row in np.diag(steps)]
    parameters = {}
    for number, (id, before) in enumerate(zip(fit.ids, numbers(fit.x), strict=True)):
        columns = [[after[number][key] - value for key, value in before.items()] for after in moved]
        slopes = np.stack(columns, axis=1) / steps
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


def discrepancy_of(bench: CurveBench, believed: MaterialFit) -> dict[str, Any]:
    """Return, in JSON's types, the believed law's misfit (kPa, noise deviations), and where and when it is largest."""
    data, residual = bench.data, bench.data.residual(believed.model)
    chi, modes = residual / np.sqrt(np.diag(bench.noise)), data.names("mode")
    curves = {name: data.curve_of == i for i, name in enumerate(_names(data.curves))}
    return {
        "rms_kpa": rms(residual),
        "in_sigma": rms(chi),
        "where": _largest(chi, curves, 1)[:2],
        "when": _largest(chi, _times(data), 3)[0],
        "under": _largest(chi, {mode: modes == mode for mode in dict.fromkeys(modes.tolist())}, 1)[0],
    }


def _names(curves: Sequence[Curve]) -> list[str]:
    """Return the name of each curve; curves of the same name are numbered from 1 on."""
    names = [curve.name for curve in curves]
    numbered = [f"{name}, number {names[: i + 1].count(name)}" for i, name in enumerate(names)]
    return [name if names.count(name) == 1 else other for name, other in zip(names, numbered, strict=True)]


def _largest(chi: FloatArray, parts: Mapping[str, BoolArray], least: int) -> list[str]:
    """Return the parts (masks of rows, by name) of at least so many rows, those with the largest mean square first."""
    many = [name for name, rows in parts.items() if rows.sum() >= least]
    return sorted(many, key=lambda name: -rms(chi[parts[name]]))


def _times(data: Data) -> dict[str, BoolArray]:
    """Return masks (n,) of the rows of each kind, in words that say when a residual is largest."""
    still, back, size = [], [], np.abs(data.strain)
    for curve, rows in zip(data.curves, data.rows, strict=True):
        moves = np.diff(np.abs(curve.strains), prepend=0.0)[rows]
        still.append(np.abs(moves) < 1e-3 * np.abs(curve.strains).max())
        back.append(moves < 0)
    held = np.concatenate(still)
    return {
        "at small strain": size < 1 / 3,
        "at middle strain": (size >= 1 / 3) & (size < 2 / 3),
        "at large strain": size >= 2 / 3,
        "while the strain is held": held,
        "while unloading": np.concatenate(back) & ~held,
    }


def _sentence(outcome: SelectionOutcome, fit: MaterialFit, finding: MaterialFinding) -> str:
    part, effect = next(pair for pair in zip(fit.parts, fit.effects, strict=True) if pair[0].id == finding.id)
    sentence = CAUSES[finding.id].sentence(effect.table())
    if isinstance(effect, Fibre):
        sentence += f" They lie {part.free_parameters.label}."
    if isinstance(effect, Relaxation):
        sentence += f" Instantaneous Young's modulus: {np.exp(fit.x[0]):.3g} kPa."
    if len(finding.group) > 1:
        needed = f"{finding.separability:.1f}, {outcome.bench.settings.search.separable:g} are needed"
        sentence += f" These data cannot distinguish it from {' or '.join(finding.group[1:])} (separability {needed})."
    return sentence
