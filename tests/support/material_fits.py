"""One form of one cause fitted to curves alone, with the standard deviations that a diagnosis would state."""

import numpy as np

from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import FittedCause
from tissuereg.diagnosis.material.answer import parameters_of
from tissuereg.diagnosis.material.bench import bench_of
from tissuereg.diagnosis.material.data import scene_of
from tissuereg.diagnosis.material.fit import fitted, refitted
from tissuereg.diagnosis.material.refine import rows_alike, stated


def form_of(experiment, cause, label):
    """Return a cause in the form of a label, among those that the curves of an experiment can determine."""
    forms = CAUSES[cause].in_curves(scene_of(experiment))
    return FittedCause(cause, next(form for form in forms if form.label == label))


def fit_and_bench(experiment, cause, label, weighting="lasting errors"):
    """Return the fit of one form, with the covariance for a form without error, and its bench."""
    bench = bench_of(experiment)
    form = form_of(experiment, cause, label)
    starts = [np.array([bench.young_log, *start]) for start in form.free_parameters.guesses]
    if weighting == "rows alike":
        bench = rows_alike(bench)
        return fitted(bench, [form], starts), bench
    return refitted(bench, [form], starts)[0], bench


def numbers(fit):
    """Return values and standard deviations of a fit of some causes, including the modulus."""
    young = float(np.exp(fit.x[0]))
    found = {"young_kpa": [young, young * float(np.sqrt(fit.covariance[0, 0]))]}
    for values in parameters_of(fit).values():
        found |= values
    return found


def both(experiment, cause, label, weighting="lasting errors"):
    """Return the numbers with the stated deviations, those for a form without error, and the form error."""
    fit, bench = fit_and_bench(experiment, cause, label, weighting)
    with_deviations, form_error = stated(bench, fit)
    return numbers(with_deviations), numbers(fit), form_error
