"""Diagnosis of material tests: which causes explain the difference between measured stress curves and a believed law.

The steps: fit of the believed law, threshold, search, proof, test of the residual, verdict. Threshold and p-value come
from simulated null experiments, which have noise but no effect. What all fits share is in `bench`; rounds of the
search, evidence and records of the answer are those of bodies. ``docs/material.md`` describes the method.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.answer import verdict_of, versions_now
from tissuereg.diagnosis.causes import CAUSES, FreeParameters
from tissuereg.diagnosis.evidence import Blocks, log_mean_exp
from tissuereg.diagnosis.fit import FittedCause
from tissuereg.diagnosis.material.advice import next_test, repeated
from tissuereg.diagnosis.material.answer import (
    MaterialDiagnosis,
    SelectionOutcome,
    discrepancy_of,
    extended_by,
    finding_of,
)
from tissuereg.diagnosis.material.bench import CurveBench, bench_of
from tissuereg.diagnosis.material.data import scene_of
from tissuereg.diagnosis.material.fit import MaterialFit, held_out_errors, null_hypothesis, plain_fit, unknown
from tissuereg.diagnosis.material.model import predicted_stresses
from tissuereg.diagnosis.material.noise import Weights
from tissuereg.diagnosis.material.refine import refined
from tissuereg.diagnosis.material.search import MaterialSearch
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings, MaterialSettings
from tissuereg.errors import TissueRegError
from tissuereg.experiment.material_experiment import MaterialExperiment

__all__ = ["MaterialDiagnosis", "diagnose_material", "predicted_stresses"]


def diagnose_material(
    experiment: MaterialExperiment,
    *,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
    settings: DiagnoseSettings = DEFAULT,
) -> MaterialDiagnosis:
    """Return the diagnosis of a material test.

    Parameters
    ----------
    experiment : MaterialExperiment
        Believed law and measured curves, from `tissuereg.io.material_experiments.read_material_experiment` or made in
        Python.
    seed : int
        Seed of the simulated null experiments; the result is the same at each call.
    progress : callable, optional
        Called with the name of the step that begins.
    settings : DiagnoseSettings
        All numbers that may change the result.

    Returns
    -------
    MaterialDiagnosis
        Answer and extended model.

    Notes
    -----
    Takes seconds for a few curves, and up to half a minute where holds at several rates make relaxation a candidate.

    Examples
    --------
    A shear stress with a cubic term, which no neo-Hookean solid has:

    >>> from pathlib import Path
    >>> import numpy as np
    >>> import tissuereg as tr
    >>> from tissuereg.experiment.material_experiment import Curve, MaterialExperiment
    >>> shear, unknown = np.linspace(0.02, 1.0, 40), np.full(40, np.nan)
    >>> curves = tuple(
    ...     Curve(name, "simple-shear", np.nan, unknown, shear, stiff * (shear + shear**3))
    ...     for name, stiff in (("a", 1.0), ("b", 1.05))
    ... )
    >>> gel = MaterialExperiment("gel", Path("."), tr.Material(3.0, 0.49), None, None, curves)
    >>> [finding.id for finding in diagnose_material(gel).findings]
    ['stiffening']
    """
    said = progress or (lambda message: None)
    rng, rules = np.random.default_rng(seed), settings.nulls
    bench, scene = bench_of(experiment, settings), scene_of(experiment, settings.material)
    none = null_hypothesis(bench)
    tried = {id: cause.in_curves(scene) for id, cause in CAUSES.items() if id not in settings.left_out}
    forms = {id: forms for id, forms in tried.items() if forms}
    said("threshold from null experiments")
    search = MaterialSearch(bench, none, forms, _threshold(bench, none.fit, forms, rng), said)
    known, believed = search.run(), plain_fit(bench)
    before, after = (bench.data.residual(fit.model) for fit in (believed, known.fit))
    p_misfit = _misfit_probability(bench.weights, after, rng, settings.material)
    beyond = [float(np.sum(bench.weights.whitened(error) ** 2)) - len(error) for error in (before, after)]
    explained = 1.0 - max(beyond[1], 0.0) / beyond[0] if beyond[0] > 0 else 0.0
    explained = explained if known.ids else math.nan
    stated = known.ids and (p_misfit >= rules.misfit or explained > settings.material.explained)
    accepted = search.findings if stated else ()
    said("form and weights that predict best")
    reported = refined(search, known) if accepted else None
    base = held_out_errors(bench, believed)
    named = base if reported is None else reported.held_out
    generic = held_out_errors(bench, none.fit, patch_share=unknown(bench, none).fit.share)
    errors = {"base": base, "named": named, "generic": generic}
    outcome = SelectionOutcome(bench, search.threshold, known, believed, explained, reported, errors)
    worst, fit = discrepancy_of(bench, believed), None if reported is None else reported.fit
    findings = () if fit is None else tuple(finding_of(outcome, fit, one) for one in accepted)
    verdict = verdict_of(findings, p_misfit, level=rules.misfit)
    further = next_test(bench, experiment, known, accepted) if verdict != "unexplained" else repeated(experiment, worst)
    return MaterialDiagnosis(
        verdict=verdict,
        findings=findings,
        candidates=tuple(search.first_race),
        p_misfit=p_misfit,
        discrepancy=worst,
        extended=experiment if fit is None else extended_by(experiment, fit),
        next_experiment=further,
        seed=seed,
        versions=versions_now(),
        possible=tuple(asdict(one) for one in search.possible),
        numbers=settings,
        experiment=experiment,
        outcome=outcome,
    )


def _threshold(
    bench: CurveBench, known: MaterialFit, forms: Mapping[str, Sequence[FreeParameters]], rng: np.random.Generator
) -> float:
    """Return the log Bayes factor, nats, that the best cause exceeds in one of a hundred null experiments."""
    # Every form is linearised about its first guesses: one column of stress with a unit prior amplitude, in addition to
    # the column of the modulus.
    numbers = bench.settings.material
    draws = rng.standard_normal((len(bench.data.stress), numbers.thresholds_from)).T
    plain = bench.data.modelled(known.model)
    change = (bench.data.modelled(bench.model((), known.x + np.array([1e-3]))) - plain) / 1e-3
    young = bench.weights.whitened(change * float(bench.prior(())[1][0]))
    best = -Blocks(young[None, None]).log_bayes_factors(draws)[:, 0]
    parts = (FittedCause(cause, form) for cause, kinds in forms.items() for form in kinds)
    pairs = ([[young, column] for column in _columns(bench, known.x, plain, part)] for part in parts)
    found = [log_mean_exp(Blocks(np.array(one)).log_bayes_factors(draws)) for one in pairs if one]
    best += np.max([np.full(len(draws), -np.inf), *found], axis=0)
    return max(numbers.least_threshold, float(np.quantile(best, numbers.quantile)))


def _columns(bench: CurveBench, x: FloatArray, plain: FloatArray, part: FittedCause) -> Iterator[FloatArray]:
    """Yield the whitened changes (n,) of stresses `plain` (n,) by a cause at its first guesses and its prior mean."""
    for start in (*part.free_parameters.guesses, part.free_parameters.mean):
        if len(start):
            with suppress(TissueRegError):
                changed = bench.data.modelled(bench.model((part,), np.concatenate([x, start])))
                if np.isfinite(changed).all():
                    yield bench.weights.whitened(changed - plain)


def _misfit_probability(
    weights: Weights, residual: FloatArray, rng: np.random.Generator, settings: MaterialSettings
) -> float:
    """Return the p-value, above 0, of the structure in a residual (n,), kPa."""
    n_nulls, shares = settings.misfits_from, settings.misfit_shares
    found = _structure(weights, weights.whitened(residual)[:, None], shares)[0]
    scale = np.exp(settings.noise_spread * rng.standard_normal(n_nulls))
    nulls = _structure(weights, rng.standard_normal((len(residual), n_nulls)) * scale, shares)
    return float((1 + (nulls >= found).sum()) / (1 + n_nulls))


def _structure(weights: Weights, white: FloatArray, shares: Sequence[float]) -> FloatArray:
    """Return the largest log likelihood ratio, over its sizes, of a generic misfit against none."""
    grown = [share**2 * weights.spectrum for share in shares]
    gains = [0.5 * (white**2).T @ (one / (1.0 + one)) - 0.5 * np.log1p(one).sum() for one in grown]
    return np.asarray(np.max(gains, axis=0))
