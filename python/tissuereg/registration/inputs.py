"""Input of a registration, checked once."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arguments import named
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.body.surface import SurfacePoints
from tissuereg.errors import MarkerError, ShapeError, SurfaceError
from tissuereg.registration.body import Body
from tissuereg.registration.learned.variants import checked_variants
from tissuereg.registration.readings import suspect
from tissuereg.registration.readings.clouds import scattered, suspect_points
from tissuereg.registration.readings.skin import skin_of
from tissuereg.registration.settings import RegisterSettings

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration


@dataclass(frozen=True, eq=False, init=False)
class SimulationVariants:
    """One moment simulated with other values of what is uncertain: moduli, supports, loads, poses of tools.

    Taken in place of a simulation by a registration with a model that was calibrated with pairs. Two dozen or more say
    how this body may differ from its simulation, where a model knows how bodies in general do. Registration starts from
    their mean.

    Parameters
    ----------
    fields : array_like of float, shape (n_variants, n_nodes, 3)
        Displacements, mm; four or more.
    simulation : array_like of float, shape (n_nodes, 3), optional
        The simulation that the answer is compared with, mm; by default their mean.

    Raises
    ------
    ShapeError
        If an array has another shape, a field is not finite, or there are fewer than four.

    Examples
    --------
    >>> SimulationVariants(np.zeros((24, 4258, 3)))
    SimulationVariants(24 fields, 4258 nodes)
    """

    fields: FloatArray
    simulation: FloatArray | None

    def __init__(self, fields: Any, simulation: Any = None) -> None:
        given = checked_variants(fields)
        own = None if simulation is None else _finite_field(simulation, given.shape[1])
        object.__setattr__(self, "fields", given)
        object.__setattr__(self, "simulation", own)

    def __repr__(self) -> str:
        return f"SimulationVariants({len(self.fields)} fields, {self.fields.shape[1]} nodes)"


@dataclass(frozen=True, eq=False)
class MomentInput:
    """What is known of one moment.

    `markers`: measured, with the reference places that the registrar was made for; `surface`: points of the surface;
    without a model only; `simulation` (n_nodes, 3) or None: displacement of the moment, mm; `after`: of a moment
    shortly before; without a model only.
    """

    markers: Markers
    surface: SurfacePoints | None = None
    simulation: Any = None
    after: "Registration | None" = None


@dataclass(frozen=True, eq=False)
class RegisterInput:
    """Checked input of a registration.

    Attributes
    ----------
    body : Body
        What is believed of the undeformed body.
    markers : Markers
        Checked markers.
    observed : MarkerObservation
        Attachment of the markers to the mesh.
    targets : TargetObservation
        Inner points.
    settings : RegisterSettings
        Settings of the registration.
    seed : int
        Seed of all random numbers.
    suspicions : tuple of str
        Why the input may be misread, in sentences.
    surface : SurfacePoints or None
        Points of the surface.
    """

    body: Body
    markers: Markers
    observed: MarkerObservation
    targets: TargetObservation
    settings: RegisterSettings
    seed: int
    suspicions: tuple[str, ...]
    surface: SurfacePoints | None = None

    @property
    def mesh(self) -> Mesh:
        """The undeformed body."""
        return self.body.mesh

    @property
    def threads(self) -> int:
        """Threads to use; 0 takes all cores."""
        return self.settings.threads


@dataclass(frozen=True, eq=False)
class Attachment:
    """What a registration's input is before anything was measured, checked; made once for a body and its points.

    Attributes
    ----------
    body : Body
        What is believed of the undeformed body.
    places : Markers
        Reference places, noise and names of the markers.
    observed : MarkerObservation
        Their attachment to the mesh.
    targets : TargetObservation
        Inner points.
    settings : RegisterSettings
        Settings of the registration.
    seed : int
        Seed of all random numbers.
    """

    body: Body
    places: Markers
    observed: MarkerObservation
    targets: TargetObservation
    settings: RegisterSettings
    seed: int

    @property
    def mesh(self) -> Mesh:
        """The undeformed body."""
        return self.body.mesh

    @classmethod
    def of(
        cls, body: Body, places: Markers, targets: Mapping[str, Any] | None, settings: RegisterSettings, seed: int
    ) -> "Attachment":
        """Check what was given, and attach markers and targets to the mesh.

        Raises
        ------
        ShapeError, MarkerError
            If something does not fit.
        """
        try:
            observed = MarkerObservation.of(body.mesh, places)
        except MarkerError as error:
            # Refused; state which other reading would fit.
            found = suspect(body.mesh, places)
            if found:
                error.args = (f"{error}; {found[0].sentence}",)
            raise
        inner = TargetObservation(body.mesh, named("targets", targets, error=MarkerError))
        return cls(body, places, observed, inner, settings, seed)

    def suspicions(self, markers: Markers) -> tuple[str, ...]:
        """Return reasons why markers may be misread; see `tissuereg.registration.readings.suspect` for the cost."""
        if not len(markers):
            return ()
        found = suspect(self.mesh, markers, self.observed)
        return tuple(one.sentence for one in found if self.body.held == "sure" or one.kind != "held")

    @cached_property
    def astray(self) -> tuple[str, ...]:
        """Reason why the reference places may be those of another body, if there is one; found once."""
        near = skin_of(self.mesh).closest(self.places.reference)
        distance = np.copysign(self.observed.distance, near.distance)
        return tuple(one.sentence for one in scattered(distance, self.mesh.extent))

    def holds(self, markers: Markers) -> bool:
        """Whether markers have the reference places and names of these, so that the attachment is theirs as well."""
        return self.places.names == markers.names and np.array_equal(self.places.reference, markers.reference)

    def measured(self, markers: Markers, surface: SurfacePoints | None = None, suspects: bool = True) -> RegisterInput:
        """Return the input of one moment; with `suspects`, also suspicions that the markers are misread.

        Raises
        ------
        MarkerError, SurfaceError
            If nothing was seen, or points of the surface lie far from the body.
        """
        suspicions = self.suspicions(markers) if suspects else ()
        if surface is None and not np.isfinite(markers.measured).any():
            message = f"at least one marker must have been seen; all {len(markers)} are missing"
            raise MarkerError(message, where="markers")
        if surface is not None:
            suspicions = (*suspicions, *_points_suspected(self.mesh, surface, self.body.held))
        return RegisterInput(
            self.body,
            markers,
            self.observed,
            self.targets,
            self.settings,
            self.seed,
            suspicions,
            surface,
        )


def _points_suspected(mesh: Mesh, surface: SurfacePoints, held: str) -> tuple[str, ...]:
    """Return reasons why points of the surface may be misread; refuse points far from the body."""
    free = held == "free" or not any(len(mesh.node_sets.get(name, ())) for name in ("fixed", "perhaps_fixed"))
    found = suspect_points(mesh, surface.places, free=free)
    if found and found[0].kind in ("unit", "far from the surface"):
        raise SurfaceError(found[0].sentence, where="surface")
    return tuple(one.sentence for one in found)


def as_markers(markers: Any) -> Markers:
    """Return markers, made from (reference, measured) if necessary; None gives an empty set."""
    if markers is None:
        return Markers(np.empty((0, 3)), np.empty((0, 3)))
    if isinstance(markers, Markers):
        return markers
    if not isinstance(markers, tuple) or len(markers) != 2:
        message = f"`markers` must be Markers or (reference, measured), got {type(markers).__name__}"
        raise ShapeError(message, where="markers")
    return Markers(*markers)


def finite_field(simulation: Any, mesh: Mesh) -> FloatArray:
    """Return a displacement field (n_nodes, 3) checked."""
    return _finite_field(simulation, mesh.n_nodes)


def _finite_field(simulation: Any, n_nodes: int) -> FloatArray:
    given = float_array("simulation", simulation, (n_nodes, 3))
    if not np.isfinite(given).all():
        node = int(np.argmin(np.isfinite(given).all(axis=1)))
        message = f"`simulation` must be finite, got {given[node].tolist()} at node {node}"
        raise ShapeError(message, where="simulation")
    return given


def rms_length(vectors: FloatArray) -> float:
    """Return the root mean square length of vectors (n, 3); components that are NaN are ignored."""
    squares = np.where(np.isfinite(vectors), vectors, 0.0) ** 2
    seen = np.isfinite(vectors).any(axis=1)
    return float(np.sqrt(squares.sum() / max(1, int(seen.sum()))))
