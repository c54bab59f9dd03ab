"""Surface patches within a ball, cut out along their rim.

The rim of a patch is where the surface meets the sphere ``|x - centre| = radius``. First the elements around it are
refined, because the stress under a bonded pad peaks there; then surface nodes near the rim slide onto it, and edges
that still cross it are cut. After that every boundary triangle lies entirely within the patch or outside.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.simulation.fine.bisection import Bisection, shape_quality
from tissuereg.simulation.settings import FINE


@dataclass(frozen=True, eq=False)
class Folds:
    """Edges of a closed triangulated surface, and the angles at which its triangles (facets) meet there.

    `edges` int64 (n_edges, 2): nodes, ascending; `facets` int64 (n_edges, 2): numbers of the two triangles at each
    edge; `cosines` (n_edges,): cosines of the angles between their normals; `normals` (n_triangles, 3): unit normals of
    all triangles, by the order of their corners; `areas` (n_triangles,): areas of all triangles, mm^2.
    """

    edges: IntArray
    facets: IntArray
    cosines: FloatArray
    normals: FloatArray
    areas: FloatArray

    @property
    def is_sharp(self) -> np.ndarray:
        """Mask (n_edges,), True for an edge of the body itself, False between facets of a smooth face."""
        return np.asarray(self.cosines < FINE.sharp)


def folds_of(nodes: FloatArray, surface: IntArray) -> Folds:
    """Return the edges of a closed triangulated surface, each with its two triangles and the angle between them.

    `nodes` (n_nodes, 3): mm; `surface` int64 (n_triangles, 3): triangles, two at every edge. Result: edges in ascending
    order of their nodes.
    """
    corners = nodes[surface]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    lengths = np.linalg.norm(normals, axis=1)
    normals = normals / lengths[:, None]
    sides = np.sort(surface[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    pairs = np.lexsort((sides[:, 1], sides[:, 0])).reshape(-1, 2)
    facets = pairs // 3
    cosines = np.clip((normals[facets[:, 0]] * normals[facets[:, 1]]).sum(axis=1), -1.0, 1.0)
    return Folds(sides[pairs[:, 0]], facets, cosines, normals, 0.5 * lengths)


def outline_nodes(surface: IntArray, nodes: IntArray) -> IntArray:
    """Return those of a surface patch's nodes that also belong to triangles (n, 3) of the surface beyond it."""
    return np.intersect1d(nodes, surface[~np.isin(surface, nodes).all(axis=1)])


@dataclass(frozen=True)
class Rim:
    """The outline of a surface patch (a pad): the curve where the surface meets a sphere.

    Parameters
    ----------
    centre : tuple of float
        Centre of the sphere in mm.
    radius : float
        Radius of the sphere in mm.
    """

    centre: tuple[float, float, float]
    radius: float

    def depth(self, points: FloatArray) -> FloatArray:
        """Return the depth (...) of points (..., 3) inside the sphere, mm; negative outside, 0 on it up to rounding."""
        depth = self.radius - np.linalg.norm(points - np.asarray(self.centre), axis=-1)
        return np.asarray(np.where(np.abs(depth) <= 1e3 * FINE.inside * self.radius, 0.0, depth))

    def crossing(self, outer: FloatArray, inner: FloatArray) -> FloatArray:
        """Return where segments (n, 3) from outside to inside cross the sphere, as shares of their length (n,)."""
        start, along = outer - np.asarray(self.centre), inner - outer
        a, b = (along**2).sum(axis=1), (start * along).sum(axis=1)
        c = (start**2).sum(axis=1) - (self.radius * (1.0 - FINE.inside)) ** 2
        return np.asarray(c / (-b + np.sqrt(np.maximum(b**2 - a * c, 0.0))))


def samples(cutter: Bisection, rim: Rim) -> FloatArray:
    """Return points of the rim (outline of a pad), one on every edge of the surface that crosses it, (n, 3) in mm.

    For an edge between nodes outside the sphere that enters it, this is its deepest point. If no edge comes near, the
    surface node next to the rim is used.
    """
    outer, inner = _crossing_edges(cutter, rim)
    share = rim.crossing(cutter.nodes[outer], cutter.nodes[inner])
    points = cutter.nodes[outer] + share[:, None] * (cutter.nodes[inner] - cutter.nodes[outer])
    _, deepest = _dipping_edges(cutter, rim, 0.0)
    points = np.concatenate([points, deepest])
    if len(points):
        return points
    surface = np.flatnonzero(cutter.on_surface)
    nearest = np.argmin(np.abs(rim.depth(cutter.nodes[surface])))
    return cutter.nodes[surface[[nearest]]]


def refine_round(cutter: Bisection, rims: Sequence[Rim], shortest: float, growth: float) -> None:
    """Make elements small around rims (outlines of pads) by cutting edges of the mesh.

    `cutter`: mesh, changed in place; `rims`: the rims; `shortest`: longest edge of an element at a rim over the rim's
    radius; `growth`: increase of the allowed edge length per mm of distance from the rim, mm/mm.
    """
    for rim in rims:
        # The rim of a coarse surface is known by few points, so it is refined in steps.
        wanted, at_rim = shortest * rim.radius, 2.0 * rim.radius
        while at_rim > wanted:
            at_rim = max(0.5 * at_rim, wanted)
            refine_near(cutter, samples(cutter, rim), at_rim, growth)


def refine_near(cutter: Bisection, points: FloatArray, edge: float, growth: float) -> None:
    """Make elements small near points by cutting edges of the mesh.

    `cutter`: mesh, changed in place; `points` (n, 3): mm; `edge`: longest edge of an element at a point, mm; `growth`:
    increase of the allowed edge length per mm of distance from the points, mm/mm.
    """
    from scipy.spatial import KDTree

    tree = KDTree(points)

    def size(centres: FloatArray) -> FloatArray:
        return np.asarray(edge + growth * tree.query(centres)[0])

    cutter.refine(size)


def cut_along(cutter: Bisection, rim: Rim, stay: IntArray) -> None:
    """Cut the surface of the mesh along a rim (outline of a pad), so that no edge crosses it any more.

    `cutter`: mesh, changed in place; `rim`: the rim; `stay` int64 (n,): numbers of nodes that must not slide onto it.
    """
    edges, deepest = _dipping_edges(cutter, rim, FINE.dip_share)
    if len(edges):
        cutter.cut(edges, deepest)
    _snap(cutter, rim, stay)
    outer, inner = _crossing_edges(cutter, rim)
    if len(outer):
        share = rim.crossing(cutter.nodes[outer], cutter.nodes[inner])
        places = cutter.nodes[outer] + share[:, None] * (cutter.nodes[inner] - cutter.nodes[outer])
        # Cuts in the middle first: they leave the better halves.
        order = np.argsort(np.abs(share - 0.5), kind="stable")
        cutter.cut(np.stack([outer, inner], axis=1)[order], places[order])


def patch_nodes(cutter: Bisection, rim: Rim) -> IntArray:
    """Return the numbers of the surface nodes within a rim (circle that bounds a pad) and on it, sorted."""
    surface = np.flatnonzero(cutter.on_surface)
    return np.asarray(surface[rim.depth(cutter.nodes[surface]) >= 0.0])


def rim_nodes(cutter: Bisection, rim: Rim) -> IntArray:
    """Return the numbers of the surface nodes on a rim (circle that bounds a pad), sorted."""
    surface = np.flatnonzero(cutter.on_surface)
    return np.asarray(surface[rim.depth(cutter.nodes[surface]) == 0.0])


def _crossing_edges(cutter: Bisection, rim: Rim) -> tuple[IntArray, IntArray]:
    """Return the ends outside (n,) and inside (n,) of the surface's edges that cross a rim's sphere, node numbers."""
    edges = cutter.surface_edges()
    depth = rim.depth(cutter.nodes[edges])
    crossing = depth[:, 0] * depth[:, 1] < 0.0
    edges, depth = edges[crossing], depth[crossing]
    swap = depth[:, 0] > 0.0
    return np.where(swap, edges[:, 1], edges[:, 0]), np.where(swap, edges[:, 0], edges[:, 1])


def _dipping_edges(cutter: Bisection, rim: Rim, least_share: float) -> tuple[IntArray, FloatArray]:
    """Return edges (n, 2) between nodes outside the rim's sphere that enter it, and their deepest points (n, 3), mm.

    `least_share`: depth that an edge must reach, as a share of its length.
    """
    edges = cutter.surface_edges()
    edges = edges[(rim.depth(cutter.nodes[edges]) < 0.0).all(axis=1)]
    start = cutter.nodes[edges[:, 0]]
    along = cutter.nodes[edges[:, 1]] - start
    squares = (along**2).sum(axis=1)
    share = np.clip(((np.asarray(rim.centre) - start) * along).sum(axis=1) / squares, 0.0, 1.0)
    deepest = start + share[:, None] * along
    dips = rim.depth(deepest) > least_share * np.sqrt(squares)
    return edges[dips], deepest[dips]


def _snap(cutter: Bisection, rim: Rim, stay: IntArray) -> None:
    """Slide surface nodes along edges onto a rim that crosses these edges nearby, if the tetrahedra stay good.

    `cutter`: mesh, changed in place; `stay` (n,): numbers of nodes that do not slide, as do none on edges of the body.
    """
    outer, inner = _crossing_edges(cutter, rim)
    if not len(outer):
        return
    share = rim.crossing(cutter.nodes[outer], cutter.nodes[inner])
    places = cutter.nodes[outer] + share[:, None] * (cutter.nodes[inner] - cutter.nodes[outer])
    node = np.where(share < 0.5, outer, inner)
    near = np.minimum(share, 1.0 - share)
    blocked = np.isin(node, stay) | np.isin(node, sharp_nodes(cutter.nodes, cutter.surface))
    able = np.flatnonzero((near < FINE.snap_share) & ~blocked)
    able = able[np.argsort(near[able], kind="stable")]
    _, first = np.unique(node[able], return_index=True)
    able = able[np.sort(first)]
    moving, towards = node[able], places[able]
    around = np.flatnonzero(np.isin(cutter.tets, moving).any(axis=1))
    tets = cutter.tets[around]
    wanted = np.minimum(FINE.kept_quality * shape_quality(cutter.nodes, tets), FINE.least_quality)
    moved = cutter.nodes.copy()
    moved[moving] = towards
    while True:
        spoilt = shape_quality(moved, tets) < wanted
        back = moving[np.isin(moving, tets[spoilt]) & (moved[moving] != cutter.nodes[moving]).any(axis=1)]
        if not len(back):
            break
        moved[back] = cutter.nodes[back]
    cutter.nodes = moved


def sharp_nodes(nodes: FloatArray, surface: IntArray) -> IntArray:
    """Return the numbers of the nodes on sharp edges of the body, which must not slide.

    `nodes` (n_nodes, 3): mm; `surface` int64 (n_triangles, 3): boundary triangles. Result: int64 (n,), sorted.
    """
    folds = folds_of(nodes, surface)
    return np.unique(folds.edges[folds.is_sharp])
