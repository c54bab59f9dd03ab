"""Input of a registration, checked once: body, markers, surface points, targets, simulation and settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
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
from tissuereg.registration.readings import Suspicion, suspect
from tissuereg.registration.readings.clouds import scattered, suspect_points
from tissuereg.registration.readings.lost import lost as lost_markers
from tissuereg.registration.readings.skin import skin_of
from tissuereg.registration.settings import RegisterSettings

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration


@dataclass(frozen=True, eq=False, init=False)
class SimulationVariants:
    """Simulations of one moment with different values of uncertain parameters: moduli, supports, loads, poses of tools.

    A registration takes an instance in place of a single simulation if it uses a trained model that was calibrated with
    pairs of simulation and true displacement. Two dozen fields or more describe how this body may differ from its
    simulation, whereas the model describes how bodies in general do. Registration starts from the mean of the fields.

    Parameters
    ----------
    fields : array_like of float, shape (n_variants, n_nodes, 3)
        Displacement of each node in each simulation, mm; four simulations or more.
    simulation : array_like of float, shape (n_nodes, 3), optional
        Displacement by the simulation with which the result is compared, mm; by default the mean of `fields`.

    Raises
    ------
    ShapeError
        If an array has another shape, a field is not finite, or there are fewer than four fields.

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
    """Measurements and simulation of one moment, as they enter a registration.

    `markers`: markers measured at this moment, mm, with the reference places that the registrar was made for;
    `surface`: points measured on the surface, mm, or None, without a trained model only; `simulation`: displacement of
    the nodes at this moment by a simulation, (n_nodes, 3), mm, or `SimulationVariants`, or None; `after`: registration
    of a moment shortly before, whose contacts are the start of this one's search, or None, without a trained model
    only; `lost`: name of each marker whose measured place is no measurement, as the moments before tell, with the
    reason.
    """

    markers: Markers
    surface: SurfacePoints | None = None
    simulation: Any = None
    after: "Registration | None" = None
    lost: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class RegisterInput:
    """Checked input of the registration of one moment.

    Attributes
    ----------
    body : Body
        Prior assumptions about the undeformed body: mesh, material, elements, supports.
    markers : Markers
        Reference and measured places of the markers, mm.
    observed : MarkerObservation
        Map from the displacement of nodes to that of the markers.
    targets : TargetObservation
        Inner points whose places are estimated, with the map from the displacement of nodes to theirs.
    settings : RegisterSettings
        Settings of the registration.
    seed : int
        Seed of all random numbers.
    suspicions : tuple of str
        Sentences that say why the input may be misread, such as in other units or axes; empty if it is plausible.
    surface : SurfacePoints or None
        Points measured on the deformed surface, mm; None if there are none.
    lost : mapping of str to str
        Name of each marker whose measured place is no measurement, so that it counts as not seen, with the reason.
    swap : Suspicion or None
        A suspicion, among `suspicions`, that markers are exchanged, which is certain enough to put them back.
    put_back : tuple of str
        Sentence on markers that were exchanged in the input and are put back in `markers`.
    """

    body: Body
    markers: Markers
    observed: MarkerObservation
    targets: TargetObservation
    settings: RegisterSettings
    seed: int
    suspicions: tuple[str, ...]
    surface: SurfacePoints | None = None
    lost: Mapping[str, str] = field(default_factory=dict)
    swap: Suspicion | None = None
    put_back: tuple[str, ...] = ()

    @property
    def mesh(self) -> Mesh:
        """Mesh of the undeformed body."""
        return self.body.mesh

    @property
    def notes(self) -> list[str]:
        """Reasons against the answer that are known before anything is fitted."""
        return [*self.put_back, *self.suspicions]

    def why_unseen(self, marker: int) -> str:
        """Return the reason why the marker of this number counts as not seen."""
        return self.lost.get(self.markers.names[marker], "not seen")

    def in_order(self) -> "RegisterInput":
        """Return the input with the markers of `swap` put back; itself without one."""
        if self.swap is None:
            return self
        markers, names, measured = self.markers, self.swap.markers, self.markers.measured.copy()
        rows = [markers.names.index(name) for name in names]
        measured[rows] = self.swap.measured
        said = self.swap.sentence
        return replace(
            self,
            markers=Markers(markers.reference, measured, markers.axis_std, markers.names),
            suspicions=tuple(one for one in self.suspicions if one != said),
            swap=None,
            put_back=(f"{said}; they were put back",),
        )

    @property
    def threads(self) -> int:
        """Number of threads to use; 0 takes all cores."""
        return self.settings.threads


@dataclass(frozen=True, eq=False)
class Attachment:
    """Checked input of registrations as far as it does not depend on measurements; made once for a body and its points.

    Attributes
    ----------
    body : Body
        Prior assumptions about the undeformed body: mesh, material, elements, supports.
    places : Markers
        Markers of which reference places (mm), noise (mm) and names are used.
    observed : MarkerObservation
        Map from the displacement of nodes to that of the markers.
    targets : TargetObservation
        Inner points whose places are estimated, with the map from the displacement of nodes to theirs.
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
        """Mesh of the undeformed body."""
        return self.body.mesh

    @classmethod
    def of(
        cls, body: Body, places: Markers, targets: Mapping[str, Any] | None, settings: RegisterSettings, seed: int
    ) -> "Attachment":
        """Check the input, locate markers and targets in the mesh, and return the result.

        `body`: prior assumptions about the body; `places`: markers with reference places, mm; `targets`: inner points
        by name, each (3,), mm, or None; `settings`, `seed`: of the registration.

        Raises
        ------
        ShapeError, MarkerError
            If an array has another shape, or a marker or target lies far from the body.
        """
        try:
            observed = MarkerObservation.of(body.mesh, places)
        except MarkerError as error:
            # Refused; state which other reading would fit.
            found = suspect(body.held_mesh, places)
            if found:
                error.args = (f"{error}; {found[0].sentence}",)
            raise
        inner = TargetObservation(body.mesh, named("targets", targets, error=MarkerError))
        return cls(body, places, observed, inner, settings, seed)

    def suspicions(self, markers: Markers) -> list[Suspicion]:
        """Return suspicions that the input is misread, such as in other units or axes; empty if it is plausible.

        `markers`: reference and measured places, mm. A motion of markers on held surface counts only if the body is
        surely held. See `tissuereg.registration.readings.suspect` for the cost.
        """
        found = suspect(self.body.held_mesh, markers, self.observed) if len(markers) else []
        return [one for one in found if self.body.held == "sure" or one.kind != "held"]

    @cached_property
    def astray(self) -> tuple[str, ...]:
        """Sentence that the reference places may be those of another body, as a tuple of one; empty if they fit."""
        near = skin_of(self.mesh).closest(self.places.reference)
        distance = np.copysign(self.observed.distance, near.distance)
        return tuple(one.sentence for one in scattered(distance, self.mesh.extent))

    def holds(self, markers: Markers) -> bool:
        """Whether `markers` have the names and reference places of the attached ones, so that it is valid for them."""
        return self.places.names == markers.names and np.array_equal(self.places.reference, markers.reference)

    def measured(self, moment: MomentInput, *, suspects: bool = True) -> RegisterInput:
        """Return the checked input of the registration of one moment, without markers that are lost.

        `moment`: reference and measured places of markers, and points of the surface; `suspects`: whether to examine
        the markers for misreadings, such as other units or axes.

        Raises
        ------
        MarkerError, SurfaceError
            If no coordinate of a marker was seen and there are no points of the surface, or such points are in another
            unit or lie far from the body.
        """
        surface, lost = moment.surface, dict(moment.lost)
        lost |= lost_markers(moment.markers.without(lost), self.mesh.extent)
        markers = moment.markers.without(lost)
        found = self.suspicions(markers) if suspects else []
        suspicions = tuple(one.sentence for one in found)
        if surface is None and not np.isfinite(markers.measured).any():
            message = f"at least one marker must have been seen; all {len(markers)} are missing"
            message += "".join(f"; {name} ({why})" for name, why in [*lost.items()][:3])
            raise MarkerError(message, where="markers")
        if surface is not None:
            suspicions = (*suspicions, *_points_suspected(self.mesh, surface, free=self.body.supports.moves))
        return RegisterInput(
            self.body,
            markers,
            self.observed,
            self.targets,
            self.settings,
            self.seed,
            suspicions,
            surface,
            lost,
            next((one for one in found if one.measured is not None), None),
        )


def _points_suspected(mesh: Mesh, surface: SurfacePoints, *, free: bool) -> tuple[str, ...]:
    """Return sentences that say why points of the surface may be misread; raise `SurfaceError` if they lie far away.

    `mesh`: undeformed body; `surface`: measured points, mm; `free`: whether nothing holds the body. Points in another
    unit raise the error as well.
    """
    found = suspect_points(mesh, surface.places, free=free)
    if found and found[0].kind in ("unit", "far from the surface"):
        raise SurfaceError(found[0].sentence, where="surface")
    return tuple(one.sentence for one in found)


def as_markers(markers: Any) -> Markers:
    """Return `Markers`, made from a pair (reference, measured) in mm if necessary; None gives an empty set."""
    if markers is None:
        return Markers(np.empty((0, 3)), np.empty((0, 3)))
    if isinstance(markers, Markers):
        return markers
    if not isinstance(markers, tuple) or len(markers) != 2:
        message = f"`markers` must be Markers or (reference, measured), got {type(markers).__name__}"
        raise ShapeError(message, where="markers")
    return Markers(*markers)


def finite_field(simulation: Any, mesh: Mesh) -> FloatArray:
    """Return a simulated displacement (n_nodes, 3), in mm, as an array; raise `ShapeError` if it is not finite."""
    return _finite_field(simulation, mesh.n_nodes)


def _finite_field(simulation: Any, n_nodes: int) -> FloatArray:
    given = float_array("simulation", simulation, (n_nodes, 3))
    if not np.isfinite(given).all():
        node = int(np.argmin(np.isfinite(given).all(axis=1)))
        message = f"`simulation` must be finite, got {given[node].tolist()} at node {node}"
        raise ShapeError(message, where="simulation")
    return given


def rms_length(vectors: FloatArray) -> float:
    """Return the root mean square length of the vectors (n, 3), in their unit; components that are NaN are ignored."""
    squares = np.where(np.isfinite(vectors), vectors, 0.0) ** 2
    seen = np.isfinite(vectors).any(axis=1)
    return float(np.sqrt(squares.sum() / max(1, int(seen.sum()))))
