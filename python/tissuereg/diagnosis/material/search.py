"""The models of a material test, in which `selection.selected` looks for causes.

In a forward step every remaining cause is fitted together with those found (a race, ranked by evidence); the best one
that exceeds the threshold and predicts held-out data better than the model without it and than the generic rival is
added.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tissuereg.diagnosis.answer import Accepted, PossibleCause
from tissuereg.diagnosis.causes import FreeParameters
from tissuereg.diagnosis.evidence import probabilities
from tissuereg.diagnosis.material.bench import CurveBench
from tissuereg.diagnosis.material.fit import (
    HeldOutErrors,
    Hypothesis,
    MaterialFit,
    excluded,
    held_out_errors,
    refitted,
    unknown,
    with_cause,
)
from tissuereg.diagnosis.selection import selected
from tissuereg.experiment.effects.history import Relaxation


@dataclass(frozen=True, eq=False, kw_only=True)
class MaterialFinding(Accepted):
    """An accepted cause, given the other findings.

    `rivals`: for each other cause of the group, the hypothesis with it in place of this one; `separability`: root of
    twice the difference in log posterior from the farthest of these; `proved`: whether it predicts held-out data better
    than the other findings alone and than a generic misfit.
    """

    rivals: dict[str, Hypothesis]
    separability: float
    proved: bool

    def passes(self, stated: float) -> bool:
        """Return whether it passes its threshold, its proof, and is, with its group, as probable as `stated`."""
        return self.log_bayes_factor > self.threshold and self.proved and self.group_probability >= stated


@dataclass(eq=False)
class MaterialSearch:
    """The selection of causes on a bench, beside the believed law alone (`none`).

    `forms`: formulas in which each cause that these curves can show is fitted, by id; `threshold`: log Bayes factor
    that null experiments exceed rarely, nats; `progress`: called with the name of the step that begins; `first_race`:
    the causes of the first round, as in the answer; `findings`, `possible`: the causes that passed their tests in the
    model of all, and those that did not.
    """

    bench: CurveBench
    none: Hypothesis
    forms: Mapping[str, Sequence[FreeParameters]]
    threshold: float
    progress: Callable[[str], None]
    first_race: list[dict[str, Any]] = field(default_factory=list)
    findings: tuple[MaterialFinding, ...] = ()
    possible: list[PossibleCause] = field(default_factory=list)
    _tried: dict[tuple[tuple[str, ...], tuple[str, ...], str], Hypothesis] = field(default_factory=dict)
    #: The hypothesis with one cause that was proved when it was accepted.
    _proved_alone: Hypothesis | None = None

    def __post_init__(self) -> None:
        self.rules, self.numbers = self.bench.settings.search, self.bench.settings.material

    def run(self) -> Hypothesis:
        """Return the hypothesis with the causes that pass their tests, at most `most_causes` (3), and keep them."""
        return selected(self, self.none, self.rules.most_causes)

    def grown(self, known: Hypothesis) -> Hypothesis:
        """Return the hypothesis with one more cause that is accepted, or a pair; `known` where none is."""
        self.progress(f"fits of all causes given {', '.join(known.ids) or 'none'}")
        racers, generic = self.race(known), unknown(self.bench, known)
        self.first_race = self.first_race or _candidates(known, [*racers, generic])
        if not racers:
            return known
        near = racers[0].evidence - 0.5 * self.rules.separable**2
        for racer in [racer for racer in racers if racer.evidence >= near]:
            enough = racer.evidence - known.evidence > self.required(known, racer)
            if enough and self.is_proved(known, racer, generic):
                self._proved_alone = None if known.ids else racer
                return racer
        return self._pair(known, racers[0], generic) or known

    def exchanged(self, known: Hypothesis) -> Hypothesis:
        """Return the hypothesis with each cause but the last exchanged where another raises the evidence clearly."""
        for cause in known.ids[:-1]:
            self.progress(f"exchange of {cause}")
            racers = self.race(self.lacking(known, cause), skipped=cause)
            if racers and racers[0].evidence > known.evidence + 0.5 * self.rules.separable**2:
                known = racers[0]
        return known

    def tested(self, known: Hypothesis) -> tuple[Hypothesis, Mapping[int, PossibleCause]]:
        """Return the hypothesis, whose `findings` are kept, and the causes that fail their tests beside the others."""
        self.findings = tuple(self.finding(known, cause) for cause in known.ids)
        stated = self.rules.stated
        return known, {i: one.as_possible() for i, one in enumerate(self.findings) if not one.passes(stated)}

    def without(self, known: Hypothesis, part: int, failed: PossibleCause) -> Hypothesis:
        """Return the hypothesis without a cause that failed, which is kept as a possible one."""
        self.possible.append(failed)
        return self.lacking(known, known.ids[part])

    def race(self, known: Hypothesis, skipped: str = "") -> list[Hypothesis]:
        """Return a hypothesis with each further cause, likeliest first; `skipped`: id of a cause that is not tried."""
        causes = [id for id in self.forms if id != skipped and not excluded(id, known.ids)]
        return sorted((self.joined(known, cause) for cause in causes), key=lambda hypothesis: -hypothesis.evidence)

    def joined(self, known: Hypothesis, cause: str) -> Hypothesis:
        """Return the hypothesis with one more cause in the best of its forms; it is fitted once."""
        key = (known.ids, tuple(part.free_parameters.label for part in known.fit.parts), cause)
        if key not in self._tried:
            self._tried[key] = with_cause(self.bench, known, cause, self.forms[cause])
        return self._tried[key]

    def required(self, known: Hypothesis, grown: Hypothesis) -> float:
        """Return the log Bayes factor, nats, that hypothesis `grown` requires over `known`, without its last cause."""
        # Without repeated curves the noise is an assumption, and the model error of the first cause is easily taken for
        # another cause: further causes then need the evidence that they would need under noise twice as large.
        guessed = self.bench.errors.repeats == 0 and len(known.ids) > 0 and grown.ids[-1] != "stiffness"
        return self.threshold * (self.numbers.further if guessed else 1.0)

    def _pair(self, known: Hypothesis, first: Hypothesis, generic: Hypothesis) -> Hypothesis | None:
        """Return a hypothesis with two more causes, where `first` has the evidence, but no proof without the second."""
        worth = first.evidence - max(generic.evidence, known.evidence)
        if worth < self.threshold or len(first.ids) == self.rules.most_causes:
            return None
        self.progress(f"pairs with {first.ids[-1]}")
        best = next(iter(self.race(first)), first)
        enough = best.evidence - first.evidence > self.required(first, best)
        return best if enough and self.is_proved(known, best, generic) else None

    def is_proved(self, known: Hypothesis, grown: Hypothesis, generic: Hypothesis) -> bool:
        """Return whether `grown` predicts held-out data better than `known` and than a generic misfit.

        For the cause "stiffness" a modulus far from its prior, without a clear loss, suffices.
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
        """Return whether the prior mean of the modulus is far from the fitted ones, from relaxed to instantaneous."""
        bench, memory = self.bench, fit.model.memory.get("relaxation")
        relaxed = float(np.log1p(-min(sum(memory.g), 0.999))) if isinstance(memory, Relaxation) else 0.0
        above, below = fit.x[0] + relaxed - bench.young_log, bench.young_log - fit.x[0]
        return bool(max(above, below) > self.rules.far_modulus * bench.young_std)

    def _proved(self, before: HeldOutErrors, after: HeldOutErrors, patch: HeldOutErrors) -> bool:
        gains = np.array([before.misfits[name] - after.misfits[name] for name in after.misfits])
        if not gains.size or gains.sum() <= self.rules.proved:
            return False
        # One block is no proof: all blocks gain, or the mean gain is significant, or most of the misfit is removed.
        clear = gains.size == 1 or gains.mean() > 2.0 * gains.std(ddof=1) / np.sqrt(gains.size)
        if not (gains.min() > 0 or clear or gains.sum() > self.numbers.most_of_misfit * before.total):
            return False
        # A patch that copies other specimens or nearby rates is close to the best possible prediction.
        needed = self.numbers.share_of_patch * (before.chi - patch.chi)
        close = self.bench.unit in ("specimen", "rate") and before.chi - after.chi > needed
        return bool(close or after.chi < patch.chi or after.rms_all < patch.rms_all)

    def lacking(self, known: Hypothesis, cause: str) -> Hypothesis:
        """Return the hypothesis `known` without one cause (an id), fitted again; `none` where no cause is left."""
        fit, kept = known.fit, [place for place, id in enumerate(known.ids) if id != cause]
        if not kept:
            return self.none
        start = np.concatenate([fit.x[:1], *(fit.x[fit.slices()[place]] for place in kept)])
        fit, evidence = refitted(self.bench, [fit.parts[place] for place in kept], [start])
        return Hypothesis(tuple(known.ids[place] for place in kept), fit, evidence)

    def finding(self, known: Hypothesis, cause: str) -> MaterialFinding:
        """Return one of the accepted causes, with the group of causes that cannot be distinguished from it."""
        self.progress(f"rivals of {cause}")
        rest = self.lacking(known, cause)
        racers, generic = self.race(rest, skipped=cause), unknown(self.bench, rest)
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
            rivals=rivals,
            separability=max((apart[name] for name in rivals), default=0.0),
            proved=known is self._proved_alone or self.is_proved(rest, last, generic),
        )


def _candidates(known: Hypothesis, tried: Sequence[Hypothesis]) -> list[dict[str, Any]]:
    """Return every cause that was tried alone, and the generic misfit, as plain data for the answer."""
    gains = {one.ids[-1]: one.evidence - known.evidence for one in tried}
    chances = probabilities(gains, 1.0)
    sizes = {one.ids[-1]: _separability(one, known) for one in tried}
    return [
        {"id": name, "probability": chances[name], "log_bayes_factor": gain, "detectability": sizes[name]}
        for name, gain in gains.items()
    ]


def _separability(one: Hypothesis, other: Hypothesis) -> float:
    return float(np.sqrt(max(0.0, 2.0 * (one.fit.log_posterior - other.fit.log_posterior))))
