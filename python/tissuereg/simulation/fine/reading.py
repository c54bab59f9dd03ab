"""Markers, targets and forces in the solved frames of a case, and corrections of forces and of frames with memory."""

from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.experiment.experiment import Experiment
from tissuereg.simulation.memory import SolvedCase
from tissuereg.simulation.settings import FINE


def force_maps(rough: FloatArray, fine: FloatArray) -> FloatArray:
    """Return one matrix per frame that maps a pad's force on coarse elements to its force on fine ones.

    `rough`, `fine` (n_frames, 3): elastic forces of one pad in one case, on coarse and fine elements, mN; NaN in frames
    without equilibrium. Result: (n_frames, 3, 3); ``map @ rough`` is ``fine`` in loaded frames, unless they differ by
    more than 60 % of the force. A frame without load has the map of the least loaded one; all are the identity if no
    frame is loaded.

    Notes
    -----
    Coarse elements are too stiff by a factor that depends on how far the pad has moved. A relaxed force needs the
    factor of the body's present shape; adding the frame's elastic difference instead leaves a larger error.
    """
    size = np.linalg.norm(rough, axis=1)
    size[~np.isfinite(fine).all(axis=1)] = np.nan
    identity: FloatArray = np.tile(np.eye(3), (len(rough), 1, 1))
    if not np.nanmax(size, initial=0.0) > 0.0:
        return identity
    loaded = size > FINE.least_loaded * np.nanmax(size)
    least = int(np.argmin(np.where(loaded, size, np.inf)))
    taken = np.where(loaded, np.arange(len(rough)), least)
    before, after = rough[taken], fine[taken]
    power = (before**2).sum(axis=1)[:, None]
    ratio = (before * after).sum(axis=1)[:, None] / power
    along = np.clip(ratio, 1.0 - FINE.most_changed, 1.0 + FINE.most_changed)
    across = (after - ratio * before) / np.sqrt(power)
    across *= np.minimum(1.0, FINE.most_changed / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-300))
    turned = across[:, :, None] * (before / np.sqrt(power))[:, None, :]
    return np.asarray(along[:, :, None] * identity + turned)


def mapped(forces: FloatArray, maps: FloatArray) -> FloatArray:
    """Return forces (..., 3), in mN, each multiplied by its 3 x 3 matrix of `maps` (..., 3, 3)."""
    return np.asarray(np.einsum("...j,...ij->...i", forces, maps))


@dataclass(frozen=True, eq=False)
class FineFrames:
    """Displacements, markers, targets and forces in the frames of one case (load history).

    `displacement` (n_frames, n_nodes, 3): of the nodes of the mesh before refinement, mm; NaN in frames without
    equilibrium; `markers` (n_frames, n_markers, 3): places of the markers, mm, without errors of their tracker;
    `targets` (n_frames, n_targets, 3): places of the targets (inner points), mm; `forces`: by the name of each
    displacement actuator that is present, its force on the body, (n_frames, 3), mN; `failed`: frames without
    equilibrium, with the reason.
    """

    displacement: FloatArray
    markers: FloatArray
    targets: FloatArray
    forces: dict[str, FloatArray]
    failed: list[tuple[int, str]]


class Reader:
    """Interpolator of displacement fields of a fine mesh at markers, targets and the nodes of the unrefined mesh.

    `experiment`: experiment on the fine mesh; `given`: the mesh from which it was refined: its nodes come first, some
    of them moved onto the rim of a pad; `quadratic`: whether fields are those of ten-node elements.
    """

    def __init__(self, experiment: Experiment, given: Mesh, *, quadratic: bool) -> None:
        self._n_given = given.n_nodes
        self._moved = np.flatnonzero((experiment.mesh.nodes[: given.n_nodes] != given.nodes).any(axis=1))
        names = tuple(f"node {node}" for node in self._moved)
        places = given.nodes[self._moved]
        self._old = MarkerObservation(experiment.mesh, places, names, quadratic=quadratic) if names else None
        self._markers = MarkerObservation(
            experiment.mesh, experiment.marker_reference, experiment.marker_names, quadratic=quadratic
        )
        self._marker_reference = experiment.marker_reference
        self._targets = TargetObservation(experiment.mesh, experiment.targets, quadratic=quadratic)

    def read(self, solved: SolvedCase) -> FineFrames:
        """Return displacements, places of markers and targets (mm), and forces (mN) in the frames of a case."""
        field = solved.all_displacement
        displacement = solved.displacement[:, : self._n_given].copy()
        if self._old is not None:
            # The node's place before it was moved onto the rim.
            displacement[:, self._moved] = self._old.predict(field[:, self._old.nodes])
        return FineFrames(
            displacement,
            self._marker_reference + self._markers.predict(field[:, self._markers.nodes]),
            self._targets.reference + self._targets.predict(field[:, self._targets.nodes]),
            solved.forces,
            solved.failed,
        )


def corrected(rough: FineFrames, rough_elastic: FineFrames, fine_elastic: FineFrames) -> FineFrames:
    """Return frames of a case with memory by first-order elements, corrected towards ten-node elements.

    `rough`: with memory, first-order elements; `rough_elastic`: the same case without memory, the same elements;
    `fine_elastic`: without memory, finer elements on the same mesh. Result: displacements and places, mm, plus the
    difference of the two elastic solutions; forces, mN: the fine elastic force, plus the rough force's change by memory
    times the map (`force_maps`) from rough to fine elastic forces.
    """
    forces = {}
    for name, force in rough.forces.items():
        before, after = rough_elastic.forces[name], fine_elastic.forces[name]
        forces[name] = after + mapped(force - before, force_maps(before, after))
    lost = dict(rough_elastic.failed) | dict(fine_elastic.failed) | dict(rough.failed)
    return FineFrames(
        rough.displacement + (fine_elastic.displacement - rough_elastic.displacement),
        rough.markers + (fine_elastic.markers - rough_elastic.markers),
        rough.targets + (fine_elastic.targets - rough_elastic.targets),
        forces,
        sorted(lost.items()),
    )
