"""Pictures of a registration by matplotlib, without a display."""

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.report import scene
from tissuereg.report.labels import on_page, place_labels
from tissuereg.report.words import silent, verdict

if TYPE_CHECKING:
    from tissuereg.result import Registration

#: Elevation of the eye, and azimuths of the two views, in degrees.
_ELEVATION, _AZIMUTHS = 18.0, (-60.0, 30.0)

#: With contacts, the views look at the first of them from this many degrees to its left and right.
_ASIDE = (-40.0, 50.0)

#: Reasons that are written out, and how many letters a line of them has.
_MOST_REASONS, _LETTERS = 3, 165

#: Share of a view that the body fills along its longer side.
_FILLED = 0.72

#: Share of the nodes whose spread lies within the scale of colours.
_SHOWN = 0.99


def registration_figure(result: "Registration") -> Any:
    """Return a figure: the registered body from two sides, its markers, contacts, and targets with their regions.

    Parameters
    ----------
    result : Registration
        What to draw.

    Returns
    -------
    matplotlib.figure.Figure
        Not bound to any window.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 6.8))
    FigureCanvasAgg(figure)
    surface, colours = scene.Surface.of(result), _colours(result)
    body = surface.places[surface.nodes]
    views = [_view(figure, column, azimuth, body) for column, azimuth in enumerate(_azimuths(result))]
    _fit(figure, views, body)
    for view in views:
        scene.draw_body(view, result, surface, colours)
        scene.draw_contacts(view, result, surface)
        scene.draw_markers(view, result, surface)
        scene.draw_surface_points(view, result)
        scene.draw_targets(view, result)
        _triad(figure, view)
    place_labels(figure, views, body)
    _scale_bar(figure, views[0], result.mesh.extent)
    bar = figure.add_axes((0.935, 0.18, 0.012, 0.55))
    figure.colorbar(colours, cax=bar, extend="max", label="standard deviation of the surface, mm")
    _legend(figure, result)
    _head(figure, result)
    return figure


def _view(figure: Any, column: int, azimuth: float, body: FloatArray) -> scene.View:
    """Return one empty view with equal scales along all axes."""
    axes: Any = figure.add_axes((0.015 + 0.455 * column, 0.075, 0.45, 0.78), projection="3d", proj_type="ortho")
    axes.set_axis_off()
    axes.computed_zorder = False  # markers and regions stay readable through the body
    axes.view_init(_ELEVATION, azimuth)
    low, high = body.min(axis=0), body.max(axis=0)
    for set_limits, a, b in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), low, high, strict=True):
        set_limits(a, b)
    axes.set_box_aspect(high - low)
    return scene.View(axes, _towards(azimuth))


def _fit(figure: Any, views: list[scene.View], body: FloatArray) -> None:
    """Zoom all views alike, so that the body fills them but for a border for labels."""
    zooms = []
    for view in views:
        frame = view.axes.get_position(original=True)
        size = np.ptp(on_page(figure, view, body), axis=0)
        room = np.array([frame.width * figure.get_figwidth() / figure.get_figheight(), frame.height])
        zooms.append(float(np.min(_FILLED * room / size)))
    for view in views:
        low, high = body.min(axis=0), body.max(axis=0)
        view.axes.set_box_aspect(high - low, zoom=min(zooms))


def _triad(figure: Any, view: scene.View) -> None:
    """Draw the directions of the axes in the lower left corner of a view."""
    from matplotlib.lines import Line2D

    ratio = figure.get_figwidth() / figure.get_figheight()
    frame = view.axes.get_position(original=True)
    origin = np.array([frame.x0 * ratio + 0.06, frame.y0 + 0.06])
    tips = on_page(figure, view, np.vstack([np.zeros(3), np.eye(3)]))
    ways = 0.045 * (tips[1:] - tips[0]) / np.linalg.norm(tips[1:] - tips[0], axis=1).max()
    for way, name in zip(ways, "xyz", strict=True):
        line = np.stack([origin, origin + way]) / (ratio, 1.0)
        figure.add_artist(Line2D(*line.T, color="dimgray", lw=1.2))
        figure.text(
            *((origin + 1.35 * way) / (ratio, 1.0)), name, fontsize=8, color="dimgray", ha="center", va="center"
        )


def _scale_bar(figure: Any, view: scene.View, extent: float) -> None:
    """Draw a round length; an orthographic view has one scale."""
    from matplotlib.lines import Line2D

    ratio = figure.get_figwidth() / figure.get_figheight()
    across = np.cross([0.0, 0.0, 1.0], view.towards)
    ends = on_page(figure, view, np.stack([np.zeros(3), across / np.linalg.norm(across)]))
    power = 10.0 ** np.floor(np.log10(0.2 * extent))
    length = power * max(step for step in (1.0, 2.0, 5.0) if step * power <= 0.2 * extent)
    width, left, low = float(np.linalg.norm(ends[1] - ends[0])) * length / ratio, 0.12, 0.105
    figure.add_artist(Line2D([left, left + width], [low, low], color="dimgray", lw=2.5, solid_capstyle="butt"))
    figure.text(left + 0.5 * width, low + 0.012, f"{length:g} mm", fontsize=8, color="dimgray", ha="center")


def _azimuths(result: "Registration") -> tuple[float, float]:
    """Return azimuths that show the most probable contact from both views."""
    if not result.contacts:
        return _AZIMUTHS
    x, y, _ = result.contacts[0].centre_mm - result.mesh.nodes.mean(axis=0)
    towards = float(np.degrees(np.arctan2(y, x)))
    return towards + _ASIDE[0], towards + _ASIDE[1]


def _towards(azimuth: float) -> FloatArray:
    up, around = np.radians(_ELEVATION), np.radians(azimuth)
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def _colours(result: "Registration") -> Any:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    largest = float(np.quantile(result.std[result.mesh.surface_nodes], _SHOWN))
    return ScalarMappable(Normalize(0.0, max(largest, 1e-9)), colormaps["YlGnBu"])


def _head(figure: Any, result: "Registration") -> None:
    """Write the verdict, large, with its reasons."""
    trust = result.trust
    figure.text(
        0.02, 0.965, verdict(trust.ok), fontsize=19, weight="bold", va="top", color="#176f2c" if trust.ok else "#a3180d"
    )
    facts = "   |   ".join([*_met(result), f"chance of this misfit p = {trust.p_value:.2g}"])
    figure.text(0.98, 0.955, facts, fontsize=10, va="top", ha="right")
    lines = [
        line
        for reason in trust.reasons[:_MOST_REASONS]
        for line in textwrap.wrap(reason, _LETTERS, initial_indent="• ", subsequent_indent="   ")[:2]
    ]
    more = len(trust.reasons) - _MOST_REASONS
    if more > 0:
        lines.append(f"• and {more} more in the report")
    figure.text(0.02, 0.905, "\n".join(lines), fontsize=9, va="top", color="#a3180d", linespacing=1.3)
    flagged = [name for name, target in result.targets.items() if target.flag]
    if flagged:
        text = "\n".join(textwrap.wrap(silent(flagged), _LETTERS)[:2])
        figure.text(0.02, 0.9 - 0.026 * len(lines), text, fontsize=9, va="top", color=scene.FLAGGED)


def _met(result: "Registration") -> list[str]:
    """Return how far the data lay from the body before and after."""
    fit, surface, words = result.markers, result.surface, []
    if fit.used:
        words.append(
            f"{len(fit.used)} markers: {fit.before_rms_mm:.2f} mm before, {fit.after_rms_mm:.2f} mm after (rms)"
        )
    if surface is not None:
        words.append(
            f"{surface.used} surface points: {surface.before_rms_mm:.2f} mm before, {surface.after_rms_mm:.2f} mm after"
        )
    return words


def _legend(figure: Any, result: "Registration") -> None:
    """Explain below the views what is drawn, and nothing else."""
    from matplotlib.lines import Line2D

    def sign(label: str, colour: str, **style: Any) -> Any:
        return Line2D([], [], color=colour, label=label, **{"ls": "none", **style})

    signs = []
    if len(result.all_markers):
        signs += [
            sign("marker before", scene.BEFORE, marker="x", ms=5),
            sign("registered", scene.FITTED, marker="o", ms=4.5),
            sign("measured", scene.MEASURED, marker="o", ms=7, mfc="none"),
        ]
    if result.surface is not None:
        signs.append(sign("surface points", scene.MEASURED, marker=".", ms=4))
    reasons = {reason for _, reason in result.markers.dropped}
    if "wrong" in reasons:
        signs.append(sign("wrong marker, not used", scene.WRONG, marker="X", ms=8))
    if "not seen" in reasons:
        signs.append(sign("not seen: where it must be", "gray", marker="$?$", ms=7))
    if result.contacts:
        signs.append(sign("contact: force on the body", scene.CONTACT, marker=r"$\rightarrow$", ms=12))
    flags = {target.flag is not None for target in result.targets.values()}
    if False in flags:
        signs.append(sign("target, 90 % region", scene.TARGET, ls="-", lw=1.2, marker="+", ms=6))
    if True in flags:
        signs.append(sign("target, no marker tells", scene.FLAGGED, ls="--", lw=1.2, marker="+", ms=6))
    figure.legend(handles=signs, loc="lower left", bbox_to_anchor=(0.015, 0.005), ncols=len(signs), fontsize=9,
                  frameon=False, columnspacing=1.6, handletextpad=0.5)  # fmt: skip
