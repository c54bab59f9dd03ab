"""The models of a material test, in which `selection.selected` looks for causes.

In a forward step every remaining cause is fitted together with those found (a race, ranked by evidence); the best one
that exceeds the threshold and predicts held-out data better than the model without it and than the generic rival is
added.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from tissuereg.diagnosis.answer import Accepted, PossibleCause
from tissuereg.diagnosis.causes import FreeParameters
from tissuereg.diagnosis.evidence import probabilities
from tissuereg.diagnosis.material.fit import MaterialFit
from tissuereg.diagnosis.material.holdout import HeldOutErrors, ProofInput, held_out_errors
from tissuereg.diagnosis.material.hypothesis import Hypothesis, excluded, refitted, unknown, with_cause
from tissuereg.diagnosis.selection import selected
from tissuereg.experiment.effects.history import Relaxation

Progress = Callable[[str], None]


@dataclass(frozen=True)
class CandidateCause:
    """One cause of the first round, in which each is added alone to the believed model.

    `id`: id of the cause, or ``unknown`` for a generic misfit; `probability`: posterior probability among all causes,
    no cause, and a generic misfit; `log_bayes_factor`: of the hypothesis with the cause against that without it, nats;
    `detectability`: root of twice the gain in log posterior, about the size of the effect in noise deviations.
    """

    id: str
    probability: float
    log_bayes_factor: float
    detectability: float


@dataclass(frozen=True, eq=False, kw_only=True)
class MaterialFinding(Accepted):
    """An accepted cause, given the other findings.

    `separability`: root of twice the difference in log posterior from each other cause of the group; `rivals`: for each
    of these, the hypothesis with it in place of this one; `proved`: whether it predicts held-out data better than the
    other findings alone and than a generic misfit.
    """

    separability: dict[str, float]
    rivals: dict[str, Hypothesis]
    proved: bool

    def passes(self, stated: float) -> bool:
        """Return whether it passes its threshold, its proof, and is, with its group, as probable as `stated`."""
        return self.log_bayes_factor > self.threshold and self.proved and self.group_probability >= stated


@dataclass(eq=False)
class MaterialSearch:
    """The selection of causes.

    `bench`: data, believed model and folds; `none`: hypothesis of the believed model, without causes; `forms`: formulas
    in which each cause is fitted, by id; a cause without any cannot be observed in these curves; `threshold`: log Bayes
    factor that null experiments exceed rarely, nats; `progress`: called with the name of the step that begins;
    `first_race`: the causes of the first round with their evidence; `findings`, `possible`: the causes that passed
    their tests in the model of all, and those that did not.
    """

    bench: ProofInput
    none: Hypothesis
    forms: dict[str, Sequence[FreeParameters]]
    threshold: float
    progress: Progress
    #: The race of single causes against the believed model, for the answer.
    first_race: list[CandidateCause] = field(default_factory=list)
    findings: tuple[MaterialFinding, ...] = ()
    possible: list[PossibleCause] = field(default_factory=list)
    _tried: dict[tuple[tuple[str, ...], tuple[str, ...], str], Hypothesis] = field(default_factory=dict)
    #: The hypothesis with one cause that was proved when it was accepted.
    _proved_alone: Hypothesis | None = None

    def __post_init__(self) -> None:
        settings = self.bench.problem.settings
        self.rules, self.numbers = settings.search, settings.material

    def run(self) -> Hypothesis:
        """Return the hypothesis with the causes that pass their tests, at most `most_causes` (3), and keep them."""
        return selected(self, self.none, self.rules.most_causes)

    def grown(self, known: Hypothesis) -> Hypothesis:
        """Return the hypothesis with one more cause that is accepted, or a pair; `known` where none is."""
        return self._step(known) or known

    def exchanged(self, known: Hypothesis) -> Hypothesis:
        """Return the hypothesis with each cause but the last exchanged where another raises the evidence clearly."""
        for cause in known.ids[:-1]:
            self.progress(f"exchange of {cause}")
            _, racers = self.alternatives(known, cause)
            if racers and racers[0].evidence > known.evidence + 0.5 * self.rules.separable**2:
                known = racers[0]
        return known

    def tested(self, known: Hypothesis) -> tuple[Hypothesis, Mapping[int, PossibleCause]]:
        """Return the hypothesis, whose `findings` are kept, and the causes that fail their tests beside the others."""
        self.findings = tuple(self.finding(known, cause) for cause in known.ids)
        failed = {
            part: one.as_possible() for part, one in enumerate(self.findings) if not one.passes(self.rules.stated)
        }
        return known, failed

    def without(self, known: Hypothesis, part: int, failed: PossibleCause) -> Hypothesis:
        """Return the hypothesis without a cause that failed, which is kept as a possible one."""
        self.possible.append(failed)
        return self.lacking(known, known.ids[part])

    def race(self, known: Hypothesis, skipped: tuple[str, ...] = ()) -> tuple[list[Hypothesis], Hypothesis]:
        """Return a hypothesis with each further cause, likeliest first, and the one with a generic misfit.

        `known`: hypothesis with the causes found before; `skipped`: ids of causes that are not tried. The generic
        misfit is a smooth Gaussian process.
        """
        causes = [id for id in self.forms if id not in skipped and not excluded(id, known.ids)]
        found = [self._with(known, cause) for cause in causes]
        found.sort(key=lambda hypothesis: -hypothesis.evidence)
        return found, unknown(self.bench.problem, known)

    def _with(self, known: Hypothesis, cause: str) -> Hypothesis:
        key = (known.ids, tuple(part.free_parameters.label for part in known.fit.parts), cause)
        if key not in self._tried:
            self._tried[key] = with_cause(self.bench.problem, known, cause, self.forms[cause])
        return self._tried[key]

    def in_forms(self, rest: Hypothesis, cause: str) -> tuple[MaterialFit, ...]:
        """Return the fits with one more cause, in each of its forms (formulas), likeliest first.

        `rest`: hypothesis without that cause; `cause`: its id.
        """
        return self._with(rest, cause).forms

    def _step(self, known: Hypothesis) -> Hypothesis | None:
        self.progress(f"fits of all causes given {', '.join(known.ids) or 'none'}")
        racers, generic = self.race(known)
        if not self.first_race:
            self.first_race = candidates(known, racers, generic)
        if not racers:
            return None
        near = racers[0].evidence - 0.5 * self.rules.separable**2
        for racer in [racer for racer in racers if racer.evidence >= near]:
            enough = racer.evidence - known.evidence > self.required(known, racer)
            if enough and self.is_proved(known, racer, generic):
                self._proved_alone = None if known.ids else racer
                return racer
        return self._pair(known, racers[0], generic)

    def required(self, known: Hypothesis, grown: Hypothesis) -> float:
        """Return the log Bayes factor that a further cause requires, nats.

        `known`, `grown`: hypotheses without and with it. Without repeated curves the noise is an assumption, and the
        model error of the first cause is easily taken for another cause: further causes then need the evidence that
        they would need under noise twice as large.
        """
        guessed = self.bench.errors.repeats == 0 and len(known.ids) > 0 and grown.ids[-1] != "stiffness"
        return self.threshold * (self.numbers.further if guessed else 1.0)

    def _pair(self, known: Hypothesis, first: Hypothesis, generic: Hypothesis) -> Hypothesis | None:
        """Return a hypothesis with two more causes; None where two are not accepted either.

        It is tried where one cause (hypothesis `first`) has enough evidence over `known` and `generic` (hypotheses
        without it, and with a generic misfit), but no proof on held-out data without the second.
        """
        worth = first.evidence - max(generic.evidence, known.evidence)
        if worth < self.threshold or len(first.ids) == self.rules.most_causes:
            return None
        self.progress(f"pairs with {first.ids[-1]}")
        racers, _ = self.race(first)
        if racers and racers[0].evidence - first.evidence > self.required(first, racers[0]):
            return racers[0] if self.is_proved(known, racers[0], generic) else None
        return None

    def is_proved(self, known: Hypothesis, grown: Hypothesis, generic: Hypothesis) -> bool:
        """Return whether a cause predicts held-out data better than the model without it and than a generic misfit.

        `known`: hypothesis without it; `grown`: hypothesis with it; `generic`: hypothesis with a generic misfit (a
        smooth Gaussian process) in its place. Result: both must hold; for the cause "stiffness" a modulus far from its
        prior, without a clear loss, suffices.
        """
        self.progress(f"held-out proof of {grown.ids[-1]}")
        before, after = held_out_errors(self.bench, known.fit), held_out_errors(self.bench, grown.fit)
        if grown.ids == (*known.ids, "stiffness"):
            # Every hypothesis fits the modulus; the criterion is its distance from the prior mean.
            return self.far_modulus(grown.fit) and after.total < before.total + self.rules.proved
        patch = held_out_errors(self.bench, known.fit, patch_share=generic.fit.share)
        if self._proved(before, after, patch):
            return True
        # Beyond the fitted strains of a single curve the forms of a cause differ widely; one of them suffices as proof.
        others = grown.forms if self.bench.unit == "part" else ()
        return any(
            self._proved(before, held_out_errors(self.bench, fit), patch) for fit in others if fit is not grown.fit
        )

    def far_modulus(self, fit: MaterialFit) -> bool:
        """Return whether the prior mean of Young's modulus is far from the fitted one.

        Far is more than `far_modulus` (3) prior standard deviations of its logarithm from the range between the fitted
        instantaneous and relaxed moduli.
        """
        problem, memory = self.bench.problem, fit.model.memory.get("relaxation")
        relaxed = float(np.log1p(-min(sum(memory.g), 0.999))) if isinstance(memory, Relaxation) else 0.0
        above, below = fit.x[0] + relaxed - problem.young_log, problem.young_log - fit.x[0]
        return bool(max(above, below) > self.rules.far_modulus * problem.young_std)

    def _proved(self, before: HeldOutErrors, after: HeldOutErrors, patch: HeldOutErrors) -> bool:
        gains = np.array([before.misfits[name] - after.misfits[name] for name in after.misfits])
        if not gains.size or gains.sum() <= self.rules.proved:
            return False
        # One fold is no proof: all folds gain, or the mean gain is significant, or most of the misfit is removed.
        clear = gains.size == 1 or gains.mean() > 2.0 * gains.std(ddof=1) / np.sqrt(gains.size)
        if not (gains.min() > 0 or clear or gains.sum() > self.numbers.most_of_misfit * before.total):
            return False
        if self.bench.unit in ("specimen", "rate"):
            # A patch that copies other specimens or nearby rates is close to the best possible prediction.
            possible = before.chi - patch.chi
            if before.chi - after.chi > self.numbers.share_of_patch * possible:
                return True
        return bool(after.chi < patch.chi or after.rms_all < patch.rms_all)

    def alternatives(self, known: Hypothesis, cause: str) -> tuple[Hypothesis, list[Hypothesis]]:
        """Return the hypothesis without one cause, and those with each other cause in its place, likeliest first.

        `known`: hypothesis with all accepted causes; `cause`: id of the one that is taken out.
        """
        rest = self.lacking(known, cause)
        racers, _ = self.race(rest, skipped=(cause,))
        return rest, racers

    def lacking(self, known: Hypothesis, cause: str) -> Hypothesis:
        """Return the hypothesis `known` without one cause (an id), fitted again; `none` where no cause is left."""
        kept = [place for place, id in enumerate(known.ids) if id != cause]
        if not kept:
            return self.none
        fit = known.fit
        start = np.concatenate([fit.x[:1], *(fit.x[fit.slices()[place]] for place in kept)])
        fit, evidence = refitted(self.bench.problem, [fit.parts[place] for place in kept], [start])
        return Hypothesis(tuple(known.ids[place] for place in kept), fit, evidence)

    def finding(self, known: Hypothesis, cause: str) -> MaterialFinding:
        """Return the finding of one accepted cause, with the group of causes that cannot be distinguished from it.

        `known`: hypothesis with all accepted causes; `cause`: id of one of them.
        """
        self.progress(f"rivals of {cause}")
        rest, racers = self.alternatives(known, cause)
        generic = unknown(self.bench.problem, rest)
        apart = {r.ids[-1]: _separability(known, r) for r in racers}
        seen = [r for r in racers if r.evidence - rest.evidence > self.required(rest, r)]
        tied = sorted((r for r in seen if apart[r.ids[-1]] < self.rules.separable), key=lambda r: apart[r.ids[-1]])
        rivals = {r.ids[-1]: r for r in tied[: self.rules.most_in_group - 1]}
        last = Hypothesis((*rest.ids, cause), known.fit, known.evidence)
        chances = probabilities({h.ids[-1]: h.evidence - rest.evidence for h in (last, generic, *racers)}, 1.0)
        return MaterialFinding(
            id=cause,
            group=(cause, *rivals),
            probability=chances[cause],
            log_bayes_factor=known.evidence - rest.evidence,
            threshold=self.required(rest, last),
            group_probability=sum(chances[name] for name in (cause, *rivals)),
            separability={name: apart[name] for name in rivals},
            rivals=rivals,
            proved=known is self._proved_alone or self.is_proved(rest, last, generic),
        )


def candidates(known: Hypothesis, racers: list[Hypothesis], generic: Hypothesis) -> list[CandidateCause]:
    """Return every cause that was tried alone, and the generic misfit, with their evidence and probability.

    `known`: hypothesis without them; `racers`: hypotheses with one of them each; `generic`: hypothesis with a generic
    misfit (a smooth Gaussian process).
    """
    everyone = {hypothesis.ids[-1]: hypothesis for hypothesis in (*racers, generic)}
    gains = {name: one.evidence - known.evidence for name, one in everyone.items()}
    chances = probabilities(gains, 1.0)
    return [
        CandidateCause(name, chances[name], gains[name], _separability(one, known)) for name, one in everyone.items()
    ]


def _separability(one: Hypothesis, other: Hypothesis) -> float:
    return float(np.sqrt(max(0.0, 2.0 * (one.fit.log_posterior - other.fit.log_posterior))))
