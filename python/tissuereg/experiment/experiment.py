"""An experiment: the believed model of a rig, and everything that was measured on it.

The classes are plain data, which `tissuereg.read_experiment` reads from a folder. Times are in s on one clock through
all load cases, lengths in mm, forces in mN, stresses in kPa.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arguments import each, maybe, named, of_kind, real, text
from tissuereg._base.arrays import FloatArray, IntArray, float_array
from tissuereg._base.choices import Element
from tissuereg.body.markers import Markers
from tissuereg.body.material import GRAVITY_MM_PER_S2, Material
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ExperimentError

if TYPE_CHECKING:
    from tissuereg.experiment.effects.base import Effect


@dataclass(frozen=True)
class Simulated:
    """The model by which this package simulated the data of an experiment, where they are not measured.

    Attributes
    ----------
    model : {"fine", "plain"}
        The fine model (`tissuereg.FineModel`, which refines the mesh at the pads), or the mesh as it is.
    element : {"tet4", "tet4-averaged", "tet10"}
        Finite elements of the plain model; the fine one always has ten-node elements.
    tables_sha256 : str, optional
        SHA-256 of mesh and tables that the statement is about; None if the file does not state it.
    """

    model: str
    element: Element
    tables_sha256: str | None = None


@dataclass(frozen=True, eq=False)
class BodyWeight:
    """Gravity that acts on the body.

    Attributes
    ----------
    direction : ndarray of float64, shape (3,)
        Direction of gravity; a vector of any length but zero.
    g_mm_per_s2 : float
        Acceleration of gravity in mm/s^2.
    in_reference : bool
        Whether the body had the shape of the mesh under this gravity, so that the mesh hangs in it already.
    """

    direction: FloatArray
    in_reference: bool
    g_mm_per_s2: float = GRAVITY_MM_PER_S2


@dataclass(frozen=True, eq=False)
class Boundary:
    """A patch of surface nodes that is held: its nodes do not move.

    Attributes
    ----------
    name : str
        Name of the boundary, and of its node set in the mesh.
    nodes : ndarray of int64, shape (n,)
        Sorted node indices.
    kind : str
        Always ``"fixed"``.
    rule : str or mapping, optional
        Rule by which the experiment file selects the nodes; None if they were given directly.
    edge_std : float, optional
        Standard deviation of the position of the patch's edge, mm; None if it is not stated.
    """

    name: str
    nodes: IntArray
    kind: str = "fixed"
    rule: str | Mapping[str, Any] | None = None
    edge_std: float | None = None


@dataclass(frozen=True, eq=False)
class Actuator:
    """A patch of surface nodes that is moved, or on which a force acts.

    Attributes
    ----------
    name : str
        Name of the actuator, and of its node set in the mesh.
    nodes : ndarray of int64, shape (n,)
        Sorted node indices.
    kind : {"displacement", "force"}
        Quantity that is prescribed: the displacement of the patch or the total force on it.
    contact : str
        Always ``"bonded"``: the patch sticks to the body.
    rule : str or mapping, optional
        Rule by which the experiment file selects the nodes; None if they were given directly.
    edge_std : float, optional
        Standard deviation of the position of the patch's edge, mm; None if it is not stated.
    """

    name: str
    nodes: IntArray
    kind: str
    contact: str = "bonded"
    rule: str | Mapping[str, Any] | None = None
    edge_std: float | None = None


@dataclass(frozen=True, eq=False)
class Case:
    """One load case: a history of loads, which begins with the unloaded body at rest, and what was measured during it.

    Attributes
    ----------
    name : str
        Name of the case in the tables of the experiment.
    times : ndarray of float64, shape (n_frames,)
        Times of the frames in s, increasing.
    markers : ndarray of float64, shape (n_frames, n_markers, 3)
        Measured places of the markers in mm, in the experiment's order of markers; NaN where the tracker did not see
        one.
    displacements : mapping of str to ndarray of float64, shape (n_frames, 3)
        Commanded displacement of each displacement actuator that is present, by its name, in mm relative to the shape
        of the body at the start of the case.
    applied_forces : mapping of str to ndarray of float64, shape (n_frames, 3)
        Commanded force of each force actuator that is present, by its name, in mN.
    forces : mapping of str to ndarray of float64, shape (n_frames, 3)
        Measured force on the body at an actuator, by the actuator's name, in mN; NaN where not measured.
    targets : mapping of str to ndarray of float64, shape (n_frames, 3)
        Measured places of inner points, by name, in mm; NaN where not measured.
    """

    name: str
    times: FloatArray
    markers: FloatArray
    displacements: Mapping[str, FloatArray] = field(default_factory=dict)
    applied_forces: Mapping[str, FloatArray] = field(default_factory=dict)
    forces: Mapping[str, FloatArray] = field(default_factory=dict)
    targets: Mapping[str, FloatArray] = field(default_factory=dict)

    @property
    def frame_step(self) -> float:
        """Median time between frames in s; 0 for a single frame."""
        return float(np.median(np.diff(self.times))) if len(self.times) > 1 else 0.0

    def index(self, time: float) -> int:
        """Return the number of the frame nearest to a time.

        Parameters
        ----------
        time : float
            Time in s, on the experiment's clock.

        Returns
        -------
        int
            Index into `times`.

        Raises
        ------
        ExperimentError
            If no frame lies within half a frame step.
        """
        of_kind("time", time, (int, float, np.number), error=ExperimentError)
        nearest = int(np.argmin(np.abs(self.times - time)))
        if not abs(self.times[nearest] - time) <= 0.5 * self.frame_step + 1e-6:
            message = (
                f"case '{self.name}' must have a frame within half a step of {time:g} s; its {len(self.times)} "
                f"frames run from {self.times[0]:g} to {self.times[-1]:g} s, the nearest is at "
                f"{self.times[nearest]:g} s"
            )
            raise ExperimentError(message, where=self.name)
        return nearest


@dataclass(frozen=True, eq=False)
class ExperimentFrame:
    """Commands and measurements at one moment (frame) of one load case.

    Attributes
    ----------
    case : str
        Name of the case.
    time : float
        Time of the frame in s.
    index : int
        Index of the frame in its case.
    markers : Markers
        Markers with reference and measured places, mm.
    displacements : dict of str to ndarray of float64, shape (3,)
        Commanded displacement of each displacement actuator, mm.
    applied_forces : dict of str to ndarray of float64, shape (3,)
        Commanded force of each force actuator, mN.
    targets : dict of str to ndarray of float64, shape (3,)
        Measured places of inner points in mm; NaN where not measured.
    """

    case: str
    time: float
    index: int
    markers: Markers
    displacements: dict[str, FloatArray]
    applied_forces: dict[str, FloatArray]
    targets: dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class Experiment:
    """The believed model of a rig (body, supports, actuators), and the load cases measured on it.

    Attributes
    ----------
    name : str
        Title of the experiment.
    folder : Path
        Folder of its tables.
    mesh_file : Path
        File of its mesh.
    mesh : Mesh
        Mesh in the reference shape. Its node set ``fixed`` has the nodes of all boundaries; each boundary and each
        actuator has a node set of its name.
    material : Material
        Believed material: the mean of its prior distribution.
    young_std : float or None
        Prior standard deviation of Young's modulus in kPa; None if it is not stated.
    poisson_std : float or None
        Prior standard deviation of Poisson's ratio; None if it is not stated.
    gravity : BodyWeight or None
        Gravity on the body; None if the file has no table ``[gravity]``, and then no weight acts.
    boundaries : tuple of Boundary
        Held patches of the surface.
    actuators : tuple of Actuator
        Moved or pulled patches of the surface. An actuator that a load case does not mention is absent from it.
    marker_names : tuple of str
        Names of the markers, in the order of all marker arrays.
    marker_reference : ndarray of float64, shape (n_markers, 3)
        Places of the markers on the body in the reference shape, mm.
    marker_std : float
        Standard deviation of a measured coordinate, mm.
    targets : dict of str to ndarray of float64, shape (3,)
        Places of inner points in the reference shape, by name, mm.
    cases : dict of str to Case
        Load cases by name, in the order of the file.
    force_std : float or None
        Standard deviation of a measured force component in mN; None if no forces are measured.
    rest_case : str or None
        Name of a case without load, from which the noise is estimated; None if there is none.
    effects : tuple of Effect
        Effects (deviations such as an inclusion or relaxation) that the user believes in, in the order of the
        ``[[effect]]`` tables of the file.
    trial_share : float
        Standard deviation of the difference between two trials (repetitions) of the same load case, as a share of the
        markers' motion; the difference is taken to be smooth over the markers.
    surface_std : float
        Standard deviation of the distance between the surface of the body and that of the mesh, along the normal, mm.
    surface_length : float or None
        Correlation length of that distance, mm; None if it is not stated.
    simulated : Simulated or None
        Model by which this package simulated the data; None if they were measured, or simulated otherwise.
    """

    name: str
    folder: Path
    mesh_file: Path
    mesh: Mesh
    material: Material
    young_std: float | None
    poisson_std: float | None
    gravity: BodyWeight | None
    boundaries: tuple[Boundary, ...]
    actuators: tuple[Actuator, ...]
    marker_names: tuple[str, ...]
    marker_reference: FloatArray
    marker_std: float
    targets: dict[str, FloatArray]
    cases: dict[str, Case]
    force_std: float | None = None
    rest_case: str | None = None
    effects: "tuple[Effect, ...]" = ()
    trial_share: float = 0.0
    surface_std: float = 0.0
    surface_length: float | None = None
    simulated: Simulated | None = None

    def __post_init__(self) -> None:
        text("name", self.name, error=ExperimentError)
        of_kind("mesh", self.mesh, Mesh, error=ExperimentError)
        of_kind("material", self.material, Material, error=ExperimentError)
        maybe("gravity", self.gravity, BodyWeight, error=ExperimentError)
        maybe("simulated", self.simulated, Simulated, error=ExperimentError)
        for name, kind in (
            ("boundaries", Boundary),
            ("actuators", Actuator),
            ("marker_names", str),
            ("effects", object),
        ):
            each(name, getattr(self, name), kind, error=ExperimentError)
        float_array("marker_reference", self.marker_reference, (len(self.marker_names), 3))
        real("marker_std", self.marker_std, above=0.0, unit="mm", error=ExperimentError)
        for name in ("young_std", "poisson_std", "force_std", "surface_length"):
            if getattr(self, name) is not None:
                real(name, getattr(self, name), above=0.0, error=ExperimentError)
        for name in ("trial_share", "surface_std"):
            real(name, getattr(self, name), least=0.0, error=ExperimentError)
        named("targets", self.targets, error=ExperimentError)
        each("cases", named("cases", self.cases, error=ExperimentError).values(), Case, error=ExperimentError)
        if self.rest_case is not None:
            text("rest_case", self.rest_case, error=ExperimentError)

    def __repr__(self) -> str:
        frames = sum(len(case.times) for case in self.cases.values())
        return (
            f"Experiment('{self.name}', {self.mesh.n_nodes} nodes, {len(self.marker_names)} markers, "
            f"{len(self.actuators)} actuators, {len(self.cases)} cases, {frames} frames)"
        )

    def case(self, name: str) -> Case:
        """Return a load case by its name.

        Parameters
        ----------
        name : str
            Name of the case in the tables of the experiment.

        Returns
        -------
        Case
            The load case: loads and measurements over time.

        Raises
        ------
        ExperimentError
            If there is no such case.
        """
        if text("name of a case", name, error=ExperimentError) not in self.cases:
            message = f"experiment '{self.name}' must have a case '{name}'; it has: {', '.join(self.cases)}"
            raise ExperimentError(message, where=name)
        return self.cases[name]

    def actuator(self, name: str) -> Actuator:
        """Return an actuator by its name.

        Parameters
        ----------
        name : str
            Name of the actuator in the experiment file.

        Returns
        -------
        Actuator
            The actuator: its patch of nodes and the quantity that it prescribes.

        Raises
        ------
        ExperimentError
            If there is no such actuator.
        """
        text("name of an actuator", name, error=ExperimentError)
        for actuator in self.actuators:
            if actuator.name == name:
                return actuator
        known = ", ".join(actuator.name for actuator in self.actuators) or "none"
        message = f"experiment '{self.name}' must have an actuator '{name}'; it has: {known}"
        raise ExperimentError(message, where=name)

    def frame(self, case: str, time: float) -> ExperimentFrame:
        """Return the commands and measurements at one moment of one load case.

        Parameters
        ----------
        case : str
            Name of the case.
        time : float
            Time in s; the nearest frame is taken, which must lie within half a frame step.

        Returns
        -------
        ExperimentFrame
            Markers, commands of the actuators, measured targets.
        """
        history = self.case(case)
        row = history.index(time)
        markers = Markers(self.marker_reference, history.markers[row], self.marker_std, self.marker_names)
        return ExperimentFrame(
            case=case,
            time=float(history.times[row]),
            index=row,
            markers=markers,
            displacements={name: values[row] for name, values in history.displacements.items()},
            applied_forces={name: values[row] for name, values in history.applied_forces.items()},
            targets={name: values[row] for name, values in history.targets.items()},
        )
