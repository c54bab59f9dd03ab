"""A body as it is given: its node sets, what holds it, markers and targets, as a page with the body to turn."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.locate import held_by, surface_of
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.report import scene
from tissuereg.report.markup import document, escape, table
from tissuereg.report.registered import PATCHES, axes_of
from tissuereg.report.solid import FINENESS, DrawnBody
from tissuereg.report.viewer import Paint, Signs, ViewScene, viewer, viewer_script
from tissuereg.report.words import counted

#: Colours of node sets that hold nothing, in turn.
_OTHERS = ("#d6aa3c", "#78aa5a", "#9678be", "#5aaab4", "#c9826b", "#a8a05a")

#: Colours of the sets that hold a body.
_HOLDS = dict(zip(("", "fixed", "perhaps_fixed"), (colour for _, colour in PATCHES), strict=True))


@dataclass(frozen=True, eq=False)
class GivenBody:
    """A body with what was given for it.

    `mesh`: with node sets; `markers`: where they sit; `targets`: inner points (3,), mm, by name.
    """

    mesh: Mesh
    markers: Markers | None = None
    targets: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def _points(self) -> tuple[list[str], FloatArray]:
        markers = {} if self.markers is None else dict(zip(self.markers.names, self.markers.reference, strict=True))
        return [*markers, *self.targets], np.array([*markers.values(), *self.targets.values()]).reshape(-1, 3)

    def found(self) -> dict[str, Any]:
        """Return numbers of nodes and tets, of nodes in every set, where markers and targets lie: values of JSON."""
        names, places = self._points
        inside = held_by(self.mesh, places)[2].tolist()
        away = surface_of(self.mesh).find(places).distances.tolist()
        where = [{"from_surface_mm": gap, "inside": within} for gap, within in zip(away, inside, strict=True)]
        n_markers = 0 if self.markers is None else len(self.markers)
        return {
            "nodes": self.mesh.n_nodes,
            "tets": self.mesh.n_tets,
            "surface_triangles": len(self.mesh.surface),
            "extent_mm": np.ptp(self.mesh.nodes, axis=0).tolist(),
            "volume_mm3": float(self.mesh.volumes.sum()),
            "frame": self.mesh.frame,
            "node_sets": {name: len(nodes) for name, nodes in self.mesh.node_sets.items()},
            "markers": dict(zip(names[:n_markers], where, strict=False)),
            "targets": dict(zip(names[n_markers:], where[n_markers:], strict=True)),
        }

    def scene(self, most: int = FINENESS.triangles) -> ViewScene:
        """Return what the view shows; `most`: number of triangles at most."""
        mesh = self.mesh
        # Of triangles in several sets those that hold the body are drawn last, and win.
        order = sorted(mesh.node_sets, key=lambda name: (name in _HOLDS, name == "fixed"))
        free = (name for name in order if name not in _HOLDS)
        colours = {**{name: _OTHERS[i % len(_OTHERS)] for i, name in enumerate(free)}, **_HOLDS}
        return ViewScene(
            title="The body",
            body=DrawnBody.of(mesh, [mesh.node_sets[name] for name in order], most),
            patches=[PATCHES[0], *((name, colours[name]) for name in order)],
            paints=[Paint("node sets")],
            layers=[
                *(self._set(name, colours[name]) for name in mesh.node_sets if len(mesh.node_sets[name])),
                *self._signs(),
            ],
            opacity=0.9,
            axes=axes_of(mesh),
        )

    def _set(self, name: str, colour: str) -> Signs:
        nodes = self.mesh.node_sets[name]
        places = self.mesh.nodes[nodes[:: -(-len(nodes) // FINENESS.nodes)]]
        title = f"{name}: {counted(len(nodes), 'node')}"
        look: dict[str, Any] = {"shape": "square", "size": 1.7, "shown": name in _HOLDS, "behind": 0.25}
        return Signs(kind="points", title=title, colour=colour, places=places, **look)

    def _signs(self) -> list[Signs]:
        found, layers = self.found(), []
        given = () if self.markers is None else self.markers.names
        for title, names, colour, shape in (
            ("marker", given, scene.MEASURED, "ring"),
            ("target", tuple(self.targets), scene.TARGET, "plus"),
        ):
            if not names:
                continue
            every, places = self._points
            rows = [every.index(name) for name in names] if title == "marker" else slice(len(given), None)
            told = [lies(one) for one in found[f"{title}s"].values()]
            look: dict[str, Any] = {"shape": shape, "size": 5.0, "names": names, "told": told, "labels": True}
            layers.append(Signs(kind="points", title=title, colour=colour, places=places[rows], behind=0.7, **look))
        return layers


def shown_page(given: GivenBody, title: str) -> str:
    """Return the page of a body, HTML; `title`: plain text."""
    found = given.found()
    size = " x ".join(f"{x:.4g}" for x in found["extent_mm"])
    held = found["node_sets"].get("fixed", 0)
    words = (
        f"{found['nodes']:,} nodes, {found['tets']:,} tetrahedra, {size} mm, {found['volume_mm3'] / 1000.0:.4g} ml"
        f"{'' if found['frame'] is None else ', patient frame ' + found['frame']}. "
        + (f"{counted(held, 'node')} in the set 'fixed'." if held else "No node is held: there is no set 'fixed'.")
    )
    parts = [
        f"<h1>{escape(title)}</h1><p class='{'yes' if held else 'no'}'>{words}</p>{viewer(given.scene())}",
        _listed("Node sets", ("set", "nodes"), [(name, f"{n:,}") for name, n in found["node_sets"].items()]),
        *(
            _listed(title, (title[:-1].lower(), "lies"), [(name, lies(one)) for name, one in found[key].items()])
            for title, key in (("Markers", "markers"), ("Targets", "targets"))
        ),
        viewer_script(),
    ]
    return document(title, parts)


def lies(one: Mapping[str, Any]) -> str:
    """Return where a point lies in words; `one`: its entry in `GivenBody.found`."""
    way = "inside the body" if one["inside"] else "outside the body"
    return f"{one['from_surface_mm']:.2f} mm from the surface, {way}"


def _listed(title: str, head: tuple[str, ...], rows: list[tuple[str, str]]) -> str:
    if not rows:
        return ""
    return f"<h2>{title}</h2>{table(head, [(escape(name), escape(said)) for name, said in rows])}"
