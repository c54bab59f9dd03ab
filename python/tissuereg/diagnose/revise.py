"""Second thoughts on causes that were found one after another: what is not needed any more goes, mates stand in.

The cause found first was weighed while the later ones were missing. Each is therefore taken out again, and exchanged
for those that came close to it when it was found.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.fit import Fit, Part, Target, fit
from tissuereg.diagnose.recorrect import PUT_RIGHT, settled

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


def needed(target: Target, current: Fit, thresholds: Mapping[str, float]) -> tuple[Target, Fit, list[int]]:
    """Return the fit without the causes whose removal costs less than their threshold, and which causes are left.

    Every fit has the mesh's error in its own causes put right.

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
    tuple of Target, Fit and list of int
        What is fitted then, and the numbers of the parts that stay, of those of `current`; one at least.
    """
    left = list(range(len(current.parts)))
    while len(left) > 1:
        spare: list[tuple[int, Target, Fit]] = []
        for number, name in enumerate(current.ids):
            # What a fit must reach to show that its missing cause is not needed.
            least = current.log_evidence - thresholds[name]
            reached = _reaching(least, target, without(target, current, number, hopeless=PUT_RIGHT - least))
            if reached is not None:
                spare.append((number, *reached))
        if not spare:
            break
        # Where one of two will do, the likelier one stays, whatever their thresholds are.
        number, target, current = max(spare, key=lambda row: row[2].log_evidence)
        del left[number]
    return target, current, left


def exchanged(target: Target, current: Fit, part: int, mates: Sequence[tuple[Part, FloatArray]]) -> tuple[Target, Fit]:
    """Return the fit with the best of some mates in the place of one cause, where it is better by `BETTER` nats.

    Every fit has the mesh's error in its own causes put right.

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
    tuple of Target and Fit
        Those given where no mate is better.
    """
    mine = current.slices()[part]
    best, of_best = current, target
    for mate, knobs in mates:
        parts = [*current.parts[:part], mate, *current.parts[part + 1 :]]
        start = np.concatenate([current.x[: mine.start], knobs, current.x[mine.stop :]])
        least = max(best.log_evidence, current.log_evidence + BETTER)
        reached = _reaching(least, target, fit(target, parts, start=start, hopeless=PUT_RIGHT - least))
        if reached is not None:
            of_best, best = reached
    return of_best, best


def _reaching(least: float, target: Target, fitted: Fit | None) -> tuple[Target, Fit] | None:
    """Return a fit with the mesh's error in it put right, if its log evidence then passes the least."""
    if fitted is None or fitted.log_evidence < least - PUT_RIGHT:
        return None
    better, again = settled(target, fitted)
    return (better, again) if again.log_evidence > least else None
