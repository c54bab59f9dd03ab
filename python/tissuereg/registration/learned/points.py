"""A latent model at the markers and targets of a registration: what depends on their places is computed once.

From the first draw of the ensemble to the last covariance only markers and targets are needed; whole fields are decoded
for the size of the event, on which the model's error depends, and for the answer.
"""

import math
from functools import cached_property
from typing import cast

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.registration.learned.calibration import PointCalibration
from tissuereg.registration.learned.model import Anchored, Anchors, LatentModel
from tissuereg.registration.learned.network import NetworkModel
from tissuereg.registration.learned.stated import stated


class PointModel:
    """A latent model evaluated at the markers and targets of registrations.

    `model` is the latent model: a trained network is reduced to the points, and of any other model the nodes around the
    points are decoded. `markers` and `targets` interpolate the displacement of markers and targets. The points are
    those of the markers, of which one off the surface needs several, and then one for each target. The attribute
    `n_decoded` is the number of members decoded so far.
    """

    def __init__(self, model: LatentModel, markers: MarkerObservation, targets: TargetObservation) -> None:
        from scipy import sparse

        self.model = model
        self._markers, self._targets = markers, targets
        at_markers = markers.points(model.n_nodes)
        self._split = at_markers.shape[0]
        self.rows = sparse.vstack([at_markers, targets.points(model.n_nodes)], format="csr")
        self._nodes = np.unique(self.rows.indices).astype(np.int64)
        self._near = self.rows[:, self._nodes]
        self._cut = model.cut(self.rows) if isinstance(model, NetworkModel) else None
        self.n_decoded = 0

    @property
    def multiply_adds(self) -> int:
        """Number of multiply-adds of the decoder at the points for one member; 0 if the model has no such decoder."""
        return 0 if self._cut is None else self._cut.multiply_adds

    def around(self, simulation: FloatArray | None) -> "PointsAround":
        """Return the model of one moment, centred on its simulation, a displacement (n_nodes, 3) in mm.

        If the model can be centred, its latents then describe differences from the simulation. Without a simulation
        (None) they describe whole fields.
        """
        if simulation is None or not isinstance(self.model, Anchors):
            return PointsAround(self, self.model)
        return PointsAround(self, self.model.around(simulation), simulation)

    def decode(self, latents: FloatArray) -> FloatArray:
        """Return displacements (n_members, n_points, 3), mm, of the points, for latents (n_latent, n_members)."""
        self.n_decoded += latents.shape[1]
        return self._cut(latents) if self._cut is not None else self.at(self.model.decode(latents, self._nodes))

    def at(self, fields: FloatArray) -> FloatArray:
        """Return displacements (..., n_points, 3) of the points in fields (..., k, 3) of the nodes around them, mm."""
        columns = np.moveaxis(fields, -2, 0)
        moved = self._near @ columns.reshape(len(columns), math.prod(columns.shape[1:]))
        return np.moveaxis(np.asarray(moved).reshape(self._near.shape[0], *columns.shape[1:]), 0, -2)

    def at_points(self, fields: FloatArray) -> FloatArray:
        """Return displacements (..., n_points, 3) of the points in whole fields (..., n_nodes, 3), in mm."""
        return self.at(fields[..., self._nodes, :])

    def markers(self, moved: FloatArray) -> FloatArray:
        """Return displacements (..., n_markers, 3), mm, of the markers from those of all points (..., n_points, 3)."""
        return self._markers.predict_points(moved[..., : self._split, :])

    def targets(self, moved: FloatArray) -> FloatArray:
        """Return displacements (..., n_targets, 3), mm, of the targets from those of all points (..., n_points, 3)."""
        return moved[..., self._split :, :]

    def components(self, moved: FloatArray) -> FloatArray:
        """Return components (n_fields, 3 (n_markers + n_targets)), in mm, from displacements (n_fields, n_points, 3).

        Markers come first, then targets, each with x, y and z.
        """
        both = np.concatenate([self.markers(moved), self.targets(moved)], axis=1)
        return both.reshape(len(both), -1)

    @cached_property
    def calibration(self) -> PointCalibration:
        """What the model's answers are worth at markers and targets, as measured, or else as the model states."""
        whole = getattr(self.model, "calibration", None) or stated(self.model.prior(), self.model.errors())
        return whole.at(lambda fields: self.components(self.at_points(fields)))

    @property
    def knows_changes(self) -> bool:
        """Whether there are pairs of simulation and truth behind the calibration."""
        return self.calibration.change_errors is not None


class PointsAround:
    """A latent model for one moment (one set of measurements) at markers and targets.

    `at` is the model at these points; `latent` is the model centred on the simulation of the moment, if it can be;
    `anchor` (n_nodes, 3) is the simulated displacement, in mm, if the latents describe differences from it. The
    attribute `code` (n_latent,) are then the latents that decode to it, else it is None.
    """

    def __init__(self, at: PointModel, latent: LatentModel, anchor: FloatArray | None = None) -> None:
        self._at, self.latent = at, latent
        self.code: FloatArray | None = None
        self._shift: FloatArray | None = None
        if anchor is not None:
            code = self.code = cast(Anchored, latent).code
            self._shift = at.at_points(anchor) - at.decode(code[:, None])[0]

    def decode(self, latents: FloatArray) -> FloatArray:
        """Return components (n_members, 3 (n_markers + n_targets)), mm, for latents (n_latent, n_members)."""
        moved = self._at.decode(latents)
        return self._at.components(moved if self._shift is None else moved + self._shift)

    @property
    def calibration(self) -> PointCalibration:
        """What the model's answers are worth at markers and targets."""
        return self._at.calibration

    def at_rows(self, fields: FloatArray) -> FloatArray:
        """Return the displacement of markers and targets in whole fields, components in a row, in mm.

        `fields` has shape (n_fields, n_nodes, 3), the result (n_fields, 3 (n_markers + n_targets)), markers first.
        """
        return self._at.components(self._at.at_points(fields))
