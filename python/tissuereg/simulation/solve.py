"""One static solve, or many on one body: the Python interface of the compiled (Rust) solver."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

import numpy as np

from tissuereg import _core
from tissuereg._base.arguments import (
    MOST_COUNTED,
    called,
    check_choice,
    check_running,
    each,
    flag,
    of_kind,
    real,
    text,
    whole,
)
from tissuereg._base.arrays import FloatArray, IntArray, depth, float_array, index_array, optional_array, stacked
from tissuereg._base.choices import ELEMENTS, Element
from tissuereg._base.shown import short_repr
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError, LoadError, MaterialError
from tissuereg.simulation.bed import core_springs, stiffness_array
from tissuereg.simulation.size import check_fits


class LoadParts(TypedDict):
    """The parts of a load as the compiled solver takes them; of many loads, each array has the member axis first.

    `forces` (n_element_nodes, 3): nodal forces, mN; `body_force` (3,): mN/mm^3; `prescribed` (n_held, 3): displacement
    of the held nodes, mm. None where a load has no such part.
    """

    forces: FloatArray | None
    body_force: FloatArray | None
    prescribed: FloatArray | None


def stacked_parts(parts: Sequence[LoadParts]) -> LoadParts:
    """Return the parts of many loads stacked along a new first axis, (n_members, ...).

    A part is zero where one load lacks it, and None if all loads lack it.
    """
    return {
        "forces": stacked([part["forces"] for part in parts]),
        "body_force": stacked([part["body_force"] for part in parts]),
        "prescribed": stacked([part["prescribed"] for part in parts]),
    }


@dataclass(frozen=True, eq=False)
class Simulation:
    """Result of a solve: the equilibrium of a body under one load.

    Attributes
    ----------
    displacement : ndarray of float64, shape (n_nodes, 3)
        Displacement of the mesh's nodes in mm.
    reactions : ndarray of float64, shape (n_held, 3)
        Force on the body at every held node in mN, in the order of the held nodes.
    all_displacement : ndarray of float64, shape (n_element_nodes, 3)
        Displacement of all nodes in mm: those of the mesh, then the mid-edge nodes of ten-node elements.
    report : dict
        Work and quality of the solve, among them `iterations`, `solves` (solutions with a factor), `factorisations`,
        `load_steps`, `residual` (norm of the unbalanced forces over that of the load) and `min_det_f` (smallest
        determinant of the deformation gradient).
    """

    displacement: FloatArray
    reactions: FloatArray
    all_displacement: FloatArray
    report: dict[str, Any]

    __repr__ = short_repr


@dataclass(frozen=True, eq=False)
class Simulations:
    """Result of many solves on one body; a member is one load with its material, and failed members are rows of NaN.

    Attributes
    ----------
    displacement : ndarray of float64, shape (n_members, n_nodes, 3)
        Displacement of the mesh's nodes in mm.
    reactions : ndarray of float64, shape (n_members, n_held, 3)
        Force on the body at every held node in mN.
    failed : list of (int, str)
        Index of every member without equilibrium, with the reason.
    all_displacement : ndarray of float64, shape (n_members, n_element_nodes, 3)
        Displacement of all nodes in mm: those of the mesh, then the mid-edge nodes of ten-node elements.
    """

    displacement: FloatArray
    reactions: FloatArray
    failed: list[tuple[int, str]]
    all_displacement: FloatArray

    @property
    def solved(self) -> IntArray:
        """Indices of the members that found equilibrium, shape (n_solved,), ascending."""
        lost = {index for index, _ in self.failed}
        return np.array([i for i in range(len(self.displacement)) if i not in lost], dtype=np.int64)


class Simulator:
    """A mesh analysed once for many solves: element data, ordering, symbolic factor.

    Parameters
    ----------
    mesh : Mesh
        Reference shape.
    element : {"tet4", "tet4-averaged", "tet10"}
        Four-node tets; four-node tets with volume ratios averaged at the nodes (for Poisson's ratios above 0.475); or
        ten-node tets on the same edges (second order, straight edges).
    held_nodes : array_like of int, optional
        Nodes whose displacement is given; by default the node set ``fixed``. With springs there may be none.
    springs : sequence of (array_like of int (n, 3), array_like of float (2,)), optional
        Sets of springs between the surface and its undeformed place. A set is a pair of surface triangles and the
        stiffness along the normal and in the plane in kPa/mm, which every solve may override.
    rests : bool
        Whether the springs support the body, in addition to held nodes. A direction (normal or plane) in which a set
        has no stiffness here must then have none in every solve, and a direction with stiffness must keep some.

    Raises
    ------
    SupportError
        If held nodes and springs leave a rigid motion free.
    LoadError, ShapeError
        If springs do not lie on the surface.
    LargeBodyError
        If one factor of the stiffness would not fit into memory.
    """

    def __init__(
        self,
        mesh: Mesh,
        *,
        element: Element = "tet4",
        held_nodes: Any = None,
        springs: Sequence[tuple[Any, Any]] = (),
        rests: bool = True,
    ) -> None:
        of_kind("mesh", mesh, Mesh)
        check_choice("element", element, ELEMENTS, ArgumentError)
        held = mesh.fixed_nodes if held_nodes is None else index_array("held_nodes", held_nodes, (None,))
        self.mesh = mesh
        self.element = element
        self.held_nodes: IntArray = held
        sets = core_springs(springs)
        flag("rests", rests)
        self.n_springs = len(sets)
        self.body = _core.Body(mesh.nodes, mesh.tets, held, element=element, springs=sets, rests=rests and bool(sets))
        check_fits(self)

    @property
    def n_points(self) -> int:
        """Number of quadrature points of an element: 1 for "tet4", 4 for the other elements."""
        return 1 if self.element == "tet4" else 4

    def forces(self, load: Load) -> FloatArray | None:
        """Return the nodal forces (n_element_nodes, 3) of a load, mN, tractions included; None if it has none."""
        of_kind("load", load, Load)
        total = None
        if load.forces is not None:
            n_rows = self.body.n_nodes if len(load.forces) == self.body.n_nodes else self.mesh.n_nodes
            given = float_array("forces", load.forces, (n_rows, 3))
            total = np.zeros_like(self.body.nodes)
            total[: len(given)] += given
        if load.traction is not None:
            triangles, traction = load.traction
            triangles = index_array("traction triangles", triangles, (None, 3))
            pulls = np.ascontiguousarray(np.broadcast_to(np.asarray(traction, np.float64), triangles.shape))
            pulled = self.body.traction_forces(triangles, pulls)
            total = pulled if total is None else total + pulled
        return total

    def load_parts(self, load: Load, n_held: int | None = None) -> LoadParts:
        """Return the parts of a load as arrays for the compiled solver.

        Parameters
        ----------
        load : Load
            The load.
        n_held : int, optional
            Number of nodes whose displacement a load may prescribe; by default that of the held nodes.

        Returns
        -------
        LoadParts
            ``forces`` (n_element_nodes, 3) in mN, with those of tractions, ``body_force`` (3,) in mN/mm^3 and
            ``prescribed`` (n_held, 3) in mm; each None where the load has no such part.

        Raises
        ------
        LoadError, ShapeError
            If the load does not fit the body.
        """
        n_held = len(self.held_nodes) if n_held is None else n_held
        return {
            "forces": self.forces(load),
            "body_force": optional_array("body_force", load.body_force, (3,)),
            "prescribed": optional_array("prescribed", load.prescribed, (n_held, 3)),
        }

    def solve(self, load: Load, material: Material, **settings: Any) -> Simulation:
        """Return the equilibrium under one load.

        Parameters
        ----------
        load : Load
            The load.
        material : Material
            Material of the body.
        **settings
            ``tolerance`` (norm of the residual over that of the load), ``threads`` (0: all cores), ``method`` ("auto",
            "newton" or "quasi-newton"), ``start`` (n_element_nodes, 3), the initial guess in mm, ``springs`` (n_sets,
            2), stiffness along the normal and in the plane in kPa/mm, ``max_iterations``, ``load_steps`` (0: as many as
            needed).

        Returns
        -------
        Simulation
            Displacement in mm, reactions in mN and the record of work.

        Raises
        ------
        ConvergenceError
            If no equilibrium is found; it has the last load fraction with equilibrium and the worst tets.
        LoadError, MaterialError, ShapeError
            If the input does not fit the body.

        Warns
        -----
        LockingWarning
            If Poisson's ratio is above 0.475 somewhere and the elements are ``"tet4"``.
        """
        young, poisson = self.moduli(material)
        found = self.body.solve(
            young,
            poisson,
            law=material.core_law(),
            **self.load_parts(load),
            **self._arrays(settings, ()),
        )
        return self.simulation(found)

    def simulation(self, found: _core.Solution) -> Simulation:
        """Return a result of the compiled solver as a `Simulation` (displacement in mm, reactions in mN)."""
        everything = found.displacement
        return Simulation(everything[: self.mesh.n_nodes].copy(), found.reactions, everything, found.report)

    def _arrays(self, settings: dict[str, Any], members: tuple[int, ...]) -> dict[str, Any]:
        """Return the settings of a solve with the stiffness of springs and the initial guess as arrays.

        `settings`: keyword arguments of `solve` or `solve_many`; `members`: () for one solve, (n_members,) for many.
        Result: `springs`, kPa/mm, of shape (*members, n_sets, 2), repeated for every member if given only once;
        `start`, mm, of shape (*members, n_element_nodes, 3), or without the member axis. Unknown settings and other
        shapes are refused.
        """
        _check_settings(settings)
        checked = dict(settings)
        if settings.get("springs") is not None:
            checked["springs"] = stiffness_array(settings["springs"], (*members, self.n_springs, 2))
        if settings.get("start") is not None:
            own = members if depth("start", settings["start"]) == 3 else ()
            checked["start"] = float_array("start", settings["start"], (*own, self.body.n_nodes, 3))
        return checked

    def internal_forces(self, displacement: Any, material: Material, *, springs: Any = None) -> FloatArray:
        """Return the nodal forces that hold a displacement in equilibrium, including the body's springs.

        Parameters
        ----------
        displacement : array_like of float, shape (n_element_nodes, 3)
            Displacement of all nodes in mm: those of the mesh, then the mid-edge nodes of ten-node elements.
        material : Material
            Material of the body.
        springs : array_like of float, shape (n_sets, 2), optional
            Stiffness of each set of springs, along the normal and in the plane, in kPa/mm; by default that given to the
            simulator.

        Returns
        -------
        ndarray of float64, shape (n_element_nodes, 3)
            Forces in mN; at held nodes the reactions of a body without load.

        Raises
        ------
        LoadError
            If the displacement turns a tet inside out.
        MaterialError, ShapeError
            If the input does not fit the body.
        """
        young, poisson = self.moduli(material)
        return self.body.internal_forces(
            float_array("displacement", displacement, (self.body.n_nodes, 3)),
            young,
            poisson,
            law=material.core_law(),
            springs=stiffness_array(springs, (self.n_springs, 2)),
        )

    def spring_forces(self, displacement: Any, *, springs: Any = None) -> FloatArray:
        """Return the forces of each set of springs on the body at a displacement.

        Springs whose fixed ends move by ``a`` add the nodal forces ``-spring_forces(a)`` of all sets to the load.

        Parameters
        ----------
        displacement : array_like of float, shape (n_element_nodes, 3)
            Displacement of all nodes in mm: those of the mesh, then the mid-edge nodes of ten-node elements.
        springs : array_like of float, shape (n_sets, 2), optional
            Stiffness of each set, along the normal and in the plane, in kPa/mm; by default that given to the simulator.

        Returns
        -------
        ndarray of float64, shape (n_sets, n_element_nodes, 3)
            Nodal forces in mN.

        Raises
        ------
        ShapeError
            If the input does not fit the body.
        """
        rows = float_array("displacement", displacement, (self.body.n_nodes, 3))
        return self.body.spring_forces(rows, stiffness_array(springs, (self.n_springs, 2)))

    def solve_many(
        self, loads: Sequence[Load], materials: Sequence[Material], *, progress: Any = None, **settings: Any
    ) -> Simulations:
        """Return the equilibria of many members, solved in parallel, each on one thread.

        A member is one load together with one material.

        Parameters
        ----------
        loads : sequence of Load
            The load of each member.
        materials : sequence of Material
            The material of each member.
        progress : callable of int, optional
            Called with the number of members finished so far.
        **settings
            Settings of `solve`: ``tolerance``, ``threads``, ``method``, ``max_iterations``, ``load_steps``; ``start``,
            the initial guess in mm, (n_members, n_element_nodes, 3), or (n_element_nodes, 3) for all members;
            ``springs``, stiffness in kPa/mm, (n_members, n_sets, 2), or (n_sets, 2) for all members.

        Returns
        -------
        Simulations
            The same bits at any thread count. A member's failure is a row of NaN and an entry in `failed`.

        Raises
        ------
        LoadError
            If the numbers of loads and materials differ.

        Warns
        -----
        LockingWarning
            If Poisson's ratio is above 0.475 somewhere and the elements are ``"tet4"``; once for all members.
        """
        loads, materials = each("loads", loads, Load), each("materials", materials, Material)
        called("progress", progress)
        if len(loads) != len(materials):
            message = f"there must be one material a load, got {len(materials)} for {len(loads)}"
            raise LoadError(message, where="materials")
        moduli = [self.moduli(material) for material in materials]
        found = self.body.solve_many(
            _one_a_member([m[0] for m in moduli]),
            _one_a_member([m[1] for m in moduli]),
            laws=[material.core_law() for material in materials],
            **stacked_parts([self.load_parts(load) for load in loads]),
            progress=progress,
            **self._arrays(settings, (len(loads),)),
        )
        everything = found.displacement
        return Simulations(everything[:, : self.mesh.n_nodes].copy(), found.reactions, found.failed, everything)

    def moduli(self, material: Material) -> tuple[FloatArray, FloatArray]:
        """Return Young's modulus and Poisson's ratio of a material as arrays, checked against the mesh.

        Parameters
        ----------
        material : Material
            Material with one value for all tets, one per tet, or one per quadrature point.

        Returns
        -------
        tuple of ndarray of float64, each of shape (1,), (n_tets,) or (n_tets, n_points)
            Young's modulus in kPa and Poisson's ratio; both have the same shape.

        Raises
        ------
        MaterialError
            If the number of values is neither one, nor that of the tets, nor that of the quadrature points.
        """
        of_kind("material", material, Material)
        young, poisson = material.young_array, material.poisson_array
        n_points = self.n_points
        for name, values in (("young", young), ("poisson", poisson)):
            if values.shape not in ((1,), (self.mesh.n_tets,), (self.mesh.n_tets, 1), (self.mesh.n_tets, n_points)):
                points = f" or one per quadrature point ({self.mesh.n_tets}, {n_points})" if values.ndim == 2 else ""
                got = values.shape if values.ndim == 2 else len(values)
                message = f"`{name}` must hold one value or one per tet ({self.mesh.n_tets}){points}, got {got}"
                raise MaterialError(message, where=name)
        young, poisson = (v[:, 0] if v.ndim == 2 and v.shape[1] == 1 else v for v in (young, poisson))
        young, poisson = _broadcast([young, poisson])
        return young, poisson


def _check_settings(settings: dict[str, Any]) -> None:
    """Refuse settings of a solve (`tolerance`, `threads`, ...) that are unknown or out of their range."""
    known = ("tolerance", "threads", "method", "start", "springs", "max_iterations", "load_steps")
    for name in settings:
        check_choice("setting", name, known, ArgumentError)
    check_running(threads=settings.get("threads", 0))
    if "tolerance" in settings:
        real("tolerance", settings["tolerance"], above=0.0, below=1.0)
    for name, least in (("max_iterations", 1), ("load_steps", 0)):
        if name in settings:
            whole(name, settings[name], least=least, most=MOST_COUNTED)
    if "method" in settings:
        text("method", settings["method"])


def _broadcast(fields: Sequence[FloatArray]) -> list[FloatArray]:
    """Return arrays of moduli, each (1,), (n_tets,) or (n_tets, n_points), all in the largest shape among them."""
    deepest = max((values.ndim for values in fields), default=1)
    columns = [values[:, None] if values.ndim < deepest else values for values in fields]
    return [np.ascontiguousarray(values) for values in np.broadcast_arrays(*columns)]


def _one_a_member(fields: Sequence[FloatArray]) -> FloatArray:
    """Return arrays of moduli, one array per member, stacked along a new first axis.

    Shape (n_members,), (n_members, n_tets) or (n_members, n_tets, n_points): that of the largest array decides.
    """
    if not fields:
        return np.empty(0)
    stacked = np.stack(_broadcast(fields))
    return stacked[:, 0].copy() if stacked.shape[1:] == (1,) else stacked


def simulate(
    mesh: Mesh,
    load: Load,
    material: Material,
    *,
    element: Element = "tet4",
    held_nodes: Any = None,
    tolerance: float = 1e-9,
    threads: int = 0,
) -> Simulation:
    """Return the equilibrium of a mesh under one load: one solve, everything included.

    Parameters
    ----------
    mesh : Mesh
        Reference shape; its node set ``fixed`` is held unless `held_nodes` is given.
    load : Load
        The load.
    material : Material
        Material of the body.
    element : {"tet4", "tet4-averaged", "tet10"}
        Four-node tets; four-node tets with volume ratios averaged at the nodes (for Poisson's ratios above 0.475); or
        ten-node tets on the same edges.
    held_nodes : array_like of int, optional
        Nodes whose displacement is given by `load.prescribed` (zero where absent).
    tolerance : float
        Norm of the residual over the norm of the load, free degrees of freedom.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.

    Returns
    -------
    Simulation
        Displacement in mm, reactions in mN, record of work.

    Raises
    ------
    ConvergenceError
        If no equilibrium is found.
    SupportError
        If the body can move freely.

    Examples
    --------
    >>> block = Mesh([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1, 2, 3]], {"fixed": [0, 1, 2]})
    >>> pulled = simulate(block, Load(forces=[[0, 0, 0]] * 3 + [[0, 0, 30.0]]), Material(young=10.0, poisson=0.3))
    >>> float(pulled.displacement[3, 2]) > 0
    True
    """
    simulator = Simulator(mesh, element=element, held_nodes=held_nodes)
    return simulator.solve(load, material, tolerance=tolerance, threads=threads)
