"""Charts of the residual over time in every case, before and after the findings, against the noise."""

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from tissuereg._base.arrays import FloatArray
from tissuereg.report import svg
from tissuereg.report.markup import escape

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import DiagnosisDetails
    from tissuereg.diagnosis.signals import CasePart
    from tissuereg.experiment.experiment import Case, Experiment

#: Share of frames that lie in the band where there is noise alone.
SHARE = 0.95

#: Number of frames in a line, at most; of longer cases, the worst frame of every few.
MOST_FRAMES = 800

_WIDTH, _LEFT, _RIGHT = 900.0, 60.0, 20.0


@dataclass(frozen=True, eq=False)
class ChannelCurve:
    """Residuals of the markers, or of one pad's force, in one case over time, in noise deviations.

    `title`: name of the curve; `times` (n_frames,): s; `before`, `after` (n_frames,): root mean squares over the
    components before and after the findings are included; NaN where nothing was measured; `low`, `high` (n_frames,):
    band in which noise alone lies in `SHARE` of all frames.
    """

    title: str
    times: FloatArray
    before: FloatArray
    after: FloatArray
    low: FloatArray
    high: FloatArray

    def worst(self, most: int = MOST_FRAMES) -> "ChannelCurve":
        """Return the curve in at most `most` frames: of every few successive ones the one with the largest `before`."""
        stride = -(-len(self.times) // most)
        size = np.where(np.isfinite(self.before), self.before, -1.0)
        rows = [i + int(np.argmax(size[i : i + stride])) for i in range(0, len(size), stride)]
        every = (self.times, self.before, self.after, self.low, self.high)
        return ChannelCurve(self.title, *(values[rows] for values in every))


def curves(details: "DiagnosisDetails") -> dict[str, list[ChannelCurve]]:
    """Return the curves of every case by its name: one of the markers, then one of every measured force.

    Residuals are whitened by noise and nuisances (tracker frame, drift, discretisation error), so that a correct model
    leaves uncorrelated noise of unit variance.
    """
    search, target, layout = details.search, details.target, details.target.bench.layout
    before = target.null.reduced(search.base.residual)
    after = target.null.reduced(search.final.residual)
    if search.final.parts and len(search.reduced):
        # Reduced also by the parameters of the causes found and by their discretisation error.
        after = search.reduced
    rows, charts = (before, after, layout.seen.astype(np.float64)), {}
    for part in layout.parts:
        several = [_curve("markers", part, *(part.markers(flat) for flat in rows))]
        for i, pad in enumerate(part.pads):
            several.append(_curve(f"force at {pad}", part, *(part.forces(flat)[:, i] for flat in rows)))
        charts[part.name] = [curve for curve in several if np.isfinite(curve.before).any()]
    return charts


def histories(extended: "Experiment", details: "DiagnosisDetails") -> str:
    """Return the charts of residuals over time in all cases of an experiment, as HTML."""
    parts = [
        f"<h3>{escape(name)}</h3>" + _chart(name, several, _load(extended.cases[name]))
        for name, several in curves(details).items()
        if several
    ]
    return "\n".join(parts)


def _curve(title: str, part: "CasePart", before: FloatArray, after: FloatArray, seen: FloatArray) -> ChannelCurve:
    count = seen.reshape(part.n_frames, -1).sum(axis=1)
    known = np.maximum(count, 1.0)

    def chi(white: FloatArray) -> FloatArray:
        power = (white.reshape(part.n_frames, -1) ** 2).sum(axis=1)
        return np.asarray(np.where(count > 0, np.sqrt(power / known), np.nan))

    low, high = (np.sqrt(chi2.ppf(p, known) / known) for p in (0.5 - SHARE / 2, 0.5 + SHARE / 2))
    return ChannelCurve(title, part.times, chi(before), chi(after), low, high)


def _load(case: "Case") -> dict[str, FloatArray]:
    """Return the size of every actuator's motion or force over its largest, each (n_frames,), by a label."""
    load = {}
    for given, unit in ((case.displacements, "mm"), (case.applied_forces, "mN")):
        for name, values in given.items():
            size = np.linalg.norm(values, axis=1)
            top = float(np.nanmax(size)) if len(size) else 0.0
            if top > 0.0:
                load[f"{name}, up to {top:.3g} {unit}"] = size / top
    return load


def _chart(name: str, several: list[ChannelCurve], load: dict[str, FloatArray]) -> str:
    times = several[0].times
    across = svg.PixelScale(float(times[0]), float(times[-1]), _LEFT, _WIDTH - _RIGHT)
    parts, at = [], 4.0
    for curve in several:
        parts.append(_panel(curve.worst(), across, at, 120.0))
        at += 148.0
    if load:
        parts.append(_load_panel(load, times, across, at))
        at += 70.0
    parts += [svg.text(across(t), at + 6.0, f"{t:g}", "middle", more="font-size='11'") for t in across.ticks(8)]
    parts.append(svg.text(_WIDTH - _RIGHT, at + 22.0, "time, s", "end", more="font-size='12'"))
    return svg.picture(_WIDTH, at + 28.0, parts, f"Residuals of case {name} over time")


def _panel(curve: ChannelCurve, across: svg.PixelScale, top: float, height: float) -> str:
    largest = float(np.nanmax([curve.before, curve.after, curve.high]))
    up = svg.PixelScale(0.0, 1.08 * largest, top + height, top + 16.0)
    x = np.array([across(t) for t in curve.times])
    if len(x) == 1:
        band = svg.bar(
            x[0] - 8.0, up(curve.high[0]), 16.0, up(curve.low[0]) - up(curve.high[0]), svg.FLOOR, "opacity='.2'"
        )
    else:
        edge = [f"{a:.1f},{up(b):.1f}" for a, b in zip(x, curve.high, strict=True)]
        edge += [f"{a:.1f},{up(b):.1f}" for a, b in zip(x[::-1], curve.low[::-1], strict=True)]
        band = f"<polygon points='{' '.join(edge)}' fill='{svg.FLOOR}' opacity='.2'/>"
    parts = [
        svg.text(_LEFT, top + 11.0, f"{curve.title}: residual over noise", more="font-size='12' font-weight='600'"),
        *(
            svg.level(up(tick), _LEFT, _WIDTH - _RIGHT, "#e3e6ea")
            + svg.text(_LEFT - 6.0, up(tick) + 4.0, f"{tick:g}", "end", more="font-size='11'")
            for tick in up.ticks(4)
        ),
        band,
        svg.line(x, np.array([up(y) for y in curve.before]), svg.BEFORE, "stroke-width='1.8'"),
        svg.line(x, np.array([up(y) for y in curve.after]), svg.AFTER, "stroke-width='1.8'"),
    ]
    return "".join(parts)


def _load_panel(load: dict[str, FloatArray], times: FloatArray, across: svg.PixelScale, top: float) -> str:
    up = svg.PixelScale(0.0, 1.05, top + 56.0, top + 18.0)
    stride = -(-len(times) // MOST_FRAMES)
    x = np.array([across(t) for t in times[::stride]])
    parts = [
        svg.text(_LEFT, top + 11.0, f"load: {'; '.join(load)}", more="font-size='12' font-weight='600'"),
        svg.level(up(0.0), _LEFT, _WIDTH - _RIGHT, "#9aa2ab"),
    ]
    dashes = ("", "stroke-dasharray='6 3'", "stroke-dasharray='2 3'")
    for i, share in enumerate(load.values()):
        parts.append(
            svg.line(x, np.array([up(y) for y in share[::stride]]), "#444", f"stroke-width='1.4' {dashes[i % 3]}")
        )
    return "".join(parts)
