"""Stress relaxation with one time constant."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Scene, Values, Variant, curve_form, free_parameters
from tissuereg.diagnosis.causes.numbers import logistic, logit
from tissuereg.experiment.effects import Relaxation


def times_of(bench: Bench, count: int) -> FloatArray:
    """Return `count` time constants of relaxation, s, from the time between frames to twice the longest case."""
    return np.geomspace(max(bench.frame_step, 1e-3), max(2.0 * bench.longest_case, 2e-3), count)


@dataclass(frozen=True)
class RelaxationCause(Cause, id="relaxation", family="memory", discrete=("part",)):
    """A share of the whole stress, or of its isochoric part, relaxes with one time constant."""

    #: Share that relaxes at which changes are simulated.
    share: float = 0.25
    #: Number of time constants, from the time between frames to twice the longest case.
    times: int = 6

    def variants(self, bench: Bench) -> Iterable[Variant]:
        """Return hypotheses for several times, of all stress or its isochoric part; none without time or if known."""
        if bench.longest_case == 0.0 or self.believed(bench):
            return []
        # The two parts differ little; every second time constant suffices for the isochoric one.
        tried = [("whole", float(tau)) for tau in times_of(bench, self.times)]
        tried += [("isochoric", float(tau)) for tau in times_of(bench, self.times)[1::2]]
        effects = [
            (f"{part} {tau:.2g} s", Relaxation(g=(self.share,), tau_s=(tau,), part=part), {"tau": tau, "part": part})
            for part, tau in tried
        ]
        return self.simulated(bench, effects)

    def free_parameters(self, bench: Bench, variant: Variant, amplitudes: FloatArray) -> FreeParameters:
        """Return two free parameters: logit of the share that relaxes, and logarithm of the time constant in s."""
        part, tau = str(variant.settings["part"]), float(variant.settings["tau"])
        share, middle = self.share * min(float(amplitudes[0]), 3.5), np.log(times_of(bench, self.times)).mean()
        return free_parameters(
            [(logit(share), logit(0.2), 1.2, 0.1), (np.log(tau), middle, 1.5, 0.1)],
            lambda x, young: (Relaxation(g=(logistic(x[0]),), tau_s=(float(np.exp(x[1])),), part=part),),
        )

    def in_curves(self, scene: Scene) -> Sequence[FreeParameters]:
        """Return a Prony series of each number of terms; none where curves cannot show effects of time."""
        if not (scene.paced and scene.longest_s > scene.shortest_s):
            return []
        low, high = float(np.log(scene.shortest_s)), float(np.log(scene.longest_s))
        found = []
        for n in range(1, scene.settings.most_terms + 1):
            # Prior means of the time constants are spread evenly over the decades that the test resolves.
            times = low + (high - low) * (np.arange(n) + 0.5) / n
            spread = (high - low) / (2.0 * n) + 0.3
            found.append(curve_form(f"prony-{n}", [(-0.7, 1.5)] * n + [(float(t), spread) for t in times], _series))
        return found

    def sentence(self, values: Values) -> str:
        """Return the finding as a sentence; `values` has the fitted shares `g` and times `tau_s` (n_terms,)."""
        terms = " and ".join(
            f"{100.0 * share:.2g} % with a time constant of {tau:.2g} s"
            for share, tau in zip(values["g"], values["tau_s"], strict=True)
        )
        return f"Of the instantaneous stress {terms} relaxes."


def _series(x: FloatArray) -> Relaxation:
    """Return the Prony series of parameters (2 n_terms,): of its shares, then of its times."""
    n = len(x) // 2
    shares = np.exp(np.clip(x[:n], -30.0, 30.0))
    shares = np.maximum(shares / (1.0 + shares.sum()), 1e-12)
    times = np.exp(np.clip(x[n:], -30.0, 30.0))
    order = np.argsort(times)
    return Relaxation(g=tuple(shares[order].tolist()), tau_s=tuple(times[order].tolist()))
