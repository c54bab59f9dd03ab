"""The discrepancy: at which markers, when and under which load the believed model differs from the measurements."""

from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.fit import Fit
from tissuereg.diagnosis.signals import SignalLayout

#: Number of markers that are listed at most, and their least root mean square in noise deviations.
MOST_MARKERS = 5
ABOVE = 1.3


def describe(layout: SignalLayout, base: Fit, final: Fit) -> dict[str, Any]:
    """Return the discrepancy of the believed model with fitted modulus.

    Parameters
    ----------
    layout : SignalLayout
        Order of the data.
    base, final : Fit
        The believed model, and with all causes found.

    Returns
    -------
    dict
        ``rms_mm`` and ``in_sigma`` over all markers, ``where`` the worst markers, ``when`` in words, ``under`` the
        worst case; chi (root mean square residual in noise deviations) by case and marker; ``rms_mm`` and ``in_sigma``
        of the final model under ``after``.
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
    order = np.argsort(-per_marker)[:MOST_MARKERS]
    where = [layout.marker_names[i] for i in order if per_marker[i] > ABOVE]
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
