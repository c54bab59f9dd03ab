"""What the view of a registration shows: the body before and after, markers, targets with regions, contacts."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.report import scene
from tissuereg.report.solid import FINENESS, DrawnBody
from tissuereg.report.viewer import Paint, Signs, ViewScene, top_of
from tissuereg.report.words import counted

if TYPE_CHECKING:
    from tissuereg.body.mesh import Mesh
    from tissuereg.registration.result import Registration
    from tissuereg.registration.target import Target

#: Names and colours of the surface's patches.
PATCHES = (("free surface", "#c3cad3"), ("held", "#59626c"), ("perhaps held", "#c9a25a"))


def registered_scene(result: "Registration", most: int = FINENESS.triangles, *, spread: bool = True) -> ViewScene:
    """Return what the view of a registration shows.

    `most`: number of triangles at most; `spread`: whether the nodes' deviations can be shown, which must be computed.
    """
    supports = result.body.supports
    body = DrawnBody.of(result.mesh, [supports.sure, supports.perhaps], most)
    moved = body.field(result.displacement)
    size = np.linalg.norm(moved, axis=1)
    paints = [Paint("displacement", "mm", size, top=top_of(size))]
    if spread:
        std = body.field(result.std)
        name = "spread (standard deviation of a node)"
        paints.append(Paint(name, "mm", std, top=top_of(std, 0.99), over=True))
    return ViewScene(
        title="The registered body",
        body=body,
        modes=moved[None],
        weights=[[np.zeros((1, 1))], [np.ones((1, 1))]],
        patches=PATCHES,
        paints=[*paints, Paint("supports")],
        states=("before", "registered"),
        start=(1, 0, 0, 0),
        outline=True,
        layers=[
            *held_layers(result.mesh, (supports.sure, supports.perhaps), result.displacement),
            *_contacts(result),
            *_surface_points(result),
            *_markers(result),
            *_dropped(result),
            *_targets(result),
        ],
        axes=axes_of(result.mesh),
    )


def axes_of(mesh: "Mesh") -> tuple[str, ...]:
    """Return the names of a mesh's axes: the directions of the patient if its frame is known."""
    return tuple(mesh.frame) if mesh.frame else ("x", "y", "z")


def held_layers(
    mesh: "Mesh", sets: tuple[IntArray, IntArray], displacement: FloatArray | None = None, *, shown: bool = False
) -> list[Signs]:
    """Return the nodes that are held, and those that perhaps are (node numbers), before and after a displacement."""
    layers = []
    for nodes, (name, colour) in zip(sets, PATCHES[1:], strict=True):
        if len(nodes):
            some = nodes[:: -(-len(nodes) // FINENESS.nodes)]
            rest = mesh.nodes[some]
            places = rest if displacement is None else [[rest], [rest + displacement[some]]]
            title = f"{name}: {counted(len(nodes), 'node')}"
            layers.append(
                Signs(kind="points", title=title, colour=colour, places=places, shape="square", size=1.6, shown=shown)
            )
    return layers


def target_layers(
    names: Sequence[str],
    regions: tuple[FloatArray, FloatArray, BoolArray],
    states: Sequence[int] = (),
    told: Sequence[str] = (),
) -> list[Signs]:
    """Return registered targets: places with names, and the ellipsoids of their 90 % regions.

    `regions`: places (n_frames, n, 3), half-axes (n_frames, n, 9), mm, and whether no marker tells (n_frames, n);
    `states`: in which they are drawn; `told`: text for each.
    """
    places, axes, flagged = regions
    layers = []
    for title, colour, region, chosen in (
        ("target", scene.TARGET, "#1f5fa8", ~flagged),
        ("target, no marker tells", scene.FLAGGED, scene.FLAGGED, flagged),
    ):
        if not chosen.any():
            continue
        at = np.where(chosen[..., None], places, np.nan)
        both: dict[str, Any] = {"places": at, "states": states, "behind": 0.8}
        edge: dict[str, Any] = {"kind": "ellipsoids", "colour": region, "by": axes, "dashed": region == colour}
        sign: dict[str, Any] = {"kind": "points", "colour": colour, "shape": "plus", "size": 5.0, "labels": True}
        layers += [
            Signs(title=f"{title}: 90 % region", **edge, **both),
            Signs(title=title, names=names, told=told, **sign, **both),
        ]
    return layers


def half_axes(target: "Target") -> FloatArray:
    """Return the three half-axes of a target's 90 % region, one after the other, (9,), mm."""
    region = target.region(0.90)
    return np.asarray((region.radii[:, None] * region.axes).ravel())


def _targets(result: "Registration") -> list[Signs]:
    if not result.targets:
        return []
    told = []
    for target in result.targets.values():
        radii = " x ".join(f"{x:.2f}" for x in target.region(0.90).radii)
        moved = float(np.linalg.norm(target.mean - target.reference))
        told.append(f"moved {moved:.2f} mm; 90 % region with half-axes {radii} mm")
    targets = list(result.targets.values())
    places, axes = np.array([one.mean for one in targets]), np.array([half_axes(one) for one in targets])
    flagged = np.array([one.flag is not None for one in targets])
    before: dict[str, Any] = {"kind": "points", "colour": scene.BEFORE, "shape": "cross", "behind": 0.8}
    before["names"] = list(result.targets)
    layers = target_layers(before["names"], (places[None], axes[None], flagged[None]), (1,), told)
    simulated = [one.simulation for one in targets if one.simulation is not None]
    if len(simulated) == len(targets):
        layers.append(Signs(title="target, simulated", places=np.array(simulated), states=(1,), **before))
    rest = np.array([one.reference for one in targets])
    layers.append(Signs(title="target before", places=rest, states=(0,), labels=True, **before))
    return layers


def _markers(result: "Registration") -> list[Signs]:
    """Return the markers that were used: where they were, where they were measured, and where the body has them."""
    fit, every = result.markers, result.all_markers
    rows = [i for i, name in enumerate(every.names) if name in fit.residual_mm]
    if not rows:
        return []
    names = [every.names[i] for i in rows]
    residual = np.array([fit.residual_mm[name] for name in names])
    start, measured = result.start_markers[rows], every.measured[rows]
    sizes = np.linalg.norm(residual, axis=1)
    said = [
        f"{'inside the body' if name in fit.inner else 'on the skin'}; "
        + (f"{size:.2f} mm from the registered body" if np.isfinite(size) else "not seen along every axis")
        for name, size in zip(names, sizes, strict=True)
    ]
    title = "marker, simulated" if result.starts_simulated else "marker before"
    after: dict[str, Any] = {"kind": "points", "states": (1,)}
    motion: dict[str, Any] = {"places": start, "by": measured, "states": (1,), "width": 1.2}
    ring: dict[str, Any] = {"places": measured, "shape": "ring", "size": 5.0, "names": names, "told": said}
    layers = [
        Signs(kind="lines", title="motion of a marker", colour=scene.BEFORE, **motion),
        Signs(kind="points", title=title, colour=scene.BEFORE, places=start, shape="cross", names=names),
        Signs(title="marker, registered", colour=scene.FITTED, places=measured - residual, size=3.0, **after),
        Signs(title="marker, measured", colour=scene.MEASURED, **ring, **after),
    ]
    wrong = [i for i, name in enumerate(names) if _is_wrong(result, name)]
    if wrong:
        named = [f"{names[i]}: does not fit" for i in wrong]
        circle: dict[str, Any] = {"shape": "ring", "size": 9.0, "width": 2.2, "labels": True, "names": named}
        layers.append(Signs(title="does not fit", colour=scene.WRONG, places=measured[wrong], **circle, **after))
    return layers


def _is_wrong(result: "Registration", name: str) -> bool:
    return any(reason.startswith(f"wrong marker: {name} ") for reason in result.trust.reasons)


def _dropped(result: "Registration") -> list[Signs]:
    """Return the markers that were not used: those measured, and where those not seen must be."""
    every, layers = result.all_markers, []
    row = {name: i for i, name in enumerate(every.names)}
    seen = [(name, why) for name, why in result.markers.dropped if np.isfinite(every.measured[row[name]]).all()]
    lost = [(name, why) for name, why in result.markers.dropped if (name, why) not in seen]
    for title, colour, shape, some in (
        ("marker not used", scene.WRONG, "cross", seen),
        ("not seen: where it must be", "#59626c", "ring", lost),
    ):
        if some:
            must = np.array([result.unseen[name].mean for name, _ in some])
            places = must if some is lost else every.measured[[row[name] for name, _ in some]]
            names = [f"{name}: {why}" for name, why in some]
            sign: dict[str, Any] = {"shape": shape, "size": 5.0, "width": 2.2, "labels": some is seen}
            layers.append(
                Signs(kind="points", title=title, colour=colour, places=places, names=names, states=(1,), **sign)
            )
    return layers


def _surface_points(result: "Registration") -> list[Signs]:
    fit = scene.surface_of(result)
    if fit is None:
        return []
    places = fit.places[:: max(1, -(-len(fit.places) // FINENESS.nodes))]
    return [Signs(kind="points", title="surface points", colour=scene.MEASURED, places=places, size=1.4, states=(1,))]


def _contacts(result: "Registration") -> list[Signs]:
    """Return every contact: the border of its patch, and an arrow along the force on the body."""
    found = scene.contacts_of(result)
    if not found:
        return []
    surface = scene.Surface.of(result)
    largest = max(contact.force_mN for contact in found)
    rims, tails, arrows, names, told = [], [], [], [], []
    for contact in found:
        node = surface.nearest(contact.centre_mm, result.mesh.nodes)
        at = (surface.places[node], surface.normals[node])
        tail, arrow = scene.force_arrow(contact, largest, at, result.mesh.extent)
        rims.append(scene.rim(result.mesh, surface, node, contact.radius_mm)[0])
        tails.append(tail)
        arrows.append(arrow)
        names.append(f"{scene.contact_verb(contact, at[1])} {contact.force_mN:,.0f} mN")
        told.append(
            f"surface moved by {contact.size_mm:.1f} mm; probability {contact.probability:.2f} within about "
            f"{contact.place_std_mm:.0f} mm"
        )
    border = np.concatenate(rims)
    same: dict[str, Any] = {"colour": scene.CONTACT, "states": (1,)}
    return [
        Signs(kind="lines", title="contact: its patch", places=border[:, 0], by=border[:, 1], **same),
        Signs(
            kind="arrows",
            title="contact: force on the body",
            places=np.array(tails),
            by=np.array(arrows),
            names=names,
            told=told,
            labels=True,
            width=2.6,
            behind=0.6,
            **same,
        ),
    ]
