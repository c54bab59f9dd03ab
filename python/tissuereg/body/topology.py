"""How given tets hang together: their handedness, nodes that several places share, parts that nothing joins."""

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg._base.arguments import check_choice
from tissuereg._base.arrays import FloatArray, IntArray, float_array, index_array
from tissuereg._base.choices import COINCIDENT, Coincident, Frame
from tissuereg._base.provenance import warn
from tissuereg._core import tet_volumes
from tissuereg.body.mesh import Mesh, per_mesh
from tissuereg.errors import MeshError

#: Nodes closer than this share of the body's extent, and than this share of the shortest edge, are at one place: files
#: with seven digits are that exact.
_SAME_PLACE = 1e-6
_SHARE_OF_EDGE = 0.01

#: Parts whose sizes a message names.
_MOST_NAMED = 5


def sound_mesh(
    nodes: Any,
    tets: Any,
    node_sets: Mapping[str, Any],
    frame: Frame | None = None,
    *,
    coincident: Coincident = "certain",
    pieces: IntArray | None = None,
    place: str = "the mesh",
) -> tuple[Mesh, IntArray]:
    """Return the mesh of given tets, with its topology corrected where that is certain, and said by a warning.

    Tets that are all left-handed are turned. Nodes at one place that are not shared are joined where whole faces
    coincide node by node, or where pieces of one file meet.

    Parameters
    ----------
    nodes : array_like of float, shape (n, 3)
        Coordinates in mm.
    tets : array_like of int, shape (m, 4)
        Node indices of every tet.
    node_sets : mapping of str to array_like of int
        Node indices by name.
    frame : {"LPS", "RAS"}, optional
        Declared patient frame of the coordinates.
    coincident : {"certain", "join", "keep"}
        Whether nodes at one place are joined where that is certain, all of them, or none.
    pieces : ndarray of int64, shape (n,), optional
        The piece of the file that each node comes from.
    place : str
        What holds the mesh, for messages.

    Returns
    -------
    mesh : Mesh
        The mesh; its nodes keep their order.
    rows : ndarray of int64, shape (mesh.n_nodes,)
        Index among `nodes` of every node of the mesh.

    Raises
    ------
    MeshError
        If the mesh cannot carry a simulation, or `coincident` is none of the three.
    ShapeError
        If an array has another shape or dtype.
    """
    check_choice("coincident", coincident, COINCIDENT, MeshError)
    points, cells = float_array("nodes", nodes, (None, 3)), index_array("tets", tets, (None, 4))
    mesh = Mesh(points, _right_handed(points, cells, place), node_sets, frame)
    rows = np.arange(mesh.n_nodes)
    if coincident != "keep":
        mesh, rows = _joined(mesh, coincident == "join", pieces, place)
    _tell_of_parts(mesh, place)
    return mesh, rows


def _right_handed(points: FloatArray, cells: IntArray, place: str) -> IntArray:
    """Return tets with two corners exchanged if all of them are left-handed; others as they are."""
    known = cells.size and cells.min() >= 0 and cells.max() < len(points) and np.isfinite(points).all()
    if not known or not (tet_volumes(points, cells) < 0).all():
        return cells
    text = (
        f"{place}: all {len(cells)} tetrahedra were left-handed; two corners of each were exchanged. If the "
        "coordinates were mirrored on the way, the body still is"
    )
    warn(text)
    return cells[:, [0, 1, 3, 2]]


def _joined(mesh: Mesh, every: bool, pieces: IntArray | None, place: str) -> tuple[Mesh, IntArray]:
    rows = np.arange(mesh.n_nodes)
    first = _first_at_place(mesh, mesh.surface_nodes if pieces is None else rows)
    shared = np.flatnonzero(first != rows)
    if not len(shared):
        return mesh, rows
    pairs = [np.stack([shared, first[shared]], axis=1)] if every else [_of_faces(mesh, first)]
    if pieces is not None and not every:
        other = shared[pieces[shared] != pieces[first[shared]]]
        pairs.append(np.stack([other, first[other]], axis=1))
    kept = _smallest_joined(np.concatenate(pairs), mesh.n_nodes)
    n_joined, n_left = int((kept != rows).sum()), int((first[kept] != kept)[np.unique(kept)].sum())
    if n_left:
        text = (
            f"{place}: {n_left} nodes lie where another node is, but share no whole face with it: they were not "
            "joined, and the body may come apart there. If it is whole, join them (--coincident join, "
            "coincident='join'); if it is not, say so (keep)"
        )
        warn(text)
    if not n_joined:
        return mesh, rows
    rows = np.unique(kept)
    new = np.searchsorted(rows, kept)
    sets = {name: new[nodes] for name, nodes in mesh.node_sets.items()}
    why = "as asked" if every else "whole faces coincide there"
    why = "pieces of the file meet there" if pieces is not None and not every else why
    text = (
        f"{place}: {n_joined} nodes lay where another node is, and were joined with it ({why}); "
        "--coincident keep (coincident='keep') keeps them apart"
    )
    warn(text)
    tets = new[mesh.tets] if pieces is None else _each_once(new[mesh.tets], place)
    return Mesh(mesh.nodes[rows], tets, sets, mesh.frame), rows


def _each_once(tets: IntArray, place: str) -> IntArray:
    """Return tets (m, 4), those that stand in several pieces of a file once."""
    _, first = np.unique(np.sort(tets, axis=1), axis=0, return_index=True)
    if len(first) < len(tets):
        warn(f"{place}: {len(tets) - len(first)} tetrahedra stand in another piece of the file too; they count once")
    return tets[np.sort(first)]


def _first_at_place(mesh: Mesh, own: IntArray) -> IntArray:
    """Return for every node the smallest node at its place, (n_nodes,); nodes but `own` share theirs with no other.

    Those inside share theirs with none, unless pieces overlap.
    """
    from scipy.spatial import cKDTree

    at = np.arange(mesh.n_nodes)
    places, of_own = np.unique(mesh.nodes[own], axis=0, return_inverse=True)
    corners = mesh.nodes[mesh.surface]
    shortest = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).min())
    near = min(_SAME_PLACE * mesh.extent, _SHARE_OF_EDGE * shortest)
    label = _smallest_joined(cKDTree(places).query_pairs(near, output_type="ndarray"), len(places))[of_own.ravel()]
    first = np.full(len(places), mesh.n_nodes)
    np.minimum.at(first, label, own)
    at[own] = first[label]
    return at


def _of_faces(mesh: Mesh, first: IntArray) -> IntArray:
    """Return pairs of nodes (k, 2) that boundary triangles have in common of which exactly two have the same places."""
    places = first[mesh.surface]
    order = np.argsort(places, axis=1)
    faces, corners = np.take_along_axis(places, order, 1), np.take_along_axis(mesh.surface, order, 1)
    _, of_face, count = np.unique(faces, axis=0, return_inverse=True, return_counts=True)
    twice = np.flatnonzero(count[of_face.ravel()] == 2)
    twice = twice[np.argsort(of_face.ravel()[twice], kind="stable")]
    return np.stack([corners[twice[0::2]].ravel(), corners[twice[1::2]].ravel()], axis=1)


def _smallest_joined(pairs: npt.NDArray[Any], n: int) -> IntArray:
    """Return for each of n things the smallest one that pairs (k, 2) join it with, over any number of steps."""
    _, label = _components(pairs, n)
    smallest = np.full(n, n)
    np.minimum.at(smallest, label, np.arange(n))
    return np.asarray(smallest[label], np.int64)


def _components(pairs: npt.NDArray[Any], n: int) -> tuple[int, IntArray]:
    """Return how many groups pairs (k, 2) make of n things, and the group of each, (n,)."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])), shape=(n, n))
    count, label = connected_components(graph, directed=False)
    return int(count), np.asarray(label, np.int64)


@per_mesh
def parts_of(mesh: Mesh) -> IntArray:
    """Return the part of the body that each node is in, (n_nodes,), from 0 on; parts share no node."""
    return _components(mesh.tets[:, [0, 1, 0, 2, 0, 3]].reshape(-1, 2), mesh.n_nodes)[1]


def _tell_of_parts(mesh: Mesh, place: str) -> None:
    label = parts_of(mesh)
    n_parts = int(label.max()) + 1
    if n_parts > 1:
        sizes = ", ".join(str(size) for size in np.sort(np.bincount(label[mesh.tets[:, 0]]))[::-1][:_MOST_NAMED])
        more = ", ..." if n_parts > _MOST_NAMED else ""
        text = (
            f"{place}: the body has {n_parts} parts that share no node, of {sizes}{more} tetrahedra: each moves alone"
        )
        warn(text)
