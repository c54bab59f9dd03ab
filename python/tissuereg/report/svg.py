"""Charts as SVG text: axes, lines, bars."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.report.markup import escape

#: Colours of the believed model, the extended one, the generic rival, the noise floor.
BEFORE, AFTER, GENERIC, FLOOR = "#c2571a", "#1f5fa8", "#8a8f98", "#2d8a4e"


@dataclass(frozen=True)
class PixelScale:
    """A linear map from values to pixels: `low` and `high` are values, `first` and `last` the pixels at them."""

    low: float
    high: float
    first: float
    last: float

    def __call__(self, value: float) -> float:
        """Return the pixel coordinate of a value; the middle where `low` and `high` are equal."""
        if self.high <= self.low:
            return 0.5 * (self.first + self.last)
        return self.first + (self.last - self.first) * (value - self.low) / (self.high - self.low)

    def ticks(self, about: int = 5) -> list[float]:
        """Return about `about` round values between `low` and `high`, for the ticks of an axis."""
        span = self.high - self.low
        if span <= 0:
            return [self.low]
        rough = span / about
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(power * m for m in (1, 2, 5, 10) if power * m >= rough)
        first = math.ceil(self.low / step - 1e-9)
        return [step * i for i in range(first, math.floor(self.high / step + 1e-9) + 1)]


def picture(width: float, height: float, parts: Sequence[str], name: str) -> str:
    """Return an SVG element as wide as the page.

    `width`, `height`: extent of its coordinates, in pixels; `parts`: SVG elements; `name`: description in plain text,
    for screen readers.
    """
    return (
        f"<svg viewBox='0 0 {width:g} {height:g}' role='img' aria-label='{escape(name)}' "
        f"style='width:100%;max-width:{width:g}px'>" + "".join(parts) + "</svg>"
    )


def text(x: float, y: float, said: object, anchor: str = "start", colour: str = "#333", more: str = "") -> str:
    """Return the plain text `said` as SVG at (x, y) in pixels; `anchor`: start, middle or end; `more`: attributes."""
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}' fill='{colour}' {more}>{escape(said)}</text>"


def line(x: FloatArray, y: FloatArray, colour: str, more: str = "") -> str:
    """Return a line through points (n,), in pixels, as SVG; points that are not finite cut it, a lone one is a dot."""
    good = np.isfinite(x) & np.isfinite(y)
    pieces, start = [], 0
    for i in range(len(x) + 1):
        if i == len(x) or not good[i]:
            if i - start > 1:
                points = " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x[start:i], y[start:i], strict=True))
                pieces.append(f"<polyline points='{points}' fill='none' stroke='{colour}' {more}/>")
            elif i - start == 1:
                pieces.append(f"<circle cx='{x[start]:.1f}' cy='{y[start]:.1f}' r='2.5' fill='{colour}'/>")
            start = i + 1
    return "".join(pieces)


def bar(x: float, y: float, width: float, height: float, colour: str, more: str = "") -> str:
    """Return a rectangle from (x, y) in pixels as SVG; a negative width extends to the left; `more`: attributes."""
    left = x + min(width, 0.0)
    return f"<rect x='{left:.1f}' y='{y:.1f}' width='{abs(width):.1f}' height='{height:.1f}' fill='{colour}' {more}/>"


def swatch(colour: str, said: str) -> str:
    """Return an entry of a chart's key, a coloured box and text, as HTML for an element of class ``key``."""
    return f"<span style='background:{colour}'></span>{escape(said)}"


def upright(x: float, top: float, bottom: float, colour: str, more: str = "") -> str:
    """Return a vertical line as SVG; `x`, `top`, `bottom` in pixels, `more`: further attributes."""
    return f"<line x1='{x:.1f}' x2='{x:.1f}' y1='{top:.1f}' y2='{bottom:.1f}' stroke='{colour}' {more}/>"


def level(y: float, left: float, right: float, colour: str, more: str = "") -> str:
    """Return a horizontal line as SVG; `y`, `left`, `right` in pixels, `more`: further attributes."""
    return f"<line x1='{left:.1f}' x2='{right:.1f}' y1='{y:.1f}' y2='{y:.1f}' stroke='{colour}' {more}/>"
