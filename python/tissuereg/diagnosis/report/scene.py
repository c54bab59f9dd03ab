"""What the view of a diagnosis shows: surface with its pads, residuals of markers and forces, inclusions."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.experiment.effects import Effect, Inclusion
from tissuereg.report.scene import TARGET, WRONG
from tissuereg.report.solid import DrawnBody
from tissuereg.report.svg import AFTER, BEFORE, FLOOR
from tissuereg.report.viewer import LOOK, ShownCase, Signs, ViewScene

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import BodyDiagnosis, DiagnosisDetails
    from tissuereg.diagnosis.signals import SignalLayout
    from tissuereg.experiment.experiment import Experiment

#: Number of residual vectors in a page, before and after together, at most; of longer cases every nth frame is shown.
MOST_VECTORS = 60_000

#: Colours of the free surface, of held nodes and, in turn, of pads.
_COLOURS = ("#c3cad3", "#7d858e", "#d6aa3c", "#78aa5a", "#9678be", "#5aaab4")


def scene(found: "BodyDiagnosis", details: "DiagnosisDetails", most: int = MOST_VECTORS) -> ViewScene:
    """Return what the view of a diagnosis with these details shows; `most`: number of residual vectors at most.

    Residuals, measured minus predicted, are those before and after the findings, in mm and mN, NaN = not measured.
    """
    layout, body = details.target.bench.layout, found.extended
    stride = max(1, -(-2 * sum(part.n_frames * part.n_markers for part in layout.parts) // most))
    cases = [ShownCase(part.name, np.round(part.times[::stride], 4).tolist()) for part in layout.parts]
    fits = (details.search.base, details.search.final)
    pairs = [_residuals(body, layout, fit.prediction, stride) for fit in fits]
    markers, forces = ([[pair[i] for pair in one] for one in pairs] for i in (0, 1))
    case, frame = _worst(markers[0])
    believed = details.target.bench.experiment.effects
    new = [effect for effect in body.effects if not any(effect is other for other in believed)]
    pads = [f"pad {actuator.name}" for actuator in body.actuators]
    patches = ["free surface", "held", *pads]
    return ViewScene(
        title="Residuals on the body at rest",
        body=drawn_surface(body),
        patches=[(name, _COLOURS[i if i < 2 else 2 + (i - 2) % 4]) for i, name in enumerate(patches)],
        layers=[*_body_layers(body, new), *_marker_layers(layout, new, markers), *_force_layers(body, forces)],
        states=("before", "after"),
        cases=cases,
        start=(0, case, frame, 0),
        opacity=0.6,
        axes=tuple(body.mesh.frame) if body.mesh.frame else ("x", "y", "z"),
    )


def drawn_surface(experiment: "Experiment", most: int | None = None) -> DrawnBody:
    """Return the surface of a body at rest as it is drawn; its patches: free, held, those of actuators in order."""
    mesh = experiment.mesh
    held = [boundary.nodes for boundary in experiment.boundaries] or [mesh.fixed_nodes]
    limit = {} if most is None else {"most": most}
    return DrawnBody.of(mesh, [np.concatenate(held), *(actuator.nodes for actuator in experiment.actuators)], **limit)


def _residuals(
    body: "Experiment", layout: "SignalLayout", prediction: FloatArray, stride: int
) -> list[tuple[FloatArray, FloatArray]]:
    """Return for each case the residuals of markers (n_frames, n_markers, 3) and of all pads' forces, likewise."""
    left = np.where(layout.seen, layout.measured - prediction, np.nan)
    names = [actuator.name for actuator in body.actuators]
    cases = []
    for part in layout.parts:
        forces = np.full((part.n_frames, len(names), 3), np.nan)
        forces[:, [names.index(pad) for pad in part.pads]] = part.forces(left).reshape(part.n_frames, -1, 3)
        markers = part.markers(left).reshape(part.n_frames, -1, 3)
        cases.append((markers[::stride], forces[::stride]))
    return cases


def _worst(cases: list[FloatArray]) -> tuple[int, int]:
    """Return the numbers of the case and of its frame with the largest residuals."""
    sizes = [(float(np.nansum(frame**2)), i, row) for i, case in enumerate(cases) for row, frame in enumerate(case)]
    return max(sizes)[1:] if sizes else (0, 0)


def _body_layers(body: "Experiment", new: Sequence[Effect]) -> list[Signs]:
    layers = []
    for title, colour, chosen in (("inclusion found", "#b0143c", True), ("inclusion believed", "#3c3c3c", False)):
        some = [one for one in body.effects if isinstance(one, Inclusion) and any(one is x for x in new) == chosen]
        if some:
            places = np.array([one.centre_mm for one in some])
            axes = np.array([np.diag(one.semi_axes_mm).ravel() for one in some])
            more: dict[str, Any] = {"by": axes, "names": [f"{title}: contrast {one.contrast:g}" for one in some]}
            layers.append(Signs(kind="ellipsoids", title=title, colour=colour, places=places, behind=0.8, **more))
    if body.targets:
        more = {"places": np.array(list(body.targets.values())), "names": list(body.targets), "labels": True}
        layers.append(Signs(kind="points", title="targets", colour=TARGET, behind=0.8, **more))
    return layers


def _marker_layers(layout: "SignalLayout", new: Sequence[Effect], residuals: list[list[FloatArray]]) -> list[Signs]:
    names, places = list(layout.marker_names), layout.reference
    seen = [[np.where(np.isfinite(one), places, np.nan) for one in cases] for cases in residuals]
    unseen = [[np.where(np.isfinite(one), np.nan, places) for one in cases] for cases in residuals]
    rms = "Residual of a coordinate in this frame (rms)"
    accused = sorted({name for effect in new for name in _markers_of(effect)} & set(names))
    layers = [
        Signs(kind="points", title="markers", colour="#20262e", places=seen, size=3.0),
        Signs(kind="points", title="markers not seen", colour="#7d858e", places=unseen, shape="ring"),
        _arrows("residual of a marker", colour=(BEFORE, AFTER), places=places, by=residuals, names=names, rms=rms),
    ]
    if accused:
        rows = [names.index(name) for name in accused]
        ring: dict[str, Any] = {"names": accused, "labels": True, "shape": "ring", "size": 8.0, "behind": 0.8}
        layers.append(Signs(kind="points", title="named by a finding", colour=WRONG, places=places[rows], **ring))
    return layers


def _force_layers(body: "Experiment", forces: list[list[FloatArray]]) -> list[Signs]:
    if not body.actuators:
        return []
    centres = np.array([body.mesh.nodes[body.actuator(one.name).nodes].mean(axis=0) for one in body.actuators])
    names = [actuator.name for actuator in body.actuators]
    pads: dict[str, Any] = {"places": centres, "names": names}
    layers = [Signs(kind="points", title="pads", colour="#6b5310", shape="square", labels=True, behind=0.7, **pads)]
    if any(np.isfinite(one).any() for cases in forces for one in cases):
        layers.append(_arrows("residual of a force", colour=FLOOR, by=forces, unit="mN", **pads))
    return layers


def _arrows(title: str, **more: Any) -> Signs:
    return Signs(kind="arrows", title=title, width=2.0, grow=LOOK.arrow, behind=0.6, **more)


def _markers_of(effect: Any) -> tuple[str, ...]:
    one = getattr(effect, "marker", None)
    return (one,) if one is not None else tuple(getattr(effect, "markers", ()))
