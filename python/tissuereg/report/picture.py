"""Pictures of a registration by matplotlib, without a display."""

from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.report import scene
from tissuereg.report.heading import write_heading, write_legend
from tissuereg.report.inset import draw_panels, round_length
from tissuereg.report.labels import on_page, place_labels
from tissuereg.report.style import STYLE
from tissuereg.report.words import contacts_of

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration


def registration_figure(result: "Registration") -> Any:
    """Return a figure: the registered body from two sides, its markers, contacts and targets, each target enlarged.

    `result`: what to draw. Result: not bound to any window. Labels do not overlap; the number of those without room is
    written below the views.
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


def _views(figure: Any, result: "Registration", body: FloatArray, ends: tuple[float, float]) -> list[scene.View]:
    """Return two empty views side by side, zoomed alike, so that the body fills them but for a border for labels."""
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
    """Return one empty view with equal scales along all axes."""
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
    """Draw the targets enlarged right of the views."""
    words = "90 % regions, seen as on the left"
    more = len(result.targets) - STYLE.panels
    if more > 0:
        words = f"90 % regions; {more} more in the report"
    figure.text(STYLE.panels_from, top - 0.025, words, fontsize=10, color="dimgray")
    draw_panels(figure, result, view.towards, (STYLE.panels_from, 0.1, STYLE.right - STYLE.panels_from, top - 0.135))


def _triad(figure: Any, view: scene.View) -> None:
    """Draw the directions of the axes in the lower left corner of a view, and keep labels off it."""
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
            *((origin + 1.35 * way) / (ratio, 1.0)), name, fontsize=9, color="dimgray", ha="center", va="center"
        )
    view.taken.append(np.stack([origin - 0.085, origin + 0.085]))


def _scale_bar(figure: Any, view: scene.View, extent: float) -> None:
    """Draw a round length; an orthographic view has one scale."""
    from matplotlib.lines import Line2D

    ratio = figure.get_figwidth() / figure.get_figheight()
    across = np.cross([0.0, 0.0, 1.0], view.towards)
    ends = on_page(figure, view, np.stack([np.zeros(3), across / np.linalg.norm(across)]))
    length = round_length(0.2 * extent)
    width, left, low = float(np.linalg.norm(ends[1] - ends[0])) * length / ratio, 0.022, 0.12
    figure.add_artist(Line2D([left, left + width], [low, low], color="dimgray", lw=2.5, solid_capstyle="butt"))
    figure.text(left + width + 0.008, low, f"{length:g} mm", fontsize=9, color="dimgray", va="center")


def _colour_bar(figure: Any, colours: Any, right: float) -> None:
    """Explain the colours of the surface, below the views."""
    bar = figure.add_axes((right - 0.27, 0.118, 0.25, 0.016))
    figure.colorbar(colours, cax=bar, extend="max", orientation="horizontal")
    bar.tick_params(labelsize=9)
    figure.text(right - 0.28, 0.12, "standard deviation of the surface, mm", fontsize=9, ha="right")


def _azimuths(result: "Registration") -> tuple[float, float]:
    """Return azimuths that show the most probable contact from both views."""
    contacts = contacts_of(result)
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
