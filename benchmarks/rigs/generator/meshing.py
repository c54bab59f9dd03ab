"""Meshes by netgen: the skin for placing pads, the truth's with pads cut out along their rims, and the user's own."""

import os
import sys
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np
from netgen.meshing import MeshingParameters
from netgen.occ import Axes, Glue, OCCGeometry, Pnt, WorkPlane, gp_Dir
from scipy.spatial import cKDTree

#: Edges of a tetrahedron by its corners.
EDGES = np.array([(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)])
FACES = np.array([(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)])


@contextmanager
def quiet():
    """Silence what netgen prints."""
    sys.stdout.flush()
    kept, nothing = os.dup(1), os.open(os.devnull, os.O_WRONLY)
    errors = os.dup(2)
    os.dup2(nothing, 1)
    os.dup2(nothing, 2)
    try:
        yield
    finally:
        os.dup2(kept, 1)
        os.dup2(errors, 2)
        for file in (kept, errors, nothing):
            os.close(file)


def _vector(v):
    return gp_Dir(*(float(x) for x in v))


def arrays_of(mesh):
    """Return nodes (n, 3) and tetrahedra (m, 4) of a netgen mesh."""
    nodes = np.array([p.p for p in mesh.Points()])
    tets = np.array([[v.nr - 1 for v in e.vertices[:4]] for e in mesh.Elements3D()])
    return nodes, tets


def outer_faces(tets):
    """Return the triangles (k, 3) that belong to one tetrahedron alone, and that tetrahedron (k,)."""
    faces = tets[:, FACES].reshape(-1, 3)
    _, first, counts = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    single = first[counts == 1]
    return faces[single], single // 4


def outward(nodes, tets):
    """Return the outer triangles, turned so that their normals point out."""
    faces, owners = outer_faces(tets)
    a, b, c = (nodes[faces[:, k]] for k in range(3))
    inner = nodes[tets[owners]].mean(axis=1)
    wrong = np.einsum("ij,ij->i", np.cross(b - a, c - a), (a + b + c) / 3 - inner) < 0
    faces[wrong] = faces[wrong][:, [0, 2, 1]]
    return faces


def skin_of(solid, edge):
    """Return centres (k, 3), outward unit normals (k, 3) and corners (k, 3, 3) of the triangles of a solid's skin."""
    with quiet():
        nodes, tets = arrays_of(OCCGeometry(solid).GenerateMesh(maxh=edge))
    corners = nodes[outward(nodes, tets)]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return corners.mean(axis=1), normals / np.linalg.norm(normals, axis=1, keepdims=True), corners


def with_patches(rig, drawn_in=0.0):
    """Return the solid of a rig with its pads, drawn in by a share, and its supports' edges cut into its faces."""
    solid = rig.body.solid
    flat = []
    for pad in rig.pads:
        half = pad.half - drawn_in * pad.half.min()
        level = pad.flat and np.abs(pad.normal).max() > 1 - 1e-12
        # On a skin that is curved, or slanted and so never met exactly, a prism through it cuts the rim.
        depth = 0.0 if level else 0.75 * pad.reach
        plane = WorkPlane(Axes(Pnt(*(pad.centre - depth * pad.normal)), n=_vector(pad.normal), h=_vector(pad.along)))
        if pad.outline == "round":
            face = plane.Circle(0, 0, float(half[0])).Face()
        else:
            face = plane.RectangleC(*(2 * float(h) for h in half)).Face()
        if not level:
            tool = face.Extrude(2 * depth)
            solid = Glue([solid - tool, solid * tool])
            continue
        flat.append(face)
    for hold in rig.holds:
        if hold.until is not None:
            low, high = rig.body.low, rig.body.high
            corner = Pnt(low[0] - 1, low[1] - 1, 0)
            plane = WorkPlane(Axes(corner, n=gp_Dir(0, 0, 1), h=gp_Dir(1, 0, 0)))
            tool = plane.Rectangle(hold.until - low[0] + 1, high[1] - low[1] + 2).Face()
            flat.append(tool * rig.body.solid)
    return Glue([solid, *flat]) if flat else solid


def _near_pads(rig, rim, within, parameters):
    """Ask for edges that are shares of half a pad's width, at its rim and within."""
    curved = not all(pad.flat for pad in rig.pads)
    centres, normals = rig.body.skin[:2] if curved else (None, None)
    tree = cKDTree(centres) if curved else None
    for pad in rig.pads:
        across, least = np.cross(pad.normal, pad.along), pad.half.min()
        if pad.outline == "round":
            angles = np.linspace(0, 2 * np.pi, int(np.ceil(2 * np.pi / rim)) + 1)[:-1]
            ring = np.stack([np.cos(angles), np.sin(angles)], axis=1) * pad.half[0]
        else:
            steps = np.linspace(-1, 1, int(np.ceil(2 * pad.half.max() / (rim * least))) + 1)
            one = np.ones_like(steps)
            ring = np.concatenate(
                [np.stack(s, axis=1) for s in ((steps, one), (steps, -one), (one, steps), (-one, steps))]
            )
            ring = ring * pad.half
        for share, edge in ((1.0, rim), (0.5, within), (0.0, within)):
            for u, v in share * ring:
                at = pad.centre + u * pad.along + v * across
                if not pad.flat:
                    # Onto the skin: small edges are asked for where the rim is.
                    k = tree.query(at)[1]
                    at = at - ((at - centres[k]) @ normals[k]) * normals[k]
                parameters.RestrictH(x=float(at[0]), y=float(at[1]), z=float(at[2]), h=float(edge * least))


def _mesh_of(solid, rig, longest, rim, within, grading):
    parameters = MeshingParameters(maxh=float(longest), grading=grading)
    _near_pads(rig, rim, within, parameters)
    with quiet():
        return OCCGeometry(solid).GenerateMesh(mp=parameters)


#: Edges at a pad's rim as a share of half its width. Elements as large as this hold a pad as if it were larger, by a
#: share of them that was found by refinement: pads are cut smaller by as much.
RIM, LARGER = 0.3, 0.09

#: Fewest nodes of a truth's mesh.
LEAST = 3000


def truth_mesh(rig, fine=1.0):
    """Return the netgen mesh of the truth, with edges that are smaller by a factor `fine`."""
    solid, longest = with_patches(rig, drawn_in=LARGER * RIM / fine), 0.17 * rig.body.size / fine
    for _ in range(5):
        mesh = _mesh_of(solid, rig, longest, RIM / fine, 0.45 / fine, 0.45)
        tets = arrays_of(mesh)[1]
        edges = np.unique(np.sort(tets[:, EDGES].reshape(-1, 2), axis=1), axis=0)
        if len(np.unique(tets)) + len(edges) > LEAST * fine**3:
            break
        longest *= 0.85
    return mesh


@dataclass
class UserMesh:
    """Nodes (n, 3), tetrahedra (m, 4), and indices of nodes by the name of a set."""

    nodes: np.ndarray
    tets: np.ndarray
    sets: dict


def user_mesh(rig):
    """Return the user's mesh of four-node elements, with the node sets that the user chose."""
    imprint = any(pad.reading == "imprint" for pad in rig.pads)
    solid = with_patches(rig) if imprint else rig.body.solid
    share, longest = 0.62, 0.2 * rig.body.size
    for _ in range(14):
        mesh = _mesh_of(solid, rig, longest, share, share, 0.35)
        nodes, tets = arrays_of(mesh)
        if 0.9 * rig.user_nodes <= len(nodes) <= 1.1 * rig.user_nodes:
            break
        longest *= np.clip((len(nodes) / rig.user_nodes) ** 0.5, 0.75, 1.35)
        if len(nodes) > 1.1 * rig.user_nodes and longest > 0.33 * rig.body.size:
            share = min(share * 1.08, 0.8)
    used, tets = np.unique(tets, return_inverse=True)
    nodes, tets = np.round(nodes[used], 5), tets.reshape(-1, 4)
    a, b, c, d = (nodes[tets[:, k]] for k in range(4))
    turned = np.einsum("ij,ij->i", np.cross(b - a, c - a), d - a) < 0
    tets[turned] = tets[turned][:, [0, 1, 3, 2]]
    return UserMesh(nodes, tets.astype(np.int32), _sets(rig, nodes, tets))


def _area(nodes, faces, which):
    a, b, c = (nodes[faces[which, k]] for k in range(3))
    return float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum() / 2)


def _sets(rig, nodes, tets):
    faces = outward(nodes, tets)
    skin = np.unique(faces)
    sets = {}
    for pad in rig.pads:
        if pad.reading == "nodes":
            # A user takes nodes up to somewhat beyond the rim, until the patch is about as large as the pad.
            wanted = np.pi * pad.half[0] ** 2 if pad.outline == "round" else 4 * pad.half.prod()
            edge = 0.62 * pad.half.min()
            tries = [skin[pad.inside(nodes[skin], grown=share * edge)] for share in np.linspace(0.0, 1.0, 21)]
            sizes = [_area(nodes, faces, np.isin(faces, some).all(axis=1)) for some in tries]
            sets[pad.name] = tries[int(np.argmin(np.abs(np.array(sizes) - wanted)))]
        elif pad.reading in ("triangles", "imprint"):
            sets[pad.name] = np.unique(faces[pad.inside(nodes[faces].mean(axis=1))])
    for hold in rig.holds:
        if hold.until is not None:
            # A user holds the nodes up to half an edge beyond the edge.
            edge = np.median(np.linalg.norm(nodes[faces[:, 0]] - nodes[faces[:, 1]], axis=1))
            sets[hold.name] = skin[hold.inside(nodes[skin], grown=0.3 * edge)]
    return sets
