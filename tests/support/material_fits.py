"""One form of one cause fitted to curves by itself, with the deviations that a diagnosis would state."""

import numpy as np

from tissuereg.diagnose.material.answer import parameters_of
from tissuereg.diagnose.material.causes import CAUSES
from tissuereg.diagnose.material.deviations import stated
from tissuereg.diagnose.material.fit import fitted
from tissuereg.diagnose.material.hypothesis import refitted
from tissuereg.diagnose.material.refine import rows_alike
from tissuereg.diagnose.material.scene import scene_of
from tissuereg.diagnose.material.verdict import bench_of


def form_of(experiment, cause, label):
    """Return a form that the curves of an experiment can show."""
    return next(form for form in CAUSES[cause].forms(scene_of(experiment)) if form.label == label)


def fit_and_bench(experiment, cause, label, weighting="lasting errors"):
    """Return the fit of one form, its covariance that of a right form, and the bench it was made on."""
    bench, noise = bench_of(experiment)
    form = form_of(experiment, cause, label)
    starts = [np.array([bench.problem.young_log, *start]) for start in form.starts]
    if weighting == "rows alike":
        bench = rows_alike(bench, noise)
        return fitted(bench.problem, [form], starts), bench
    return refitted(bench.problem, [form], starts)[0], bench


def numbers(fit, *causes):
    """Return values and deviations of a fit of some causes, the modulus among them."""
    young = float(np.exp(fit.x[0]))
    found = {"young_kpa": [young, young * float(np.sqrt(fit.covariance[0, 0]))]}
    for values in parameters_of(fit, causes).values():
        found |= values
    return found


def both(experiment, cause, label, weighting="lasting errors"):
    """Return the numbers with the deviations stated, and with those of a form that is right."""
    fit, bench = fit_and_bench(experiment, cause, label, weighting)
    fitted = stated(bench, fit)
    return numbers(fitted.fit, cause), numbers(fit, cause), fitted.form_error
