"""The search for causes: forward selection with held-out proof, then exchange and elimination (`selection`).

Each round screens all causes on the residual of the current model, fits the likely ones, and accepts the first that
passes its threshold and the held-out proof (`proof`) and is likelier than not. The found cause joins the model together
with nuisances for its own error (`nuisances.effect_nuisances`, `nuisances.other_forms`).
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.answer import PossibleCause
from tissuereg.diagnosis.candidates import Candidate, exchanged, refitted, without
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.evidence import Null, fit_amplitudes, probabilities
from tissuereg.diagnosis.fit import Fit, FitTarget, fit
from tissuereg.diagnosis.nuisances import effect_nuisances, other_forms
from tissuereg.diagnosis.proof import (
    GENERIC,
    NAMED,
    HeldOut,
    LinearModel,
    figure_blocks,
    held_out,
    linear_model,
    proof_blocks,
)
from tissuereg.diagnosis.refined import corrected_fit
from tissuereg.diagnosis.screen import UNKNOWN, Screen, Screened
from tissuereg.diagnosis.selection import selected
from tissuereg.diagnosis.settings import DEFAULT, DiagnoseSettings


@dataclass(frozen=True, eq=False)
class Step:
    """One round of the search.

    `screened`: linear evidence of all causes by id; `candidates`: the causes that were fitted, likeliest first;
    `given`: ids of the causes found before; `found`: the candidate that was accepted; None where none was; `proof`:
    predictions of held-out blocks with the accepted candidate, else with the likeliest; None where none passed its
    threshold. Rows are models: before the cause, with it, with the generic rival instead, the believed one; `figures`:
    the same for the blocks for which errors of the accepted one are reported (`figure_blocks`); `possible`: causes that
    came close to acceptance; `shift`: evidence of every cause in the model of all causes found minus that in the round,
    nats; `lead`: nats by which the cause that was exchanged for the accepted one leads it, until it is tested again.
    """

    screened: dict[str, Screened]
    candidates: list[Candidate]
    found: Candidate | None
    proof: HeldOut | None
    figures: HeldOut | None = None
    possible: tuple[PossibleCause, ...] = ()
    shift: float = 0.0
    lead: float = 0.0
    settings: DiagnoseSettings = DEFAULT
    given: tuple[str, ...] = ()

    def gains(self) -> dict[str, float]:
        """Return the log Bayes factor of every cause in the round, nats, by id: of its fit, else of the screening."""
        screened = {name: screened.log_bayes_factor for name, screened in self.screened.items()}
        return screened | {candidate.id: candidate.gain for candidate in self.candidates}

    def evidence(self) -> dict[str, float]:
        """Return the log Bayes factors as `gains` does, but in the model of all causes found."""
        gains = {name: gain + self.shift for name, gain in self.gains().items()}
        return gains if self.found is None else {**gains, self.found.id: self.found.gain}

    def chances(self) -> dict[str, float]:
        """Return the posterior probability, by id, of every cause in the round, the generic rival and no cause."""
        gains = self.evidence()
        if self.found is not None and self.proof is not None:
            # The held-out proof has distinguished the cause from the generic rival.
            density = self.proof.log_density.sum(axis=1)
            gains[UNKNOWN] = min(gains[UNKNOWN], self.found.gain - float(density[NAMED] - density[GENERIC]))
        look_alike = self.settings.evidence.look_alike
        chances = probabilities(gains, self.settings.evidence.temper)
        own = {name: chances[name] for name in CAUSES if name in chances}
        unknown = chances[UNKNOWN] + look_alike * sum(own.values())
        return {**chances, **{name: (1.0 - look_alike) * chance for name, chance in own.items()}, UNKNOWN: unknown}

    def close(self, nats: float) -> list[Candidate]:
        """Return the other candidates, likeliest first, that come within `nats` of the accepted one by `evidence`."""
        if self.found is None:
            return []
        least = self.found.gain - nats
        others = [replace(c, gain=c.gain + self.shift) for c in self.candidates if c.id != self.found.id]
        return [c for c in others if c.gain > least]

    def group(self, threshold: float, named: Collection[str] = ()) -> tuple[str, ...]:
        """Return the id of the accepted cause, then those the data cannot distinguish from it, likeliest first.

        `threshold`: log Bayes factor required of that cause, nats; `named`: ids that are findings themselves and join
        no group.
        """
        assert self.found is not None
        rules = self.settings.search
        as_likely = self.found.gain - self.settings.as_likely_within
        others = (c for c in self.close(0.5 * rules.separable**2) if c.id not in named)
        close = [c.id for c in others if c.gain > min(threshold, as_likely)]
        return (self.found.id, *close)[: rules.most_in_group]

    def probability(self, threshold: float, named: Collection[str] = ()) -> float:
        """Return the probability of the accepted cause together with its group; arguments as for `group`."""
        chances = self.chances()
        return sum(chances.get(name, 0.0) for name in self.group(threshold, named))

    def failed(self, threshold: float, named: Collection[str] = ()) -> PossibleCause | None:
        """Return the accepted cause if it fails threshold, proof or probability, else None; takes what `group` does."""
        assert self.found is not None
        assert self.proof is not None
        chance, rules = self.probability(threshold, named), self.settings.search
        passes = self.found.gain >= threshold and self.proof.proves(rules) and chance >= rules.stated
        return None if passes else PossibleCause(self.found.id, chance, self.found.gain, threshold)

    def dropped(self, failed: PossibleCause) -> "Step":
        """Return the round without its finding, which joins the possible causes."""
        return replace(self.bare(), possible=(*self.possible, failed))

    def bare(self) -> "Step":
        """Return the round without its finding."""
        return replace(self, found=None, figures=None, shift=0.0)

    def retested(self, top: Candidate) -> "Step":
        """Return the round with the evidence that its finding, `top`, has in the model of all causes.

        All causes of the round keep their distance to the cause that was accepted first.
        """
        assert self.found is not None
        return replace(self, found=top, shift=self.shift + top.gain - self.lead - self.found.gain, lead=0.0)


@dataclass(frozen=True, eq=False)
class Search:
    """All rounds of the search for causes.

    `base`, `final`: fits of the believed model and with all causes found; `steps`: rounds in order; the last one
    accepted nothing, unless there are as many as asked for; `reduced` (size,): residual of the final model, whitened by
    noise, nuisances and the model's own parameters; `target`: of the last fit; None where no cause was found.
    """

    base: Fit
    final: Fit
    steps: list[Step] = field(default_factory=list)
    reduced: FloatArray = field(default_factory=lambda: np.empty(0))
    target: FitTarget | None = None

    def withdrawn(self, target: FitTarget) -> "Search":
        """Return the same rounds with all findings withdrawn, so that the final model is the believed one."""
        steps = [step.bare() for step in self.steps]
        return Search(self.base, self.base, steps, target.null.reduced(self.base.residual))


def search(target: FitTarget, screen: Screen, thresholds: Mapping[str, float], most: int) -> Search:
    """Return the causes that the data show, with all rounds of the search for them.

    `thresholds`: log Bayes factor that each cause must exceed, nats, by id; `most`: number of causes at most. There are
    no causes where none is accepted.
    """
    base = fit(target, [])
    assert base is not None  # the believed model has an equilibrium: it was solved before
    found = selected(_Bodies(target, screen, base, thresholds), _FoundCauses(target, target, base), most)
    reduced = _null_after(found.target, found.fit).reduced(found.fit.residual)
    return Search(base, found.fit, list(found.steps), reduced, found.target if found.ids else None)


@dataclass(frozen=True, eq=False)
class _FoundCauses:
    """The causes found so far, with the model of all of them and the rounds in which they were found."""

    #: Data and model with and without nuisances for the size of the causes.
    target: FitTarget
    plain: FitTarget
    fit: Fit
    steps: tuple[Step, ...] = ()
    #: Whether the causes are as they were accepted, alone.
    settled: bool = True
    #: Fits without each cause, None where there is no equilibrium; empty before they are tested.
    rests: tuple[Fit | None, ...] = ()
    #: The first cause, settled; None where there is none, or a later one is likelier alone.
    first: "_FoundCauses | None" = None

    @property
    def ids(self) -> tuple[str, ...]:
        """Ids of the causes, in their order."""
        return self.fit.ids

    def rounds(self) -> list[int]:
        """Return the numbers of the rounds of the causes, in their order."""
        return [number for number, step in enumerate(self.steps) if step.found is not None]

    def with_steps(self, changed: Mapping[int, Step]) -> tuple[Step, ...]:
        """Return all rounds, of which some are changed, by number."""
        return tuple(changed.get(number, step) for number, step in enumerate(self.steps))


@dataclass(frozen=True, eq=False)
class _Bodies:
    """The models of a body (`selection.Models`); `given`: without nuisances for the errors of causes."""

    given: FitTarget
    screen: Screen
    base: Fit
    thresholds: Mapping[str, float]

    def grown(self, known: _FoundCauses) -> _FoundCauses:
        """Return what was found with the cause that the next round accepts."""
        step = _round(known.target, self.screen, self.base, known.fit, self.thresholds)
        steps = (*known.steps, step)
        if step.found is None:
            return replace(known, steps=steps)
        plain, target, fitted = _with_finding(known.plain, self.screen, self.base, known.fit, step.found)
        grown = _FoundCauses(target, plain, fitted, steps, not known.ids, first=known.first)
        return replace(grown, first=known.first or grown)

    def exchanged(self, known: _FoundCauses) -> _FoundCauses:
        """Return what was found with causes exchanged for their closest rivals."""
        self.given.bench.progress("revision of the causes found")
        rules, target, current = self.given.bench.settings.search, known.target, known.fit
        changed: dict[int, Step] = {}
        for part, number in enumerate(known.rounds()):
            step = known.steps[number]
            rivals = [c.as_rival() for c in step.close(rules.rivals_within) if c.id not in current.ids]
            target, better = exchanged(target, current, part, rivals[: rules.most_rivals])
            if better is not current:
                changed[number] = replace(step, lead=better.log_evidence - current.log_evidence)
                current = better
        return replace(known, target=target, fit=current, steps=known.with_steps(changed))

    def tested(self, known: _FoundCauses) -> tuple[_FoundCauses, Mapping[int, PossibleCause]]:
        """Return what was found with evidence and proofs in the model of all causes, and what fails them."""
        if known.settled:
            return known, {}
        target, current = known.target, known.fit
        rests = tuple(without(target, current, part) for part in range(len(current.parts)))
        changed = {
            number: _judged(target, self.screen, self.base, current, rests[part], part, known.steps[number])
            for part, number in enumerate(known.rounds())
        }
        shortcomings = (
            step.failed(self.thresholds[name], current.ids)
            for step, name in zip(changed.values(), current.ids, strict=True)
        )
        failed = {part: short for part, short in enumerate(shortcomings) if short is not None}
        # Causes without which there is no equilibrium wait for the others.
        removable = {part: short for part, short in failed.items() if rests[part] is not None}
        return replace(known, rests=rests, steps=known.with_steps(changed)), removable or failed

    def without(self, known: _FoundCauses, part: int, failed: PossibleCause) -> _FoundCauses:
        """Return what was found without a cause, and without the nuisances for its error."""
        number = known.rounds()[part]
        steps = known.with_steps({number: known.steps[number].dropped(failed)})
        rest, first = known.rests[part], known.first
        if number == 0:
            others = [step.found.gain for step in steps if step.found is not None]
            told = 0.5 * self.given.bench.settings.search.separable**2
            # The first cause stays as it was accepted alone, unless the data tell it from a later one.
            first = None if max(others, default=0.0) > failed.log_bayes_factor + told else first
        if rest is None or not rest.parts:
            bare = tuple(step.bare() for step in steps)
            if first is None or rest is None:
                return _FoundCauses(self.given, self.given, self.base, bare)
            alone = replace(first.steps[0], possible=bare[0].possible)
            return replace(first, steps=(alone, *bare[1:]), first=first)
        target, current = corrected_fit(*self._refitted(known, rest, part))
        return replace(known, target=target, fit=current, steps=steps, rests=(), first=first)

    def _refitted(self, known: _FoundCauses, rest: Fit, part: int) -> tuple[FitTarget, Fit]:
        """Return target and fit after a cause was taken out, given its number and the fit `rest` without it."""
        others = [pair for at, pair in enumerate(zip(known.ids, known.rests, strict=True)) if at != part]
        forms = [
            _forms(self.given, self.screen, name, known.fit.prediction - before.prediction)
            for name, before in others
            if before is not None
        ]
        errors = self.given.white(effect_nuisances(self.given.bench, rest.prediction - self.base.prediction))
        null = Null(np.concatenate([self.given.null.nuisances, *forms, errors]))
        target = replace(known.target, null=null)
        return target, fit(target, rest.parts, near=rest.near) or rest


def _round(target: FitTarget, screen: Screen, base: Fit, current: Fit, thresholds: Mapping[str, float]) -> Step:
    """Return one round: the candidates for a further cause, and the likeliest that passes the held-out proof."""
    screened = screen.of(_as_screened(screen, target, current))
    candidates = refitted(target, screen, screened, current, thresholds)
    step = Step(screened, candidates, None, None, settings=target.bench.settings, given=current.ids)
    passing = [candidate for candidate in candidates if candidate.gain >= thresholds[candidate.id]]
    references = references_of(target, screen, base, current) if passing else []
    for candidate in passing:
        tried = prove(target, references, current, candidate.fit)
        step = replace(step, proof=step.proof or tried)
        if tried.proves(target.bench.settings.search):
            figures = prove(target, references, current, candidate.fit, stated=True)
            accepted = replace(step, found=candidate, proof=tried, figures=figures)
            failed = accepted.failed(thresholds[candidate.id], current.ids)
            if failed is None:
                return accepted
            step = replace(step, possible=(*step.possible, failed))
    return step


def _with_finding(
    plain: FitTarget, screen: Screen, base: Fit, before: Fit, found: Candidate
) -> tuple[FitTarget, FitTarget, Fit]:
    """Return the targets after a cause was found, without and with nuisances for its size, and the fit to the last."""
    # A found cause has a model error of its own. Its discretisation error was corrected; what remains of that, and the
    # error of its form, are nuisances when further causes are tested.
    forms = _forms(plain, screen, found.id, found.fit.prediction - before.prediction)
    null = Null(np.concatenate([plain.null.nuisances, forms]))
    plain = replace(plain, correction=found.target.correction, null=null)
    errors = plain.white(effect_nuisances(plain.bench, found.fit.prediction - base.prediction))
    target = replace(plain, null=Null(np.concatenate([null.nuisances, errors])))
    alone = found.fit
    return plain, target, fit(target, alone.parts, near=alone.near) or alone


def _forms(target: FitTarget, screen: Screen, name: str, change: FloatArray) -> FloatArray:
    """Return nuisances for the form of a cause, by its id, that was found to make a change (size,), mm and mN."""
    return other_forms(screen.white_columns(name), target.white(change), target.bench.settings.nuisances)


def _judged(
    target: FitTarget, screen: Screen, base: Fit, current: Fit, before: Fit | None, part: int, step: Step
) -> Step:
    """Return the round of a finding with evidence and proof in the model of all causes; `before`: fit without it."""
    assert step.found is not None
    # The evidence that the removal of the cause costs; without an equilibrium that of its round.
    gain = step.found.gain + step.lead if before is None else current.log_evidence - before.log_evidence
    step = step.retested(Candidate(current.parts[part].id, current, gain, target))
    if before is None:
        return step
    references = references_of(target, screen, base, before)
    proof = prove(target, references, before, current, part)
    figures = prove(target, references, before, current, part, stated=True)
    return replace(step, proof=proof, figures=figures)


def prove(
    target: FitTarget,
    references: list[LinearModel],
    current: Fit,
    found: Fit,
    part: int | None = -1,
    *,
    stated: bool = False,
) -> HeldOut:
    """Return the predictions of the compared models on held-out blocks: of a proof, or those whose errors are stated.

    `references`: as `references_of`; `current`, `found`: fits without and with the cause; `part`: its number in the
    latter; None for the modulus; `stated`: whether the blocks are those whose errors are stated (`figure_blocks`).
    """
    slopes, change = _columns_and_change(target, current, found, part)
    layout, rules = target.bench.layout, target.bench.settings.search
    blocks = figure_blocks(layout, slopes, change, rules) if stated else proof_blocks(layout, slopes, rules)
    before, *others = references
    named = linear_model(target, found)
    made = held_out([before, named, *others], blocks)
    if stated:
        return made
    # Data that the fit predicts exactly, as each model sees them.
    would = replace(before, residual=before.residual - current.residual + change)
    exact = replace(named, residual=named.residual - found.residual)
    return replace(made, expected_gain=-float(np.subtract(*held_out([would, exact], blocks).log_density.sum(axis=1))))


def _columns_and_change(target: FitTarget, current: Fit, found: Fit, part: int | None) -> tuple[FloatArray, FloatArray]:
    """Return whitened changes: by one prior deviation of each parameter (k, size), and by the whole cause (size,)."""
    slopes = target.slopes(found)[slice(1) if part is None else found.slices()[part]]
    change = target.white(found.prediction - current.prediction)
    return (slopes if len(slopes) else change[None]), change


def references_of(target: FitTarget, screen: Screen, base: Fit, current: Fit) -> list[LinearModel]:
    """Return three models to compare a cause with: one without it, that plus the generic rival, the believed one.

    `base`, `current`: fits of the believed model and without the cause. The rival has the size of most evidence.
    """
    reduced = target.null.reduced(current.residual)
    gains = [fit_amplitudes(reduced, target.null.reduced(columns))[0] for columns in screen.generic_white]
    rival = linear_model(target, current, np.asarray(screen.generic_white[int(np.argmax(gains))]))
    return [linear_model(target, current), rival, linear_model(target, base)]


def _null_after(target: FitTarget, current: Fit) -> Null:
    """Return the covariance of noise and nuisances given the causes found, whose parameters are nuisances in it too."""
    return Null(np.concatenate([target.null.nuisances, target.slopes(current)]))


def _as_screened(screen: Screen, target: FitTarget, current: Fit) -> FloatArray:
    """Return the residual (size,) of a fit, whitened by noise and nuisances, orthogonal to its parameters' changes."""
    residual = screen.null.reduced(current.residual)
    if not current.parts:
        return residual
    slopes = screen.null.reduced(target.white(current.jacobian[1:]))
    modes = np.linalg.svd(slopes, full_matrices=False)[2]
    return np.asarray(residual - (residual @ modes.T) @ modes)
