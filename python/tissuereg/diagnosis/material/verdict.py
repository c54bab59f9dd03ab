"""The sequence of steps of a material diagnosis: fit of the believed law, threshold, search, proof, verdict."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.answer import PossibleCause
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.causes.base import Scene
from tissuereg.diagnosis.material.data import data_of, scene_of
from tissuereg.diagnosis.material.fit import FitProblem, MaterialFit
from tissuereg.diagnosis.material.holdout import HeldOutErrors, ProofInput, folds_of, held_out_errors
from tissuereg.diagnosis.material.hypothesis import Hypothesis, null_hypothesis, plain_fit, unknown
from tissuereg.diagnosis.material.model import Model
from tissuereg.diagnosis.material.noise import covariance, generic_covariance, noise_of, weights_of
from tissuereg.diagnosis.material.nulls import misfit_probability, threshold
from tissuereg.diagnosis.material.refine import Refined, refined
from tissuereg.diagnosis.material.search import CandidateCause, MaterialFinding, MaterialSearch
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings
from tissuereg.experiment.material_experiment import MaterialExperiment


@dataclass(frozen=True, eq=False)
class SelectionOutcome:
    """Everything that a diagnosis of material tests found, from which its answer and report are made.

    `verdict` {"named", "group", "consistent", "unexplained"}; `known`: the believed law with the causes found;
    `believed`: the believed law, fitted with independent rows; `refined`: the reported fit of the findings; None
    without findings; `findings`: named causes; none where the verdict is consistent or unexplained; `possible`: causes
    that were found and are not stated, as their evidence or probability does not suffice given the others;
    `candidates`: every cause tried alone, and the generic misfit; `threshold`: log Bayes factor that a first cause must
    exceed, nats; `p_misfit`: p-value of the residual after the findings; `explained`: share of the misfit (in squared
    units of noise) that the findings explain; NaN without findings; `held_out`: errors on held-out data of the believed
    law (``base``), with the findings (``named``), and with a generic misfit (``generic``); `bench`: rows, covariances
    and the parts that are held out; `scene`: tested modes and ranges of strain, time and stress.
    """

    verdict: str
    known: Hypothesis
    believed: MaterialFit
    refined: Refined | None
    findings: tuple[MaterialFinding, ...]
    possible: tuple[PossibleCause, ...]
    candidates: tuple[CandidateCause, ...]
    threshold: float
    p_misfit: float
    explained: float
    held_out: dict[str, HeldOutErrors]
    bench: ProofInput
    scene: Scene


def find_out(
    experiment: MaterialExperiment, seed: int, progress: Callable[[str], None], settings: DiagnoseSettings = DEFAULT
) -> SelectionOutcome:
    """Return everything that a diagnosis of material tests finds, from noise and fits to the verdict.

    `experiment`: believed law and measured curves; `seed`: seed of the simulated null experiments; `progress`: called
    with the name of the step that begins.
    """
    rng, rules = np.random.default_rng(seed), settings.nulls
    bench = bench_of(experiment, settings)
    problem, scene = bench.problem, scene_of(experiment, settings.material)
    none = null_hypothesis(problem)
    tried = {id: cause.in_curves(scene) for id, cause in CAUSES.items() if id not in settings.left_out}
    forms = {id: forms for id, forms in tried.items() if forms}
    progress("threshold from null experiments")
    limit = threshold(problem, none.fit, forms, rng)
    search = MaterialSearch(bench, none, forms, limit, progress)
    known = search.run()
    data = problem.data
    believed = plain_fit(problem, bench.noise)
    residual = data.stress - data.modelled(known.fit.model)
    p_misfit = misfit_probability(problem.weights, residual, rng, settings.material)
    explained = _explained(bench, data.stress - data.modelled(believed.model), residual) if known.ids else math.nan
    generic = unknown(problem, none)
    verdict = "consistent" if p_misfit > rules.misfit else "unexplained"
    findings: tuple[MaterialFinding, ...] = ()
    if known.ids and (p_misfit > rules.misfit or explained > settings.material.explained):
        findings = search.findings
        verdict = "group" if any(len(finding.group) > 1 for finding in findings) else "named"
    progress("form and weights that predict best")
    reported = refined(search, known) if findings else None
    base = held_out_errors(bench, believed)
    named = base if reported is None else reported.held_out
    patch = held_out_errors(bench, none.fit, patch_share=generic.fit.share)
    return SelectionOutcome(
        verdict,
        known,
        believed,
        reported,
        findings,
        tuple(search.possible),
        tuple(search.first_race),
        limit,
        p_misfit,
        explained,
        {"base": base, "named": named, "generic": patch},
        bench,
        scene,
    )


def bench_of(experiment: MaterialExperiment, settings: DiagnoseSettings = DEFAULT) -> ProofInput:
    """Return the rows, covariances and folds that fits and proofs of an experiment need."""
    numbers = settings.material
    data, noise = data_of(experiment, numbers.most_rows), noise_of(experiment, numbers)
    own, generic = covariance(data, noise, numbers), generic_covariance(data, numbers)
    base = Model(experiment.material).with_effects(experiment.effects)
    young = float(base.material.young_array[0])
    std = numbers.young_spread if experiment.young_std is None else math.log1p(experiment.young_std / young)
    problem = FitProblem(base, data, weights_of(own, generic), math.log(young), std, settings)
    unit, folds = folds_of(experiment, data, numbers)
    return ProofInput(unit, folds, problem, own, generic, own, noise)


def _explained(bench: ProofInput, before: FloatArray, after: FloatArray) -> float:
    sizes = [float(np.sum(bench.problem.weights.whitened(error) ** 2)) - len(error) for error in (before, after)]
    return 1.0 - max(sizes[1], 0.0) / sizes[0] if sizes[0] > 0 else 0.0
