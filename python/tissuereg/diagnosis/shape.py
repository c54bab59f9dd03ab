"""Uncertainty of the shape of a body and of its patches: motions of the mesh's nodes with prior deviations.

The same description gives different bodies in different solvers, and a segmented surface is off by a fraction of a
voxel. These are nuisances, never findings. Each is a direction, a motion of the mesh's nodes per mm:

* a patch is shifted along the surface, in two directions, or is larger;
* its rim is no circle, but a wave with two or three periods around the patch;
* the surface under a pad lies higher, or is tilted;
* the edge of a support is displaced;
* the whole surface is displaced along its normal, by a smooth random field and by the gap between the facets and the
  smooth surface through their nodes.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh, node_normals
from tissuereg.body.observe import MarkerObservation
from tissuereg.diagnosis.bench import Bench, Tangents
from tissuereg.diagnosis.correction import make_correction
from tissuereg.diagnosis.predictor import FINE_SCHEMA, Predictor, fingerprint
from tissuereg.diagnosis.settings import DEFAULT, ShapeSettings
from tissuereg.diagnosis.signals import thinned_patterns
from tissuereg.experiment.experiment import Actuator, Boundary, Experiment
from tissuereg.io.cache import keep_arrays, read_arrays
from tissuereg.simulation.fine import rough_element, without_time
from tissuereg.simulation.fine.meshing import rim_of
from tissuereg.simulation.fine.rims import Folds, folds_of, outline_nodes, sharp_nodes
from tissuereg.simulation.fine.third import gaps


@dataclass(frozen=True, eq=False)
class Direction:
    """One way in which the body's shape may deviate from the mesh.

    `motion` (n_nodes, 3): motion of the mesh's nodes per mm of the deviation; `std_mm`: its prior standard deviation,
    mm.
    """

    name: str
    motion: FloatArray
    std_mm: float


def shape_directions(
    experiment: Experiment, given: Mesh | None = None, settings: ShapeSettings = DEFAULT.shape
) -> list[Direction]:
    """Return the ways in which the shape of an experiment's body may deviate from its mesh.

    `given`: the mesh whose facets the experiment's own mesh subdivides, by default that itself; gaps to the smooth
    surface are those of its facets. Result: ten for each pad, one for each support whose edge is no edge of the body,
    and those of the whole surface.
    """
    surface = _BodySurface(experiment, given or experiment.mesh, settings)
    found = [direction for pad in experiment.actuators for direction in _of_pad(surface, pad)]
    found += [direction for support in experiment.boundaries for direction in _of_support(surface, support)]
    return [*found, *_of_surface(surface, experiment)]


class _BodySurface:
    """The surface of a body: unit normals and gaps to the smooth surface, mm, (n_nodes, 3), sharp edges, patches."""

    def __init__(self, experiment: Experiment, given: Mesh, settings: ShapeSettings) -> None:
        from scipy.spatial import KDTree

        self.settings = settings
        self.mesh: Mesh = experiment.mesh
        self.folds: Folds = folds_of(self.mesh.nodes, self.mesh.surface)
        ends = given.nodes[(self.folds if given is self.mesh else folds_of(given.nodes, given.surface)).edges]
        self._edges, self._lengths = KDTree(ends.mean(axis=1)), np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        self.normals = node_normals(self.mesh, self.folds.normals * self.folds.areas[:, None])
        between = gaps(given)
        self.facets = float(np.sqrt((between[given.surface_nodes] ** 2).sum(axis=1).mean()))
        self.gaps = between if given is self.mesh else _carried(given, between, self.mesh)
        self.sharp = sharp_nodes(self.mesh.nodes, self.mesh.surface)
        self.patches: Sequence[Actuator | Boundary] = (*experiment.actuators, *experiment.boundaries)

    def of(self, patch: Actuator | Boundary) -> IntArray:
        """Return the numbers of the nodes of a patch that lie on the surface, sorted."""
        return np.intersect1d(patch.nodes, self.mesh.surface_nodes)

    def radius(self, nodes: IntArray) -> float:
        """Return the radius, mm, of a disc of a patch's area: a third of a facet counts for each corner in `nodes`."""
        share = np.isin(self.mesh.surface, nodes).sum(axis=1) / 3.0
        return float(np.sqrt((share * self.folds.areas).sum() / np.pi))

    def unresolved(self, nodes: IntArray, ball_radius: float | None) -> float:
        """Return the deviation of a patch's edge due to the given mesh, mm; `ball_radius`: mm, of a patch in a ball."""
        outline = outline_nodes(self.mesh.surface, nodes)
        if not len(outline):
            return 0.0
        length = float(self._lengths[self._edges.query(self.mesh.nodes[outline])[1]].mean())
        if ball_radius is None:
            return self.settings.edge_share * length
        # The area of n nodes a distance h apart is n h^2; n has the deviation lattice * (radius / h)^(1/2).
        finer = length / self.settings.finer
        return float(self.settings.lattice * finer**1.5 / (2.0 * np.pi * ball_radius**0.5))

    def stays(self, patch: Actuator | Boundary) -> np.ndarray:
        """Return a mask (n_nodes,) of the nodes that stay when a patch moves: edges of the body and other patches."""
        others = [other.nodes for other in self.patches if other is not patch]
        return np.isin(np.arange(self.mesh.n_nodes), np.concatenate([self.sharp, *others]))

    def near(self, patch: Actuator | Boundary, radius: float) -> FloatArray:
        """Return how every node moves with a patch, (n_nodes, 1): 1 on it, a Gaussian of the distance, or 0."""
        from scipy.spatial import KDTree

        away = KDTree(self.mesh.nodes[self.of(patch)]).query(self.mesh.nodes)[0]
        moves = np.exp(-0.5 * (away / (self.settings.reach * radius)) ** 2)
        return np.where(self.stays(patch), 0.0, moves)[:, None]

    def along(self, motion: FloatArray) -> FloatArray:
        """Return a motion (n_nodes, 3) without its part along the surface's normals."""
        return np.asarray(motion - (motion * self.normals).sum(axis=1, keepdims=True) * self.normals)


def _of_pad(surface: _BodySurface, pad: Actuator) -> Iterator[Direction]:
    mesh, inside = surface.mesh, surface.of(pad)
    normal = surface.normals[inside].mean(axis=0) if len(inside) else np.zeros(3)
    rim = rim_of(pad)
    radius = surface.radius(inside) if rim is None else rim.radius
    if np.linalg.norm(normal) < surface.settings.round_below:
        yield from _of_grip(surface, pad, radius)
        return
    normal /= np.linalg.norm(normal)
    rules, mesh_edge = surface.settings, surface.unresolved(inside, None if rim is None else rim.radius)
    place = _std_of(pad, rules.place_share * radius, mesh_edge)
    size, height = _std_of(pad, rules.size_share * radius, mesh_edge), _std_of(pad, rules.height_share * radius)
    arms = mesh.nodes - (mesh.nodes[inside].mean(axis=0) if rim is None else np.asarray(rim.centre))
    near = surface.near(pad, radius)
    first = np.linalg.svd(normal[None])[2][1]
    sides = np.array([first, np.cross(normal, first)])
    for number, side in enumerate(sides):
        yield Direction(f"place of {pad.name} {number}", surface.along(near * side), place)
    outwards = surface.along(near * arms / radius)
    yield Direction(f"size of {pad.name}", outwards, size)
    angle = np.arctan2(arms @ sides[1], arms @ sides[0])
    for times in rules.waves:
        for number, wave in enumerate((np.cos(times * angle), np.sin(times * angle))):
            yield Direction(f"rim of {pad.name} {times} {number}", wave[:, None] * outwards, place)
    # Facets lie off the smooth surface, and each at its own angle.
    across = float(np.hypot(height, np.sqrt((surface.gaps[inside] ** 2).sum(axis=1).mean())))
    yield Direction(f"height of {pad.name}", near * normal, across)
    for number, side in enumerate(sides):
        turned = (arms @ side / radius)[:, None] * near * normal
        yield Direction(f"tilt of {pad.name} {number}", turned, rules.tilt_share * across)


def _of_grip(surface: _BodySurface, pad: Actuator, radius: float) -> Iterator[Direction]:
    """Yield the deviations of a pad that surrounds the body: shifts along its surface, and a displaced edge."""
    near = surface.near(pad, radius)
    rules, mesh_edge = surface.settings, surface.unresolved(surface.of(pad), None)
    place = _std_of(pad, rules.place_share * radius, mesh_edge)
    for axis, side in enumerate(np.eye(3)):
        motion = surface.along(near * side)
        if motion.any():
            yield Direction(f"place of {pad.name} {axis}", motion, place)
    yield from _of_support(surface, pad)


def _of_support(surface: _BodySurface, support: Actuator | Boundary) -> Iterator[Direction]:
    mesh, inside = surface.mesh, surface.of(support)
    beyond = mesh.surface[~np.isin(mesh.surface, inside).all(axis=1)]
    rim = np.setdiff1d(outline_nodes(mesh.surface, inside), np.flatnonzero(surface.stays(support)))
    if not len(rim):
        return
    outwards = np.zeros_like(mesh.nodes)
    middles = mesh.nodes[beyond].mean(axis=1)
    for corner in range(3):
        np.add.at(outwards, beyond[:, corner], middles - mesh.nodes[beyond[:, corner]])
    outwards = surface.along(outwards)
    motion = np.zeros_like(mesh.nodes)
    motion[rim] = outwards[rim] / np.maximum(np.linalg.norm(outwards[rim], axis=1, keepdims=True), 1e-300)
    share = surface.settings.place_share * surface.radius(inside)
    yield Direction(f"edge of {support.name}", motion, _std_of(support, share, surface.unresolved(inside, None)))


def _std_of(patch: Actuator | Boundary, share: float, unresolved: float = 0.0) -> float:
    """Return the stated deviation of a patch's edge, mm; else that of a share of its size and of the mesh together."""
    return float(np.hypot(share, unresolved)) if patch.edge_std is None else patch.edge_std


def _of_surface(surface: _BodySurface, experiment: Experiment) -> Iterator[Direction]:
    mesh = surface.mesh
    held = [support.nodes for support in experiment.boundaries]
    free = np.setdiff1d(mesh.surface_nodes, np.concatenate(held) if held else [])
    facets = surface.facets
    if facets > 1e-6 * mesh.extent:
        yield Direction("facets", surface.gaps / facets, facets)
    std = float(np.hypot(experiment.surface_std, facets))
    if not std > 1e-6 * mesh.extent:
        return
    length = experiment.surface_length or surface.settings.length_share * mesh.extent
    for number, pattern in enumerate(thinned_patterns(mesh.nodes[free], length, surface.settings)):
        motion = np.zeros_like(mesh.nodes)
        motion[free] = pattern[:, None] * surface.normals[free]
        yield Direction(f"surface {number}", motion, std)


def _carried(given: Mesh, motion: FloatArray, mesh: Mesh) -> FloatArray:
    """Return a motion (n_given, 3) of a mesh carried to one whose surface subdivides its, (n_nodes, 3); zero inside."""
    places = mesh.nodes[mesh.surface_nodes]
    between = MarkerObservation(given, places, tuple(f"node {node}" for node in mesh.surface_nodes))
    carried = np.zeros_like(mesh.nodes)
    carried[mesh.surface_nodes] = between.predict(motion[between.nodes])
    return carried


def shape_nuisances(bench: Bench, fine: FloatArray, *, keep: bool = False) -> list[tuple[str, FloatArray]]:
    """Return name and column (size,), mm and mN, of each deviation of the shape, by one prior standard deviation.

    `fine`: as for `shape_columns`; `keep`: whether the columns are read from and written to the cache.
    """
    experiment = bench.experiment
    edges = [pad.edge_std for pad in experiment.actuators] + [support.edge_std for support in experiment.boundaries]
    stated = [experiment.surface_std, experiment.surface_length, edges]
    numbers = f"{FINE_SCHEMA} {bench.predictor.element} {stated} {bench.settings.shape} {bench.settings.model}"
    entry = f"shape_{fingerprint(experiment, numbers)}"
    kept = read_arrays(entry) if keep else None
    if kept is not None:
        return list(zip(kept["names"].tolist(), kept["columns"], strict=True))
    found = [(direction.name, direction.std_mm * column) for direction, column in shape_columns(bench, fine)]
    if keep and found:
        names, columns = zip(*found, strict=True)
        keep_arrays(entry, {"names": np.array(names), "columns": np.array(columns)})
    return found


def shape_columns(bench: Bench, fine: FloatArray) -> Iterator[tuple[Direction, FloatArray]]:
    """Yield every deviation of the body's shape with the change of the prediction (size,) that it makes, per mm.

    A model with memory is replaced by its elastic counterpart. `fine` (size,): prediction of the believed model on the
    fine mesh with ten-node elements, mm and mN. Changes are in mm and mN; forces are mapped to those of ten-node
    elements (`Correction`). Raises `ConvergenceError` if a frame has no equilibrium.

    Costs one factored tangent of the fine mesh for each state, and for each direction and state one evaluation of the
    internal forces and one solution.
    """
    experiment, element = bench.fine.fine, rough_element(bench.fine.fine)
    if not bench.is_elastic:
        experiment = without_time(experiment, element)
    predictor = Predictor(
        experiment, bench.layout, element=element, threads=bench.predictor.threads, settings=bench.settings.model
    )
    directions = shape_directions(experiment, bench.experiment.mesh, bench.settings.shape)
    columns = Tangents(predictor, keep=False).by_shapes([direction.motion for direction in directions])
    corrected = make_correction(bench.layout, predictor.predict(), fine).of_columns(columns)
    yield from zip(directions, corrected, strict=True)
