"""The discrepancy: at which markers, when and under which load the believed model differs from the measurements."""

from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.evidence import rms
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
    seen, white = layout.seen, base.residual
    markers = layout.of_markers() & seen
    cases = {part.name: rms(part.markers(white)[part.markers(seen)]) for part in layout.parts}
    forces = {part.name: rms(part.forces(white)[part.forces(seen)]) for part in layout.parts if part.pads}
    per_marker = {name: rms(values) for name, values in _by_place(layout, white, pads=False).items()}
    worst_case = max(cases, key=lambda name: max(cases[name], forces.get(name, 0.0)))
    order = sorted(per_marker, key=lambda name: -per_marker[name])[: settings.most_markers]
    part = layout[worst_case]
    top = int(np.argmax((part.markers(white) ** 2).mean(axis=(1, 2))))
    return {
        "rms_mm": rms((layout.measured - base.prediction)[markers]),
        "in_sigma": rms(white[markers]),
        "where": [name for name in order if per_marker[name] > settings.above],
        "when": f"most at {part.times[top]:.4g} s ({part.times[top] - part.times[0]:.3g} s into the case)",
        "under": worst_case,
        "chi_by_case": cases,
        "chi_forces_by_case": forces,
        "chi_by_marker": per_marker,
        "after": {
            "rms_mm": rms((layout.measured - final.prediction)[markers]),
            "in_sigma": rms(final.residual[markers]),
        },
    }


def _by_place(layout: SignalLayout, white: FloatArray, *, pads: bool) -> dict[str, FloatArray]:
    """Return what was measured of a whitened residual (size,) at each marker, and at each pad with `pads`, by name."""
    found: dict[str, list[FloatArray]] = {name: [] for name in layout.marker_names}
    for part in layout.parts:
        values, seen = part.markers(white), part.markers(layout.seen)
        for i, name in enumerate(layout.marker_names):
            found[name].append(values[:, i][seen[:, i]])
        values, seen = part.forces(white), part.forces(layout.seen)
        for i, name in enumerate(part.pads if pads else ()):
            found.setdefault(name, []).append(values[:, i][seen[:, i]])
    return {name: np.concatenate(parts) for name, parts in found.items()}


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
    chi = {name: rms(values) for name, values in _by_place(layout, reduced, pads=True).items()}
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
