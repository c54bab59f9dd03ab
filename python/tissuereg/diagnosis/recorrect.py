"""Correction of the discretisation error in a fitted cause, in addition to that of the believed model.

The effect of a cause has a discretisation error of its own. Four-node elements lock by an amount that depends on
Poisson's ratio: on a body of 600 nodes a change of the ratio moves markers two to three times too far, and a law that
is stiffer in tension twice too far; without a correction the two cannot be distinguished. The boundary of an inclusion
cuts across elements: with a radius of 8 mm in elements of 5 mm a quarter of its effect is error. In data without noise
that displaced the fitted place by 1.9 mm, and by 0.6 mm after the correction; the fine mesh's own error is 6 %.

A fit is simulated on the fine mesh, the difference becomes part of the correction, and the model is fitted again. The
error is assumed proportional to the effect. Where the new fit is another effect rather than more or less of the same,
the correction is computed again: on 600 nodes friction slips ten times too far, and the slipping region depends on the
friction.
"""

from dataclasses import replace

import numpy as np

from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.fit import Fit, FitTarget, at_believed_modulus, fit
from tissuereg.diagnosis.predictor import NO_ANSWER
from tissuereg.diagnosis.refined import refined_effects
from tissuereg.errors import MeshError


def corrected_fit(target: FitTarget, found: Fit) -> tuple[FitTarget, Fit]:
    """Return a target whose correction covers a fitted model, and the fit to it: correct and refit until they agree.

    `target`: data, believed model and correction of the fit; `found`: fit with causes. The two given ones are
    returned where `recorrected` changes nothing.

    Notes
    -----
    Most effects need one round: in 12 fits of bodies of 600 nodes a second one at the new fit changed the log evidence
    by 1.3 at most, where the first one changed it by up to 18, and moved no parameter by more than 0.5 of its
    deviations. Friction needs six: of a test body whose friction has a size of 21 noise deviations the fit gains 51
    nats on the user's mesh, 35 after one round, 108 after six, and 103 with ten-node elements throughout.
    """
    corrected = target, found
    for _ in range(target.bench.settings.model.most_corrections):
        better = recorrected(target, corrected[1])
        start, choices = corrected[1].x, found.choices
        again = None if better is target else fit(better, found.parts, start=start, choices=choices)
        if again is None:
            break
        corrected = better, again
        if _uncorrected(better, again) < target.bench.settings.model.uncorrected:
            break
    return corrected


def _uncorrected(target: FitTarget, found: Fit) -> float:
    """Return the estimated discretisation error of a fit that its correction does not cover, in noise deviations.

    It is the error of the effect that was corrected last, times the relative size of that part of the new effect which
    is no multiple of it.
    """
    of_effect = target.correction.of_effect
    if of_effect is None:
        return 0.0
    try:
        other = of_effect.other(at_believed_modulus(target, found)[1])
    except NO_ANSWER:
        # The fit reached this model by steps from a neighbour; solved at once it has no equilibrium.
        return 0.0
    remainder, error, effect = (
        float(np.linalg.norm(target.null.reduced(target.white(np.where(target.bench.layout.seen, flat, 0.0)))))
        for flat in (other, of_effect.difference, of_effect.change)
    )
    return remainder * error / effect if effect > 0.0 else 0.0


def recorrected(target: FitTarget, found: Fit) -> FitTarget:
    """Return a target whose correction is exact for the believed model and for a fitted model with causes.

    `target`: data, believed model and correction of the fit; `found`: fit with causes. The given target is returned
    where the modulus does more than scale forces, where all causes are errors of the tracker or one is memory, where
    the fine mesh has no equilibrium, and for data that were simulated on the user's mesh.
    """
    bench = target.bench
    if not bench.settings.model.corrected or bench.is_exact or not target.scales_forces(found.ids):
        return target
    if all(CAUSES[name].closed_form for name in found.ids):
        return target
    bench.progress(f"fine mesh with {' + '.join(found.ids)}")
    try:
        effects, coarse = at_believed_modulus(target, found)
        fine = refined_effects(bench, effects)
    except (*NO_ANSWER, MeshError):
        return target
    if fine is None:
        return target
    std = np.full(bench.layout.size, target.noise.force_std)
    for case in bench.layout.parts:
        case.markers(std)[:] = target.noise.marker_std[:, None]
    return replace(target, correction=target.correction.with_effect(bench.base, coarse, fine, std))
