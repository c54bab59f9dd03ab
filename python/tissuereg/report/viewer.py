"""A body to turn, for all pages: what is drawn (a scene), and the HTML that shows it without anything else."""

import base64
import html
import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import numpy.typing as npt

from tissuereg._base.arrays import FloatArray
from tissuereg.io.json import plain
from tissuereg.report.solid import DrawnBody

#: Numbers that may change: (n, k), (n_frames, n, k), or such arrays by state and by case.
Moving = FloatArray | Sequence[Sequence[FloatArray]]


class Look(NamedTuple):
    """Constants of the view.

    `step_mm`: resolution to which places may be rounded; `behind`: opacity of signs on the far side; `size`: radius of
    a sign, pixels; `yaw`, `pitch`: first direction of view, radian; `arrow`: longest arrow that grows, over the body.
    """

    step_mm: float = 0.001
    behind: float = 0.35
    size: float = 3.5
    yaw: float = -0.6
    pitch: float = 0.35
    arrow: float = 0.16


LOOK = Look()


@dataclass(frozen=True, eq=False, kw_only=True)
class Signs:
    """Signs of one kind, with an entry in the legend that shows or hides them.

    `kind`: what is drawn; `title`: of the legend; `colour`: one, or one for each state; `places` (n, 3): mm, NaN hides
    a sign; `by`: of arrows vectors (n, 3), of lines their other ends (n, 3), mm, of ellipsoids three half-axes (n, 9),
    mm; `names`: shown at the pointer, and as `labels`; `told`: further text at the pointer; `shape`, `size`: of points;
    `states`: those in which it is drawn, empty for all; `grow`: arrows are scaled so that the longest is this share of
    the body; `rms`: words before the root mean square of arrows; `behind`: opacity on the far side.
    """

    kind: Literal["points", "arrows", "lines", "ellipsoids"]
    title: str
    colour: str | Sequence[str]
    places: Moving
    by: Moving | None = None
    names: Sequence[str] = ()
    told: Sequence[str] = ()
    labels: bool = False
    shape: Literal["dot", "ring", "cross", "plus", "square"] = "dot"
    size: float = LOOK.size
    width: float = 1.6
    dashed: bool = False
    states: Sequence[int] = ()
    shown: bool = True
    grow: float = 0.0
    unit: str = "mm"
    rms: str = ""
    behind: float = LOOK.behind

    def to_json(self) -> dict[str, Any]:
        """Return the layer as plain values, numbers packed."""
        own = {name: getattr(self, name) for name in self.__dataclass_fields__ if name not in ("places", "by")}
        by = None if self.by is None else moving(self.by)
        return {**own, "places": moving(self.places), "by": by}


class Paint(NamedTuple):
    """A colouring of the body by `values` (n_drawn,), or by its displacement at the moment; ends at `top`.

    `over`: whether values beyond `top` exist; neither values nor `moved`: the patches' colours.
    """

    title: str
    unit: str = ""
    values: FloatArray | None = None
    moved: bool = False
    top: float = 1.0
    over: bool = False


class ShownCase(NamedTuple):
    """A sequence of frames: name, times (n_frames,), s, and perhaps a sentence for each frame."""

    name: str
    times: Sequence[float]
    said: Sequence[str] | None = None


@dataclass(frozen=True, eq=False, kw_only=True)
class ViewScene:
    """All that a view shows.

    `body`: its surface at rest; `modes` (k, n_drawn, 3): displacements, mm, of which the body at a moment is moved by a
    sum with `weights` (1, k), (n_frames, 1, k), or such by state and case; `patches`: names and colours of the numbers
    in `body.patch`; `states`: names between which to switch; `cases`: with frames; `clock`: name of the slider through
    frames that can be played; `start`: state, case, frame and number of the paint at first; `opacity`: of the body at
    first; `axes`: names of the axes.
    """

    title: str
    body: DrawnBody
    layers: Sequence[Signs] = ()
    modes: FloatArray | None = None
    weights: Moving | None = None
    patches: Sequence[tuple[str, str]] = ()
    paints: Sequence[Paint] = ()
    states: Sequence[str] = ()
    cases: Sequence[ShownCase] = ()
    clock: str = ""
    start: Sequence[int] = (0, 0, 0, 0)
    opacity: float = 0.85
    outline: bool = False
    outline_title: str = "outline before"
    axes: Sequence[str] = ("x", "y", "z")
    aim: tuple[float, float] = field(default=(LOOK.yaw, LOOK.pitch))

    def to_json(self) -> dict[str, Any]:
        """Return the scene as plain values, numbers packed: what ``viewer.js`` reads."""
        state, case, frame, paint = self.start
        own = ("title", "states", "clock", "opacity", "outline", "outline_title", "axes")
        return {
            "schema": "tissuereg.scene/1",
            **{name: getattr(self, name) for name in own},
            "body": {
                "nodes": packed(self.body.nodes),
                "triangles": packed(self.body.triangles),
                "patch": packed(self.body.patch),
                "modes": None if self.modes is None else packed(self.modes),
                "weights": None if self.weights is None else moving(self.weights),
            },
            "patches": [{"name": name, "colour": colour} for name, colour in self.patches],
            "paints": [
                {**one._asdict(), "values": None if one.values is None else packed(one.values)} for one in self.paints
            ],
            "layers": [layer.to_json() for layer in self.layers],
            "cases": [one._asdict() for one in self.cases],
            "start": {"state": state, "case": case, "frame": frame, "paint": paint}
            | {"yaw": self.aim[0], "pitch": self.aim[1], "opacity": self.opacity},
        }


def packed(values: npt.ArrayLike) -> dict[str, Any]:
    """Return an array as its shape and base64 text, little-endian.

    Whole numbers as u2 or u4; others as i2 in units of ``by`` where that resolves 1 um (of lengths in mm), -32768 for
    NaN, else as f4.
    """
    given = np.asarray(values)
    by, largest = 1.0, float(np.nanmax(np.abs(given), initial=0.0)) if np.isfinite(given).any() else 0.0
    if given.dtype.kind in "iu":
        kind = "u2" if largest < 2**16 else "u4"
    elif largest / 32767.0 <= LOOK.step_mm:
        kind, by = "i2", max(largest, 1e-30) / 32767.0
        given = np.where(np.isfinite(given), np.rint(given / by), -32768)
    else:
        kind = "f4"
    text = base64.b64encode(np.ascontiguousarray(given, dtype=f"<{kind}").tobytes()).decode("ascii")
    return {"as": kind, "by": by, "shape": list(given.shape), "data": text}


def moving(values: Moving) -> list[list[dict[str, Any]]]:
    """Return numbers that may change, packed, by state and by case, each (n_frames, n, k)."""
    given = [[values]] if isinstance(values, np.ndarray) else values
    return [[packed(one if one.ndim == 3 else one[None]) for one in cases] for cases in given]


def script_text(value: Any) -> str:
    """Return a value as JSON that is safe inside a script element, whatever its strings contain."""
    text = json.dumps(plain(value), separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def viewer(scene: ViewScene) -> str:
    """Return the element of a page that shows a scene; the page needs `viewer_script` once, after all of them."""
    data, coarse = script_text(scene.to_json()), scene.body.words
    return (
        "<p class='hint'>Drag to turn, two fingers or + and - to zoom, shift and drag to move; point at a sign or at "
        f"the surface for its numbers. {coarse}</p>"
        "<div class='viewer'><noscript>The body can be turned where scripts are allowed.</noscript>"
        f"<script type='application/json'>{data}</script></div>"
    )


def viewer_script() -> str:
    """Return the script that brings the viewers of a page to life, as HTML."""
    return f"<script>\n{Path(__file__).with_name('viewer.js').read_text(encoding='utf-8')}</script>"


def framed(page: str, height: int) -> str:
    """Return a whole HTML page as a frame inside another page, such as a notebook; `height` in pixels."""
    text = html.escape(page, quote=True)
    return f"<iframe srcdoc='{text}' width='100%' height='{height}' style='border:0' sandbox='allow-scripts'></iframe>"


def top_of(values: FloatArray, share: float = 1.0) -> float:
    """Return a number of two digits that is not less than that `share` of some values."""
    largest = float(np.quantile(values, share)) if values.size else 0.0
    if not largest > 0.0:
        return 1.0
    digit = 10.0 ** (np.floor(np.log10(largest)) - 1)
    return float(np.ceil(largest / digit - 1e-9) * digit)
