"""Enlarged pictures of targets: the 90 % region of each to scale, and the target's place before registration."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.report import scene
from tissuereg.report.labels import shortened
from tissuereg.report.style import STYLE

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration
    from tissuereg.registration.target import Target


@dataclass(frozen=True, eq=False)
class _Panel:
    """One target in its enlarged picture, in coordinates across the line of sight with the registered place as origin.

    `ellipse` (n, 2): outline of the 90 % region, mm; `before` (2,): place before registration, mm.
    """

    ellipse: FloatArray  # outline of the region, (n, 2)
    before: FloatArray  # where the target was, undeformed or as simulated, (2,)


def draw_panels(figure: Any, result: "Registration", towards: FloatArray, frame: tuple[float, ...]) -> None:
    """Draw an enlarged picture (panel) of each target, seen along the unit vector `towards` from body to viewer.

    `frame` has left, bottom, width and height of the room for all panels, as shares of the figure. At most the first
    `STYLE.panels` targets are drawn.
    """
    chosen = list(result.targets.items())[: STYLE.panels]
    left, bottom, width, height = frame
    rows, columns = next(grid for grid in STYLE.grids if grid[0] * grid[1] >= len(chosen))
    inch = figure.get_figheight()
    step, wide = height / rows, width / columns
    tall = min(step - STYLE.words_inch / inch, 1.1 * wide * figure.get_figwidth() / inch)
    for index, (name, target) in enumerate(chosen):
        row, column = divmod(index, columns)
        top = bottom + height - row * step - STYLE.words_inch / inch
        x = left + column * wide
        _words(figure, result, (name, target), (x, top + 0.06 / inch, wide - 0.008))
        axes = figure.add_axes((x, top - tall + 0.06 / inch, wide - 0.008, tall - 0.06 / inch), zorder=30)
        _draw(axes, _across(target, towards), result.mesh.extent, flagged=target.flag is not None)


def _words(figure: Any, result: "Registration", one: "tuple[str, Target]", place: tuple[float, float, float]) -> None:
    """Write name, region size (mm) and motion of the target `one` above a panel; `place`: in shares of the figure."""
    name, target = one
    left, low, width = place
    colour = scene.TARGET if target.flag is None else scene.FLAGGED
    title = shortened(figure, name, width, fontsize=10, weight="bold")
    figure.text(left, low + 0.026, title, fontsize=10, weight="bold", color=colour)
    way = float(np.linalg.norm(target.mean - _before(target)))
    motion = f"moved {way:.2g} mm" if target.simulation is None else f"simulation corrected by {way:.2g} mm"
    radius = target.region(0.90).radii[-1]
    facts = (f"90 % within {radius:.2g} mm, {motion}", f"{radius:.2g} mm, {motion}")
    fits = [text for text in facts if shortened(figure, text, width, fontsize=9) == text]
    figure.text(left, low, fits[0] if fits else f"within {radius:.2g} mm", fontsize=9, color=colour)


def _before(target: "Target") -> FloatArray:
    return target.reference if target.simulation is None else target.simulation


def _across(target: "Target", towards: FloatArray) -> _Panel:
    """Return a target as seen along the line of sight `towards` (3,): its ellipsoid is projected to an ellipse."""
    right = np.cross([0.0, 0.0, 1.0], towards)
    right /= np.linalg.norm(right)
    across = np.stack([right, np.cross(towards, right)])
    region = target.region(0.90)
    half_axes = region.radii[:, None] * region.axes @ across.T
    values, vectors = np.linalg.eigh(half_axes.T @ half_axes)
    angles = np.linspace(0.0, 2.0 * np.pi, 91)
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ellipse = circle * np.sqrt(np.maximum(values, 0.0)) @ vectors.T
    return _Panel(ellipse, across @ (_before(target) - target.mean))


def _draw(axes: Any, panel: _Panel, extent: float, *, flagged: bool) -> None:
    """Draw one panel: 90 % region, registered place, arrow from the place before, scale bar; `extent`: body's, mm."""
    from matplotlib.patches import Polygon

    colour = scene.FLAGGED if flagged else scene.TARGET
    middle, half = _window(axes, panel, extent)
    axes.set_xlim(middle[0] - half[0], middle[0] + half[0])
    axes.set_ylim(middle[1] - half[1], middle[1] + half[1])
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor("#f7f7f4")
    for side in axes.spines.values():
        side.set_color("#9a9a94")
    axes.add_patch(Polygon(panel.ellipse, closed=True, fc=scene.REGION, alpha=0.45, ec="none"))
    style = "--" if flagged else "-"
    axes.add_patch(Polygon(panel.ellipse, closed=True, fc="none", ec=colour, lw=1.6, ls=style, zorder=4))
    if np.linalg.norm(panel.before) > 0.02 * half.min():
        way = {"arrowstyle": "-|>", "color": scene.BEFORE, "lw": 1.6, "shrinkA": 0.0, "shrinkB": 3.0}
        axes.annotate("", xy=(0.0, 0.0), xytext=panel.before * _inside(panel.before, middle, half), arrowprops=way)
    axes.plot(*panel.before, marker="x", ms=8, mew=2.0, color=scene.BEFORE, zorder=5)
    axes.plot(0.0, 0.0, marker="+", ms=11, mew=1.8, color=colour, zorder=6)
    _scale_bar(axes, half, middle, to_the_right=bool(panel.before[0] < 0.0))


def _window(axes: Any, panel: _Panel, extent: float) -> tuple[FloatArray, FloatArray]:
    """Return centre (2,) and half side lengths (2,) of the part of the plane that a panel shows, mm.

    It contains the region, and the target's place before registration if that is near enough; `extent`: largest extent
    of the body, mm.
    """
    box = axes.get_position()
    sides = np.array([box.width * axes.figure.get_figwidth(), box.height * axes.figure.get_figheight()])
    room = sides - (0.0, STYLE.bar_inch)
    radius = max(float(np.linalg.norm(panel.ellipse, axis=1).max()), STYLE.smallest * extent)
    for shown in (np.vstack([panel.ellipse, panel.before]), panel.ellipse):
        low, high = shown.min(axis=0), shown.max(axis=0)
        scale = max(float(np.max(STYLE.border * (high - low) / room)), 2.0 * STYLE.border * radius / float(room.min()))
        if scale * room.min() <= STYLE.widest * radius:
            break
    middle = 0.5 * (low + high) - (0.0, 0.5 * scale * STYLE.bar_inch)
    return middle, 0.5 * scale * sides


def _inside(before: FloatArray, middle: FloatArray, half: FloatArray) -> float:
    """Return the share of the line from the registered place to the place before that lies in a panel's window.

    `before`, `middle`, `half` (2,): place before registration, centre and half side lengths of the window, mm.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = np.where(before > 0.0, (middle + half) / before, (middle - half) / before)
    return float(min(1.0, np.min(reach[before != 0.0], initial=1.0)))


def _scale_bar(axes: Any, half: FloatArray, middle: FloatArray, *, to_the_right: bool) -> None:
    """Draw a bar of round length in a lower corner; `half`, `middle` (2,): half sides and centre of the window, mm."""
    length = round_length(0.45 * float(half[0]))
    inch = 2.0 * half[1] / (axes.get_position().height * axes.figure.get_figheight())
    side = 1.0 if to_the_right else -1.0
    end, low = middle[0] + side * 0.93 * half[0], middle[1] - half[1] + 0.11 * inch
    axes.plot([end, end - side * length], [low, low], color="#444444", lw=2.5, solid_capstyle="butt", zorder=7)
    place, align = end - side * (length + 0.05 * half[0]), "right" if to_the_right else "left"
    axes.text(place, low, f"{length:g} mm", fontsize=9, color="#444444", va="center", ha=align, zorder=7)


def round_length(most: float) -> float:
    """Return the largest of 1, 2, 5 times a power of ten that is no larger than `most` (> 0).

    >>> round_length(0.73), round_length(31.0)
    (0.5, 20.0)
    """
    power = 10.0 ** np.floor(np.log10(most))
    return float(f"{power * max(step for step in (1.0, 2.0, 5.0) if step * power <= most * (1.0 + 1e-12)):.1g}")
