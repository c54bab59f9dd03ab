"""`tetrahedralize` fills a surface with a tetrahedral mesh for simulations and measures the quality of this mesh."""

import math
import os
from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np

from tissuereg._base.arguments import check_running, found, named, real
from tissuereg._base.arrays import FloatArray, IntArray, frozen
from tissuereg._base.choices import Frame, Unit
from tissuereg._base.clock import Clock
from tissuereg._base.provenance import warn
from tissuereg.body.closest import ClosestTriangles
from tissuereg.body.mesh import Mesh
from tissuereg.body.triangles import Triangles
from tissuereg.errors import FormatError, MeshError, MeshingError
from tissuereg.io.node_rules import KINDS, NodeRule, nodes_by_rule, parsed_rule
from tissuereg.io.surfaces import SurfaceInput, read_triangles
from tissuereg.meshing.fill import check_mesher, filled
from tissuereg.meshing.repair import repaired
from tissuereg.meshing.segmentation import Segmentation, is_segmentation
from tissuereg.meshing.settings import MESHING
from tissuereg.meshing.topology import components
from tissuereg.simulation.fine.bisection import shape_quality

#: Volume of a regular tetrahedron whose edges are 1.
_REGULAR = 1.0 / (6.0 * math.sqrt(2.0))


#: One rule, or several that are combined.
NodeRules = NodeRule | Sequence[NodeRule]


class FilledMesh(Mesh):
    """A tetrahedral mesh that fills a surface, with a record of how it was made.

    Attributes
    ----------
    repaired : list of str
        Sentences that each state one repair of the surface, or one defect that is left; empty if there were none.
    quality : dict
        Measures of the mesh: ``min_quality`` and ``median_quality`` of its tets (mean ratio, 1 for a regular tet),
        ``shortest_edge_mm``, ``median_edge_mm``, ``surface_distance_mm`` (largest distance of the mesh's boundary from
        the surface, measured at nodes and centres of its triangles), ``missed_mm`` (largest distance of the surface
        from the mesh's boundary, which is large where thin parts were lost or an inner shell was filled),
        ``volume_mm3``, ``volume_change_percent`` (against the volume that the surface encloses), ``parts`` (number of
        parts that share no node).
    settings : dict
        Target edge length ``size_mm``, largest deviation from the surface ``deviation_mm``, and ``mesher``, the
        mesher's name and version.
    labels : dict of str to dict
        Of each label of a segmentation: number of ``tets`` whose middle lies in it, their ``volume_mm3``, and that of
        its voxels, ``voxels_mm3``; empty for a surface.
    seconds : dict of str to float
        Wall time in s of the stages ``read``, ``repair``, ``fill``, ``measure``.
    """

    labels: dict[str, dict[str, float]]
    repaired: list[str]
    quality: dict[str, Any]
    settings: dict[str, Any]
    seconds: dict[str, float]


def tetrahedralize(
    surface: SurfaceInput | tuple[str | os.PathLike[str], Sequence[str | int]],
    size_mm: float,
    *,
    unit: Unit | None = None,
    frame: Frame | None = None,
    fixed: NodeRules | None = None,
    node_sets: Mapping[str, NodeRules] | None = None,
    deviation_mm: float | None = None,
    threads: int = 0,
) -> FilledMesh:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    surface : path-like, pair of arrays, or Triangles
        A .stl, .ply, .obj, .off, .vtp, .vtu, .vtk or .msh file; or vertices (n, 3) in `unit` and triangles (m, 3) as
        vertex indices. Or a segmentation (.nrrd, .nii, .nii.gz, .mha, .dcm) and its labels that together make the body,
        by the names of segments or by number: ``("seg.nrrd", ["liver", "tumour"])``. Its surface is that of the labels'
        voxels without the steps; coordinates are those of the image, LPS.
    size_mm : float
        Target edge length in mm, whatever `unit` is; at most half of the largest extent. Three or more elements across
        the thinnest part that bends is a good start. Details of the surface get shorter edges, and above a twelfth of
        the body's diagonal the mesher makes edges shorter than the target.
    unit : {"mm", "cm", "m"}, optional
        Unit of the surface's coordinates. By default the unit stated in the file's header, or else mm.
    frame : {"LPS", "RAS"}, optional
        Patient frame of the surface's coordinates, which the mesh then states. By default that stated in the file's
        header, if one is. No coordinate is turned.
    fixed : str, sequence of float, or list of them, optional
        Rule that selects the held nodes, or a list of rules whose nodes are united: ``"plane nx ny nz d [tol]"`` (nodes
        within `tol` of a plane), ``"ball x y z r"`` (surface nodes in a ball), ``"box x0 y0 z0 x1 y1 z1"``,
        ``"near FILE r"`` (surface nodes near another surface) or the name of one of `node_sets`; lengths in mm. `tol`
        should be at least `deviation_mm`.
    node_sets : mapping of str to rules, optional
        Rules, as in `fixed`, that select the nodes of further sets, by name; a rule may name a set that stands before
        it.
    deviation_mm : float, optional
        Largest distance of the faces of the tetrahedra from the surface, mm. By default the smaller of 5 % of the size
        and 0.1 % of the diagonal of the bounding box; for labels a quarter of the longest edge of a voxel.
    threads : int
        Number of threads of the mesher; 0 stands for all cores. The mesh differs from run to run for any number.

    Returns
    -------
    FilledMesh
        A `Mesh` in mm with the node sets ``fixed`` and `node_sets`, and the attributes `repaired`, `quality`,
        `settings` and `seconds`.

    Raises
    ------
    FormatError
        If the file, the unit or a rule cannot be read, or the file states another frame.
    UnitError
        If the largest extent is not that of an organ, 5 to 2,000 mm; this is checked first.
    MeshError
        If the surface encloses nothing, the size does not suit it, or a rule selects no node.
    MissingPackageError
        If pytetwild is not installed.
    MeshingError
        If the mesher fails.

    Notes
    -----
    Cost: about a second per thousand tetrahedra, nearly all of it in the mesher; a noisy surface,
    or a finer deviation, costs several times more.
    """
    clock = Clock()
    check_running(threads=threads)
    size_mm = real("size_mm", size_mm, unit="mm", error=MeshError)
    if deviation_mm is not None:
        deviation_mm = real("deviation_mm", deviation_mm, unit="mm", error=MeshError)
    with clock.stage("read"):
        segmented = _segmented(surface, unit, frame)
        mended: list[str] = []
        if segmented is not None:
            given, mended = segmented.surface(threads)
            if deviation_mm is None:
                deviation_mm = MESHING.deviation_of_voxel * float(segmented.grid.spacing.max())
        else:
            given = read_triangles(cast(SurfaceInput, surface), unit, frame=frame)
        rules = {**named("node_sets", node_sets, error=MeshError), **({} if fixed is None else {"fixed": fixed})}
        _check_rules(rules, segmented)
        _check_lengths(given, size_mm, deviation_mm)
        check_mesher()
    with clock.stage("repair"):
        body, repairs = repaired(given, least_volume=_REGULAR * size_mm**3)
        _check_number(body, size_mm)
    wanted = deviation_mm or min(MESHING.deviation_of_size * size_mm, MESHING.deviation_of_diagonal * _diagonal(body))
    with clock.stage("fill"):
        inner = None if segmented is None else segmented.interfaces(body, threads)
        nodes, tets, mesher = filled(body, size_mm, wanted, threads, inner)
        mesh = _sound(nodes, tets, given.frame)
        labelled = {} if segmented is None else segmented.of_tets(mesh)
        _add_sets(mesh, labelled, rules, segmented)
    with clock.stage("measure"):
        mesh.quality = _quality(mesh, body)
        voxels = {} if segmented is None else segmented.volumes
        mesh.labels = {
            name: {"tets": len(own), "volume_mm3": float(mesh.volumes[own].sum()), "voxels_mm3": voxels[name]}
            for name, own in labelled.items()
        }
    mesh.repaired, mesh.seconds = [*mended, *repairs], clock.seconds
    mesh.settings = {"size_mm": float(size_mm), "deviation_mm": float(wanted), "mesher": mesher}
    if mesh.quality["parts"] > 1:
        text = f"the body is in {mesh.quality['parts']} parts that share no node: each must be held on its own"
        warn(text)
    return mesh


def _segmented(surface: Any, unit: Unit | None, frame: Frame | None) -> Segmentation | None:
    """Return the labels of a segmentation, given as its file and them; None where `surface` is something else."""
    if isinstance(surface, str | os.PathLike) and is_segmentation(surface):
        surface = (surface, ())  # which is refused with the list of its labels
    if not (isinstance(surface, tuple) and len(surface) == 2 and isinstance(surface[0], str | os.PathLike)):
        return None
    path, labels = surface
    if not is_segmentation(path):
        message = f"`surface` must be an image (.nrrd, .nii.gz ...) where labels are given, got {found(str(path))}"
        raise FormatError(message, where="surface")
    if unit not in (None, "mm") or frame not in (None, "LPS"):
        message = f"`unit` and `frame` must be left out with labels: images are in mm, LPS; got {unit}, {frame}"
        raise FormatError(message, where="frame" if frame not in (None, "LPS") else "unit")
    return Segmentation.read(path, labels)


def _listed(rules: NodeRules, name: str) -> Sequence[NodeRule]:
    """Return one rule for nodes, or several, as a list that is not empty; a FormatError names the argument `name`."""
    if isinstance(rules, str | Mapping):
        return [rules]
    if not isinstance(rules, Sequence | np.ndarray) or not len(rules):
        message = f"`{name}` must be a rule for nodes, or a list of them, got {found(rules)}"
        raise FormatError(message, where=name)
    if not all(isinstance(rule, str | Mapping | Sequence | np.ndarray) for rule in rules):
        return [cast(NodeRule, rules)]
    return cast(Sequence[NodeRule], rules)


def _check_rules(rules: Mapping[str, NodeRules], segmented: Segmentation | None) -> None:
    """Refuse, before the long work of the mesher, invalid rules for nodes and names of node sets not made before."""
    made = [] if segmented is None else [*segmented.sets]
    for name, several in rules.items():
        for rule in _listed(several, name):
            if segmented is not None and segmented.label_near(rule, name) is not None:
                continue
            kind, _ = parsed_rule(rule, name)
            if kind not in (*KINDS, *made):
                message = (
                    f"`{name}` must start with {', '.join(KINDS)} or be a set made before it "
                    f"({', '.join(made) or 'none'}), got {found(kind)}"
                )
                raise MeshError(message, where=name)
        made.append(name)


def _sound(nodes: FloatArray, tets: IntArray, frame: Frame | None) -> FilledMesh:
    try:
        return FilledMesh(nodes, tets, frame=frame)
    except MeshError as error:
        message = f"the mesher must make a mesh that can be simulated: {error}; try another size"
        raise MeshingError(message, where="surface") from error


def _add_sets(
    mesh: Mesh, labelled: Mapping[str, IntArray], rules: Mapping[str, NodeRules], segmented: Segmentation | None
) -> None:
    """Give a new mesh a node set for each of several labels, whose tets are `labelled`, and those of rules."""
    for name in [] if segmented is None else segmented.sets:
        mesh.node_sets[name] = frozen(np.unique(mesh.tets[labelled[name]]))
    for name, several in rules.items():
        chosen = [_nodes_of(mesh, rule, name, segmented) for rule in _listed(several, name)]
        mesh.node_sets[name] = frozen(np.unique(np.concatenate(chosen)))


def _nodes_of(mesh: Mesh, rule: NodeRule, name: str, segmented: Segmentation | None) -> IntArray:
    near = None if segmented is None else segmented.label_near(rule, name)
    return nodes_by_rule(mesh, rule, name) if segmented is None or near is None else segmented.nodes_near(mesh, near)


def _diagonal(surface: Triangles) -> float:
    return float(math.dist(surface.vertices.min(axis=0), surface.vertices.max(axis=0)))


def _check_lengths(surface: Triangles, size_mm: float, deviation_mm: float | None) -> None:
    if not 0 < size_mm <= surface.extent / 2:
        message = (
            f"the size must be positive and at most half of the largest extent, {surface.extent / 2:.4g} mm, "
            f"got {size_mm:g} mm"
        )
        raise MeshError(message, where="size_mm")
    if deviation_mm is not None and not 0 < deviation_mm < size_mm:
        message = f"the deviation must be positive and less than the size, {size_mm:g} mm, got {deviation_mm:g} mm"
        raise MeshError(message, where="deviation_mm")


def _check_number(body: Triangles, size_mm: float) -> None:
    expected = body.volume / (_REGULAR * size_mm**3)
    if expected > MESHING.most_tets:
        least = (body.volume / (_REGULAR * MESHING.most_tets)) ** (1 / 3)
        message = (
            f"the size must leave at most {MESHING.most_tets:,} tetrahedra; {size_mm:g} mm would make about "
            f"{expected:.2g}: choose at least {least:.2g} mm"
        )
        raise MeshError(message, where="size_mm")


def _quality(mesh: Mesh, surface: Triangles) -> dict[str, Any]:
    """Return measures of a mesh that fills a closed surface with outward normals; keys as in `FilledMesh.quality`.

    Cost: one search for the closest triangle per point, at most `MESHING.points` points each way.
    """
    shape = shape_quality(mesh.nodes, mesh.tets)
    length = np.linalg.norm(mesh.nodes[mesh.edges[:, 0]] - mesh.nodes[mesh.edges[:, 1]], axis=1)
    boundary = Triangles(mesh.nodes, mesh.surface)
    volume = float(mesh.volumes.sum())
    return {
        "min_quality": float(shape.min()),
        "median_quality": float(np.median(shape)),
        "shortest_edge_mm": float(length.min()),
        "median_edge_mm": float(np.median(length)),
        "surface_distance_mm": largest_distance(boundary, surface),
        "missed_mm": largest_distance(surface, boundary),
        "volume_mm3": volume,
        "volume_change_percent": 100.0 * (volume / surface.volume - 1.0),
        "parts": int(components(mesh.edges[:, 0], mesh.edges[:, 1], mesh.n_nodes).max()) + 1,
    }


def largest_distance(measured: Triangles, to: Triangles) -> float:
    """Return the largest distance in mm of vertices and centres of the triangles `measured` from the surface `to`.

    >>> flat = Triangles([[0, 0, 0], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]])
    >>> largest_distance(Triangles([[0, 0, 2], [9, 0, 0], [0, 9, 0]], [[0, 1, 2]]), flat)
    2.0
    """
    return float(np.max(ClosestTriangles(to.corners).find(_points(measured)).distances))


def _points(surface: Triangles) -> FloatArray:
    points = np.concatenate([surface.vertices[np.unique(surface.triangles)], surface.corners.mean(axis=1)])
    return np.asarray(points[:: -(-len(points) // MESHING.points)])
