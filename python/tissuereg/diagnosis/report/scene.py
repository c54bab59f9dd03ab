"""Data of the three-dimensional view as one JSON: surface, markers with residuals, forces, inclusions."""

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.experiment.effects import Inclusion
from tissuereg.experiment.experiment import Experiment
from tissuereg.io.json import plain

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import Diagnosis
    from tissuereg.diagnosis.search import Search
    from tissuereg.diagnosis.signals import CasePart, SignalLayout
    from tissuereg.experiment.experiment import Experiment

#: Number of residual vectors in a page, before and after together, at most; of longer cases every nth frame is shown.
MOST_VECTORS = 60_000


def scene(found: "Diagnosis", most: int = MOST_VECTORS) -> dict[str, Any]:
    """Return the data of the three-dimensional view of a diagnosis, of JSON's types.

    `found`: the diagnosis, with its details; `most`: number of residual vectors at most. The entries are the drawn
    surface, pads, markers, targets and inclusions, and for each case the residuals (measured minus predicted) before
    and after the findings. Lengths are in micrometres, forces in mN, None = not measured.
    """
    layout, search = found.details["layout"], found.details["search"]
    body = found.extended
    surface = drawn_surface(body)
    vectors = 2 * sum(part.n_frames * part.n_markers for part in layout.parts)
    stride = max(1, -(-vectors // most))
    cases = [_case(layout, search, part, stride) for part in layout.parts]
    return {
        "nodes": _micrometres(surface.nodes),
        "triangles": surface.triangles.ravel().tolist(),
        "patch": surface.patch.tolist(),
        "pads": [_pad(body, actuator.name) for actuator in body.actuators],
        "markers": {"names": list(layout.marker_names), "places": _micrometres(layout.reference)},
        "named": sorted({name for effect in _new(found) for name in _markers_of(effect)}),
        "targets": [{"name": name, "place": _micrometres(place)} for name, place in body.targets.items()],
        "inclusions": [
            {
                "centre": _micrometres(np.array(effect.centre_mm)),
                "axes": _micrometres(np.array(effect.semi_axes_mm)),
                "contrast": effect.contrast,
                "found": any(effect is other for other in _new(found)),
            }
            for effect in body.effects
            if isinstance(effect, Inclusion)
        ],
        "cases": cases,
        "start": _worst(cases),
    }


def script_text(value: dict[str, Any]) -> str:
    """Return a value as JSON that is safe inside a script element, whatever its strings contain."""
    text = json.dumps(plain(value), separators=(",", ":"), allow_nan=False)
    return text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")


def _case(layout: "SignalLayout", search: "Search", part: "CasePart", stride: int) -> dict[str, Any]:
    rows = slice(None, None, stride)
    case: dict[str, Any] = {"name": part.name, "times": np.round(part.times[rows], 4).tolist(), "pads": list(part.pads)}
    for when, fit in (("before", search.base), ("after", search.final)):
        residual = np.where(layout.seen, layout.measured - fit.prediction, np.nan)
        case[when] = _micrometres(part.markers(residual)[rows])
        case[f"forces_{when}"] = _plain(np.round(part.forces(residual)[rows], 2))
    return case


def _pad(body: "Experiment", name: str) -> dict[str, Any]:
    nodes = body.mesh.nodes[body.actuator(name).nodes]
    return {"name": name, "centre": _micrometres(nodes.mean(axis=0)), "nodes": _micrometres(nodes)}


def _worst(cases: list[dict[str, Any]]) -> list[int]:
    """Return the numbers of the case and of its frame with the largest residuals of markers before the findings."""
    sizes = [
        (sum(x * x for x in frame if x is not None), number, row)
        for number, case in enumerate(cases)
        for row, frame in enumerate(_rows(case["before"], len(case["times"])))
    ]
    return list(max(sizes)[1:]) if sizes else [0, 0]


def _rows(flat: list[Any], count: int) -> list[list[Any]]:
    width = len(flat) // max(count, 1)
    return [flat[i * width : (i + 1) * width] for i in range(count)]


def _new(found: "Diagnosis") -> tuple[Any, ...]:
    """Return the effects that the diagnosis added to the believed model."""
    target = found.details.get("target")
    believed = () if target is None else target.bench.experiment.effects
    return tuple(effect for effect in found.extended.effects if not any(effect is other for other in believed))


def _markers_of(effect: Any) -> tuple[str, ...]:
    one = getattr(effect, "marker", None)
    return (one,) if one is not None else tuple(getattr(effect, "markers", ()))


def _micrometres(places: FloatArray) -> list[int | None]:
    """Return lengths in mm of any shape as a flat list of whole micrometres, None where not finite.

    Whole micrometres make short text, and are far below any noise.
    """
    flat = np.asarray(places, np.float64).ravel()
    return [round(1000.0 * x) if np.isfinite(x) else None for x in flat.tolist()]


def _plain(values: FloatArray) -> list[float | None]:
    return [x if np.isfinite(x) else None for x in values.ravel().tolist()]


#: Number of triangles, at most; larger surfaces are coarsened.
MOST_TRIANGLES = 12_000


@dataclass(frozen=True, eq=False)
class PatchedSurface:
    """The triangles of a surface, each with the number of its patch.

    `nodes` (n, 3): mm; `triangles` int64 (m, 3): with outward normals; `patch` int64 (m,): 0 is the free surface, 1
    held nodes, 2 and above the actuators in their order.
    """

    nodes: FloatArray
    triangles: IntArray
    patch: IntArray


def drawn_surface(experiment: Experiment, most: int = MOST_TRIANGLES) -> PatchedSurface:
    """Return the surface of a body at rest, coarse enough to be drawn.

    `experiment`: with the body and its patches; `most`: number of triangles at most. Nodes are merged on coarser and
    coarser grids until there are few enough triangles.
    """
    mesh = experiment.mesh
    patch = np.zeros(len(mesh.surface), np.int64)
    held = [boundary.nodes for boundary in experiment.boundaries] or [mesh.fixed_nodes]
    for number, nodes in [
        *((1, nodes) for nodes in held),
        *((2 + i, actuator.nodes) for i, actuator in enumerate(experiment.actuators)),
    ]:
        patch[np.isin(mesh.surface, nodes).all(axis=1)] = number
    used, triangles = np.unique(mesh.surface, return_inverse=True)
    found = PatchedSurface(mesh.nodes[used], triangles.reshape(-1, 3), patch)
    width = mesh.extent / 80.0
    while len(found.triangles) > most:
        found = _joined(found, width)
        width *= 1.25
    return found


def _joined(surface: PatchedSurface, width: float) -> PatchedSurface:
    """Return the surface with all nodes in a grid cell, a cube of edge `width` mm, replaced by their mean."""
    cells = np.floor((surface.nodes - surface.nodes.min(axis=0)) / width).astype(np.int64)
    _, group = np.unique(cells, axis=0, return_inverse=True)
    group = group.reshape(-1)
    count = np.bincount(group)
    nodes = np.stack([np.bincount(group, surface.nodes[:, axis]) / count for axis in range(3)], axis=1)
    triangles = group[surface.triangles]
    whole = (np.diff(np.sort(triangles, axis=1), axis=1) > 0).all(axis=1)
    return PatchedSurface(nodes, triangles[whole], surface.patch[whole])
