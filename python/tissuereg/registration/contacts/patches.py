r"""Patches on the free surface of a mesh at which contacts may act.

One unit of a patch with centre c and radius r is the nodal force

    A_n (1 - |x_n - c|^2 / r^2)_+ E / (1.6 r)

along each axis, where A_n is the surface area of node n. One unit moves its patch by about 1 mm, so that Young's
modulus cancels from everything but the forces.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.registration.contacts.settings import DISCRETISATION


@dataclass(frozen=True, eq=False)
class Patches:
    """Overlapping round parts of a mesh's surface, of several radii, on each of which a contact may act.

    Attributes
    ----------
    centres : ndarray of float64, shape (n_patches, 3)
        Node at the centre of each patch on the undeformed surface, mm.
    radii : ndarray of float64, shape (n_patches,)
        Radius of each patch, mm.
    level : ndarray of int64, shape (n_patches,)
        Number of each patch's radius among the radii in use, 0 for the smallest.
    normals : ndarray of float64, shape (n_patches, 3)
        Outward unit normal at the centre.
    shapes : scipy.sparse.csr_array, shape (n_patches, n_nodes)
        Nodal force of a unit coefficient along an axis over Young's modulus, mm^2 per mm. For supports that move it is
        the dimensionless profile, 1 at the centre.
    texture : tuple of ndarray
        For each patch the patches of the next smaller radius inside it, on which its force may vary: int64 first
        entries (n_patches + 1,), int64 patch numbers (n_entries,), and float64 ratios (n_entries,) of the standard
        deviation of their coefficient to that of the patch.
    neighbours : tuple of ndarray
        For each patch the similar patches, to which a step of the sampler may move a contact: int64 first entries
        (n_patches + 1,) and int64 patch numbers (n_entries,).
    """

    centres: FloatArray
    radii: FloatArray
    level: IntArray
    normals: FloatArray
    shapes: Any
    texture: tuple[IntArray, IntArray, FloatArray]
    neighbours: tuple[IntArray, IntArray]

    @property
    def n_patches(self) -> int:
        """Number of patches."""
        return len(self.centres)


def make_patches(mesh: Mesh, free: IntArray, *, by_area: bool = True) -> Patches:
    """Return the patches, of several radii, that cover a part of a mesh's surface.

    `mesh`: undeformed body; `free` int64 (n_free,): nodes of the surface that patches may contain; `by_area`: whether
    shapes are nodal forces over Young's modulus in mm^2 per mm, in proportion to the nodes' areas; otherwise they are
    the dimensionless profile 1 - (distance / radius)^2, for supports that move. Result: about a thousand patches;
    larger radii have fewer centres.
    """
    areas, normals = surface_of_nodes(mesh)
    places = mesh.nodes[free]
    edges = mesh.nodes[mesh.surface] - mesh.nodes[np.roll(mesh.surface, 1, axis=1)]
    edge = float(np.linalg.norm(edges, axis=2).mean())
    radii = _radii(mesh.extent, edge)
    chosen = [_thinned(places, normals[free], DISCRETISATION.thinning * radius) for radius in radii]
    level = np.repeat(np.arange(len(radii)), [len(c) for c in chosen])
    nodes = free[np.concatenate(chosen)]
    centres, across, radius = mesh.nodes[nodes], normals[nodes], radii[level]
    weights = areas[free] if by_area else np.ones(len(free))
    scale = 1.6 * radius if by_area else np.ones(len(radius))
    shapes = _shapes((places, normals[free], weights, free), (centres, across, radius, scale), mesh.n_nodes)
    return Patches(
        centres,
        radius,
        level,
        across,
        shapes,
        _texture(centres, across, radius, level),
        _neighbours(centres, across, radius, level),
    )


def surface_of_nodes(mesh: Mesh) -> tuple[FloatArray, FloatArray]:
    """Return the surface area (n_nodes,) in mm^2 and the outward normal (n_nodes, 3) of every node, zero inside."""
    a, b, c = (mesh.nodes[mesh.surface[:, i]] for i in range(3))
    across = 0.5 * np.cross(b - a, c - a)
    area, normal = np.zeros(mesh.n_nodes), np.zeros((mesh.n_nodes, 3))
    for corner in range(3):
        np.add.at(area, mesh.surface[:, corner], np.linalg.norm(across, axis=1) / 3.0)
        np.add.at(normal, mesh.surface[:, corner], across)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    return area, normal / np.where(length > 0, length, 1.0)


def _radii(extent: float, edge: float) -> FloatArray:
    """Return the radii of patches, (n_radii,), in mm, ascending.

    They are fixed shares of `extent`, mm; none is below a few times `edge`, the mean edge length of the surface in mm.
    """
    wanted = np.array(DISCRETISATION.radii_shares) * extent
    least = DISCRETISATION.least_edges * edge
    return np.asarray(np.concatenate([[max(least, wanted[0])], wanted[wanted > 1.3 * max(least, wanted[0])]]))


def _thinned(places: FloatArray, normals: FloatArray, gap: float) -> IntArray:
    """Return the numbers of places, int64 (n_kept,), of which no two on one side of the body are closer than `gap`, mm.

    `places` (n, 3): mm; `normals` (n, 3): outward unit normals; places whose normals differ much are on opposite sides.
    The first place that is not too close to those kept is kept next.
    """
    from scipy.spatial import cKDTree

    tree = cKDTree(places)
    left = np.ones(len(places), bool)
    kept = []
    for index in range(len(places)):
        if left[index]:
            kept.append(index)
            near = np.asarray(tree.query_ball_point(places[index], gap))
            # The other side of a sheet has its own centres.
            left[near[normals[near] @ normals[index] > DISCRETISATION.least_cosine]] = False
            left[index] = False
    return np.array(kept, np.int64)


def _shapes(
    surface: tuple[FloatArray, FloatArray, FloatArray, IntArray],
    patches: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    n_nodes: int,
) -> Any:
    """Return the nodal value (n_patches, n_nodes) of one unit of every patch, sparse: profile times weight over scale.

    `surface`: places (n, 3), mm, normals (n, 3), weights (n,), such as areas in mm^2, and numbers (n,) of surface
    nodes; `patches`: centres (n_patches, 3), mm, normals (n_patches, 3), radii (n_patches,), mm, and scales
    (n_patches,), such as 1.6 radii in mm. The profile is 1 - (distance / radius)^2.
    """
    places, normals, weights, nodes = surface
    centres, across, radii, scale = patches
    from scipy.sparse import csr_array
    from scipy.spatial import cKDTree

    found = cKDTree(places).query_ball_point(centres, radii)
    rows = np.repeat(np.arange(len(centres)), [len(f) for f in found])
    own = np.concatenate([np.asarray(f, np.int64) for f in found])
    distance = np.linalg.norm(places[own] - centres[rows], axis=1)
    same_side = np.einsum("ij,ij->i", normals[own], across[rows]) > DISCRETISATION.least_cosine
    profile = np.clip(1.0 - (distance / radii[rows]) ** 2, 0.0, None)
    values = np.where(same_side, weights[own] * profile / scale[rows], 0.0)
    shapes = csr_array((values, (rows, nodes[own])), shape=(len(centres), n_nodes))
    shapes.eliminate_zeros()
    return shapes


def _texture(
    centres: FloatArray, across: FloatArray, radii: FloatArray, level: IntArray
) -> tuple[IntArray, IntArray, FloatArray]:
    """Return for each patch the patches of the next smaller radius inside it, with ratios of standard deviations.

    `centres` (n_patches, 3): mm; `across` (n_patches, 3): normals; `radii` (n_patches,): mm; `level` (n_patches,):
    number of the radius. Result: compressed rows: first entries (n_patches + 1,), patch numbers (n_entries,), ratios
    (n_entries,).
    """
    trees = _trees(centres, level)
    found = [_pairs(trees, (coarse, coarse - 1), radii, across) for coarse in range(1, len(trees))]
    first, inside, patches = _by_patch(found, len(centres))
    return first, inside, np.asarray(0.5 * radii[inside] / radii[patches])


def _neighbours(
    centres: FloatArray, across: FloatArray, radii: FloatArray, level: IntArray
) -> tuple[IntArray, IntArray]:
    """Return for each patch the similar patches: near ones of equal radius, and those of the next radii at its centre.

    `centres` (n_patches, 3): mm; `across` (n_patches, 3): normals; `radii` (n_patches,): mm; `level` (n_patches,):
    number of the radius. Result: compressed rows: first entries (n_patches + 1,), patch numbers (n_entries,).
    """
    trees, reach = _trees(centres, level), DISCRETISATION.thinning * radii
    found = []
    for of in range(len(trees)):
        found.append(_pairs(trees, (of, of), 1.5 * reach, across))
        for other in (of - 1, of + 1):
            if 0 <= other < len(trees):
                larger = 0.7 * np.maximum(reach, reach[trees[other][0][0]])
                found.append(_pairs(trees, (of, other), larger, across))
    return _by_patch(found, len(centres))[:2]


def _trees(centres: FloatArray, level: IntArray) -> list[tuple[IntArray, Any]]:
    """Return for each radius, smallest first, the numbers of its patches and a search tree of their centres in mm."""
    from scipy.spatial import cKDTree

    members = [np.flatnonzero(level == one) for one in range(int(level.max(initial=-1)) + 1)]
    return [(own, cKDTree(centres[own])) for own in members]


def _pairs(
    trees: list[tuple[IntArray, Any]], levels: tuple[int, int], reach: FloatArray, across: FloatArray
) -> tuple[IntArray, IntArray]:
    """Return pairs of patches of two radii on one side of the body whose centres are nearer than the first one's reach.

    `trees`: patch numbers and search tree of each radius; `levels`: the two radii, by number; `reach` (n_patches,): mm;
    `across` (n_patches, 3): outward normals. Result: two arrays of patch numbers, int64 (n_pairs,).
    """
    (own, of), (theirs, tree) = trees[levels[0]], trees[levels[1]]
    # Exclude those exactly at the reach.
    found = tree.query_ball_point(of.data, np.nextafter(reach[own], 0.0))
    patches = np.repeat(own, [len(one) for one in found])
    others = theirs[np.concatenate([np.asarray(one, np.int64) for one in found])]
    same_side = np.einsum("ij,ij->i", across[patches], across[others]) > DISCRETISATION.least_cosine
    kept = same_side & (patches != others)
    return patches[kept], others[kept]


def _by_patch(found: list[tuple[IntArray, IntArray]], n_patches: int) -> tuple[IntArray, IntArray, IntArray]:
    """Return pairs of patches sorted by the first: first entries (n_patches + 1,), second and first of each pair.

    `found`: lists of pairs, each as two arrays of patch numbers, int64 (n_pairs,).
    """
    patches = np.concatenate([np.empty(0, np.int64), *(one[0] for one in found)])
    others = np.concatenate([np.empty(0, np.int64), *(one[1] for one in found)])
    order = np.lexsort((others, patches))
    count = np.bincount(patches, minlength=n_patches)
    return np.concatenate([[0], np.cumsum(count)]).astype(np.int64), others[order], patches[order]
