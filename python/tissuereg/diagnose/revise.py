"""Second thoughts on causes that were found one after another: what is not needed any more goes, mates stand in.

The cause found first was weighed while the later ones were missing. Each is therefore taken out again, and exchanged
for those that came close to it when it was found.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.fit import Fit, Part, Target, fit

#: Nats by which a mate must be better.
BETTER = 2.0


def without(target: Target, current: Fit, part: int) -> Fit | None:
    """Return the fit of a model that lacks one of its causes.

    Parameters
    ----------
    target : Target
        What is fitted.
    current : Fit
        With all causes.
    part : int
        Number of the one that goes.

    Returns
    -------
    Fit or None
        None where it finds no equilibrium.
    """
    mine = current.slices()[part]
    others = [*current.parts[:part], *current.parts[part + 1 :]]
    return fit(target, others, start=np.delete(current.x, np.r_[mine]))


def needed(target: Target, current: Fit, thresholds: Mapping[str, float]) -> tuple[Fit, list[int]]:
    """Return the fit without the causes whose removal costs less than their threshold, and which causes are left.

    Parameters
    ----------
    target : Target
        What is fitted.
    current : Fit
        With all causes.
    thresholds : mapping of str to float
        Nats, by id.

    Returns
    -------
    tuple of Fit and list of int
        Numbers of the parts that stay, of those of `current`; one at least.
    """
    left = list(range(len(current.parts)))
    while len(left) > 1:
        fits = [(number, without(target, current, number)) for number in range(len(left))]
        spare = [
            (current.log_evidence - f.log_evidence - thresholds[current.ids[number]], number, f)
            for number, f in fits
            if f is not None
        ]
        beyond, number, fitted = min(spare, key=lambda row: row[0], default=(np.inf, 0, current))
        if beyond >= 0.0:
            break
        current = fitted
        del left[number]
    return current, left


def exchanged(target: Target, current: Fit, part: int, mates: Sequence[tuple[Part, FloatArray]]) -> Fit:
    """Return the fit with the best of some mates in the place of one cause, where it is better by `BETTER` nats.

    Parameters
    ----------
    target : Target
        What is fitted.
    current : Fit
        With all causes.
    part : int
        Number of the cause that may be replaced.
    mates : sequence of (Part, ndarray of float64, shape (k,))
        With the knobs where they begin.

    Returns
    -------
    Fit
        The one given where no mate is better.
    """
    mine = current.slices()[part]
    best = current
    for mate, knobs in mates:
        parts = [*current.parts[:part], mate, *current.parts[part + 1 :]]
        fitted = fit(target, parts, start=np.concatenate([current.x[: mine.start], knobs, current.x[mine.stop :]]))
        if fitted is not None and fitted.log_evidence > max(best.log_evidence, current.log_evidence + BETTER):
            best = fitted
    return best
