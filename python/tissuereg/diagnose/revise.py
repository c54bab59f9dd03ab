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


def without(target: Target, current: Fit, part: int, *, hopeless: float = np.inf) -> Fit | None:
    """Return the fit of a model that lacks one of its causes.

    Parameters
    ----------
    target : Target
        What is fitted.
    current : Fit
        With all causes.
    part : int
        Number of the one that goes.
    hopeless : float
        As `fit` takes it.

    Returns
    -------
    Fit or None
        None where it finds no equilibrium.
    """
    mine = current.slices()[part]
    others = [*current.parts[:part], *current.parts[part + 1 :]]
    return fit(target, others, start=np.delete(current.x, np.r_[mine]), hopeless=hopeless)


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
        spare: list[tuple[float, int, Fit]] = []
        for number, name in enumerate(current.ids):
            # What a fit must reach to show that its missing cause is not needed.
            least = current.log_evidence - thresholds[name]
            fitted = without(target, current, number, hopeless=-least)
            if fitted is not None and fitted.log_evidence > least:
                spare.append((fitted.log_evidence - least, number, fitted))
        if not spare:
            break
        _, number, current = max(spare, key=lambda row: row[0])
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
        start = np.concatenate([current.x[: mine.start], knobs, current.x[mine.stop :]])
        least = max(best.log_evidence, current.log_evidence + BETTER)
        fitted = fit(target, parts, start=start, hopeless=-least)
        if fitted is not None and fitted.log_evidence > least:
            best = fitted
    return best
