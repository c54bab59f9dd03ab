"""The simulation of a tracked body, which can be exchanged: from the state of the actuators to the displacement.

Anything with the method `field` is a `Physics`. One that can also hold a registered shape by nodal forces has the
methods of `HoldingPhysics`; the package's own solver does (`FemPhysics`).
"""

from collections.abc import Callable
from typing import Any, Protocol, runtime_checkable

import numpy as np

from tissuereg._base.arguments import called, check_choice, check_running, found, of_kind, real
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg._base.choices import Element
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError, ConvergenceError, LoadError
from tissuereg.simulation.solve import Simulator


@runtime_checkable
class Physics(Protocol):
    """A simulation that returns the displacement of the body, (n_nodes, 3), mm, for a known state of the actuators."""

    def field(self, actuator: Any, *, start: FloatArray | None = None) -> FloatArray:
        """Return the displacement of the body for a known state of the actuators.

        Parameters
        ----------
        actuator : object
            State of the actuators, as this simulation takes it: a number, several numbers, or a `Load`.
        start : ndarray of float64, shape (n_nodes, 3), optional
            A displacement near the wanted one, mm: a first guess, which may be ignored.

        Returns
        -------
        ndarray of float64, shape (n_nodes, 3)
            Displacement of the nodes of the tracked body, mm.
        """
        ...


@runtime_checkable
class HoldingPhysics(Physics, Protocol):
    """A simulation that can hold a given shape by nodal forces while the actuators move on."""

    def holding(self, displacement: FloatArray, actuator: Any) -> FloatArray:
        """Return the dead loads that, beside the known actuators, hold a displacement in equilibrium.

        Parameters
        ----------
        displacement : ndarray of float64, shape (n_nodes, 3)
            A registered displacement, mm.
        actuator : object
            State of the actuators at that moment.

        Returns
        -------
        ndarray of float64, shape (n_nodes, 3)
            Nodal forces, mN; zero at held nodes.

        Raises
        ------
        LoadError
            If the displacement turns a tetrahedron inside out: no forces hold it then.
        """
        ...

    def held_field(self, actuator: Any, forces: FloatArray, start: FloatArray) -> FloatArray:
        """Return the displacement for a known state of the actuators under further dead loads.

        Parameters
        ----------
        actuator : object
            State of the actuators now.
        forces : ndarray of float64, shape (n_nodes, 3)
            Nodal dead loads that `holding` returned, mN.
        start : ndarray of float64, shape (n_nodes, 3)
            Displacement of the shape that these loads held, mm: a first guess.

        Returns
        -------
        ndarray of float64, shape (n_nodes, 3)
            Displacement of each node, mm.

        Raises
        ------
        ConvergenceError
            If there is no equilibrium.
        """
        ...


class FemPhysics:
    """The package's own finite-element solver with four-node elements as a simulation; the mesh is analysed once.

    Parameters
    ----------
    mesh : Mesh
        Undeformed body.
    material : Material
        Assumed material, by default ``Material()``.
    load_of : callable of actuator -> Load, optional
        Returns the load for a state of the actuators; by default this state is a `Load` itself, or None for no load.
    element : {"tet4", "tet4-averaged"}
        Finite elements: plain four-node tets, or those with volume ratios averaged at the nodes.
        Elements.
    held_nodes : array_like of int, optional
        Numbers of the nodes whose displacement is given; by default the node set ``fixed``.
    tolerance : float
        Norm of the residual over the norm of the load at which a solve ends; the relative error of the displacement is
        of that order.
    threads : int
        Threads to use; 0 takes all cores.

    Raises
    ------
    ArgumentError, SupportError
        If an argument is out of its range, or the body can move freely.

    Notes
    -----
    Cost of a frame: one solve, started near its answer; none while the load stands still.
    """

    def __init__(
        self,
        mesh: Mesh,
        material: Material | None = None,
        load_of: Callable[[Any], Load] | None = None,
        *,
        element: Element = "tet4",
        held_nodes: Any = None,
        tolerance: float = 1e-3,
        threads: int = 0,
    ) -> None:
        called("load_of", load_of)
        check_running(threads=threads)
        # Elements without nodes beside the mesh's.
        check_choice("element", element, ("tet4", "tet4-averaged"), ArgumentError)
        self._simulator = Simulator(mesh, element=element, held_nodes=held_nodes)
        self._material = Material() if material is None else of_kind("material", material, Material)
        self._load_of = load_of
        self._tolerance = real("tolerance", tolerance, above=0.0, below=1.0)
        self._threads = threads
        self._kept: dict[str, tuple[Load, FloatArray]] = {}

    def field(self, actuator: Any, *, start: FloatArray | None = None) -> FloatArray:
        """Return the displacement (n_nodes, 3), mm, under the load that belongs to the state of the actuators.

        `start` (n_nodes, 3): a first guess, mm.
        """
        known = self._load(actuator)
        return self._solved("known", Load(self._simulator.forces(known), known.body_force, known.prescribed), start)

    def holding(self, displacement: FloatArray, actuator: Any) -> FloatArray:
        """Return the nodal forces (n_nodes, 3), mN, that hold a displacement (n_nodes, 3), mm, beside known loads."""
        simulator = self._simulator
        forces = simulator.internal_forces(displacement, self._material)
        known = self._load(actuator)
        given = simulator.forces(known)
        if given is not None:
            forces -= given
        if known.body_force is not None:
            forces -= self._node_volumes[:, None] * float_array("body_force", known.body_force, (3,))
        forces[simulator.held_nodes] = 0.0
        return forces

    def held_field(self, actuator: Any, forces: FloatArray, start: FloatArray) -> FloatArray:
        """Return the displacement (n_nodes, 3), mm, under the known load and further nodal forces (n_nodes, 3), mN.

        `actuator`: state of the actuators that gives the known load; `start` (n_nodes, 3): a first guess, mm.
        """
        known = self._load(actuator)
        given = self._simulator.forces(known)
        together = forces if given is None else forces + given
        return self._solved("held", Load(together, known.body_force, known.prescribed), start)

    def _load(self, actuator: Any) -> Load:
        load = actuator if self._load_of is None else self._load_of(actuator)
        return Load() if load is None else of_kind("actuator", load, Load, error=LoadError)

    def _solved(self, which: str, load: Load, start: FloatArray | None) -> FloatArray:
        """Return the equilibrium (n_nodes, 3), mm, under a load; the one kept as `which` if its load is equal."""
        if which in self._kept and start is not None and _same(self._kept[which][0], load):
            return np.array(self._kept[which][1])
        settings: dict[str, Any] = {"tolerance": self._tolerance, "threads": self._threads}
        try:
            found = self._simulator.solve(load, self._material, start=start, **settings).displacement
        except (ConvergenceError, LoadError):
            if start is None:
                raise
            found = self._simulator.solve(load, self._material, **settings).displacement
        parts = (None if part is None else np.array(part) for part in (load.forces, load.body_force, load.prescribed))
        self._kept[which] = Load(*parts), found.copy()
        return found

    @property
    def _node_volumes(self) -> FloatArray:
        mesh, volumes = self._simulator.mesh, np.zeros(self._simulator.mesh.n_nodes)
        np.add.at(volumes, mesh.tets, 0.25 * mesh.volumes[:, None])
        return volumes


def _same(one: Load, other: Load) -> bool:
    """Whether two loads without tractions are equal."""
    parts = ((one.forces, other.forces), (one.body_force, other.body_force), (one.prescribed, other.prescribed))
    return all(a is b is None or (a is not None and b is not None and np.array_equal(a, b)) for a, b in parts)


class CalledPhysics:
    """A simulation made of a function of the actuators' state: another solver, a formula, a reader of files.

    Parameters
    ----------
    function : callable of actuator -> array_like of float, shape (n_nodes, 3)
        Returns the displacement in mm on the nodes of the tracked body.

    Raises
    ------
    ArgumentError
        If `function` cannot be called.
    """

    def __init__(self, function: Callable[[Any], Any]) -> None:
        if not callable(function):
            message = f"`function` must be a function of the actuators' state, got {found(function)}"
            raise ArgumentError(message, where="function")
        self._function = function

    def field(self, actuator: Any, *, start: FloatArray | None = None) -> FloatArray:
        """Return the displacement (n_nodes, 3), mm, that the given function returns for the state of the actuators."""
        return float_array("simulation", self._function(actuator), (None, 3))


def as_physics(given: Any, name: str) -> Physics:
    """Return the argument `name` as a simulation, with a function wrapped; raise `ArgumentError` if it is neither."""
    if isinstance(given, Physics) and not isinstance(given, type):
        return given
    if callable(given) and not isinstance(given, type):
        return CalledPhysics(given)
    message = f"`{name}` must have a method `field` or be a function of the actuators, got {found(given)}"
    raise ArgumentError(message, where=name)
