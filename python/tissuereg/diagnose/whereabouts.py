"""What to check next where nothing explains the data: the part of the rig beside which most is left.

Every part is a hypothesis of one number: what is left has the variance ``1 + a w`` in units of noise, with ``w`` how
near a measured number is to that part. The part whose ``a`` gains most likelihood is the one to check; those of one
kind share the price of having been chosen among.
"""

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray, IntArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.left import moment, worst_places
from tissuereg.diagnose.screen import UNKNOWN
from tissuereg.diagnose.signals import Layout

#: A part is felt within about this share of the body's extent.
REACH = 0.15

#: Variances over the noise's that are tried.
_VARIANCES = np.geomspace(0.01, 1e6, 49)

#: A number belongs to a part where it is nearer than this.
_NEAR = 0.5


@dataclass(frozen=True, eq=False)
class Part:
    """Something of the rig or of the model that can be checked.

    Attributes
    ----------
    kind : str
        ``marker``, ``pad``, ``support``, ``case`` or ``body``.
    name : str
        As in the experiment; for the body its elements.
    near : ndarray of float64, shape (size,)
        How near every measured number is to it, 0 to 1.
    """

    kind: str
    name: str
    near: FloatArray


#: What is to be done about a part of each kind.
_ACTIONS = {
    "marker": "check marker {name}: that it sticks, is seen whole and is not taken for another; "
    "leave it out and diagnose again",
    "pad": "check pad {name}: where it sits, whether it slips or lifts, and that its motion and force are as recorded; "
    "put a marker beside it",
    "support": "check support {name}: whether the body slips or lifts there, and where its edge lies; "
    "put a marker beside it",
    "case": "measure case {name} again: what does not come back is no property of the body",
    "body": "check the model of the whole body: {elements}measure its shape and its material apart",
}


def next_check(bench: Bench, left: FloatArray, alike: str = UNKNOWN) -> dict[str, Any]:
    """Return what to check next, from where and when most is left.

    Parameters
    ----------
    bench : Bench
        The believed model.
    left : ndarray of float64, shape (size,)
        What nothing explains, whitened.
    alike : str
        The cause that it looks like, ``"unknown"`` for none.

    Returns
    -------
    dict
        ``action`` in words, ``separates`` (empty) and ``separability`` (None) as `advise` has them, and ``check``: the
        part's ``kind`` and ``name``, the ``share`` of what is left that lies near it, ``where`` (markers and pads,
        the worst first), ``case`` and ``time_s``.
    """
    layout = bench.layout
    parts = list(parts_of(bench))
    count = Counter(part.kind for part in parts)
    part = max(parts, key=lambda one: gain(left, one.near, layout) - np.log(count[one.kind]))
    share = _share(left, part.near, layout)
    case, time = moment(layout, left * np.sqrt(part.near))
    where = worst_places(layout, left)
    elements = "" if part.name == "tet10" else "diagnose again with the elements tet10; if it stays, "
    said = _ACTIONS[part.kind].format(name=part.name, elements=elements)
    worst = f", worst at {', '.join(where)}" if where and part.kind not in ("marker", "case") else ""
    like = "" if alike == UNKNOWN else f"; of the catalogue '{alike}' comes nearest"
    whole = "what is left lies everywhere, in step with the motion"
    lies = whole if part.kind == "body" else f"{share:.0%} of what is left lies there"
    return {
        "action": f"{said} ({lies}{worst}, most at {time:.4g} s under case {case}{like})",
        "separates": [],
        "separability": None,
        "check": {"kind": part.kind, "name": part.name, "share": share, "where": where, "case": case, "time_s": time},
    }


def parts_of(bench: Bench) -> Iterator[Part]:
    """Yield all that can be checked."""
    layout, experiment = bench.layout, bench.experiment
    for i, name in enumerate(layout.marker_names):
        yield Part("marker", name, _near_markers(layout, np.eye(len(layout.marker_names))[i]))
    for pad in experiment.actuators:
        near = _near_markers(layout, _closeness(bench, pad.nodes))
        for part in layout.parts:
            case = experiment.cases[part.name]
            if pad.name not in case.displacements and pad.name not in case.applied_forces:
                part.markers(near)[:] = 0.0
            if pad.name in part.pads:
                part.forces(near)[:, part.pads.index(pad.name)] = 1.0
        yield Part("pad", pad.name, near)
    for boundary in experiment.boundaries:
        yield Part("support", boundary.name, _near_markers(layout, _closeness(bench, boundary.nodes)))
    if len(layout.parts) > 1:
        for part in layout.parts:
            yield Part("case", part.name, layout.of_case(part.name).astype(np.float64))
    yield Part("body", bench.predictor.element, _in_step(layout, bench.base))


def gain(left: FloatArray, near: FloatArray, layout: Layout) -> float:
    """Return by how many nats a part with a variance of its own explains what is left better than noise alone."""
    seen = layout.seen
    squares, variance = left[seen] ** 2, 1.0 + _VARIANCES[:, None] * near[seen]
    nats = 0.5 * (squares * (1.0 - 1.0 / variance) - np.log(variance)).sum(axis=1)
    return float(max(nats.max(), 0.0))


def _share(left: FloatArray, near: FloatArray, layout: Layout) -> float:
    """Return the share of what is left, beyond noise, that lies near a part."""
    seen = layout.seen
    beyond = left[seen] ** 2 - 1.0
    whole, there = float(beyond.sum()), float(beyond[near[seen] > _NEAR].sum())
    return float(np.clip(there / whole, 0.0, 1.0)) if whole > 0.0 else 0.0


def _near_markers(layout: Layout, closeness: FloatArray) -> FloatArray:
    near = np.zeros(layout.size)
    for part in layout.parts:
        part.markers(near)[:] = closeness[:, None]
    return near


def _closeness(bench: Bench, nodes: IntArray) -> FloatArray:
    """Return how near each marker is to a patch, 1 on it, shape (n_markers,)."""
    places = bench.experiment.mesh.nodes[nodes]
    apart = np.linalg.norm(bench.layout.reference[:, None] - places, axis=2).min(axis=1)
    return np.asarray(np.exp(-0.5 * (apart / (REACH * bench.extent)) ** 2))


def _in_step(layout: Layout, believed: FloatArray) -> FloatArray:
    """Return squares of what the believed model says over the largest, markers and forces each."""
    near = np.zeros(layout.size)
    markers = layout.of_markers()
    for rows in (markers, ~markers):
        largest = np.abs(believed[rows]).max(initial=0.0)
        if largest > 0.0:
            near[rows] = (believed[rows] / largest) ** 2
    return near
