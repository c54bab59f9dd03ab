"""The search for causes: forward selection with held-out proof, then exchange and elimination (`selection`).

Each round screens all causes on the residual of the current model, fits the likely ones, and accepts the first that
passes its threshold and the held-out proof (`proof`) and is likelier than not. The found cause joins the model together
with nuisances for its own error (`nuisances.effect_nuisances`, `nuisances.other_forms`).

A finding is a cause that was found with its group: those that the data cannot distinguish from it. The modulus is
fitted in every model, and named where it lies far from its prior mean. Its log Bayes factor is half the square of its
distance from that, in the logarithm of the modulus and in prior standard deviations; like any cause, it must predict
held-out data better than the believed value and the generic rival.
"""

from collections.abc import Collection, Mapping, Sequence
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.answer import Finding, PossibleCause
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.candidates import Candidate, exchanged, refitted, without
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.evidence import Null, probabilities
from tissuereg.diagnosis.fit import Fit, FitTarget, fit
from tissuereg.diagnosis.nuisances import effect_nuisances, other_forms
from tissuereg.diagnosis.proof import GENERIC, NAMED, HeldOut, held_out_figures, prove, references_of
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


def _rounds(steps: Sequence[Step]) -> dict[int, tuple[Step, Candidate]]:
    """Return the rounds that accepted a cause, in order and by number, each with the cause."""
    return {i: (step, step.found) for i, step in enumerate(steps) if step.found is not None}


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

    def rounds(self) -> dict[int, tuple[Step, Candidate]]:
        """Return the rounds that accepted a cause, in order and by number, each with the cause."""
        return _rounds(self.steps)

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
    bodies, none = _Bodies(target, screen, base, thresholds), _FoundCauses(target, target, base)
    found = selected(bodies, none, most)
    # The parameters of the causes found are nuisances too.
    null = Null(np.concatenate([found.target.null.nuisances, found.target.slopes(found.fit)]))
    last = found.target if found.ids else None
    return Search(base, found.fit, list(found.steps), null.reduced(found.fit.residual), last)


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
        return list(_rounds(self.steps))

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
        step = self.round(known.target, known.fit)
        steps = (*known.steps, step)
        if step.found is None:
            return replace(known, steps=steps)
        plain, target, fitted = self.with_finding(known.plain, known.fit, step.found)
        grown = _FoundCauses(target, plain, fitted, steps, not known.ids, first=known.first)
        return replace(grown, first=known.first or grown)

    def round(self, target: FitTarget, current: Fit) -> Step:
        """Return one round: the candidates for a further cause, and the likeliest that passes the held-out proof."""
        screened = self.screen.of(self.left(target, current))
        candidates = refitted(target, self.screen, screened, current, self.thresholds)
        step = Step(screened, candidates, None, None, settings=target.bench.settings, given=current.ids)
        passing = [candidate for candidate in candidates if candidate.gain >= self.thresholds[candidate.id]]
        references = references_of(target, self.screen, self.base, current) if passing else []
        for candidate in passing:
            tried = prove(target, references, current, candidate.fit)
            step = replace(step, proof=step.proof or tried)
            if tried.proves(target.bench.settings.search):
                figures = prove(target, references, current, candidate.fit, stated=True)
                accepted = replace(step, found=candidate, proof=tried, figures=figures)
                failed = accepted.failed(self.thresholds[candidate.id], current.ids)
                if failed is None:
                    return accepted
                step = replace(step, possible=(*step.possible, failed))
        return step

    def left(self, target: FitTarget, current: Fit) -> FloatArray:
        """Return a fit's residual (size,) as it is screened: reduced, orthogonal to its parameters' changes."""
        residual = self.screen.null.reduced(current.residual)
        if not current.parts:
            return residual
        slopes = self.screen.null.reduced(target.white(current.jacobian[1:]))
        modes = np.linalg.svd(slopes, full_matrices=False)[2]
        return np.asarray(residual - (residual @ modes.T) @ modes)

    def with_finding(self, plain: FitTarget, before: Fit, found: Candidate) -> tuple[FitTarget, FitTarget, Fit]:
        """Return the targets with a cause, without and with nuisances for its size, and the fit to the last."""
        # A found cause has a model error of its own. Its discretisation error was corrected; what remains of that, and
        # the error of its form, are nuisances when further causes are tested.
        null = Null(np.concatenate([plain.null.nuisances, self.forms(found.id, found.fit, before)]))
        plain = replace(plain, correction=found.target.correction, null=null)
        target = replace(plain, null=Null(np.concatenate([null.nuisances, self.errors(found.fit)])))
        return plain, target, fit(target, found.fit.parts, near=found.fit.near) or found.fit

    def forms(self, name: str, found: Fit, before: Fit) -> FloatArray:
        """Return whitened nuisances for the form of a cause, by its id, given the fits with and without it."""
        change = self.given.white(found.prediction - before.prediction)
        return other_forms(self.screen.white_columns(name), change, self.given.bench.settings.nuisances)

    def errors(self, found: Fit) -> FloatArray:
        """Return whitened nuisances for the size of all causes of a fit."""
        return self.given.white(effect_nuisances(self.given.bench, found.prediction - self.base.prediction))

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
        rests = tuple(without(known.target, known.fit, part) for part in range(len(known.ids)))
        changed, failed = {}, {}
        for part, number in enumerate(known.rounds()):
            changed[number] = self.judged(known, rests[part], part, known.steps[number])
            short = changed[number].failed(self.thresholds[known.ids[part]], known.ids)
            if short is not None:
                failed[part] = short
        # Causes without which there is no equilibrium wait for the others.
        removable = {part: short for part, short in failed.items() if rests[part] is not None}
        return replace(known, rests=rests, steps=known.with_steps(changed)), removable or failed

    def judged(self, known: _FoundCauses, rest: Fit | None, part: int, step: Step) -> Step:
        """Return the round of a finding with evidence and proof in the model of all causes; `rest`: fit without it."""
        assert step.found is not None
        target, current = known.target, known.fit
        # The evidence that the removal of the cause costs; without an equilibrium that of its round.
        gain = step.found.gain + step.lead if rest is None else current.log_evidence - rest.log_evidence
        step = step.retested(Candidate(current.parts[part].id, current, gain, target))
        if rest is None:
            return step
        references = references_of(target, self.screen, self.base, rest)
        proof, figures = (prove(target, references, rest, current, part, stated=stated) for stated in (False, True))
        return replace(step, proof=proof, figures=figures)

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
        others_of = [pair for at, pair in enumerate(zip(known.ids, known.rests, strict=True)) if at != part]
        forms = [self.forms(name, known.fit, before) for name, before in others_of if before is not None]
        null = Null(np.concatenate([self.given.null.nuisances, *forms, self.errors(rest)]))
        target = replace(known.target, null=null)
        target, current = corrected_fit(target, fit(target, rest.parts, near=rest.near) or rest)
        return replace(known, target=target, fit=current, steps=steps, rests=(), first=first)


def findings_of(target: FitTarget, screen: Screen, found: Search, thresholds: Mapping[str, float]) -> list[Finding]:
    """Return the findings of a search; the modulus is one of them where it lies beyond its prior.

    `target`: of the first fit; `thresholds`: log Bayes factor required of every cause, nats, by id. The findings lack
    the errors at inner targets, which are added later.
    """
    findings = []
    rounds = found.rounds().values()
    named = {top.id for _, top in rounds}
    for part, (step, top) in enumerate(rounds):
        # Parameters are those of the model with all causes found.
        values, deviations = found.final.values(part, target.bench.young)
        assert step.proof is not None  # found causes were proved
        assert step.figures is not None
        findings.append(
            Finding(
                id=top.id,
                group=step.group(thresholds[top.id], named),
                probability=step.chances().get(top.id, 0.0),
                log_bayes_factor=top.gain,
                threshold=thresholds[top.id],
                parameters=values,
                deviations=deviations,
                held_out=held_out_figures(target.bench.layout, target.noise, step.proof, step.figures),
                sentence=CAUSES[top.id].sentence(values),
                group_probability=step.probability(thresholds[top.id], named),
            )
        )
    stiff = modulus_finding(target, screen, found)
    return findings if stiff is None else [stiff, *findings]


def possible_of(found: Search) -> tuple[dict[str, Any], ...]:
    """Return the causes that came close to a finding and are none, likeliest first, as plain data for the answer."""
    named = {top.id for _, top in found.rounds().values()}
    best: dict[str, PossibleCause] = {}
    for one in (one for step in found.steps for one in step.possible if one.id not in named):
        if one.id not in best or one.probability > best[one.id].probability:
            best[one.id] = one
    return tuple(asdict(one) for one in sorted(best.values(), key=lambda one: -one.probability))


def candidates_of(screen: Screen, first: Step) -> tuple[dict[str, Any], ...]:
    """Return every cause that was tried in the first round, likeliest first, as plain data for the answer.

    Each entry has ``id``, ``probability``, ``log_bayes_factor`` in nats, and ``detectability``, the norm of the change
    that the cause makes, in noise deviations.
    """
    chances, gains = first.chances(), first.gains()
    rows: list[dict[str, Any]] = []
    for name in [*CAUSES, UNKNOWN]:
        if name in gains:
            best = first.screened[name].best
            seen = screen.detectability(name, best, first.screened[name].amplitudes) if best is not None else 0.0
            numbers = {"log_bayes_factor": gains[name], "detectability": seen}
            rows.append({"id": name, "probability": chances.get(name, 0.0), **numbers})
    return tuple(sorted(rows, key=lambda row: -float(row["log_bayes_factor"])))


def modulus_finding(target: FitTarget, screen: Screen, found: Search) -> Finding | None:
    """Return the modulus as a finding where it lies far from its prior mean, the data determine it, and it is proved.

    `found`: the search with the causes found; the modulus is the first parameter of their fit. The proof compares
    predictions of held-out data with those of the model whose modulus is fixed at the believed value. The result is
    None where one of the three fails, where its probability is less than `stated`, and where that model has no
    equilibrium.
    """
    target = found.target or target
    final, bench = found.final, target.bench
    if "stiffness" in (*bench.settings.left_out, *final.ids):
        return None
    rules, evidence = bench.settings.search, bench.settings.evidence
    excess = float(abs(final.x[0])) / bench.young_spread
    deviation = float(np.sqrt(final.covariance[0, 0]))
    if excess < rules.far_modulus or deviation > rules.determined_modulus * bench.young_spread:
        return None
    pinned = replace(target, bench=_pinned(bench))
    start = final.x.copy()
    start[0] = 0.0
    before = fit(pinned, final.parts, start=start) or fit(pinned, final.parts)
    believed = fit(pinned, []) if final.parts else before
    if before is None or believed is None:
        return None
    references = references_of(target, screen, believed, before)
    proof = prove(target, references, before, final, None)
    if not proof.proves(rules):
        return None
    young = final.young(bench.young)
    values = {"young_kpa": young}
    odds = np.exp(-0.5 * (excess**2 - rules.far_modulus**2) / evidence.temper)
    chance = float((1.0 - evidence.look_alike) / (1.0 + odds))
    if chance < rules.stated:
        return None
    figures = prove(target, references, before, final, None, stated=True)
    return Finding(
        id="stiffness",
        group=("stiffness",),
        probability=chance,
        log_bayes_factor=0.5 * excess**2,
        threshold=0.5 * rules.far_modulus**2,
        parameters=values,
        deviations={"young_kpa": young * deviation},
        held_out=held_out_figures(bench.layout, target.noise, proof, figures),
        sentence=CAUSES["stiffness"].sentence(values),
        group_probability=chance,
    )


def _pinned(bench: Bench) -> Bench:
    """Return a copy of the believed model whose modulus is fixed at the believed value; computed results are shared."""
    other = copy(bench)
    other.young_spread = 1e-9  # in the modulus' logarithm: fixed at the believed value
    return other
