"""A latent model at the markers and targets of a registration: what depends on their places is made once.

Everything between the first draw and the last covariance needs markers and targets alone; whole fields are decoded for
the size of the event, on which the model's error depends, and for the answer.
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
    """Errors of a model for one state: truth minus reconstruction of fields not used in training, mm.

    `markers` (n_fields, n_markers, 3): at the markers; `targets` (n_fields, n_targets, 3): at the targets; `nodes`:
    returns their mean square length (n_nodes,) at the nodes, mm^2.
    """

    markers: FloatArray
    targets: FloatArray
    nodes: Callable[[], FloatArray]


class PointModel:
    """A latent model at markers and targets.

    `model`: a trained network is cut down to the points; of any other model the nodes around them are decoded;
    `markers`: attachment of the markers; `targets`: inner points. `n_decoded`: members decoded so far.
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
        """Multiply-adds of the cut decoder, one member; 0 if the model is not cut."""
        return 0 if self._cut is None else self._cut.multiply_adds

    def around(self, simulation: FloatArray | None) -> "PointsAround":
        """Return the model of one moment; if it can, its latents then describe changes from the simulation.

        `simulation` (n_nodes, 3) or None: simulated displacement, mm.
        """
        if simulation is None or not isinstance(self.model, Anchors):
            return PointsAround(self, self.model, simulation)
        return PointsAround(self, self.model.around(simulation), simulation, simulation)

    def decode(self, latents: FloatArray) -> FloatArray:
        """Return displacements (n_members, n_points, 3), mm, of the points, for latents (n_latent, n_members)."""
        self.n_decoded += latents.shape[1]
        return self._cut(latents) if self._cut is not None else self.at(self.model.decode(latents, self._nodes))

    def at(self, fields: FloatArray) -> FloatArray:
        """Return displacements (..., n_points, 3) of the points in fields (..., k, 3) of the k nodes around them."""
        columns = np.moveaxis(fields, -2, 0)
        moved = self._near @ columns.reshape(len(columns), math.prod(columns.shape[1:]))
        return np.moveaxis(np.asarray(moved).reshape(self._near.shape[0], *columns.shape[1:]), 0, -2)

    def at_points(self, fields: FloatArray) -> FloatArray:
        """Return displacements (..., n_points, 3) of the points in whole fields (..., n_nodes, 3)."""
        return self.at(fields[..., self._nodes, :])

    def markers(self, moved: FloatArray) -> FloatArray:
        """Return displacements (..., n_markers, 3) of the markers, given those of all points (..., n_points, 3)."""
        return self._markers.predict_points(moved[..., : self._split, :])

    def targets(self, moved: FloatArray) -> FloatArray:
        """Return displacements (..., n_targets, 3) of the targets, given those of all points (..., n_points, 3)."""
        return moved[..., self._split :, :]

    def components(self, moved: FloatArray) -> FloatArray:
        """Return components (n_fields, 3 (n_markers + n_targets)) of displacements (n_fields, n_points, 3), mm."""
        both = np.concatenate([self.markers(moved), self.targets(moved)], axis=1)
        return both.reshape(len(both), -1)

    @cached_property
    def calibration(self) -> PointCalibration | None:
        """The model's calibration at the markers and targets; None if the model has none."""
        whole = getattr(self.model, "calibration", None)
        return None if whole is None else whole.at(lambda fields: self.components(self.at_points(fields)))

    @property
    def knows_changes(self) -> bool:
        """Whether the model was calibrated with pairs of simulation and truth."""
        return self.calibration is not None and self.calibration.change_errors is not None

    def errors(self, law: ScaledErrors, scale: FloatArray) -> ErrorsAt:
        """Return the model's errors at markers and targets, each error field times its factor (n_fields,).

        `law`: error fields; what they are at the points is computed once.
        """
        if id(law) not in self._errors:
            moved = self.at_points(law.fields)
            self._errors[id(law)] = self.markers(moved), self.targets(moved)
        markers, targets = self._errors[id(law)]
        factors = scale[:, None, None]
        return ErrorsAt(factors * markers, factors * targets, lambda: law.mean_square(scale))


class PointsAround:
    """A latent model of one moment at markers and targets.

    `at`: the model at these points; `latent`: the model of the moment; `simulation` (n_nodes, 3) or None: simulated
    displacement, mm; `anchor` (n_nodes, 3): what the mean of the prior decodes to, if the latents are of changes from
    it, mm. `prior`, `family`: latents given the simulation, and those of all training fields.
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
        """Return displacements of the points at the prior's mean, (n_points, 3), and of members.

        `latents` (n_latent, n_members). The members' displacements are (n_members, n_points, 3), mm. If the latents
        describe changes from a simulation, the mean decodes to it.
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
        """The model's calibration at the markers and targets; None if the model has none."""
        return self._at.calibration

    def components(self, moved: FloatArray) -> FloatArray:
        """Return displacements (n_fields, n_points, 3) as components (n_fields, 3 (n_markers + n_targets)), mm."""
        return self._at.components(moved)

    def at_rows(self, field: FloatArray) -> FloatArray:
        """Return the components (3 (n_markers + n_targets),) of one field (n_nodes, 3), mm."""
        return np.asarray(self.all_rows(field[None])[0])

    def all_rows(self, fields: FloatArray) -> FloatArray:
        """Return the components (n_fields, 3 (n_markers + n_targets)) of fields (n_fields, n_nodes, 3), mm."""
        return self._at.components(self._at.at_points(fields))

    def markers(self, moved: FloatArray) -> FloatArray:
        """Return displacements (..., n_markers, 3) of the markers, given those of all points (..., n_points, 3)."""
        return self._at.markers(moved)

    def targets(self, moved: FloatArray) -> FloatArray:
        """Return displacements (..., n_targets, 3) of the targets, given those of all points (..., n_points, 3)."""
        return self._at.targets(moved)

    def errors(self, latents: FloatArray | None = None) -> ErrorsAt:
        """Return the model's expected errors for latents (n_latent,); those of a typical event for None."""
        if isinstance(self.latent, ScalesErrors):
            return self._at.errors(*self.latent.error_law(latents))
        own = self.latent.errors(latents)
        moved = self._at.at_points(own)
        return ErrorsAt(self.markers(moved), self.targets(moved), lambda: mean_square(own))
