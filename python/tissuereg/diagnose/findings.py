"""What is said of a search: findings with their groups, probabilities and proofs, and all candidates."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.answer import Finding
from tissuereg.diagnose.causes import CAUSES
from tissuereg.diagnose.fit import Target
from tissuereg.diagnose.proof import BEFORE, BELIEVED, GENERIC, NAMED
from tissuereg.diagnose.screen import UNKNOWN, Screen, probabilities
from tissuereg.diagnose.search import SEPARABLE, Search, Step, asked_of

#: The modulus is a finding beyond this many prior deviations.
STIFFNESS = 3.0

#: Ids in one group at most.
MOST_IN_GROUP = 3

#: A cause is in the group of the one found if it passes the threshold too, or is this share as likely.
AS_LIKELY = 0.1

#: Log Bayes factors are divided by this before they become probabilities: the models of mesh error and noise are not
#: exact.
TEMPER = 2.0

#: Share of a cause's probability that goes to something outside the catalogue that looks like it, which no evidence
#: tells: of 159 findings surer than 0.8 on the blind bench seven were such effects.
LOOK_ALIKE = 0.04


def findings_of(target: Target, found: Search, thresholds: Mapping[str, float]) -> list[Finding]:
    """Return what a search has found, the modulus among it where it lies beyond its prior.

    Parameters
    ----------
    target : Target
        What was fitted.
    found : Search
        All rounds.
    thresholds : mapping of str to float
        Of every cause, nats.

    Returns
    -------
    list of Finding
        Without what targets say.
    """
    findings = []
    young = target.bench.young
    for part, step in enumerate(step for step in found.steps if step.found is not None):
        top = step.found
        assert top is not None  # of those steps
        # Parameters are those of the model with all causes found.
        values, deviations = found.final.values(part, young)
        chances = _chances(step)
        asked = asked_of(thresholds, further=part > 0)
        findings.append(
            Finding(
                id=top.id,
                group=group_of(step, thresholds[top.id]),
                probability=chances.get(top.id, 0.0),
                log_bayes_factor=top.gain,
                threshold=asked[top.id],
                parameters=values,
                deviations=deviations,
                held_out=_held_out(target, step),
                sentence=CAUSES[top.id].sentence(values),
            )
        )
    stiff = _stiffness(target, found)
    return ([stiff] if stiff is not None else []) + findings


def group_of(step: Step, threshold: float) -> tuple[str, ...]:
    """Return the cause that a step found, and those that cannot be told from it, likeliest first.

    Parameters
    ----------
    step : Step
        With a cause found.
    threshold : float
        Of that cause, nats.

    Returns
    -------
    tuple of str
        `MOST_IN_GROUP` ids at most.
    """
    top = step.found
    assert top is not None  # as asked
    as_likely = step.close(-TEMPER * np.log(AS_LIKELY))
    close = [c.id for c in step.close(0.5 * SEPARABLE**2) if c.gain > threshold or c in as_likely]
    return (top.id, *close)[:MOST_IN_GROUP]


def candidates_of(screen: Screen, first: Step) -> tuple[dict[str, Any], ...]:
    """Return every id that was tried in the first step, likeliest first, as `Diagnosis.candidates` has them.

    Parameters
    ----------
    screen : Screen
        All hypotheses.
    first : Step
        Of the search.

    Returns
    -------
    tuple of dict
        One an id.
    """
    chances, gains = _chances(first), _gains(first)
    rows: list[dict[str, Any]] = []
    for name in [*CAUSES, UNKNOWN]:
        if name in gains:
            best = first.screened[name].best
            seen = screen.detectability(name, best, first.screened[name].amplitudes) if best is not None else 0.0
            rows.append(
                {
                    "id": name,
                    "probability": chances.get(name, 0.0),
                    "log_bayes_factor": gains[name],
                    "detectability": seen,
                }
            )
    return tuple(sorted(rows, key=lambda row: -float(row["log_bayes_factor"])))


def _gains(step: Step) -> dict[str, float]:
    """Return log Bayes factors of all causes in a step: of the fitted ones by their fits, of others by the screen."""
    screened = {name: screened.log_bayes_factor for name, screened in step.screened.items()}
    return screened | {candidate.id: candidate.gain for candidate in step.candidates}


def _chances(step: Step) -> dict[str, float]:
    """Return the probabilities of all causes in a step."""
    gains = _gains(step)
    if step.found is not None:
        # A proof on held-out data has told cause and patch apart.
        gains[UNKNOWN] = min(gains[UNKNOWN], step.found.gain - float(_margin(step)))
    chances = probabilities(gains, TEMPER)
    own = {name: chances[name] for name in CAUSES if name in chances}
    unknown = chances[UNKNOWN] + LOOK_ALIKE * sum(own.values())
    return {**chances, **{name: (1.0 - LOOK_ALIKE) * chance for name, chance in own.items()}, UNKNOWN: unknown}


def _margin(step: Step) -> float:
    assert step.proof is not None  # found causes were proved
    density = step.proof.log_density.sum(axis=1)
    return float(density[NAMED] - density[GENERIC])


def _stiffness(target: Target, found: Search) -> Finding | None:
    """Return the modulus as a finding where it lies beyond its prior and the data tell it."""
    final, believed = found.final, target.bench.young
    excess = float(np.expm1(final.x[0])) / target.bench.young_spread
    spread = float(np.sqrt(final.covariance[0, 0])) / target.bench.young_spread
    if abs(excess) < STIFFNESS or spread > 0.3 or "stiffness" in final.ids:
        return None
    young = final.young(believed)
    values = {"young_kpa": young}
    gain = 0.5 * (excess**2 - STIFFNESS**2)
    return Finding(
        id="stiffness",
        group=("stiffness",),
        probability=float((1.0 - LOOK_ALIKE) / (1.0 + np.exp(-gain / TEMPER))),
        log_bayes_factor=0.5 * excess**2,
        threshold=0.5 * STIFFNESS**2,
        parameters=values,
        deviations={"young_kpa": young * float(np.sqrt(final.covariance[0, 0]))},
        held_out={},
        sentence=CAUSES["stiffness"].sentence(values),
    )


def _held_out(target: Target, step: Step) -> dict[str, object]:
    """Return the figures of a finding's proof: residuals in mm, and over their noise with forces."""
    assert step.proof is not None  # found causes were proved
    assert step.figures is not None
    layout, noise = target.bench.layout, target.noise
    markers = layout.of_markers() & layout.seen
    chi = [_rms(row[layout.seen & np.isfinite(row)]) for row in step.figures.left]
    typical = float(noise.marker_std.mean())
    rms = [typical * _rms(row[markers & np.isfinite(row)]) for row in step.figures.left]
    return {
        "rms_base_mm": rms[BELIEVED],
        "rms_named_mm": rms[NAMED],
        "rms_generic_mm": rms[GENERIC],
        "noise_mm": typical,
        "chi_base": chi[BELIEVED],
        "chi_named": chi[NAMED],
        "chi_generic": chi[GENERIC],
        "log_density_gain": float(step.proof.log_density[NAMED].sum() - step.proof.log_density[BEFORE].sum()),
        "cases": list(step.figures.blocks),
    }


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
