"""The search for causes: one after another, each proved, each weighed against what else could explain the data."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.candidates import Candidate, asked_of, refitted
from tissuereg.diagnose.causes import CAUSES
from tissuereg.diagnose.evidence import Null, fit_amplitudes
from tissuereg.diagnose.fit import Fit, Target, fit
from tissuereg.diagnose.nuisances import effect_nuisances, other_forms
from tissuereg.diagnose.proof import (
    BEFORE,
    GENERIC,
    NAMED,
    HeldOut,
    Linear,
    figure_blocks,
    held_out,
    linear_model,
    proof_blocks,
)
from tissuereg.diagnose.revise import exchanged, needed, without
from tissuereg.diagnose.screen import Screen, Screened

#: Causes in one answer at most.
MOST_CAUSES = 3

#: Two causes are told apart where their separability passes this; the evidence then differs by half its square.
SEPARABLE = 4.0

#: Gain in log predictive density that a proof asks for.
PROVED = 4.0

#: A cause that gains so many nats and beats its rivals is named though something is left that it does not explain.
CLEAR = 100.0

#: Mates that are tried in the place of one of several causes: so many, and within so many nats of it.
MOST_MATES, MATES_WITHIN = 2, 40.0


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the search.

    Attributes
    ----------
    screened : dict of str to Screened
        Linear evidence of all causes.
    candidates : list of Candidate
        Those fitted, likeliest first.
    found : Candidate or None
        The one that was proved.
    proof : HeldOut or None
        Of the likeliest candidate or the one found; rows as `proof` names them.
    figures : HeldOut or None
        Of the one found, on what can be guessed without it being measured; rows as in the proof.
    rivals : float
        Log density that the best rival gives to what the proof held out: the generic one, or another candidate that the
        data tell from the one found.
    """

    screened: dict[str, Screened]
    candidates: list[Candidate]
    found: Candidate | None
    proof: HeldOut | None
    figures: HeldOut | None = None
    rivals: float = np.inf

    @property
    def is_clear(self) -> bool:
        """Whether the one found gains `CLEAR` nats, and foretells what was held out better than every rival does."""
        if self.found is None or self.proof is None:
            return False
        return self.found.gain >= CLEAR and float(self.proof.log_density[NAMED].sum()) > self.rivals

    def close(self, nats: float) -> list[Candidate]:
        """Return the candidates within so many nats of the one found, itself left out, likeliest first."""
        if self.found is None:
            return []
        own = next((c.gain for c in self.candidates if c.id == self.found.id), self.found.gain)
        return [c for c in self.candidates if c.id != self.found.id and c.gain > own - nats]


@dataclass(frozen=True, eq=False)
class Search:
    """All rounds.

    Attributes
    ----------
    base : Fit
        The believed model.
    final : Fit
        With all causes found.
    steps : list of Step
        In order; the last one found nothing, unless there are `MOST_CAUSES`.
    reduced : ndarray of float64, shape (size,)
        What the final model leaves, whitened and reduced by all nuisances and its own knobs.
    target : Target or None
        What was fitted in the end, the mesh's error in the causes found put right; None where nothing was found.
    """

    base: Fit
    final: Fit
    steps: list[Step] = field(default_factory=list)
    reduced: FloatArray = field(default_factory=lambda: np.empty(0))
    target: Target | None = None

    def taken_back(self, target: Target) -> "Search":
        """Return the same search with nothing found."""
        steps = [replace(step, found=None) for step in self.steps]
        return Search(self.base, self.base, steps, target.null.reduced(self.base.residual))


def search(
    target: Target, screen: Screen, thresholds: Mapping[str, float], *, progress: Callable[[str], None] | None = None
) -> Search:
    """Return the causes that data show.

    Parameters
    ----------
    target : Target
        What is fitted.
    screen : Screen
        All hypotheses of the bank.
    thresholds : mapping of str to float
        Log Bayes factor that every cause must pass.
    progress : callable of str, optional
        Called with what is at work.

    Returns
    -------
    Search
        Nothing found is an answer too.
    """
    base = fit(target, [])
    assert base is not None  # the bench has solved the believed model
    current, steps, plain = base, [], target
    while len(current.parts) < MOST_CAUSES:
        step = _round(target, screen, base, current, thresholds, progress)
        steps.append(step)
        if step.found is None:
            break
        plain, target, current = _beyond(plain, screen, base, current, step.found)
    if len(current.parts) > 1:
        if progress is not None:
            progress("second thoughts")
        target, current, steps = _revised(target, screen, base, current, steps, thresholds)
    reduced = _null_after(target, current).reduced(current.residual)
    return Search(base, current, steps, reduced, target if current.parts else None)


def _round(
    target: Target,
    screen: Screen,
    base: Fit,
    current: Fit,
    thresholds: Mapping[str, float],
    progress: Callable[[str], None] | None,
) -> Step:
    """Return what is likely beside a fit, and the likeliest of it that is proved."""
    screened = screen.of(_as_screened(screen, target, current))
    asked = asked_of(thresholds, current.ids)
    candidates = refitted(target, screen, screened, current, asked, progress)
    step = Step(screened, candidates, None, None)
    passing = [candidate for candidate in candidates if candidate.gain >= asked[candidate.id]]
    beside = _beside(target, screen, base, current) if passing else []
    for candidate in passing:
        tried = _prove(target, beside, current, candidate)
        step = replace(step, proof=step.proof or tried)
        density = tried.log_density.sum(axis=1)
        proved = 0.0 if CAUSES[candidate.id].always_fitted else PROVED
        if density[NAMED] > density[BEFORE] + proved and density[NAMED] > density[GENERIC]:
            rivals = max(float(density[GENERIC]), _best_rival(target, current, candidates, candidate))
            figures = _figures(target, beside, current, candidate)
            return replace(step, found=candidate, proof=tried, figures=figures, rivals=rivals)
    return step


def _best_rival(target: Target, current: Fit, candidates: Sequence[Candidate], found: Candidate) -> float:
    """Return the best log density that causes which data tell from the one found give to what its proof held out."""
    blocks = proof_blocks(target.bench.layout, _seen(target, current, found, -1)[0])
    others = [other for other in candidates if other.gain <= found.gain - 0.5 * SEPARABLE**2]
    held = held_out([linear_model(target, other.fit) for other in others], blocks) if others else None
    return -np.inf if held is None else float(held.log_density.sum(axis=1).max())


def _beyond(plain: Target, screen: Screen, base: Fit, before: Fit, found: Candidate) -> tuple[Target, Target, Fit]:
    """Return what is fitted once a cause was found, without and with the size of its error, and the fit then."""
    # What was found has an error of its own: that of the mesh was corrected, what is left of it and of the form stands
    # beside further causes.
    forms = other_forms(screen.white_columns(found.id), plain.white(found.fit.prediction - before.prediction))
    null = Null(np.concatenate([plain.null.nuisances, forms]))
    plain = replace(plain, correction=found.target.correction, null=null)
    errors = plain.white(effect_nuisances(plain.bench, found.fit.prediction - base.prediction))
    target = replace(plain, null=Null(np.concatenate([null.nuisances, errors])))
    return plain, target, fit(target, found.fit.parts, start=found.fit.x) or found.fit


def _revised(
    target: Target, screen: Screen, base: Fit, current: Fit, steps: list[Step], thresholds: Mapping[str, float]
) -> tuple[Target, Fit, list[Step]]:
    """Return what is left of several causes once each was taken out again and exchanged for its mates."""
    found = [number for number, step in enumerate(steps) if step.found is not None]
    target, current, left = needed(target, current, thresholds)
    found = [found[part] for part in left]
    steps = [step if number in found else replace(step, found=None) for number, step in enumerate(steps)]
    for part, number in enumerate(found):
        mates = [c.as_mate() for c in steps[number].close(MATES_WITHIN) if c.id not in current.ids]
        target, current = exchanged(target, current, part, mates[:MOST_MATES])
    for part, number in enumerate(found):
        # What a finding gains is what its removal costs.
        before = without(target, current, part)
        if before is not None:
            gain = current.log_evidence - before.log_evidence
            top = Candidate(current.parts[part].id, current, gain, target)
            beside = _beside(target, screen, base, before)
            proof = _prove(target, beside, before, top, part)
            figures = _figures(target, beside, before, top, part)
            steps[number] = replace(steps[number], found=top, proof=proof, figures=figures)
    return target, current, steps


def _prove(target: Target, beside: list[Linear], current: Fit, candidate: Candidate, part: int = -1) -> HeldOut:
    """Return the densities that models give to what was held out, in the rows that `proof` names."""
    slopes, _ = _seen(target, current, candidate, part)
    return held_out(_models(target, beside, candidate), proof_blocks(target.bench.layout, slopes))


def _figures(target: Target, beside: list[Linear], current: Fit, candidate: Candidate, part: int = -1) -> HeldOut:
    """Return what the same models leave of what was held out, where they can guess it."""
    slopes, change = _seen(target, current, candidate, part)
    return held_out(_models(target, beside, candidate), figure_blocks(target.bench.layout, slopes, change))


def _seen(target: Target, current: Fit, candidate: Candidate, part: int) -> tuple[FloatArray, FloatArray]:
    """Return a cause's columns (k, size) over prior deviations, and what it changes (size,), whitened."""
    mine = candidate.fit.slices()[part]
    slopes = target.white(candidate.fit.jacobian[mine]) * candidate.fit.deviation[mine, None]
    change = target.white(candidate.fit.prediction - current.prediction)
    return (slopes if len(slopes) else change[None]), change


def _beside(target: Target, screen: Screen, base: Fit, current: Fit) -> list[Linear]:
    """Return what any cause is held against: the model before it, the generic rival beside that, the believed one."""
    rival = linear_model(target, current, rival_columns(screen, target, current))
    return [linear_model(target, current), rival, linear_model(target, base)]


def _models(target: Target, beside: list[Linear], candidate: Candidate) -> list[Linear]:
    before, *others = beside
    return [before, linear_model(target, candidate.fit), *others]


def rival_columns(screen: Screen, target: Target, current: Fit) -> FloatArray:
    """Return the generic rival's columns beside a fit, whitened (p, size), of the size that the data favour."""
    reduced = target.null.reduced(current.residual)
    gains = [fit_amplitudes(reduced, target.null.reduced(columns)).log_bayes_factor for columns in screen.generic_white]
    return np.asarray(screen.generic_white[int(np.argmax(gains))])


def _null_after(target: Target, current: Fit) -> Null:
    """Return what is expected once causes were found: their knobs are nuisances too."""
    slopes = target.white(current.jacobian) * current.deviation[:, None]
    return Null(np.concatenate([target.null.nuisances, slopes]))


def _as_screened(screen: Screen, target: Target, current: Fit) -> FloatArray:
    """Return the residual of a model, reduced by the screen's own null and cleared of the model's knobs."""
    residual = screen.null.reduced(current.residual)
    if not current.parts:
        return residual
    slopes = screen.null.reduced(target.white(current.jacobian[1:]))
    modes = np.linalg.svd(slopes, full_matrices=False)[2]
    return np.asarray(residual - (residual @ modes.T) @ modes)
