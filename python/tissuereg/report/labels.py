"""Labels that do not cover each other: each goes to the free place closest to what it is about."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg.report.scene import Label, View

#: Distances of a label from its place that are tried, over the figure's height.
_REACHES = (0.05, 0.08, 0.12, 0.17, 0.23, 0.30, 0.38)

#: Directions that are tried.
_DIRECTIONS = 20

#: What it costs, in heights of the figure, to cover a place that had better stay clear, or the body.
_COVERED, _ON_BODY = 0.08, 0.15

#: Room between labels, over the figure's height.
_GAP = 0.008


def place_labels(figure: Any, views: Sequence[View], body: FloatArray) -> None:
    """Write the labels of views, with a line to what each is about.

    Parameters
    ----------
    figure : matplotlib.figure.Figure
        Its axes have their final places.
    views : sequence of View
        With labels.
    body : ndarray of float64, shape (n, 3)
        Places of the body's surface, mm.
    """
    ratio = figure.get_figwidth() / figure.get_figheight()
    for view in views:
        taken: list[FloatArray] = []
        frame = _frame(view, ratio)
        silhouette, clear, anchors = (
            on_page(figure, view, np.reshape(places, (-1, 3)))
            for places in (body, view.keep_clear, [label.place for label in view.labels])
        )
        for label, anchor in zip(view.labels, anchors, strict=True):
            size = _size(figure, label.text, ratio)
            middle = _free_place(anchor, size, frame, taken, (np.concatenate([clear, anchors]), silhouette))
            taken.append(_box(middle, size + 2.0 * _GAP))
            clear = np.concatenate([clear, _leader(anchor, taken[-1])])
            _write(figure, label, anchor, middle, size, ratio)


def on_page(figure: Any, view: View, places: FloatArray) -> FloatArray:
    """Return where places (n, 3) lie on the page (n, 2), in heights of the figure."""
    from mpl_toolkits.mplot3d import proj3d

    ratio = figure.get_figwidth() / figure.get_figheight()
    view.axes.apply_aspect()
    x, y, _ = proj3d.proj_transform(*places.T, view.axes.get_proj())
    pixels = view.axes.transData.transform(np.stack([np.asarray(x), np.asarray(y)], axis=1).reshape(-1, 2))
    return np.asarray(figure.transFigure.inverted().transform(pixels) * (ratio, 1.0))


def _frame(view: View, ratio: float) -> FloatArray:
    """Return the part of the page (low, high) that the labels of a view may take."""
    box = view.axes.get_position(original=True)
    return np.array([[box.x0 * ratio, box.y0], [box.x1 * ratio, box.y1]])


def _size(figure: Any, text: str, ratio: float) -> FloatArray:
    """Return width and height of a text in heights of the figure."""
    probe = figure.text(0.0, 0.0, text, fontsize=9)
    box = probe.get_window_extent(figure.canvas.get_renderer())
    probe.remove()
    width, height = figure.transFigure.inverted().transform((box.width, box.height))
    return np.array([width * ratio, height])


def _box(middle: FloatArray, size: FloatArray) -> FloatArray:
    return np.stack([middle - 0.5 * size, middle + 0.5 * size])


def _free_place(
    anchor: FloatArray,
    size: FloatArray,
    frame: FloatArray,
    taken: list[FloatArray],
    drawn: tuple[FloatArray, FloatArray],
) -> FloatArray:
    """Return the middle of the cheapest box: inside the frame, off other labels, near, off what is drawn."""
    angles = 2.0 * np.pi * np.arange(_DIRECTIONS) / _DIRECTIONS
    best, least = anchor, np.inf
    for reach in _REACHES:
        for angle in angles:
            way = np.array([np.cos(angle), np.sin(angle)])
            middle = anchor + way * (reach + 0.5 * np.abs(way) @ size)
            box = _box(middle, size)
            outside = np.maximum(frame[0] - box[0], 0.0).sum() + np.maximum(box[1] - frame[1], 0.0).sum()
            covers = sum(_overlap(box, other) for other in taken)
            leader = _leader(anchor, box)
            clear, body = (_inside(places, box + _GAP * np.array([[-1.0], [1.0]])) for places in drawn)
            clear += sum(_inside(leader, other) for other in taken)
            cost = reach + 10.0 * outside + 1e3 * covers + _COVERED * clear + _ON_BODY * min(1.0, 0.25 * body)
            if cost < least:
                best, least = middle, cost
    return best


def _leader(anchor: FloatArray, box: FloatArray) -> FloatArray:
    """Return places (10, 2) along the line from an anchor to its box."""
    return np.linspace(anchor, np.clip(anchor, *box), 10)


def _inside(places: FloatArray, box: FloatArray) -> int:
    return int(np.all((places > box[0]) & (places < box[1]), axis=1).sum())


def _overlap(one: FloatArray, other: FloatArray) -> float:
    sides = np.minimum(one[1], other[1]) - np.maximum(one[0], other[0])
    return float(np.prod(np.maximum(sides, 0.0)) + (0.01 if (sides > 0.0).all() else 0.0))


def _write(figure: Any, label: Label, anchor: FloatArray, middle: FloatArray, size: FloatArray, ratio: float) -> None:
    from matplotlib.lines import Line2D

    scale = np.array([1.0 / ratio, 1.0])
    end = np.clip(anchor, *_box(middle, size))
    line = np.stack([anchor, end]) * scale
    figure.add_artist(Line2D(*line.T, color=label.colour, lw=0.7, alpha=0.8, zorder=20))
    around = {"boxstyle": "square,pad=0.15", "fc": (1, 1, 1, 0.85), "ec": "none"}
    figure.text(
        *(middle * scale), label.text, ha="center", va="center", fontsize=9, color=label.colour, bbox=around, zorder=21
    )
