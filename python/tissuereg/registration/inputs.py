"""Input of a registration, checked once, and its settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arguments import flag, maybe, named, of_kind, real, whole
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg._base.choice import check_choice
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import MarkerObservation, TargetObservation
from tissuereg.body.surface import SurfacePoints
from tissuereg.errors import ArgumentError, MarkerError, ShapeError, SurfaceError
from tissuereg.registration.contacts.settings import ContactSettings
from tissuereg.registration.readings import suspect
from tissuereg.registration.readings.clouds import suspect_points
from tissuereg.registration.readings.scatter import scattered
from tissuereg.registration.readings.skin import skin_of

#: How the latents of a trained model are found.
UPDATES = ("esmda", "gauss-newton")


@dataclass(frozen=True)
class RegisterSettings:
    """Settings of a registration.

    Parameters
    ----------
    update : {"esmda", "gauss-newton"}
        How the latents of a trained model are found: by an ensemble, or as the most probable ones with the Gaussian
        about them, which needs fewer decodes.
    n_members, n_steps : int
        Ensemble size N_e and number of assimilations N_a, with a trained model. With ``update="gauss-newton"`` so many
        draws from the Gaussian stand for the posterior, and there are no steps.
    decrease : float
        Ratio of successive inflation coefficients.
    decode_all : bool
        Decode the ensemble before every update. By default a calibrated model, whose answer is found about the
        ensemble's mean, decodes before the first and the last; between them predictions follow their regression.
    contacts : ContactSettings
        Prior and sampling of unknown contacts, without a model.

    Raises
    ------
    ArgumentError
        If a value is not a number or out of its range.
    """

    update: str = "esmda"
    n_members: int = 200
    n_steps: int = 5
    decrease: float = 2.0
    decode_all: bool = False
    contacts: ContactSettings = field(default_factory=ContactSettings)

    def __post_init__(self) -> None:
        check_choice("update", self.update, UPDATES, ArgumentError)
        whole("n_members", self.n_members, least=2)
        whole("n_steps", self.n_steps, least=1)
        real("decrease", self.decrease, above=0.0)
        flag("decode_all", self.decode_all)
        of_kind("contacts", self.contacts, ContactSettings)


@dataclass(frozen=True, eq=False)
class RegisterInput:
    """Checked input of a registration.

    Attributes
    ----------
    mesh : Mesh
        Undeformed body.
    markers : Markers
        Checked markers.
    observed : MarkerObservation
        Attachment of the markers to the mesh.
    targets : TargetObservation
        Inner points.
    settings : RegisterSettings
        Settings of the registration.
    seed, threads : int
        Seed of all random numbers; threads to use.
    suspicions : tuple of str
        Why the input may be misread, in sentences.
    surface : SurfacePoints or None
        Points of the surface.
    """

    mesh: Mesh
    markers: Markers
    observed: MarkerObservation
    targets: TargetObservation
    settings: RegisterSettings
    seed: int
    threads: int
    suspicions: tuple[str, ...]
    surface: SurfacePoints | None = None


@dataclass(frozen=True, eq=False)
class Attachment:
    """What a registration's input is before anything was measured, checked; made once for a body and its points.

    Attributes
    ----------
    mesh : Mesh
        Undeformed body.
    places : Markers
        Reference places, noise and names of the markers.
    observed : MarkerObservation
        Their attachment to the mesh.
    targets : TargetObservation
        Inner points.
    settings : RegisterSettings
        Settings of the registration.
    seed, threads : int
        Seed of all random numbers; threads to use.
    held : str
        How the node set ``fixed`` is taken.
    """

    mesh: Mesh
    places: Markers
    observed: MarkerObservation
    targets: TargetObservation
    settings: RegisterSettings
    seed: int
    threads: int
    held: str

    @classmethod
    def of(
        cls,
        mesh: Any,
        markers: Any,
        targets: Mapping[str, Any] | None,
        settings: RegisterSettings | None,
        seed: int,
        threads: int,
        held: str = "sure",
    ) -> "Attachment":
        """Check what was given, and attach markers and targets to the mesh.

        Raises
        ------
        ShapeError, MarkerError
            If something does not fit.
        """
        body, places = as_mesh(mesh), as_markers(markers)
        try:
            observed = MarkerObservation.of(body, places)
        except MarkerError as error:
            # Refused; state which other reading would fit.
            found = suspect(body, places)
            if found:
                error.args = (f"{error}; {found[0].sentence}",)
            raise
        inner = TargetObservation(body, named("targets", targets, error=MarkerError))
        how = maybe("settings", settings, RegisterSettings) or RegisterSettings()
        return cls(body, places, observed, inner, how, seed, threads, held)

    def suspicions(self, markers: Markers) -> tuple[str, ...]:
        """Return reasons why markers may be misread; see `tissuereg.registration.readings.suspect` for the cost."""
        if not len(markers):
            return ()
        found = suspect(self.mesh, markers, self.observed)
        return tuple(one.sentence for one in found if self.held == "sure" or one.kind != "held")

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
            suspicions = (*suspicions, *_points_suspected(self.mesh, surface, self.held))
        return RegisterInput(
            self.mesh,
            markers,
            self.observed,
            self.targets,
            self.settings,
            self.seed,
            self.threads,
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


def as_mesh(mesh: Any) -> Mesh:
    """Return a mesh, made from (nodes, tets, fixed_nodes) if necessary."""
    if isinstance(mesh, Mesh):
        return mesh
    if not isinstance(mesh, tuple) or len(mesh) != 3:
        message = f"`mesh` must be a Mesh or (nodes, tets, fixed_nodes), got {type(mesh).__name__}"
        raise ShapeError(message, where="mesh")
    return Mesh(mesh[0], mesh[1], {"fixed": mesh[2]})


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
    given = float_array("simulation", simulation, (mesh.n_nodes, 3))
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
