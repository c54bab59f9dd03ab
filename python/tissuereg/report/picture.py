"""Pictures of a registration by matplotlib, without a display."""

from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._arrays import FloatArray

if TYPE_CHECKING:
    from tissuereg.result import Registration

#: View directions: elevation and azimuth in degrees.
_VIEWS = ((18.0, -60.0), (18.0, 30.0))


def registration_figure(result: "Registration") -> Any:
    """Return a figure: the undeformed and the registered body, markers, targets with their regions.

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

    figure = Figure(figsize=(12.5, 5.6), layout="constrained")
    FigureCanvasAgg(figure)
    colours: Any = None
    for column, view in enumerate(_VIEWS):
        axes: Any = figure.add_subplot(1, 2, column + 1, projection="3d")
        axes.computed_zorder = False  # markers and regions stay readable through the body
        colours = _draw_body(axes, result)
        _draw_markers(axes, result)
        _draw_surface_points(axes, result)
        for name, target in result.targets.items():
            _draw_region(axes, target.region(0.90), name)
        axes.view_init(*view)
        _equal_box(axes, result)
        if column == 0 and (len(result.all_markers) or result.surface is not None):
            axes.legend(loc="upper left", fontsize=8, frameon=False)
    figure.colorbar(colours, ax=figure.axes, shrink=0.65, label="posterior standard deviation, mm")
    figure.suptitle(
        f"{_title(result)}   |   trusted: {'yes' if result.trust.ok else 'no'} (p = {result.trust.p_value:.2g})",
        fontsize=10,
    )
    return figure


def _title(result: "Registration") -> str:
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
    return "   |   ".join(words)


def _draw_body(axes: Any, result: "Registration") -> Any:
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    mesh = result.mesh
    moved = (mesh.nodes + result.displacement)[mesh.surface]
    spread = result.std[mesh.surface].mean(axis=1)
    scale = ScalarMappable(Normalize(0.0, max(float(spread.max()), 1e-9)), colormaps["viridis"])
    normals = np.cross(moved[:, 1] - moved[:, 0], moved[:, 2] - moved[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    light = 0.72 + 0.28 * np.clip(normals @ (np.array([0.3, -0.5, 0.8]) / 0.99), 0.0, 1.0)
    faces = scale.to_rgba(spread)
    faces[:, :3] *= light[:, None]
    faces[:, 3] = 0.55
    axes.add_collection3d(Poly3DCollection(moved, facecolors=faces, edgecolors=(0, 0, 0, 0.08), linewidths=0.2))
    axes.add_collection3d(
        Poly3DCollection(
            mesh.nodes[mesh.surface],
            facecolors=(0, 0, 0, 0),
            edgecolors=(0.4, 0.4, 0.4, 0.10),
            linewidths=0.3,
        )
    )
    return scale


def _draw_surface_points(axes: Any, result: "Registration") -> None:
    if result.surface is not None:
        axes.scatter(*result.surface.places.T, s=3, c="tab:red", depthshade=False, label="surface points")


def _draw_markers(axes: Any, result: "Registration") -> None:
    seen = result.all_markers.seen
    if not seen.any():
        return
    measured = result.all_markers.measured[seen]
    start = result.start_markers[seen]
    # A marker that is wrong was seen and is not used; one seen in part is used and has no place.
    names = [name for name, whole in zip(result.all_markers.names, seen, strict=True) if whole]
    left = [result.markers.residual_mm.get(name, np.full(3, np.nan)) for name in names]
    fitted = measured - np.array(left)
    axes.scatter(*start.T, s=16, c="tab:orange", marker="x", depthshade=False, label="before")
    axes.scatter(*fitted.T, s=18, c="tab:blue", depthshade=False, label="registered")
    axes.scatter(*measured.T, s=46, facecolors="none", edgecolors="tab:red", depthshade=False, label="measured")
    for a, b in zip(start, measured, strict=True):
        axes.plot(*np.array([a, b]).T, c="tab:orange", lw=0.8)


def _draw_region(axes: Any, region: Any, name: str) -> None:
    around, along = np.meshgrid(np.linspace(0, 2 * np.pi, 25), np.linspace(0, np.pi, 13))
    unit = np.stack([np.cos(around) * np.sin(along), np.sin(around) * np.sin(along), np.cos(along)], axis=-1)
    shell = region.centre + (unit * region.radii) @ region.axes
    axes.plot_wireframe(*np.moveaxis(shell, -1, 0), color="crimson", linewidth=0.6, alpha=0.9, zorder=8)
    axes.text(*region.centre, f"   {name}, 90 %", color="crimson", fontsize=9, weight="bold", zorder=9)


def _equal_box(axes: Any, result: "Registration") -> None:
    points: FloatArray = np.concatenate([result.mesh.nodes, result.mesh.nodes + result.displacement])
    low, high = points.min(axis=0), points.max(axis=0)
    axes.set_box_aspect(high - low, zoom=1.15)
    for set_limits, a, b, title in zip(
        (axes.set_xlim, axes.set_ylim, axes.set_zlim), low, high, ("x, mm", "y, mm", "z, mm"), strict=True
    ):
        set_limits(a, b)
        getattr(axes, f"set_{title[0]}label")(title, fontsize=8)
    axes.tick_params(labelsize=7)
