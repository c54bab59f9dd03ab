"""The mesh's error in what was found: the correction of the believed model made right for the fitted one too.

A ball that cuts across the user's elements has an error of its own: of one of 8 mm in elements of 5 mm a quarter of
what it changes. In data without noise that moved its place by 1.9 mm and the fit with its mesh put right by 0.6 mm; the
fine mesh's own error in the ball is 6 %.
"""

from dataclasses import replace

import numpy as np

from tissuereg.diagnose.fit import ABSOLUTE, Fit, Target, bodily
from tissuereg.diagnose.refined import refined_effects
from tissuereg.effects import ChainEffect
from tissuereg.errors import ConvergenceError, ExperimentError, MeshError, SupportError


def recorrected(target: Target, found: Fit) -> Target:
    """Return a target whose correction is right for the believed model and for a fitted one.

    Parameters
    ----------
    target : Target
        What was fitted.
    found : Fit
        With causes.

    Returns
    -------
    Target
        The one given where the answer hangs on more than displacements and the modulus scales more than forces, where
        the tracker's errors alone or memory were found, and where the fine mesh finds no equilibrium.
    """
    bench = target.bench
    if not bench.scales_forces or any(part.id in ABSOLUTE for part in found.parts):
        return target
    # What is linear in the fit stays so.
    effects = bodily(found.parts, found.x, bench.young)
    if all(isinstance(effect, ChainEffect) for effect in effects):
        return target
    try:
        fine = refined_effects(bench, effects)
        if fine is None:
            return target
        coarse = bench.predictor.predict(effects)
    except (ConvergenceError, ExperimentError, MeshError, SupportError):
        return target
    std = np.full(bench.layout.size, target.noise.force_std)
    for case in bench.layout.parts:
        case.markers(std)[:] = target.noise.marker_std[:, None]
    return replace(target, correction=target.correction.with_effect(bench.base, coarse, fine, std))
