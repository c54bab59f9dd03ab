"""Places of the pads, markers and target of a made-up rig on a user's body."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh, node_normals
from tissuereg.errors import MeshError

#: Of the body's extent: radius of a pad, and how far it is pushed in. Of its distance from held nodes: the same two.
_RADIUS_SHARE, _STROKE_SHARE = 0.12, 0.04
_DEPTH_SHARE, _THIN_STROKE_SHARE = 0.5, 0.2

N_MARKERS, _N_PADS = 10, 2


@dataclass(frozen=True, eq=False)
class MadeUpRig:
    """Made-up pads, markers and a target on a body.

    `centres` (2, 3) and `radii` (2,): balls that cut the pads out of the surface, mm; `pushes` (2, 3): motion of each
    pad, mm; `markers` (n, 3): reference places, mm; `target` (3,): an inner point, mm.
    """

    centres: FloatArray  # of the balls whose surface nodes are the pads, (2, 3); above the surface of a thin body
    radii: FloatArray  # of these balls, (2,)
    pushes: FloatArray  # largest motion of each pad, (2, 3)
    markers: FloatArray  # nodes of the surface, (N_MARKERS, 3)
    target: FloatArray  # a point near the body's middle, (3,)

    @classmethod
    def on(cls, body: Mesh, held: IntArray) -> "MadeUpRig":
        """Place pads and markers on `body` far from the held nodes (indices `held`) and from each other.

        Pads consist of free nodes and share none. Raises MeshError if the free surface has no room for them.
        """
        free = np.setdiff1d(body.surface_nodes, held)
        corners = body.nodes[body.surface]
        areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        places, normals = body.nodes[free], node_normals(body, areas)[free]
        if not len(held) or len(free) < _N_PADS + N_MARKERS:
            message = (
                f"the surface must have held nodes and {_N_PADS + N_MARKERS} free ones at least for pads and markers, "
                f"got {len(held)} and {len(free)}"
            )
            raise MeshError(message, where="mesh")
        from_held = _distance(places, body.nodes[held])
        pads = _pads(places, from_held, _RADIUS_SHARE * body.extent)
        radius = min(_RADIUS_SHARE * body.extent, 0.45 * float(np.linalg.norm(places[pads[0]] - places[pads[1]])))
        balls = [_cap(radius, _DEPTH_SHARE * from_held[pad]) for pad in pads]
        centres = np.array([places[pad] + lift * normals[pad] for pad, (_, lift) in zip(pads, balls, strict=True)])
        strokes = np.minimum(_STROKE_SHARE * body.extent, _THIN_STROKE_SHARE * from_held[pads])
        away = _distance(places, places[pads])
        # Markers off the pads, if the body is large enough for that.
        off = away > radius if np.count_nonzero(away > radius) >= N_MARKERS else away > 0
        spots = np.flatnonzero(off)
        markers = places[spots[_spread(places[spots], np.minimum(away, from_held)[spots], N_MARKERS)]]
        rig = cls(
            centres.round(3),
            np.array([size for size, _ in balls]).round(3),
            (-strokes[:, None] * normals[pads]).round(3),
            markers.round(3),
            _middle(body).round(3),
        )
        rig._check(body, held)
        return rig

    def _check(self, body: Mesh, held: IntArray) -> None:
        """Raise MeshError if a pad contains held nodes or no node, or if the two pads share nodes."""
        patches = [
            set(map(int, body.surface_nodes_within(at, r))) for at, r in zip(self.centres, self.radii, strict=True)
        ]
        taken = set(map(int, held))
        if any(not patch or patch & taken for patch in patches) or set.intersection(*patches):
            message = (
                "two pads must find room on the free surface; this body is too thin, too coarse or held too widely for "
                "made-up ones: write its experiment.toml by hand (docs/experiment.md)"
            )
            raise MeshError(message, where="mesh")


def _pads(places: FloatArray, from_held: FloatArray, radius: float) -> IntArray:
    """Return the indices (2,) of two places for pads: far from held nodes, from each other and from the body's ends.

    `places` (n, 3): mm; `from_held` (n,): distance from the held nodes, mm; `radius`: radius of a pad, mm.
    """
    from_middle = np.linalg.norm(places - places.mean(axis=0), axis=1)
    first = int(np.argmax(from_held - 1e-3 * from_middle))
    apart = np.minimum(np.linalg.norm(places - places[first], axis=1), 3.0 * radius)
    second = int(np.argmax(apart * from_held - 1e-3 * radius * from_middle))
    return np.array([first, second])


def _cap(radius: float, depth: float) -> tuple[float, float]:
    """Return radius and lift of the centre, mm, of a ball that cuts out a patch of `radius`, at most `depth` deep."""
    if radius <= depth:
        return radius, 0.0
    lift = (radius**2 - depth**2) / (2.0 * depth)
    return lift + depth, lift


def _middle(body: Mesh) -> FloatArray:
    """Return the centroid (3,), mm, of the tet that is closest to the body's centre of volume."""
    centres = body.nodes[body.tets].mean(axis=1)
    middle = np.average(centres, axis=0, weights=body.volumes)
    return np.asarray(centres[np.argmin(np.linalg.norm(centres - middle, axis=1))])


def _distance(points: FloatArray, others: FloatArray) -> FloatArray:
    from scipy.spatial import KDTree

    return np.asarray(KDTree(others).query(points)[0])


def _spread(points: FloatArray, distance: FloatArray, n: int) -> IntArray:
    """Return indices of `n` of the points (n_points, 3), mm, chosen one by one, each the farthest from those before.

    `distance` (n_points,): distance of each point, in mm, from other things that the chosen ones stay away from as
    well.
    """
    chosen: list[int] = []
    for _ in range(n):
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(points - points[chosen[-1]], axis=1))
    return np.array(chosen)
