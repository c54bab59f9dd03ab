"""What every method of the comparison is given, what it returns, and the one call that all of them share."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np

from tissuereg import Load, Markers, Material, Mesh
from tissuereg._base.arguments import check_running, maybe, named, of_kind, real
from tissuereg._base.arrays import BoolArray, FloatArray, IntArray, float_array, frozen, index_array, optional_array
from tissuereg.errors import ArgumentError, MarkerError, ShapeError
from tissuereg.registration.learned.model import LatentModel

#: What of a method's needs comes with every moment, not with the setting.
_OF_A_MOMENT = frozenset({"simulation", "variants"})


@dataclass(frozen=True, eq=False)
class Setting:
    """One body with its markers and all that is believed of it: what every method is given, once.

    Attributes
    ----------
    mesh : Mesh
        Undeformed body; its node set ``fixed`` is held.
    reference_mm : ndarray of float64, shape (n_markers, 3)
        Places of the markers on or near the undeformed surface.
    std_mm : ndarray of float64, shape (n_markers,)
        Standard deviation of a measured coordinate, the same along each axis.
    material : Material
        Believed material.
    load : Load, optional
        Believed load of the first moment.
    model : LatentModel, optional
        Trained model of the mesh.
    fields : ndarray of float64, shape (n_fields, n_nodes, 3), optional
        Training fields: displacements in mm, simulated beforehand.
    driven : ndarray of int64, shape (n_driven,)
        Nodes that the actuators move, as far as they are known; by default none.
    frame_s : float
        Time between moments, s.
    seed : int
        Source of all randomness.
    threads : int
        Threads to use; 0 takes all cores.

    Raises
    ------
    ShapeError
        If an array has another shape, a training field is not finite, or there is no such node.
    MarkerError
        If a reference place is not finite, or a standard deviation not positive and finite.
    ArgumentError
        If another part is of the wrong kind or out of its range.
    """

    mesh: Mesh
    reference_mm: FloatArray
    std_mm: FloatArray
    material: Material
    load: Load | None = None
    model: LatentModel | None = None
    fields: FloatArray | None = None
    driven: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    frame_s: float = 0.025
    seed: int = 0
    threads: int = 0

    def __post_init__(self) -> None:
        of_kind("mesh", self.mesh, Mesh)
        reference = float_array("reference_mm", self.reference_mm, (None, 3))
        std = float_array("std_mm", self.std_mm, (len(reference),))
        of_kind("material", self.material, Material)
        maybe("load", self.load, Load)
        _check_model(self.model, self.mesh)
        fields = optional_array("fields", self.fields, (None, self.mesh.n_nodes, 3))
        if fields is not None and not np.isfinite(fields).all():
            wrong = int(np.argmin(np.isfinite(fields).all(axis=(1, 2))))
            message = f"`fields` must be finite displacements in mm; field {wrong} is not"
            raise ShapeError(message, where="fields")
        driven = index_array("driven", self.driven, (None,))
        if len(driven) and not (driven.min() >= 0 and driven.max() < self.mesh.n_nodes):
            message = (
                f"`driven` must name nodes from 0 to {self.mesh.n_nodes - 1}, got {driven.min()} to {driven.max()}"
            )
            raise ShapeError(message, where="driven")
        real("frame_s", self.frame_s, above=0.0, unit="s")
        check_running(seed=self.seed, threads=self.threads)
        _check_rows("reference_mm", reference, np.asarray(np.isfinite(reference).all(axis=1)), "finite, in mm")
        _check_rows("std_mm", std, np.isfinite(std) & (std > 0.0), "positive and finite, in mm")
        object.__setattr__(self, "reference_mm", frozen(reference))
        object.__setattr__(self, "std_mm", frozen(std))
        object.__setattr__(self, "fields", fields)
        object.__setattr__(self, "driven", frozen(np.setdiff1d(driven, self.mesh.fixed_nodes)))

    @property
    def held(self) -> IntArray:
        """Nodes whose motion a simulation prescribes: those that are held, and those that the actuators move."""
        return np.union1d(self.mesh.fixed_nodes, self.driven)

    @property
    def n_markers(self) -> int:
        """Number of markers."""
        return len(self.reference_mm)

    def markers(self, measured_mm: FloatArray) -> Markers:
        """Return measured places (n_markers, 3) in mm as markers of this setting."""
        return Markers(self.reference_mm, measured_mm, self.std_mm)


@dataclass(frozen=True, eq=False)
class Estimate:
    """What a method says of one moment.

    Attributes
    ----------
    displacement_mm : ndarray of float64, shape (n_nodes, 3)
        Displacement of the nodes.
    spread_mm : ndarray of float64, shape (n_nodes, 3), optional
        Standard deviation of each of its components, where the method gives one.
    kept : mapping of str to object
        What else the method found, by name: iterations, parameters, and the like.
    """

    displacement_mm: FloatArray
    spread_mm: FloatArray | None = None
    kept: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        moved = float_array("displacement_mm", self.displacement_mm, (None, 3))
        object.__setattr__(self, "displacement_mm", moved)
        object.__setattr__(self, "spread_mm", optional_array("spread_mm", self.spread_mm, (len(moved), 3)))
        named("kept", self.kept)


@dataclass(frozen=True, eq=False)
class Moment:
    """One checked measurement.

    Attributes
    ----------
    measured_mm : ndarray of float64, shape (n_markers, 3)
        Measured places, NaN where a marker was not seen.
    displacement_mm : ndarray of float64, shape (n_seen, 3)
        Measured minus reference place of the markers that were seen.
    seen : ndarray of int64, shape (n_seen,)
        Markers that were seen, at least one.
    simulation_mm : ndarray of float64, shape (n_nodes, 3), or None
        Simulated displacement.
    """

    measured_mm: FloatArray
    displacement_mm: FloatArray
    seen: IntArray
    simulation_mm: FloatArray | None

    @property
    def start_mm(self) -> FloatArray:
        """The simulation of a method that needs one."""
        return of_kind("simulation_mm", self.simulation_mm, np.ndarray)


class Rival(ABC):
    """A method of the comparison.

    A subclass makes in its constructor everything that can be made once, and takes its tuning constants as further
    arguments with defaults.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.

    Attributes
    ----------
    name : str
        As tables print it.
    needs : frozenset of str
        What the method needs, of ``simulation``, ``model``, ``load``, ``fields`` and ``variants``.
    remembers : bool
        Whether the answer of a moment depends on the moments just before, so that none may be left out.
    setting : Setting

    Raises
    ------
    ArgumentError
        If the setting lacks what the method needs.
    """

    name: ClassVar[str]
    needs: ClassVar[frozenset[str]] = frozenset()
    remembers: ClassVar[bool] = False

    def __init__(self, setting: Setting) -> None:
        self.setting = of_kind("setting", setting, Setting)
        for part in sorted(self.needs - _OF_A_MOMENT):
            if getattr(setting, part) is None:
                message = f"`setting.{part}` must be given for the method '{self.name}', got None"
                raise ArgumentError(message, where=part)

    @abstractmethod
    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return what the method says of one moment.

        Parameters
        ----------
        measured_mm : array_like of float, shape (n_markers, 3)
            Measured places of the markers, mm; NaN = not seen. Moments come in the order of time; a method that
            remembers is made anew for each motion.
        simulation_mm : array_like of float, shape (n_nodes, 3), optional
            Simulated displacement of the moment, mm. Methods that do not need it ignore it.

        Returns
        -------
        Estimate
            Displacement of all nodes.

        Raises
        ------
        ShapeError
            If an array has another shape, or the simulation is not finite.
        MarkerError
            If no marker was seen.
        ArgumentError
            If the method needs a simulation and there is none.
        """

    def moment(self, measured_mm: Any, simulation_mm: Any = None) -> Moment:
        """Return the arguments of `register`, checked; raises as stated there."""
        reference = self.setting.reference_mm
        measured = float_array("measured_mm", measured_mm, reference.shape)
        simulation = optional_array("simulation_mm", simulation_mm, self.setting.mesh.nodes.shape)
        if simulation is not None and not np.isfinite(simulation).all():
            message = "`simulation_mm` must be finite"
            raise ShapeError(message, where="simulation_mm")
        if simulation is None and "simulation" in self.needs:
            message = f"`simulation_mm` must be given for the method '{self.name}', got None"
            raise ArgumentError(message, where="simulation_mm")
        seen = np.flatnonzero(np.isfinite(measured).all(axis=1))
        if len(seen) == 0:
            message = f"at least one of {len(reference)} markers must be seen, all rows of `measured_mm` have NaN"
            raise MarkerError(message, where="measured_mm")
        return Moment(measured, (measured - reference)[seen], seen, simulation)


def _check_rows(name: str, values: FloatArray, good: BoolArray, wanted: str) -> None:
    if not good.all():
        row = int(np.argmin(good))
        message = f"`{name}` must be {wanted}; marker {row} has {values[row].tolist()}"
        raise MarkerError(message, where=name)


def _check_model(model: Any, mesh: Mesh) -> None:
    if model is not None and getattr(model, "n_nodes", None) != mesh.n_nodes:
        known = getattr(model, "n_nodes", "no number of nodes")
        message = f"`model` must know the mesh's {mesh.n_nodes} nodes, it knows {known}"
        raise ArgumentError(message, where="model")
