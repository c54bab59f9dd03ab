"""The whole diagnosis of a material test: base fit, race, proof, groups, verdict."""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.material.causes import CAUSES
from tissuereg.diagnose.material.data import data_of
from tissuereg.diagnose.material.fit import Fit, Problem
from tissuereg.diagnose.material.holdout import Bench, HeldOutErrors, folds_of, held_out_errors
from tissuereg.diagnose.material.hypothesis import Hypothesis, null_hypothesis, plain_fit, unknown
from tissuereg.diagnose.material.model import model_of
from tissuereg.diagnose.material.noise import Noise, covariance, noise_of
from tissuereg.diagnose.material.nulls import misfit_probability, threshold
from tissuereg.diagnose.material.refine import Refined, refined
from tissuereg.diagnose.material.scene import Scene, scene_of
from tissuereg.diagnose.material.search import Candidate, Finding, Search, visible
from tissuereg.diagnose.material.weights import generic_covariance, weights_of
from tissuereg.material_experiment import MaterialExperiment

#: Standard deviation of the logarithm of a modulus that is given without one.
USUAL_YOUNG = 0.3
#: Structure in the residual that noise leaves less often than this is a misfit.
MISFIT = 0.01
#: Share of the misfit that findings must explain where they leave a misfit.
EXPLAINED = 0.8


@dataclass(frozen=True, eq=False)
class Outcome:
    """All that was found out.

    Attributes
    ----------
    verdict : {"named", "group", "consistent", "unexplained"}
        In a word.
    known : Hypothesis
        What is believed with the causes found.
    believed : Fit
        What is believed, fitted as a user would.
    refined : Refined or None
        Form and numbers of the findings that are handed on.
    findings : tuple of Finding
        None where the verdict is consistent or unexplained.
    candidates : tuple of Candidate
        The race of single causes, unknown among them.
    threshold : float
        Evidence that a cause must exceed.
    p_misfit : float
        Global p-value after the findings.
    explained : float
        Share of the misfit (in squared units of noise) that the findings explain; NaN without findings.
    before, after, patch : HeldOutErrors
        Held-out data foretold by what is believed, with the findings, with a generic patch.
    unit : str
        What was held out.
    noise : Noise
        Of the curves.
    bench : Bench
        Rows, covariances and folds.
    scene : Scene
        What the curves can show.
    """

    verdict: str
    known: Hypothesis
    believed: Fit
    refined: Refined | None
    findings: tuple[Finding, ...]
    candidates: tuple[Candidate, ...]
    threshold: float
    p_misfit: float
    explained: float
    before: HeldOutErrors
    after: HeldOutErrors
    patch: HeldOutErrors
    unit: str
    noise: Noise
    bench: Bench
    scene: Scene


def find_out(experiment: MaterialExperiment, seed: int, progress: Callable[[str], None]) -> Outcome:
    """Find out what the believed law of an experiment gets wrong.

    Parameters
    ----------
    experiment : MaterialExperiment
        Beliefs and curves.
    seed : int
        Of simulated nulls.
    progress : callable
        Told what is done.

    Returns
    -------
    Outcome
        With all figures of the answer.
    """
    rng = np.random.default_rng(seed)
    bench, noise = bench_of(experiment)
    problem, scene = bench.problem, scene_of(experiment)
    none = null_hypothesis(problem)
    forms = visible({id: cause.forms(scene) for id, cause in CAUSES.items()})
    progress("thresholds from simulated nulls")
    limit = threshold(problem, none.fit, forms, rng)
    search = Search(bench, forms, limit, progress)
    known = _without_near_modulus(search, none, search.run(none))
    data = problem.data
    believed = plain_fit(problem, bench.noise)
    left = data.stress - data.modelled(known.fit.model)
    p_misfit = misfit_probability(problem.weights, left, rng)
    explained = _explained(bench, data.stress - data.modelled(believed.model), left) if known.ids else math.nan
    generic = unknown(problem, none)
    verdict = "consistent" if p_misfit > MISFIT else "unexplained"
    findings: tuple[Finding, ...] = ()
    if known.ids and (p_misfit > MISFIT or explained > EXPLAINED):
        findings = tuple(search.finding(none, known, cause) for cause in known.ids)
        verdict = "group" if any(len(finding.group) > 1 for finding in findings) else "named"
    progress("form and weights that foretell best")
    reported = refined(search, none, known, noise) if findings else None
    before = held_out_errors(bench, believed)
    after = before if reported is None else reported.held_out
    patch = held_out_errors(bench, none.fit, patch_share=generic.fit.share)
    return Outcome(
        verdict,
        known,
        believed,
        reported,
        findings,
        tuple(search.first_race),
        limit,
        p_misfit,
        explained,
        before,
        after,
        patch,
        bench.unit,
        noise,
        bench,
        scene,
    )


def bench_of(experiment: MaterialExperiment) -> tuple[Bench, Noise]:
    """Return all that fits and proofs of an experiment need.

    Parameters
    ----------
    experiment : MaterialExperiment
        Beliefs and curves.

    Returns
    -------
    bench : Bench
        Rows, covariances and folds.
    noise : Noise
        Of the curves.
    """
    data, noise = data_of(experiment), noise_of(experiment)
    own, generic = covariance(data, noise), generic_covariance(data)
    base = model_of(experiment)
    young = float(base.material.young_array[0])
    std = USUAL_YOUNG if experiment.young_std is None else math.log1p(experiment.young_std / young)
    problem = Problem(base, data, weights_of(own, generic), math.log(young), std)
    unit, folds = folds_of(experiment, data)
    return Bench(unit, folds, problem, own, generic, noise.repeats), noise


def _without_near_modulus(search: Search, none: Hypothesis, known: Hypothesis) -> Hypothesis:
    """Return the answer less a modulus that lies within its belief."""
    if "stiffness" not in known.ids:
        return known
    return known if search.far_modulus(known.fit) else search.without(none, known, "stiffness")


def _explained(bench: Bench, before: FloatArray, after: FloatArray) -> float:
    sizes = [float(np.sum(bench.problem.weights.whitened(left) ** 2)) - len(left) for left in (before, after)]
    return 1.0 - max(sizes[1], 0.0) / sizes[0] if sizes[0] > 0 else 0.0
