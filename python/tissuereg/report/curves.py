"""Small charts of a value over time, as SVG, side by side on a wide page and one below the other on a narrow one."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.report import svg
from tissuereg.report.words import at_time


class Chart(NamedTuple):
    """Sizes of a chart in pixels, and the number of points of a line at most."""

    width: float = 380.0
    height: float = 170.0
    left: float = 46.0
    right: float = 8.0
    top: float = 24.0
    bottom: float = 30.0
    points: int = 600


CHART = Chart()

#: Colours of lines and bands, and of frames that are not to be trusted.
LINE, DOUBTED = "#0072b2", "#d9534f"


@dataclass(frozen=True, eq=False)
class TimeCurve:
    """A value over time.

    `title`: with its unit; `times` (n,): s, ascending; `values` (n,): NaN leaves a gap; `half` (n,): half the width of
    a band about it, None for no band; `zero`: whether the axis begins at zero.
    """

    title: str
    times: FloatArray
    values: FloatArray
    half: FloatArray | None = None
    zero: bool = False

    def thinned(self) -> "TimeCurve":
        """Return the curve in so few points that it can be drawn: of each bin the least and the greatest are kept.

        Those of the band's edges are kept, too; a bin without any value leaves a gap.
        """
        if len(self.times) <= CHART.points:
            return self
        half = None if self.half is None else np.nan_to_num(self.half)
        edges = [self.values] if half is None else [self.values - half, self.values + half]
        n_bins = max(CHART.points // (2 * len(edges)), 1)
        kept: set[int] = set()
        for rows in np.array_split(np.arange(len(self.times)), n_bins):
            seen = rows[np.isfinite(self.values[rows])]
            if not len(seen):
                kept.add(int(rows[0]))
            for edge in edges if len(seen) else ():
                kept |= {int(seen[np.argmin(edge[seen])]), int(seen[np.argmax(edge[seen])])}
        rows = np.array(sorted(kept))
        half = None if self.half is None else self.half[rows]
        return TimeCurve(self.title, self.times[rows], self.values[rows], half, self.zero)


def charts(curves: Sequence[TimeCurve], doubted: BoolArray) -> str:
    """Return the charts of curves of the same times, as HTML; `doubted` (n,): frames that are not to be trusted."""
    return f"<div class='charts'>{''.join(_chart(curve, doubted) for curve in curves)}</div>"


def _chart(curve: TimeCurve, doubted: BoolArray) -> str:
    drawn = curve.thinned()
    low, high = _range(drawn)
    first, last = float(curve.times[0]), float(curve.times[-1])
    across = svg.PixelScale(first, last, CHART.left, CHART.width - CHART.right)
    up = svg.PixelScale(low, high, CHART.height - CHART.bottom, CHART.top)
    x, y = np.array([across(t) for t in drawn.times]), np.array([up(v) for v in drawn.values])
    end, edge = CHART.height - CHART.bottom, CHART.width - CHART.right
    small = "font-size='11'"
    parts = [
        svg.text(CHART.left, 14.0, curve.title, more="font-size='12.5' font-weight='600'"),
        *(svg.bar(across(a), CHART.top, max(across(b) - across(a), 1.5), end - CHART.top, DOUBTED, "opacity='.18'")
          for a, b in _spans(curve.times, doubted)),
        *(svg.level(up(tick), CHART.left, edge, "#e3e6ea")
          + svg.text(CHART.left - 5.0, up(tick) + 4.0, f"{tick:g}", "end", more=small) for tick in up.ticks(4)),
        *(svg.text(across(tick), end + 14.0, at_time(tick), "middle", more=small) for tick in across.ticks(5)),
        svg.text(edge, CHART.height - 3.0, "time, s", "end", more=small),
    ]  # fmt: skip
    if drawn.half is not None:
        good = np.isfinite(drawn.values)
        above = [f"{a:.1f},{up(v):.1f}" for a, v in zip(x[good], (drawn.values + drawn.half)[good], strict=True)]
        below = [f"{a:.1f},{up(v):.1f}" for a, v in zip(x[good], (drawn.values - drawn.half)[good], strict=True)]
        parts.append(f"<polygon points='{' '.join(above + below[::-1])}' fill='{LINE}' opacity='.22'/>")
    parts.append(svg.line(x, y, LINE, "stroke-width='1.6' stroke-linejoin='round'"))
    return svg.picture(CHART.width, CHART.height, parts, f"{curve.title} over time")


def _range(curve: TimeCurve) -> tuple[float, float]:
    """Return the range of the axis."""
    half = 0.0 if curve.half is None else curve.half
    low, high = float(np.nanmin(curve.values - half)), float(np.nanmax(curve.values + half))
    low = 0.0 if curve.zero else low
    room = max(0.06 * (high - low), 1e-3 * max(abs(low), abs(high)), 1e-6)
    return low - room * (not curve.zero), high + room


def _spans(times: FloatArray, doubted: BoolArray) -> list[tuple[float, float]]:
    """Return begin and end of each run of doubted frames, s, to half-way to the frames beside it."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], doubted, [False]]).astype(np.int8)))
    middle = np.concatenate([times[:1], 0.5 * (times[1:] + times[:-1]), times[-1:]])
    return [(float(middle[a]), float(middle[b])) for a, b in edges.reshape(-1, 2)]
