"""Contents of one view of a registration: body, markers, contacts and targets, each with its label."""

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.registration.contacts.patches import surface_of_nodes
from tissuereg.report.style import STYLE

if TYPE_CHECKING:
    from tissuereg.registration.contacts.found import FoundContact
    from tissuereg.registration.contacts.surface_fit import SurfaceFit
    from tissuereg.registration.result import Registration
    from tissuereg.registration.target import Region

#: Colours by meaning; they can be distinguished with any kind of colour vision, and signs differ in shape as well.
BEFORE, FITTED, MEASURED, WRONG = "#e07b00", "#0072b2", "black", "#d6218f"
CONTACT, TARGET, FLAGGED, REGION = "#a01c10", "black", "#6a1fb0", "#8fb3d9"


@dataclass(frozen=True, eq=False)
class Label:
    """Text of one or two lines that names a place: `place` (3,) in mm; `colour` is that of text and leader line."""

    place: FloatArray  # (3,), mm
    text: str
    colour: str  # of text and leader line


@dataclass(eq=False)
class View:
    """One 3D axes object of matplotlib with its direction of view and what labels must respect.

    `towards` (3,): unit vector from body to viewer; `labels`: labels to be written; `keep_clear`: places (3,), mm, that
    labels should not cover; `taken`: boxes (2, 2), low and high corner in figure heights, that they must not cover.
    """

    axes: Any
    towards: FloatArray  # unit vector (3,) from the body to the viewer
    labels: list[Label] = field(default_factory=list)  # filled by the functions below
    # Places (3,) that labels should not cover, filled likewise.
    keep_clear: list[FloatArray] = field(default_factory=list)
    # Corners (2, 2), lower left and upper right, in heights of the figure, of what labels must not cover.
    taken: list[FloatArray] = field(default_factory=list)


@dataclass(frozen=True, eq=False)
class Surface:
    """The surface of the registered body.

    `places` (n_nodes, 3): registered places of all nodes, mm; `normals` (n_nodes, 3): outward unit normals, zero at
    inner nodes; `nodes` (n,): indices of the surface nodes.
    """

    places: FloatArray  # of all nodes, (n_nodes, 3), mm
    normals: FloatArray  # outward unit normals of its nodes, zero inside
    nodes: Any  # of the surface, (n,)

    @classmethod
    def of(cls, result: "Registration") -> "Surface":
        """Return the registered surface of a registration; if tets are inverted, normals are of the undeformed body."""
        moved = Mesh(result.mesh.nodes + result.displacement, result.mesh.tets) if result.inverted_tets == 0 else None
        normals = surface_of_nodes(moved or result.mesh)[1]
        return cls(result.mesh.nodes + result.displacement, normals, result.mesh.surface_nodes)

    def nearest(self, place: FloatArray, where: FloatArray) -> int:
        """Return the index of the surface node whose row in `where` (n_nodes, 3), mm, is closest to `place` (3,)."""
        return int(self.nodes[np.argmin(np.linalg.norm(where[self.nodes] - place, axis=1))])


def contacts_of(result: "Registration") -> "tuple[FoundContact, ...]":
    """Return the contacts that a registration found: an empty tuple for a trained model, which finds none."""
    return getattr(result, "contacts", ())


def surface_of(result: "Registration") -> "SurfaceFit | None":
    """Return the fit to unlabelled surface points; None if there are none, as always for a trained model."""
    return getattr(result, "surface", None)


def contact_verb(contact: "FoundContact", normal: FloatArray) -> str:
    """Return "pull", "push" or "sideways" by the angle between a contact's force and the outward normal (3,).

    "pull or push" where that is not known.
    """
    if contact.sense == "pull or push":
        return contact.sense
    along = float(contact.direction @ normal)
    return "pull" if along > 0.5 else "push" if along < -0.5 else "sideways"


def draw_body(view: View, result: "Registration", surface: Surface, colours: Any) -> None:
    """Draw the faces turned to the viewer, coloured by standard deviation in mm, and faint undeformed edges."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    mesh = result.mesh
    moved = surface.places[mesh.surface]
    normals = np.cross(moved[:, 1] - moved[:, 0], moved[:, 2] - moved[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    facing = normals @ view.towards > 0.0
    faces = colours.to_rgba(result.std[mesh.surface].mean(axis=1))
    faces[:, :3] *= (0.8 + 0.2 * np.clip(normals @ view.towards, 0.0, 1.0))[:, None]
    faces[:, 3] = 0.8
    view.axes.add_collection3d(
        Poly3DCollection(moved[facing], facecolors=faces[facing], edgecolors=(1, 1, 1, 0.12), linewidths=0.2, zorder=2)
    )
    rest = mesh.nodes[mesh.surface]
    view.axes.add_collection3d(
        Poly3DCollection(rest, facecolors=(0, 0, 0, 0), edgecolors=(0.4, 0.4, 0.4, 0.10), linewidths=0.3, zorder=1)
    )


def draw_surface_points(view: View, result: "Registration") -> None:
    """Draw the measured points of the deformed surface into a view, if the registration used such points."""
    surface = surface_of(result)
    if surface is not None:
        view.axes.scatter(*surface.places.T, s=4, c=MEASURED, depthshade=False, zorder=6)


def draw_markers(view: View, result: "Registration", surface: Surface) -> None:
    """Draw each used marker before registration, registered and measured, and unused ones with name and reason."""
    fit, every = result.markers, result.all_markers
    if not len(every):
        return
    used = np.array([name in fit.residual_mm for name in every.names])
    start, measured = result.start_markers, every.measured
    residual = np.array([fit.residual_mm.get(name, np.zeros(3)) for name in every.names])
    whole = used & np.isfinite(measured).all(axis=1)
    near = np.array([surface.normals[surface.nearest(place, result.mesh.nodes)] @ view.towards > -0.1
                     for place in every.reference])  # fmt: skip
    for side, faint in ((near, 1.0), (~near, STYLE.far_alpha)):
        chosen = whole & side
        fitted = measured[chosen] - residual[chosen]
        plain: dict[str, Any] = {"depthshade": False, "alpha": faint}
        view.axes.scatter(*start[chosen].T, s=16, c=BEFORE, marker="x", zorder=6, **plain)
        view.axes.scatter(*fitted.T, s=16, c=FITTED, zorder=7, **plain)
        ring: dict[str, Any] = {"facecolors": "none", "edgecolors": MEASURED, "linewidths": 0.9}
        view.axes.scatter(*measured[chosen].T, s=44, zorder=8, **ring, **plain)
        for a, b in zip(start[chosen], measured[chosen], strict=True):
            view.axes.plot(*np.array([a, b]).T, c=BEFORE, lw=0.8, alpha=faint, zorder=5)
        view.keep_clear += [*measured[chosen], *start[chosen]]
    for index in np.flatnonzero(used & near):
        name = every.names[index]
        if any(reason.startswith(f"wrong marker: {name} ") for reason in result.trust.reasons):
            view.axes.scatter(*measured[index], s=120, facecolors="none", edgecolors=WRONG, depthshade=False, zorder=9)
            view.labels.append(Label(measured[index], f"{name}: does not fit", WRONG))
    reasons = dict(fit.dropped)
    for index in np.flatnonzero(~used):
        _draw_dropped(view, result, index, reasons[every.names[index]], 1.0 if near[index] else STYLE.far_alpha)


def _draw_dropped(view: View, result: "Registration", index: Any, reason: str, faint: float) -> None:
    """Draw the unused marker number `index` at its measured place, or at its predicted one if it was not seen."""
    name = result.all_markers.names[index]
    measured, expected = result.all_markers.measured[index], result.unseen[name].mean
    seen = bool(np.isfinite(measured).all())
    place = measured if seen else expected
    style: dict[str, Any] = {"depthshade": False, "alpha": faint, "zorder": 9, "c": WRONG if seen else "gray"}
    view.axes.scatter(*place, s=70 if seen else 40, marker="X" if seen else "$?$", **style)
    if seen:
        view.axes.plot(*np.array([place, expected]).T, c=WRONG, lw=1.0, ls=":", alpha=faint, zorder=9)
    if faint == 1.0:
        view.labels.append(Label(place, f"{name}: {reason}", WRONG if seen else "dimgray"))


def draw_contacts(view: View, result: "Registration", surface: Surface) -> None:
    """Draw every contact: the border of its patch, an arrow along the force on the body, a label with its numbers."""
    largest = max((contact.force_mN for contact in contacts_of(result)), default=0.0)
    for contact in contacts_of(result):
        node = surface.nearest(contact.centre_mm, result.mesh.nodes)
        centre, normal = surface.places[node], surface.normals[node]
        faint = 1.0 if normal @ view.towards > -0.1 else STYLE.far_alpha
        lines, corners = rim(result.mesh, surface, node, contact.radius_mm)
        _draw_rim(view, lines, surface.normals[corners].mean(axis=1))
        tail, arrow = force_arrow(contact, largest, (centre, normal), result.mesh.extent)
        view.axes.quiver(*tail, *arrow, color=CONTACT, lw=2.4, arrow_length_ratio=0.28, alpha=faint, zorder=10)
        if faint == 1.0:
            text = (
                f"{contact_verb(contact, normal)}: {contact.size_mm:.1f} mm, {contact.force_mN:,.0f} mN\n"
                f"probability {contact.probability:.2f} within about {contact.place_std_mm:.0f} mm"
            )
            view.labels.append(Label(centre, text, CONTACT))
        view.keep_clear += [tail + share * arrow for share in np.linspace(0.0, 1.0, 7)]


def force_arrow(
    contact: "FoundContact", largest: float, at: tuple[FloatArray, FloatArray], extent: float
) -> tuple[FloatArray, FloatArray]:
    """Return tail (3,) and vector (3,), mm, of the arrow of a contact's force.

    `largest`: force of the strongest contact, mN; `at`: place (3,), mm, and outward normal (3,) of its centre;
    `extent`: of the body, mm.
    """
    centre, normal = at
    share = max(STYLE.least_arrow, contact.force_mN / largest) if largest > 0.0 else STYLE.least_arrow
    arrow = STYLE.arrow * extent * share * contact.direction
    # The arrow of a pull begins at the surface, that of a push ends there.
    return (centre - arrow if contact.direction @ normal < 0.0 else centre), arrow


def rim(mesh: Mesh, surface: Surface, node: int, radius: float) -> tuple[FloatArray, IntArray]:
    """Return the border of a contact patch, of `radius` mm on the undeformed body, on the deformed surface.

    Its lines (n, 2, 3), mm, and for each the corners (n, 3) of the triangle in which it lies.
    """
    corners = mesh.surface[(surface.normals[mesh.surface] @ surface.normals[node] > 0.0).all(axis=1)]
    inside = np.linalg.norm(mesh.nodes[corners] - mesh.nodes[node], axis=2) - radius
    corners, inside = (part[(inside < 0.0).any(axis=1) & (inside > 0.0).any(axis=1)] for part in (corners, inside))
    # The corner that is alone on its side of the border; the border cuts the two edges that meet there.
    alone = np.argmax(np.where((inside < 0.0).sum(axis=1, keepdims=True) == 1, -inside, inside), axis=1)
    rows, ends = np.arange(len(corners)), []
    for step in (1, 2):
        other = (alone + step) % 3
        a, b = inside[rows, alone], inside[rows, other]
        share = (a / (a - b))[:, None]
        ends.append((1.0 - share) * surface.places[corners[rows, alone]] + share * surface.places[corners[rows, other]])
    return np.stack(ends, axis=1), corners


def _draw_rim(view: View, lines: FloatArray, normals: FloatArray) -> None:
    """Draw the border of a contact patch: lines (n, 2, 3), mm, with the directions (n, 3) in which they face."""
    from mpl_toolkits.mplot3d.art3d import Line3DCollection

    facing = normals @ view.towards > 0.0
    for side, faint in ((facing, 1.0), (~facing, STYLE.far_alpha)):
        if side.any():
            view.axes.add_collection3d(Line3DCollection(lines[side], colors=CONTACT, lw=1.5, alpha=faint, zorder=4))


def draw_targets(view: View, result: "Registration") -> None:
    """Draw every target with the ellipsoid of its 90 % region, dashed if the markers do not constrain the target."""
    many = len(result.targets) > STYLE.labels
    for name, target in result.targets.items():
        region, flagged = target.region(0.90), target.flag is not None
        colour = FLAGGED if flagged else TARGET
        _draw_region(view, region, colour, "--" if flagged else "-")
        view.axes.scatter(*region.centre, s=34, marker="+", c=colour, depthshade=False, zorder=12)
        view.keep_clear.append(region.centre)
        if flagged or not many:
            view.labels.append(Label(region.centre, f"{name}: {target.flag}" if flagged else name, colour))


def _draw_region(view: View, region: "Region", colour: str, style: str) -> None:
    """Draw an ellipsoid by the three ellipses that contain two of its half-axes; `style`: line style of matplotlib."""
    angles = np.linspace(0.0, 2.0 * np.pi, 41)[:, None]
    along = region.radii[:, None] * region.axes
    for a, b in ((0, 1), (0, 2), (1, 2)):
        ellipse = region.centre + np.cos(angles) * along[a] + np.sin(angles) * along[b]
        view.axes.plot(*ellipse.T, c=colour, lw=1.1, ls=style, zorder=11)
