"""Labels that do not cover each other: each is put in the free place closest to what it describes."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.report.scene import Label, View
from tissuereg.report.style import STYLE


def place_labels(figure: Any, views: Sequence[View], body: FloatArray) -> int:
    """Write the labels of views, each with a line to its place; return how many are left out for lack of room.

    The axes of `figure` have their final places; `body` (n, 3) has places on the surface of the body, in mm.
    """
    left_out = 0
    for view in views:
        frame = _frame(figure, view)
        silhouette, clear, anchors = (
            on_page(figure, view, np.reshape(places, (-1, 3)))
            for places in (body, view.keep_clear, [label.place for label in view.labels])
        )
        for label, anchor in zip(view.labels, anchors, strict=True):
            text = _fitted(figure, label.text, frame)
            size = _size(figure, text)
            middle = _free_place(anchor, size, frame, view.taken, (np.concatenate([clear, anchors]), silhouette))
            if middle is None:
                left_out += 1
                continue
            view.taken.append(_box(middle, size + 2.0 * STYLE.gap))
            clear = np.concatenate([clear, _leader(anchor, view.taken[-1])])
            _write(figure, replace(label, text=text), anchor, middle, size)
    return left_out


def on_page(figure: Any, view: View, places: FloatArray) -> FloatArray:
    """Return the position on the page (n, 2), in figure heights, of places (n, 3), mm, in a 3D view."""
    from mpl_toolkits.mplot3d import proj3d

    view.axes.apply_aspect()
    x, y, _ = proj3d.proj_transform(*places.T, view.axes.get_proj())
    pixels = view.axes.transData.transform(np.stack([np.asarray(x), np.asarray(y)], axis=1).reshape(-1, 2))
    return np.asarray(figure.transFigure.inverted().transform(pixels) * (ratio(figure), 1.0))


def shortened(figure: Any, text: str, width: float, **style: Any) -> str:
    """Return a line of text, cut with an ellipsis if it is wider than `width`, a share of the figure's width."""
    if _size(figure, text, **style)[0] <= width * ratio(figure):
        return text
    low, high = 0, len(text)
    while high - low > 1:
        middle = (low + high) // 2
        fits = _size(figure, text[:middle].rstrip() + "…", **style)[0] <= width * ratio(figure)
        low, high = (middle, high) if fits else (low, middle)
    return text[:low].rstrip() + "…"


def _fitted(figure: Any, text: str, frame: FloatArray) -> str:
    """Return a text with its lines cut to most of the width of a frame: low and high corner (2, 2), figure heights."""
    width = STYLE.widest_label * float(np.ptp(frame[:, 0])) / ratio(figure)
    return "\n".join(shortened(figure, line, width, fontsize=STYLE.font) for line in text.split("\n"))


def ratio(figure: Any) -> float:
    """Return the width of a figure over its height."""
    return float(figure.get_figwidth() / figure.get_figheight())


def _frame(figure: Any, view: View) -> FloatArray:
    """Return the part of the page that the labels of a view may take: low and high corner (2, 2), figure heights."""
    box = view.axes.get_position(original=True)
    scale = np.array([ratio(figure), 1.0])
    return np.asarray([[box.x0, box.y0], [box.x1, box.y1]] * scale)


def _size(figure: Any, text: str, **style: Any) -> FloatArray:
    """Return width and height (2,) of a text on the page, in figure heights; `style`: keywords of matplotlib's text."""
    probe = figure.text(0.0, 0.0, text, **{"fontsize": STYLE.font, **style})
    box = probe.get_window_extent(figure.canvas.get_renderer())
    probe.remove()
    width, height = figure.transFigure.inverted().transform((box.width, box.height))
    return np.array([width * ratio(figure), height])


def _box(middle: FloatArray, size: FloatArray) -> FloatArray:
    return np.stack([middle - 0.5 * size, middle + 0.5 * size])


def _free_place(
    anchor: FloatArray,
    size: FloatArray,
    frame: FloatArray,
    taken: list[FloatArray],
    drawn: tuple[FloatArray, FloatArray],
) -> FloatArray | None:
    """Return the centre (2,) of the best free box for a label inside a frame, or None if there is none.

    All lengths are in figure heights. `anchor` (2,): point that the label names; `size` (2,): width and height of the
    box; `frame` (2, 2): low and high corner; `taken`: boxes (2, 2) that it must not overlap; `drawn`: points (n, 2)
    that should stay clear, and points (m, 2) of the body.
    """
    best, least = None, np.inf
    for reach, middle in _candidates(anchor, size, frame):
        if min(reach, 1.0) >= least:  # no later one costs less
            break
        box = _box(middle, size)
        outside = (box[0] < frame[0]).any() or (box[1] > frame[1]).any()
        if reach >= least or outside or any(_overlap(_box(middle, size + 2.0 * STYLE.gap), other) for other in taken):
            continue
        leader = _leader(anchor, box)
        clear, body = (_inside(places, box + STYLE.gap * np.array([[-1.0], [1.0]])) for places in drawn)
        crossed = any(_inside(leader, other) for other in taken)
        cost = reach + STYLE.covered * clear + STYLE.crossed * crossed + STYLE.on_body * min(1.0, 0.25 * body)
        if cost < least:
            best, least = middle, cost
    return best


def _candidates(anchor: FloatArray, size: FloatArray, frame: FloatArray) -> Iterator[tuple[float, FloatArray]]:
    """Yield cost and centre (2,) of boxes that may take a label; the cost is their distance from the anchor.

    They lie first around the anchor (2,), then anywhere in the frame (2, 2), which costs 1 more. Lengths are in figure
    heights; `size` (2,): width and height of the label.
    """
    for reach in STYLE.reaches:
        for angle in 2.0 * np.pi * np.arange(STYLE.directions) / STYLE.directions:
            way = np.array([np.cos(angle), np.sin(angle)])
            yield reach, anchor + way * (reach + 0.5 * np.abs(way) @ size)
    steps = np.maximum(np.ptp(frame, axis=0) - size, 0.0)
    for share in np.ndindex(STYLE.places, STYLE.places):
        middle = frame[0] + 0.5 * size + steps * np.array(share) / (STYLE.places - 1)
        yield 1.0 + float(np.linalg.norm(middle - anchor)), middle


def _leader(anchor: FloatArray, box: FloatArray) -> FloatArray:
    """Return 30 points (30, 2) on the line from an anchor (2,) to the nearest point of a box (2, 2)."""
    return np.linspace(anchor, np.clip(anchor, *box), 30)


def _inside(places: FloatArray, box: FloatArray) -> int:
    return int(np.all((places > box[0]) & (places < box[1]), axis=1).sum())


def _overlap(one: FloatArray, other: FloatArray) -> bool:
    return bool((np.minimum(one[1], other[1]) > np.maximum(one[0], other[0])).all())


def _write(figure: Any, label: Label, anchor: FloatArray, middle: FloatArray, size: FloatArray) -> None:
    from matplotlib.lines import Line2D

    scale = np.array([1.0 / ratio(figure), 1.0])
    end = np.clip(anchor, *_box(middle, size))
    line = np.stack([anchor, end]) * scale
    figure.add_artist(Line2D(*line.T, color=label.colour, lw=0.8, alpha=0.8, zorder=20))
    around = {"boxstyle": "square,pad=0.15", "fc": (1, 1, 1, 0.85), "ec": "none"}
    middle = middle * scale
    figure.text(
        *middle, label.text, ha="center", va="center", fontsize=STYLE.font, color=label.colour, bbox=around, zorder=21
    )
