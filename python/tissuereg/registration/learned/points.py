"""A latent model at the markers and targets of a registration: what depends on their places is computed once.

From the first draw of the ensemble to the last covariance only markers and targets are needed; whole fields are decoded
for the size of the event, on which the model's error depends, and for the answer.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.registration.learned.calibration import PointCalibration
from tissuereg.registration.learned.model import Anchors, Gaussian, LatentModel, ScaledErrors, ScalesErrors, mean_square
from tissuereg.registration.learned.network import NetworkModel


@dataclass(frozen=True, eq=False)
class ErrorsAt:
    """Expected errors of a model at markers and targets: truth minus reconstruction of fields not used in training.

    `markers` (n_fields, n_markers, 3) are those at the markers, `targets` (n_fields, n_targets, 3) those at the
    targets, in mm; `nodes` is a function that returns the mean square length (n_nodes,) at the nodes, in mm^2.
    """

    markers: FloatArray
    targets: FloatArray
    nodes: Callable[[], FloatArray]


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
        self._errors: dict[int, tuple[FloatArray, FloatArray]] = {}
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
            return PointsAround(self, self.model, simulation)
        return PointsAround(self, self.model.around(simulation), simulation, simulation)

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
    def calibration(self) -> PointCalibration | None:
        """The calibration (measured accuracy) of the model at the markers and targets; None if the model has none."""
        whole = getattr(self.model, "calibration", None)
        return None if whole is None else whole.at(lambda fields: self.components(self.at_points(fields)))

    @property
    def knows_changes(self) -> bool:
        """Whether the model was calibrated with pairs of simulation and truth."""
        return self.calibration is not None and self.calibration.change_errors is not None

    def errors(self, law: ScaledErrors, scale: FloatArray) -> ErrorsAt:
        """Return the model's errors at markers and targets, each error field times its factor `scale` (n_fields,).

        `law` holds the error fields (n_fields, n_nodes, 3); their values at the points are computed once.
        """
        if id(law) not in self._errors:
            moved = self.at_points(law.fields)
            self._errors[id(law)] = self.markers(moved), self.targets(moved)
        markers, targets = self._errors[id(law)]
        factors = scale[:, None, None]
        return ErrorsAt(factors * markers, factors * targets, lambda: law.mean_square(scale))


class PointsAround:
    """A latent model for one moment (one set of measurements) at markers and targets.

    `at` is the model at these points; `latent` is the model centred on the simulation of the moment, if it can be;
    `simulation` (n_nodes, 3) is the simulated displacement, in mm, or None; `anchor` (n_nodes, 3) is the field that the
    prior's mean decodes to, in mm, if the latents describe differences from it. The attribute `prior` is the prior of
    the latents given the simulation, `family` the distribution of the latents of all training fields.
    """

    def __init__(
        self,
        at: PointModel,
        latent: LatentModel,
        simulation: FloatArray | None,
        anchor: FloatArray | None = None,
    ) -> None:
        self._at, self.latent = at, latent
        self.prior: Gaussian = latent.prior(simulation)
        self.family: Gaussian = self.prior if simulation is None else latent.prior(None)
        self._shift: FloatArray | None = None
        self._anchor = None if anchor is None else at.at_points(anchor)

    def first(self, latents: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the displacement of the points at the prior's mean, (n_points, 3), and for each member.

        `latents` (n_latent, n_members) are the members; their displacements are (n_members, n_points, 3); all are in
        mm. If the latents describe differences from a simulation, the mean decodes to it.
        """
        moved = self._at.decode(np.concatenate([self.prior.mean[:, None], latents], axis=1))
        if self._anchor is not None:
            self._shift = self._anchor - moved[0]
            moved = moved + self._shift
        return moved[0], moved[1:]

    def decode(self, latents: FloatArray) -> FloatArray:
        """Return displacements (n_members, n_points, 3), mm, of the points, for latents (n_latent, n_members)."""
        if self._anchor is not None and self._shift is None:
            self.first(latents[:, :0])
        moved = self._at.decode(latents)
        return moved if self._shift is None else moved + self._shift

    @property
    def calibration(self) -> PointCalibration | None:
        """The calibration (measured accuracy) of the model at the markers and targets; None if the model has none."""
        return self._at.calibration

    def components(self, moved: FloatArray) -> FloatArray:
        """Return components (n_fields, 3 (n_markers + n_targets)), in mm, from displacements (n_fields, n_points, 3).

        Markers come first, then targets, each with x, y and z.
        """
        return self._at.components(moved)

    def at_rows(self, field: FloatArray) -> FloatArray:
        """Return the components (3 (n_markers + n_targets),) of markers, then targets, in a field (n_nodes, 3), mm."""
        return np.asarray(self.all_rows(field[None])[0])

    def all_rows(self, fields: FloatArray) -> FloatArray:
        """Return the displacement of markers and targets in whole fields, components in a row, in mm.

        `fields` has shape (n_fields, n_nodes, 3), the result (n_fields, 3 (n_markers + n_targets)), markers first.
        """
        return self._at.components(self._at.at_points(fields))

    def markers(self, moved: FloatArray) -> FloatArray:
        """Return displacements (..., n_markers, 3), mm, of the markers from those of all points (..., n_points, 3)."""
        return self._at.markers(moved)

    def targets(self, moved: FloatArray) -> FloatArray:
        """Return displacements (..., n_targets, 3), mm, of the targets from those of all points (..., n_points, 3)."""
        return self._at.targets(moved)

    def errors(self, latents: FloatArray | None = None) -> ErrorsAt:
        """Return expected errors at markers and targets for latents (n_latent,); those of a typical event for None."""
        if isinstance(self.latent, ScalesErrors):
            return self._at.errors(*self.latent.error_law(latents))
        own = self.latent.errors(latents)
        moved = self._at.at_points(own)
        return ErrorsAt(self.markers(moved), self.targets(moved), lambda: mean_square(own))
