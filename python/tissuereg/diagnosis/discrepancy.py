"""The discrepancy: at which markers, when and under which load the believed model differs from the measurements."""

from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.fit import Fit
from tissuereg.diagnosis.misfit import Misfit
from tissuereg.diagnosis.screen import UNKNOWN, Screen
from tissuereg.diagnosis.search import Search
from tissuereg.diagnosis.settings import DEFAULT, AdviceSettings
from tissuereg.diagnosis.signals import SignalLayout


def describe(layout: SignalLayout, base: Fit, final: Fit, settings: AdviceSettings = DEFAULT.report) -> dict[str, Any]:
    """Return where, when and by how much the believed model with fitted modulus differs from the data.

    `layout`: order of the data; `base`, `final`: fits of the believed model and of that with all causes found. The
    result has the entries ``rms_mm`` and ``in_sigma``, root mean square residual of a marker's coordinate in mm and in
    noise deviations; ``where``, names of the worst markers; ``when``, a text; ``under``, name of the worst case;
    ``chi_by_case``, ``chi_forces_by_case`` and ``chi_by_marker``, root mean square residuals in noise deviations by
    name; and ``after``, with ``rms_mm`` and ``in_sigma`` of the final model.
    """
    seen = layout.seen
    error = np.where(seen, layout.measured - base.prediction, np.nan)
    markers = layout.of_markers() & seen
    cases = {part.name: _chi(part.markers(base.residual), part.markers(_shown(layout))) for part in layout.parts}
    forces = {
        part.name: _chi(part.forces(base.residual), part.forces(_shown(layout))) for part in layout.parts if part.pads
    }
    per_marker = _per_marker(layout, base.residual)
    worst_case = max(cases, key=lambda name: max(cases[name], forces.get(name, 0.0)))
    order = np.argsort(-per_marker)[: settings.most_markers]
    where = [layout.marker_names[i] for i in order if per_marker[i] > settings.above]
    part = layout[worst_case]
    frames = np.sqrt((part.markers(base.residual) ** 2).mean(axis=(1, 2)))
    top = int(np.argmax(frames))
    rms = float(np.sqrt(np.mean(error[markers] ** 2))) if markers.any() else 0.0
    return {
        "rms_mm": rms,
        "in_sigma": float(np.sqrt(np.mean(base.residual[markers] ** 2))) if markers.any() else 0.0,
        "where": where,
        "when": f"most at {part.times[top]:.4g} s ({part.times[top] - part.times[0]:.3g} s into the case)",
        "under": worst_case,
        "chi_by_case": cases,
        "chi_forces_by_case": forces,
        "chi_by_marker": dict(zip(layout.marker_names, per_marker.tolist(), strict=True)),
        "after": {
            "rms_mm": float(np.sqrt(np.mean((layout.measured - final.prediction)[markers] ** 2)))
            if markers.any()
            else 0.0,
            "in_sigma": float(np.sqrt(np.mean(final.residual[markers] ** 2))) if markers.any() else 0.0,
        },
    }


def _shown(layout: SignalLayout) -> FloatArray:
    return layout.seen.astype(np.float64)


def _chi(white: FloatArray, shown: FloatArray) -> float:
    return float(np.sqrt((white**2).sum() / max(float(shown.sum()), 1.0)))


def _per_marker(layout: SignalLayout, white: FloatArray) -> FloatArray:
    total, count = np.zeros(len(layout.marker_names)), np.zeros(len(layout.marker_names))
    for part in layout.parts:
        total += (part.markers(white) ** 2).sum(axis=(0, 2))
        count += part.markers(_shown(layout)).sum(axis=(0, 2))
    return np.asarray(np.sqrt(total / np.maximum(count, 1.0)))


def residual_summary(
    layout: SignalLayout, screen: Screen, found: Search, misfit: Misfit, settings: AdviceSettings = DEFAULT.report
) -> dict[str, Any]:
    """Return a description of the residual that remains after the findings, where it is too large to be noise.

    `layout`: order of the data; `screen`: all hypotheses, to find the cause that it resembles; `found`: the search,
    with findings and remaining residual; `misfit`: result of the misfit test of that residual. The result has the
    p-value ``p``, ``where`` (names of markers and pads), the text ``when``, ``looks_like`` (an id, or ``"unknown"``),
    and the text ``sentence``.
    """
    where = largest_residuals(layout, found.reduced, settings)
    case, time = worst_frame(layout, found.reduced)
    alike = nearest_cause(screen, found, settings.looks_like)
    when = f"most at {time:.4g} s, under case {case}"
    places = f"at {', '.join(where)}" if where else "spread over all markers and pads"
    like = "no cause of the catalogue" if alike == UNKNOWN else f"'{alike}' more than any other cause"
    sentence = f"A misfit remains after the findings (p = {misfit.p:.2g}) {places}, {when}; it resembles {like}."
    return {"p": misfit.p, "where": where, "when": when, "looks_like": alike, "sentence": sentence}


def largest_residuals(
    layout: SignalLayout, reduced: FloatArray, settings: AdviceSettings = DEFAULT.report
) -> list[str]:
    """Return the names of the markers and pads with the largest root mean square residuals, the largest first.

    `reduced` (size,): whitened by noise and nuisances. At most `most_places` are named, and only those above `above`.
    """
    power: dict[str, float] = {}
    count: dict[str, float] = {}
    seen = layout.seen
    for part in layout.parts:
        rows = [
            (name, part.markers(reduced)[:, i], part.markers(seen)[:, i]) for i, name in enumerate(layout.marker_names)
        ]
        rows += [(name, part.forces(reduced)[:, i], part.forces(seen)[:, i]) for i, name in enumerate(part.pads)]
        for name, values, known in rows:
            power[name] = power.get(name, 0.0) + float((values[known] ** 2).sum())
            count[name] = count.get(name, 0.0) + float(known.sum())
    chi = {name: np.sqrt(power[name] / count[name]) for name in power if count[name]}
    worst = sorted((name for name in chi if chi[name] > settings.above), key=lambda name: -chi[name])
    return worst[: settings.most_places]


def worst_frame(layout: SignalLayout, reduced: FloatArray) -> tuple[str, float]:
    """Return the case and the time, s, of the frame with the largest sum of squares in a whitened residual (size,)."""
    worst = ("", 0.0, -np.inf)
    for part in layout.parts:
        power = (part.markers(reduced) ** 2).sum(axis=(1, 2)) + (part.forces(reduced) ** 2).sum(axis=(1, 2))
        top = int(np.argmax(power))
        if power[top] > worst[2]:
            worst = (part.name, float(part.times[top]), float(power[top]))
    return worst[:2]


def nearest_cause(screen: Screen, found: Search, least: float = DEFAULT.report.looks_like) -> str:
    """Return the id of the further cause that the remaining residual resembles most, or ``"unknown"``.

    It is ``"unknown"`` where no cause has a log Bayes factor of at least `least` nats.
    """
    gains = {name: one.log_bayes_factor for name, one in screen.of(found.reduced).items()}
    named = set(found.final.ids)
    others = {name: gain for name, gain in gains.items() if name not in named and name != UNKNOWN}
    best = max(others, key=lambda name: others[name], default=UNKNOWN)
    return best if others.get(best, -np.inf) >= least else UNKNOWN
