"""From a race of single causes to the few that stand: forward, swap and backward steps, proved on held-out data."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from tissuereg.diagnose.material.causes import CAUSES, Form
from tissuereg.diagnose.material.fit import Fit
from tissuereg.diagnose.material.holdout import Bench, HeldOutErrors, held_out_errors
from tissuereg.diagnose.material.hypothesis import Hypothesis, forms_of, refitted, unknown, with_cause

#: Separability under which two causes are one group (a difference of 8 in log posterior), and its members at most.
LEAST_SEPARABILITY = 4.0
LARGEST_GROUP = 3
#: Findings at most.
MOST_FINDINGS = 3
#: Gain in log predictive density on held-out data that a cause must bring.
LEAST_GAIN = 4.0
#: Where specimens or rates are left out a patch copies the others: of what it gains a cause must gain this.
_SHARE_OF_PATCH = 0.75
#: A cause that takes this share of the misfit of held-out data may foretell one fold worse.
_MOST_OF_MISFIT = 0.5

#: A modulus is a finding beyond so many standard deviations of its belief.
FAR_YOUNG = 3.0

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Candidate:
    """One cause in the race that decided on it.

    Attributes
    ----------
    id : str
        Of the cause.
    log_bayes_factor : float
        Over the same hypothesis without it.
    detectability : float
        Root of twice the gain in log posterior.
    probability : float
        Among all causes, none, and unknown.
    """

    id: str
    log_bayes_factor: float
    detectability: float
    probability: float


@dataclass(frozen=True, eq=False)
class Finding:
    """A cause that stands.

    Attributes
    ----------
    id : str
        Likeliest.
    group : tuple of str
        All that these data cannot tell from it, itself first.
    probability : float
        As in `Candidate`.
    log_bayes_factor : float
        Over all other findings without it.
    separability : dict of str to float
        From the other members of its group.
    rivals : dict of str to Hypothesis
        With each of them in its place.
    """

    id: str
    group: tuple[str, ...]
    probability: float
    log_bayes_factor: float
    separability: dict[str, float]
    rivals: dict[str, Hypothesis]


@dataclass(eq=False)
class Search:
    """A race and its rules.

    Parameters
    ----------
    bench : Bench
        Data, beliefs and folds.
    forms : dict of str to list of Form
        By cause; causes without any cannot be seen.
    threshold : float
        Evidence that chance does not reach.
    progress : callable
        Told what is done.
    """

    bench: Bench
    forms: dict[str, list[Form]]
    threshold: float
    progress: Progress
    #: The race of single causes over what is believed, for the answer.
    first_race: list[Candidate] = field(default_factory=list)
    _tried: dict[tuple[tuple[str, ...], tuple[str, ...], str], Hypothesis] = field(default_factory=dict)

    def run(self, none: Hypothesis) -> Hypothesis:
        """Return the causes that stand.

        Parameters
        ----------
        none : Hypothesis
            What is believed.

        Returns
        -------
        Hypothesis
            With at most `MOST_FINDINGS` causes.
        """
        known = none
        while len(known.ids) < MOST_FINDINGS:
            grown = self._step(known)
            if grown is None:
                break
            known = self._swapped(none, grown)
        return self._pruned(none, known)

    def race(self, known: Hypothesis, skipped: tuple[str, ...] = ()) -> tuple[list[Hypothesis], Hypothesis]:
        """Return what is known with each further cause, likeliest first, and with a generic misfit."""
        causes = [id for id in self.forms if id not in known.ids and id not in skipped]
        found = []
        for cause in causes:
            forms = forms_of(cause, known.ids, self.forms)
            if forms:
                found.append(self._with(known, cause, forms))
        found.sort(key=lambda hypothesis: -hypothesis.evidence)
        return found, unknown(self.bench.problem, known)

    def _with(self, known: Hypothesis, cause: str, forms: list[Form]) -> Hypothesis:
        key = (known.ids, tuple(form.label for form in known.fit.forms), cause)
        if key not in self._tried:
            self._tried[key] = with_cause(self.bench.problem, known, cause, forms)
        return self._tried[key]

    def in_forms(self, rest: Hypothesis, cause: str) -> tuple[Fit, ...]:
        """Return what is known with one more cause, in each of its forms, likeliest first."""
        return self._with(rest, cause, self.forms[cause]).forms

    def _step(self, known: Hypothesis) -> Hypothesis | None:
        self.progress(f"race of causes beside {', '.join(known.ids) or 'nothing'}")
        racers, generic = self.race(known)
        if not self.first_race:
            self.first_race = candidates(known, racers, generic)
        if not racers:
            return None
        near = racers[0].evidence - 0.5 * LEAST_SEPARABILITY**2
        for racer in [racer for racer in racers if racer.evidence >= near]:
            if racer.evidence - known.evidence > self.needed(known, racer) and self.stands(known, racer, generic):
                return racer
        return self._pair(known, racers[0], generic)

    def needed(self, known: Hypothesis, grown: Hypothesis) -> float:
        """Return the evidence that a further cause must bring.

        Where nothing is repeated the noise is a guess, and what a law leaves of a real material is easily taken for
        another cause: beyond the first, causes must stand under noise twice as large.
        """
        guessed = self.bench.repeats == 0 and len(known.ids) > 0 and grown.ids[-1] != "stiffness"
        return self.threshold * (4.0 if guessed else 1.0)

    def _pair(self, known: Hypothesis, first: Hypothesis, generic: Hypothesis) -> Hypothesis | None:
        """Return what is known with two causes at once, where the first explains much but fails without the second."""
        worth = first.evidence - max(generic.evidence, known.evidence)
        if worth < self.threshold or len(first.ids) == MOST_FINDINGS:
            return None
        self.progress(f"pairs with {first.ids[-1]}")
        racers, _ = self.race(first)
        if racers and racers[0].evidence - first.evidence > self.needed(first, racers[0]):
            return racers[0] if self.stands(known, racers[0], generic) else None
        return None

    def stands(self, known: Hypothesis, grown: Hypothesis, generic: Hypothesis) -> bool:
        """Say whether a cause foretells held-out data better than what is known, and than a generic patch.

        Parameters
        ----------
        known : Hypothesis
            Without it.
        grown : Hypothesis
            With it.
        generic : Hypothesis
            With a generic misfit in its place.

        Returns
        -------
        bool
            Both must hold.
        """
        self.progress(f"held-out proof of {grown.ids[-1]}")
        before, after = held_out_errors(self.bench, known.fit), held_out_errors(self.bench, grown.fit)
        if grown.ids == (*known.ids, "stiffness"):
            # Every hypothesis fits the modulus: what counts is how far it lies from its belief.
            return self.far_modulus(grown.fit) and after.total < before.total + LEAST_GAIN
        patch = held_out_errors(self.bench, known.fit, patch_share=generic.fit.share)
        if self._proved(before, after, patch):
            return True
        # Beyond the strains of a lone curve forms of one cause part widely: one that holds there proves the cause.
        others = grown.forms if self.bench.unit == "part" else ()
        return any(
            self._proved(before, held_out_errors(self.bench, fit), patch) for fit in others if fit is not grown.fit
        )

    def far_modulus(self, fit: Fit) -> bool:
        """Say whether the belief lies far from the modulus, from the instantaneous to the relaxed one."""
        problem, relaxation = self.bench.problem, fit.model.relaxation
        relaxed = 0.0 if relaxation is None else float(np.log1p(-min(sum(relaxation.g), 0.999)))
        above, below = fit.x[0] + relaxed - problem.young_log, problem.young_log - fit.x[0]
        return bool(max(above, below) > FAR_YOUNG * problem.young_std)

    def _proved(self, before: HeldOutErrors, after: HeldOutErrors, patch: HeldOutErrors) -> bool:
        gains = np.array([before.misfits[name] - after.misfits[name] for name in after.misfits])
        if not gains.size or gains.sum() <= LEAST_GAIN:
            return False
        # One fold's luck is no proof: all gain, or their mean is clear of its error, or little is left of the misfit.
        clear = gains.size == 1 or gains.mean() > 2.0 * gains.std(ddof=1) / np.sqrt(gains.size)
        if not (gains.min() > 0 or clear or gains.sum() > _MOST_OF_MISFIT * before.total):
            return False
        if self.bench.unit in ("specimen", "rate"):
            # What a patch copies from other specimens or near rates is close to the best that can be known.
            possible = before.chi - patch.chi
            if before.chi - after.chi > _SHARE_OF_PATCH * possible:
                return True
        return bool(after.chi < patch.chi or after.rms_all < patch.rms_all)

    def alternatives(self, none: Hypothesis, known: Hypothesis, cause: str) -> tuple[Hypothesis, list[Hypothesis]]:
        """Return what is known without a cause, and that with each other cause in its place, likeliest first."""
        rest = self.without(none, known, cause)
        racers, _ = self.race(rest, skipped=(cause,))
        return rest, racers

    def without(self, none: Hypothesis, known: Hypothesis, cause: str) -> Hypothesis:
        """Return what is known less one cause, fitted again."""
        kept = [(id, form) for id, form in zip(known.ids, known.fit.forms, strict=True) if id != cause]
        if not kept:
            return none
        forms = tuple(form for _, form in kept)
        first, parts = 1, [known.fit.x[:1]]
        for id, form in zip(known.ids, known.fit.forms, strict=True):
            last = first + len(form.mean)
            if id != cause:
                parts.append(known.fit.x[first:last])
            first = last
        fit, evidence = refitted(self.bench.problem, forms, [np.concatenate(parts)])
        return Hypothesis(tuple(id for id, _ in kept), fit, evidence)

    def _swapped(self, none: Hypothesis, known: Hypothesis) -> Hypothesis:
        """Return what is known with an earlier cause replaced, where another explains more beside the newest."""
        for cause in known.ids[:-1]:
            self.progress(f"swaps of {cause}")
            _, racers = self.alternatives(none, known, cause)
            if racers and racers[0].evidence > known.evidence + 0.5 * LEAST_SEPARABILITY**2:
                known = racers[0]
        return known

    def _pruned(self, none: Hypothesis, known: Hypothesis) -> Hypothesis:
        """Return what is known less causes that the others have made needless."""
        for cause in known.ids:
            rest = self.without(none, known, cause)
            last = Hypothesis((*rest.ids, cause), known.fit, known.evidence)
            if len(known.ids) > 1 and known.evidence - rest.evidence < self.needed(rest, last):
                known = rest
        return known

    def finding(self, none: Hypothesis, known: Hypothesis, cause: str) -> Finding:
        """Return what can be said of one cause of the answer.

        Parameters
        ----------
        none : Hypothesis
            What is believed.
        known : Hypothesis
            The answer.
        cause : str
            One of its ids.

        Returns
        -------
        Finding
            With its group.
        """
        self.progress(f"rivals of {cause}")
        rest, racers = self.alternatives(none, known, cause)
        generic = unknown(self.bench.problem, rest)
        apart = {r.ids[-1]: _separability(known, r) for r in racers}
        seen = [r for r in racers if r.evidence - rest.evidence > self.needed(rest, r)]
        tied = sorted((r for r in seen if apart[r.ids[-1]] < LEAST_SEPARABILITY), key=lambda r: apart[r.ids[-1]])
        tied = tied[: LARGEST_GROUP - 1]
        among = [known.evidence, rest.evidence, generic.evidence, *(r.evidence for r in racers)]
        probability = float(np.exp(known.evidence - np.logaddexp.reduce(among)))
        return Finding(
            cause,
            (cause, *(r.ids[-1] for r in tied)),
            probability,
            known.evidence - rest.evidence,
            {r.ids[-1]: apart[r.ids[-1]] for r in tied},
            {r.ids[-1]: r for r in tied},
        )


def candidates(known: Hypothesis, racers: list[Hypothesis], generic: Hypothesis) -> list[Candidate]:
    """Return the race as it is told, unknown among them."""
    everyone = [*racers, generic]
    total = np.logaddexp.reduce([known.evidence, *(h.evidence for h in everyone)])
    return [
        Candidate(
            hypothesis.ids[-1],
            hypothesis.evidence - known.evidence,
            float(np.sqrt(max(0.0, 2.0 * (hypothesis.fit.log_posterior - known.fit.log_posterior)))),
            float(np.exp(hypothesis.evidence - total)),
        )
        for hypothesis in everyone
    ]


def visible(forms: dict[str, list[Form]]) -> dict[str, list[Form]]:
    """Return the causes that have forms, in the catalogue's order."""
    return {id: forms[id] for id in CAUSES if forms.get(id)}


def _separability(one: Hypothesis, other: Hypothesis) -> float:
    return float(np.sqrt(max(0.0, 2.0 * (one.fit.log_posterior - other.fit.log_posterior))))
