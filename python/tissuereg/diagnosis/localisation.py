"""Localisation of an unexplained residual: the component of the rig or model near which it is largest.

Every marker, pad, support and case, and the body as a whole, is a hypothesis with one parameter ``a``: the reduced
residual has the variance ``1 + a w`` instead of 1, where the weight ``w``, 0 to 1, is the proximity of a measured
number to the component. The component with the largest gain in log likelihood, maximised over ``a``, minus the
logarithm of the number of components of its kind, is the one to check.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.diagnosis.answer import to_check
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.discrepancy import largest_residuals, worst_frame
from tissuereg.diagnosis.screen import UNKNOWN
from tissuereg.diagnosis.settings import DEFAULT, AdviceSettings
from tissuereg.diagnosis.signals import SignalLayout


@dataclass(frozen=True, eq=False)
class RigComponent:
    """A component of the rig or of the model that can be checked.

    `kind`: ``marker``, ``pad``, ``support``, ``case`` or ``body``; `name`: its name in the experiment; for the body the
    name of its elements; `proximity` (size,): how near every measured number is to the component, 0 to 1.
    """

    kind: str
    name: str
    proximity: FloatArray


#: The advised action for a component of each kind.
_ACTIONS = {
    "marker": "check marker {name}: that it is firmly attached, fully visible and not mistaken for another; "
    "leave it out and diagnose again",
    "pad": "check pad {name}: its position, whether it slips or lifts off, and that its motion and force are as "
    "recorded; add a marker next to it",
    "support": "check support {name}: whether the body slips or lifts off there, and where its edge is; "
    "add a marker next to it",
    "case": "measure case {name} again: a deviation that does not repeat is no property of the body",
    "body": "check the model of the whole body: {elements}measure its shape and its material separately",
}


def next_check(bench: Bench, residual: FloatArray, nearest: str = UNKNOWN) -> dict[str, Any]:
    """Return the component of the rig or model to check next, where no cause explains the data.

    `bench`: the believed model; `residual` (size,): unexplained residual, whitened by noise and nuisances; `nearest`:
    id of the cause that it resembles most, ``"unknown"`` for none. The result has ``action``, the advice in words,
    ``separates`` (empty) and ``separability`` (None), and ``check``: the component's ``kind`` and ``name``, the
    ``share`` of the misfit near it, ``where`` (markers and pads, the worst first), and ``case`` and ``time_s`` of the
    worst frame.
    """
    layout, settings = bench.layout, bench.settings.report
    components = list(components_of(bench))
    count = Counter(one.kind for one in components)
    chosen = max(
        components,
        key=lambda one: log_likelihood_gain(residual, one.proximity, layout, settings) - np.log(count[one.kind]),
    )
    share = _share(residual, chosen.proximity, layout, settings)
    case, time = worst_frame(layout, residual * np.sqrt(chosen.proximity))
    where = largest_residuals(layout, residual, settings)
    elements = "" if chosen.name == "tet10" else "diagnose again with the elements tet10; if the misfit remains, "
    action = _ACTIONS[chosen.kind].format(name=chosen.name, elements=elements)
    worst = f", worst at {', '.join(where)}" if where and chosen.kind not in ("marker", "case") else ""
    like = "" if nearest == UNKNOWN else f"; the cause of the catalogue that comes nearest is '{nearest}'"
    whole = "the misfit is spread over the body, in proportion to its motion"
    place = whole if chosen.kind == "body" else f"{share:.0%} of the misfit is there"
    action = f"{action} ({place}{worst}, most at {time:.4g} s under case {case}{like})"
    return to_check(action, chosen.kind, chosen.name, share=share, where=where, case=case, time_s=time)


def components_of(bench: Bench) -> Iterator[RigComponent]:
    """Yield every marker, pad, support and case, and the body, as components that can be checked.

    The proximity of each, (size,), weighs every measured number from 0 (far) to 1 (at it); the body's is that of its
    motion.
    """
    layout, experiment = bench.layout, bench.experiment
    for i, name in enumerate(layout.marker_names):
        yield RigComponent("marker", name, _near_markers(layout, np.eye(len(layout.marker_names))[i]))
    for pad in experiment.actuators:
        near = _near_markers(layout, _closeness(bench, pad.nodes))
        for part in layout.parts:
            case = experiment.cases[part.name]
            if pad.name not in case.displacements and pad.name not in case.applied_forces:
                part.markers(near)[:] = 0.0
            if pad.name in part.pads:
                part.forces(near)[:, part.pads.index(pad.name)] = 1.0
        yield RigComponent("pad", pad.name, near)
    for boundary in experiment.boundaries:
        yield RigComponent("support", boundary.name, _near_markers(layout, _closeness(bench, boundary.nodes)))
    if len(layout.parts) > 1:
        for part in layout.parts:
            yield RigComponent("case", part.name, layout.of_case(part.name).astype(np.float64))
    yield RigComponent("body", bench.predictor.element, _squared_motion(layout, bench.base))


def log_likelihood_gain(
    residual: FloatArray, proximity: FloatArray, layout: SignalLayout, settings: AdviceSettings = DEFAULT.report
) -> float:
    """Return the gain in log likelihood, in nats, of an additional variance near a component over unit variance.

    `residual` (size,): whitened by noise and nuisances; `proximity` (size,): weight of every measured number in the
    additional variance, 0 to 1; `layout`: order of both. The gain is the largest over the sizes of that variance.
    """
    seen, variances = layout.seen, np.geomspace(*settings.variances)
    squares, variance = residual[seen] ** 2, 1.0 + variances[:, None] * proximity[seen]
    nats = 0.5 * (squares * (1.0 - 1.0 / variance) - np.log(variance)).sum(axis=1)
    return float(max(nats.max(), 0.0))


def _share(residual: FloatArray, proximity: FloatArray, layout: SignalLayout, settings: AdviceSettings) -> float:
    """Return the share of the squared residual (size,) beyond noise that lies near a component of the rig.

    `residual`: whitened; `proximity` (size,): weight of every measured number, 0 to 1.
    """
    seen = layout.seen
    beyond = residual[seen] ** 2 - 1.0
    whole, there = float(beyond.sum()), float(beyond[proximity[seen] > settings.near].sum())
    return float(np.clip(there / whole, 0.0, 1.0)) if whole > 0.0 else 0.0


def _near_markers(layout: SignalLayout, closeness: FloatArray) -> FloatArray:
    near = np.zeros(layout.size)
    for part in layout.parts:
        part.markers(near)[:] = closeness[:, None]
    return near


def _closeness(bench: Bench, nodes: IntArray) -> FloatArray:
    """Return how close each marker at rest lies to a patch, (n_markers,): a Gaussian of the distance, 1 on it."""
    places = bench.experiment.mesh.nodes[nodes]
    apart = np.linalg.norm(bench.layout.reference[:, None] - places, axis=2).min(axis=1)
    return np.asarray(np.exp(-0.5 * (apart / (bench.settings.report.reach * bench.extent)) ** 2))


def _squared_motion(layout: SignalLayout, believed: FloatArray) -> FloatArray:
    """Return the squares of a prediction (size,) over the largest of them, 0 to 1, for markers and forces each."""
    near = np.zeros(layout.size)
    markers = layout.of_markers()
    for rows in (markers, ~markers):
        largest = np.abs(believed[rows]).max(initial=0.0)
        if largest > 0.0:
            near[rows] = (believed[rows] / largest) ** 2
    return near
