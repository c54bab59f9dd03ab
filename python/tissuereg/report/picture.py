"""The picture of a registration by matplotlib: two views of the body, verdict and reasons above, legend below."""

import io
import math
import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.report import scene
from tissuereg.report.inset import draw_panels, round_length
from tissuereg.report.labels import on_page, place_labels, ratio
from tissuereg.report.style import STYLE
from tissuereg.report.words import counted, markers_used, silent, start_word, verdict

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration


def registration_figure(result: "Registration") -> Any:
    """Return a matplotlib figure of a registration: the body from two sides, markers, contacts, targets, also enlarged.

    The figure belongs to no window. Labels do not overlap; the number of labels without room is written below the
    views.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=STYLE.size_inch)
    FigureCanvasAgg(figure)
    surface, colours = scene.Surface.of(result), _colours(result)
    top = write_heading(figure, result) - 0.01
    right = STYLE.panels_from - 0.012 if result.targets else STYLE.right
    body = surface.places[surface.nodes]
    views = _views(figure, result, body, (right, top))
    for view in views:
        scene.draw_body(view, result, surface, colours)
        scene.draw_contacts(view, result, surface)
        scene.draw_markers(view, result, surface)
        scene.draw_surface_points(view, result)
        scene.draw_targets(view, result)
        # matplotlib cuts what lies outside the square in the middle of a frame; the zoom is that of the whole frame.
        for artist in view.axes.get_children():
            artist.set_clip_on(False)
        _triad(figure, view)
    left_out = place_labels(figure, views, body)
    _scale_bar(figure, views[0], result.mesh.extent)
    _colour_bar(figure, colours, right)
    if left_out:
        figure.text(0.022, 0.082, f"{left_out} labels have no room: see the report", fontsize=9, color="dimgray")
    if result.targets:
        _panels(figure, result, views[0], top)
    write_legend(figure, result)
    return figure


def png_bytes(figure: Any) -> bytes:
    """Return a figure as the bytes of a PNG file of 1430 x 792 pixels."""
    stream = io.BytesIO()
    figure.savefig(stream, dpi=110, format="png", pil_kwargs={"compress_level": 2})
    return stream.getvalue()


def _views(figure: Any, result: "Registration", body: FloatArray, ends: tuple[float, float]) -> list[scene.View]:
    """Return two empty 3D views side by side, of equal scale, which the body fills but for a border for labels.

    `body` (n, 3): places that must be visible, mm; `ends`: right and top end of the room for views, as shares of the
    figure.
    """
    right, top = ends
    wide = 0.5 * (right - STYLE.left)
    frames = [(STYLE.left + wide * column, STYLE.low, wide - 0.006, top - STYLE.low) for column in range(2)]
    azimuths = _azimuths(result)
    views = [_view(figure, frame, azimuth, body) for frame, azimuth in zip(frames, azimuths, strict=True)]
    zooms = []
    for view in views:
        frame = view.axes.get_position(original=True)
        size = np.ptp(on_page(figure, view, body), axis=0)
        room = np.array([frame.width * figure.get_figwidth() / figure.get_figheight(), frame.height])
        zooms.append(float(np.min(STYLE.filled * room / size)))
    for view in views:
        low, high = body.min(axis=0), body.max(axis=0)
        view.axes.set_box_aspect(high - low, zoom=min(zooms))
    return views


def _view(figure: Any, frame: tuple[float, ...], azimuth: float, body: FloatArray) -> scene.View:
    """Return an empty 3D view of a body (n, 3), mm, in `frame` (shares of the figure); `azimuth` is in degrees."""
    axes: Any = figure.add_axes(frame, projection="3d", proj_type="ortho")
    axes.set_axis_off()
    axes.computed_zorder = False  # markers and regions stay readable through the body
    axes.view_init(STYLE.elevation, azimuth)
    low, high = body.min(axis=0), body.max(axis=0)
    for set_limits, a, b in zip((axes.set_xlim, axes.set_ylim, axes.set_zlim), low, high, strict=True):
        set_limits(a, b)
    axes.set_box_aspect(high - low)
    return scene.View(axes, _towards(azimuth))


def _panels(figure: Any, result: "Registration", view: scene.View, top: float) -> None:
    """Draw the enlarged pictures of the targets right of the views, below the height `top`, a share of the figure."""
    words = "90 % regions, seen as on the left"
    more = len(result.targets) - STYLE.panels
    if more > 0:
        words = f"90 % regions; {more} more in the report"
    figure.text(STYLE.panels_from, top - 0.025, words, fontsize=10, color="dimgray")
    draw_panels(figure, result, view.towards, (STYLE.panels_from, 0.1, STYLE.right - STYLE.panels_from, top - 0.135))


def _triad(figure: Any, view: scene.View) -> None:
    """Draw the directions of x, y and z in the lower left corner of a view, and keep labels away from there."""
    from matplotlib.lines import Line2D

    frame = view.axes.get_position(original=True)
    origin = np.array([frame.x0 * ratio(figure) + 0.06, frame.y0 + 0.06])
    tips = on_page(figure, view, np.vstack([np.zeros(3), np.eye(3)]))
    ways = 0.045 * (tips[1:] - tips[0]) / np.linalg.norm(tips[1:] - tips[0], axis=1).max()
    for way, name in zip(ways, "xyz", strict=True):
        line = np.stack([origin, origin + way]) / (ratio(figure), 1.0)
        figure.add_artist(Line2D(*line.T, color="dimgray", lw=1.2))
        figure.text(
            *((origin + 1.35 * way) / (ratio(figure), 1.0)), name, fontsize=9, color="dimgray", ha="center", va="center"
        )
    view.taken.append(np.stack([origin - 0.085, origin + 0.085]))


def _scale_bar(figure: Any, view: scene.View, extent: float) -> None:
    """Draw a bar of round length, in mm, for all views, whose scale is the same everywhere; `extent`: body's, mm."""
    from matplotlib.lines import Line2D

    across = np.cross([0.0, 0.0, 1.0], view.towards)
    ends = on_page(figure, view, np.stack([np.zeros(3), across / np.linalg.norm(across)]))
    length = round_length(0.2 * extent)
    width, left, low = float(np.linalg.norm(ends[1] - ends[0])) * length / ratio(figure), 0.022, 0.12
    figure.add_artist(Line2D([left, left + width], [low, low], color="dimgray", lw=2.5, solid_capstyle="butt"))
    figure.text(left + width + 0.008, low, f"{length:g} mm", fontsize=9, color="dimgray", va="center")


def _colour_bar(figure: Any, colours: Any, right: float) -> None:
    """Draw the colour bar of the surface's standard deviation, in mm, below the views, which end at `right`."""
    bar = figure.add_axes((right - 0.27, 0.118, 0.25, 0.016))
    figure.colorbar(colours, cax=bar, extend="max", orientation="horizontal")
    bar.tick_params(labelsize=9)
    figure.text(right - 0.28, 0.12, "standard deviation of the surface, mm", fontsize=9, ha="right")


def _azimuths(result: "Registration") -> tuple[float, float]:
    """Return the azimuths of the two views, degrees, from which the most probable contact is visible."""
    contacts = scene.contacts_of(result)
    if not contacts:
        return STYLE.azimuths
    x, y, _ = contacts[0].centre_mm - result.mesh.nodes.mean(axis=0)
    towards = float(np.degrees(np.arctan2(y, x)))
    return towards + STYLE.aside[0], towards + STYLE.aside[1]


def _towards(azimuth: float) -> FloatArray:
    up, around = np.radians(STYLE.elevation), np.radians(azimuth)
    return np.array([np.cos(up) * np.cos(around), np.cos(up) * np.sin(around), np.sin(up)])


def _colours(result: "Registration") -> Any:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    largest = float(np.quantile(result.std[result.mesh.surface_nodes], STYLE.shown))
    return ScalarMappable(Normalize(0.0, max(largest, 1e-9)), colormaps["YlGnBu"])


def write_heading(figure: Any, result: "Registration") -> float:
    """Write the verdict, large, and its reasons; return this text's lower end as a share of the figure's height."""
    trust = result.trust
    good = "#176f2c" if trust.ok else "#a3180d"
    figure.text(0.02, 0.972, verdict(trust.ok), fontsize=19, weight="bold", va="top", color=good)
    chance = f"chance of this misfit p = {trust.p_value:.2g}"
    facts = "   |   ".join([*_met(result), *([chance] if math.isfinite(trust.p_value) else [])])
    figure.text(0.02, 0.915, facts, fontsize=10, va="top")
    lines = [line for reason in trust.reasons[: STYLE.reasons] for line in _wrapped(reason, "• ", "   ")]
    more = len(trust.reasons) - STYLE.reasons
    if more > 0:
        lines.append(f"• and {more} more in the report")
    coloured = [(line, "#a3180d") for line in lines]
    flagged = [name for name, target in result.targets.items() if target.flag]
    if flagged:
        coloured += [(line, scene.FLAGGED) for line in _wrapped(silent(flagged))]
    for row, (line, colour) in enumerate(coloured):
        figure.text(0.02, 0.882 - STYLE.line * row, line, fontsize=9.5, va="top", color=colour)
    return 0.882 - STYLE.line * len(coloured)


def _wrapped(text: str, first: str = "", later: str = "") -> list[str]:
    """Return the wrapped lines of a text, cut with an ellipsis if too long; `first`, `later`: indents of the lines."""
    return textwrap.wrap(
        text, STYLE.letters, max_lines=STYLE.lines, placeholder=" …", initial_indent=first, subsequent_indent=later
    )


def _met(result: "Registration") -> list[str]:
    """Return texts on the distance of markers and surface points from the body, in mm (rms), before and after."""
    fit, surface, words, start = result.markers, scene.surface_of(result), [], start_word(result.starts_simulated)
    if fit.used:
        words.append(
            f"{markers_used(fit.used, fit.inner)}: {fit.before_rms_mm:.2f} mm {start}, "
            f"{fit.after_rms_mm:.2f} mm after (rms)"
        )
    if surface is not None:
        words.append(
            f"{counted(surface.used, 'surface point')}: {surface.before_rms_mm:.2f} mm {start}, "
            f"{surface.after_rms_mm:.2f} mm after"
        )
    return words or ["no marker was used"]


def write_legend(figure: Any, result: "Registration") -> None:
    """Write a legend below the views that explains the symbols drawn in them, and no others."""
    signs = [_sign(*sign[:2], **sign[2]) for sign in _signs(result)]
    figure.legend(handles=signs, loc="lower left", bbox_to_anchor=(0.012, 0.0), ncols=STYLE.columns, fontsize=10,
                  frameon=False, columnspacing=1.6, handletextpad=0.5, labelspacing=0.35)  # fmt: skip


def _sign(label: str, colour: str, **style: Any) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, label=label, **{"ls": "none", **style})


def _signs(result: "Registration") -> list[tuple[str, str, dict[str, Any]]]:
    """Return label, colour and line style of every symbol that the picture of this registration contains."""
    signs: list[tuple[str, str, dict[str, Any]]] = []
    if len(result.all_markers):
        signs += [
            ("before", scene.BEFORE, {"marker": "x", "ms": 6, "mew": 1.8}),
            ("marker, registered", scene.FITTED, {"marker": "o", "ms": 4.5}),
            ("marker, measured", scene.MEASURED, {"marker": "o", "ms": 7, "mfc": "none"}),
        ]
    if scene.surface_of(result) is not None:
        signs.append(("surface points", scene.MEASURED, {"marker": ".", "ms": 4}))
    reasons = {reason for _, reason in result.markers.dropped}
    if "wrong" in reasons:
        signs.append(("wrong marker, not used", scene.WRONG, {"marker": "X", "ms": 8}))
    if reasons - {"wrong"}:
        signs.append(("not seen: where it must be", "dimgray", {"marker": "$?$", "ms": 7}))
    if scene.contacts_of(result):
        signs.append(("contact: force on the body", scene.CONTACT, {"marker": r"$\rightarrow$", "ms": 12}))
    flags = {target.flag is not None for target in result.targets.values()}
    if False in flags:
        signs.append(("target, 90 % region", scene.TARGET, {"ls": "-", "lw": 1.2, "marker": "+", "ms": 7}))
    if True in flags:
        signs.append(("target, no marker tells", scene.FLAGGED, {"ls": "--", "lw": 1.2, "marker": "+", "ms": 7}))
    return signs
