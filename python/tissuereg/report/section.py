"""Sections of a deformed body through a target: outlines before and after, the region, the image under them."""

import base64
import struct
import zlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg._base.choices import Frame
from tissuereg._base.provenance import warn
from tissuereg.errors import ArgumentError
from tissuereg.imaging.images import Grid, read_image
from tissuereg.imaging.warp import section_of
from tissuereg.io.points import turned
from tissuereg.report import svg
from tissuereg.report.inset import round_length
from tissuereg.report.markup import escape
from tissuereg.report.scene import BEFORE

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration
    from tissuereg.registration.target import Region, Target


class Cuts(NamedTuple):
    """Constants of sections.

    `targets`: that are cut at most; `pixels`: of an image along a side; `border`: of the picture over the body's
    extent; `side`: of a picture, pixels; `dark`, `light`: shares of an image's values that are drawn black and white.
    """

    targets: int = 6
    pixels: int = 220
    border: float = 0.06
    side: float = 360.0
    dark: float = 0.01
    light: float = 0.99
    near: float = 5.0
    least: float = 0.15


CUTS = Cuts()

#: Colour of the registered outline and of the region.
_BODY, _REGION = "#0072b2", "#d6218f"


@dataclass(frozen=True, eq=False)
class CutPlane:
    """A plane through a place, as it is looked at: `name`; `right`, `down` (3,): unit vectors; `edges`: their names."""

    name: str
    right: FloatArray
    down: FloatArray
    edges: tuple[str, str, str, str]  # left, right, top, bottom

    @property
    def across(self) -> FloatArray:
        """Return both directions, (2, 3)."""
        return np.stack([self.right, self.down])

    @property
    def normal(self) -> FloatArray:
        """Unit normal (3,), away from the viewer."""
        return np.asarray(np.cross(self.right, self.down))


def planes(frame: Frame | None) -> list[CutPlane]:
    """Return three planes along the axes of a patient frame, as radiologists look at them, or of x, y and z."""
    if frame is None:
        x, y, z = np.eye(3)
        edges = [("-x", "+x", "+y", "-y"), ("-x", "+x", "+z", "-z"), ("-y", "+y", "+z", "-z")]
        ways = [("x, y", x, -y), ("x, z", x, -z), ("y, z", y, -z)]
    else:
        left, back, head = turned(np.eye(3), "LPS", frame)
        edges = [("R", "L", "A", "P"), ("R", "L", "S", "I"), ("A", "P", "S", "I")]
        ways = [("axial", left, back), ("coronal", left, -head), ("sagittal", back, -head)]
    return [CutPlane(name, right, down, edge) for (name, right, down), edge in zip(ways, edges, strict=True)]


class ImageUnder:
    """An image of the undeformed body, to be laid under sections of the deformed one.

    `path`: its file; `result`: the registration that moves it. Raises FormatError or ArgumentError if the file cannot
    be read, has several values a voxel or does not show the body.
    """

    def __init__(self, path: Any, result: "Registration") -> None:
        self._image, self._space = read_image(path), result.field.space
        if result.mesh.frame is None:
            warn("the mesh states no patient frame; it is taken for LPS, as images are")
        if self._image.GetNumberOfComponentsPerPixel() > 1:
            message = f"{path} must hold one value a voxel, got {self._image.GetNumberOfComponentsPerPixel()}"
            raise ArgumentError(message, where="image")
        at = Grid.of(self._image).indices(turned(result.mesh.nodes, result.mesh.frame, "LPS"))
        if not ((at >= -0.5) & (at <= np.array(self._image.GetSize()) - 0.5)).all(axis=1).any():
            message = f"{path} must show the body; none of its nodes lies there: check the frames"
            raise ArgumentError(message, where="image")

    def at(self, plane: CutPlane, corner: FloatArray, side: float) -> tuple[FloatArray, BoolArray]:
        """Return the image as it is now in a square of a plane, and what of it is inside the body.

        `corner` (3,): upper left; `side`: in mm.
        """
        frame, step = self._space.mesh.frame, side / CUTS.pixels
        steps = turned(step * np.stack([plane.right, plane.down, plane.normal]), frame, "LPS").T
        first = turned(corner + 0.5 * step * (plane.right + plane.down), frame, "LPS")
        return section_of(self._space, self._image, Grid((CUTS.pixels, CUTS.pixels, 1), first, steps))


def sections(result: "Registration", image: Any = None) -> str:
    """Return sections through the first targets, as HTML; `image`: file of an image of the undeformed body."""
    under = None if image is None else ImageUnder(image, result)
    if not result.targets:
        return ""
    chosen = list(result.targets.items())[: CUTS.targets]
    more = len(result.targets) - len(chosen)
    parts = [
        "<h2>Sections through the targets</h2><p>The registered body (blue) and the body before (orange, dashed), cut "
        "through the registered place of each target, with its 90 % region (magenta)"
        + (
            ". Below lies the image, moved with the body: it was taken before the deformation"
            if under is not None
            else ""
        )
        + ("." if more <= 0 else f". The first {len(chosen)} targets are shown, {more} more are in the table."),
    ]
    for name, target in chosen:
        parts.append(_of_target(result, name, target, under))
    return "</p>".join(parts[:1]) + "</p>" + "\n".join(parts[1:])


def _of_target(result: "Registration", name: str, target: "Target", under: ImageUnder | None) -> str:
    """Return the sections through one target, the whole body above and enlarged ones below, as HTML."""
    region = target.region(0.90)
    cuts = [_Cut(result, plane, target.mean) for plane in planes(result.mesh.frame)]
    near = max(CUTS.near * float(region.radii[-1]), CUTS.least * max(cut.side for cut in cuts))
    squares = [(cut, *cut.whole) for cut in cuts] + [(cut, np.full(2, -0.5 * near), near) for cut in cuts]
    greys: list[FloatArray | None] = [None] * len(squares)
    limits, scale = (0.0, 1.0), ""
    if under is not None:
        found = [under.at(cut.plane, cut.centre + low @ cut.plane.across, side) for cut, low, side in squares]
        within = np.concatenate([grey[inside] for grey, inside in found])
        dark, light = np.quantile(within if within.size else found[0][0], (CUTS.dark, CUTS.light))
        limits = float(dark), float(light)
        scale = f" <small>(grey from {limits[0]:.4g} to {limits[1]:.4g})</small>"
        greys = [grey for grey, _ in found]
    drawn = [
        cut.picture((low, side), name, region, None if grey is None else png(grey, limits))
        for (cut, low, side), grey in zip(squares, greys, strict=True)
    ]
    return f"<h3>{escape(name)}{scale}</h3><div class='sections'>{''.join(drawn)}</div>"


class _Cut:
    """A body before and after in one plane, in mm from the target along the plane's directions."""

    def __init__(self, result: "Registration", plane: CutPlane, centre: FloatArray) -> None:
        mesh = result.mesh
        self.plane, self.centre = plane, centre
        self.after, self.before = (
            [(loop - centre) @ plane.across.T for loop in loops(places, mesh.surface, centre, plane.normal)]
            for places in (mesh.nodes + result.displacement, mesh.nodes)
        )
        reach = np.concatenate([*self.after, *self.before, np.zeros((1, 2))])
        low, high = reach.min(axis=0), reach.max(axis=0)
        side = self.side = float((1.0 + 2.0 * CUTS.border) * max((high - low).max(), 1e-3 * mesh.extent))
        #: Upper left corner (2,) and side of the picture of the whole body, mm.
        self.whole = (0.5 * (low + high) - 0.5 * side, side)

    def picture(self, square: tuple[FloatArray, float], name: str, region: "Region", image: str | None) -> str:
        """Return the section as HTML.

        `square`: upper left corner (2,) and side of what is shown, mm; `name`: of the target; `image`: data of a PNG
        file that lies under it.
        """
        low, side = square
        scale = CUTS.side / side

        def path(lines: Sequence[FloatArray]) -> str:
            at = [(line - low) * scale for line in lines]
            return "".join("M" + "L".join(f"{x:.1f},{y:.1f}" for x, y in line) + "Z" for line in at)

        middle = -low * scale
        length = round_length(0.3 * side)
        left, right, top, bottom = self.plane.edges
        half, end = 0.5 * CUTS.side, CUTS.side
        ink = "#20262e" if image is None else "#ffffff"
        faint = f"stroke='{ink}' stroke-width='.7' opacity='.55'"
        across = f"x1='0' x2='{middle[0] - 9:.1f}' y1='{middle[1]:.1f}' y2='{middle[1]:.1f}'"
        upright = f"x1='{middle[0]:.1f}' x2='{middle[0]:.1f}' y1='0' y2='{middle[1] - 9:.1f}'"
        fill = "#dfe5ec" if image is None else "none"
        halo = "" if image is None else "font-weight='600' stroke='#000' stroke-width='2.5' paint-order='stroke'"
        parts = [
            f"<rect width='{end:g}' height='{end:g}' fill='{'#fbfcfd' if image is None else '#000'}'/>",
            "" if image is None else f"<image href='data:image/png;base64,{image}' width='{end:g}' height='{end:g}'/>",
            f"<path d='{path(self.after)}' fill='{fill}' fill-rule='evenodd' stroke='{_BODY}' stroke-width='1.8'/>",
            f"<path d='{path(self.before)}' fill='none' stroke='{BEFORE}' stroke-width='1.3' stroke-dasharray='4 3'/>",
            f"<line {across} {faint}/><line {upright} {faint}/>",
            f"<path d='{path([cut_region(region, self.plane.across)])}' fill='{_REGION}' fill-opacity='.3' "
            f"stroke='{_REGION}' stroke-width='1.6'/>",
            svg.bar(10.0, end - 12.0, length * scale, 3.0, ink, more="stroke='#000' stroke-width='.6'"),
            svg.text(10.0, end - 17.0, f"{length:g} mm", colour=ink, more=f"font-size='12' {halo}"),
            svg.text(5.0, half + 4.0, left, colour=ink, more=f"font-size='12' {halo}"),
            svg.text(end - 5.0, half + 4.0, right, "end", colour=ink, more=f"font-size='12' {halo}"),
            svg.text(half, 14.0, top, "middle", colour=ink, more=f"font-size='12' {halo}"),
            svg.text(half, end - 6.0, bottom, "middle", colour=ink, more=f"font-size='12' {halo}"),
        ]
        drawing = svg.picture(end, end, parts, f"section through {name}, {self.plane.name}")
        words = self.plane.name if side == self.side else f"{self.plane.name}, enlarged"
        return f"<figure>{drawing}<figcaption>{escape(words)}</figcaption></figure>"


def loops(places: FloatArray, surface: IntArray, centre: FloatArray, normal: FloatArray) -> list[FloatArray]:
    """Return the closed lines, each (n, 3), mm, in which a plane cuts a closed surface.

    `places` (n_nodes, 3): mm; `surface` (n, 3): corners of its triangles; `centre`, `normal` (3,): of the plane.
    """
    height = (places - centre) @ normal
    above: BoolArray = height > 0.0  # a node in the plane counts as below
    cut = surface[above[surface].any(axis=1) & ~above[surface].all(axis=1)]
    ends: dict[tuple[int, int], list[tuple[int, int]]] = {}
    for triangle in cut.tolist():
        edges = [(triangle[k], triangle[(k + 1) % 3]) for k in range(3)]
        one, other = [(min(edge), max(edge)) for edge in edges if above[edge[0]] != above[edge[1]]]
        ends.setdefault(one, []).append(other)
        ends.setdefault(other, []).append(one)
    found = []
    while ends:
        edge, line = next(iter(ends)), []
        while edge in ends:
            line.append(edge)
            edge = next((one for one in ends.pop(edge) if one in ends), edge)
        a, b = np.array(line).T
        share = (height[a] / (height[a] - height[b]))[:, None]
        found.append(np.asarray((1.0 - share) * places[a] + share * places[b]))
    return found


def cut_region(region: "Region", across: FloatArray) -> FloatArray:
    """Return the outline (n, 2), mm, in which a plane through its centre, along directions (2, 3), cuts a region."""
    along = (region.axes @ across.T) / np.maximum(region.radii, 1e-9)[:, None]
    values, vectors = np.linalg.eigh(along.T @ along)
    angles = np.linspace(0.0, 2.0 * np.pi, 61)[:-1]
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return np.asarray((circle / np.sqrt(np.maximum(values, 1e-18))) @ vectors.T)


def png(values: FloatArray, limits: tuple[float, float]) -> str:
    """Return values (rows, columns) as a grey PNG file, base64; `limits`: values that are black and white."""
    low, high = limits
    grey = np.clip(255.0 * (values - low) / max(high - low, 1e-12), 0.0, 255.0).round().astype(np.uint8)
    rows = np.concatenate([np.zeros((len(grey), 1), np.uint8), grey], axis=1).tobytes()
    head = struct.pack(">IIBBBBB", grey.shape[1], grey.shape[0], 8, 0, 0, 0, 0)
    parts = [b"\x89PNG\r\n\x1a\n"]
    for kind, data in ((b"IHDR", head), (b"IDAT", zlib.compress(rows, 9)), (b"IEND", b"")):
        parts.append(struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data)))
    return base64.b64encode(b"".join(parts)).decode("ascii")
