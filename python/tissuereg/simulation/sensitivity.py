"""Derivatives of an equilibrium by causes (moduli, load, springs), and of observations by the moduli of every point.

The derivatives are exact. The tangent stiffness at the equilibrium is factored once; each cause costs one solution, and
so does each observation.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, IntArray, float_array, index_array
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.simulation.bed import stiffness_array
from tissuereg.simulation.solve import Simulation, Simulator


@dataclass(frozen=True)
class Parameter:
    """A scalar parameter by which an equilibrium is differentiated: of the material law, or of springs.

    It has the same value everywhere. `name`: ``"young"`` (kPa), ``"poisson"``, a shape parameter of the law (a key of
    `Material.shape`), ``"k1_over_mu"`` or ``"k2"`` of fibres, or ``"springs.normal_kpa_per_mm"`` or
    ``"springs.tangential_kpa_per_mm"`` of springs on the surface; `term`: index of the term of an Ogden law, or of the
    set of springs, from 0 on.
    """

    name: str
    term: int = 0


@dataclass(frozen=True, eq=False)
class ModulusField:
    """A spatial field of changes of a modulus by which an equilibrium is differentiated.

    `name` {"young", "poisson"}: which modulus; `rates` (n_tets,) or (n_tets, n_points): change of the modulus (kPa for
    "young") per unit of the cause. For an inclusion or a layer this is 1 inside and 0 outside.
    """

    name: str
    rates: Any


#: Causes by which an equilibrium can be differentiated. A `Load` is a change of the load.
Cause = Parameter | ModulusField | Load


@dataclass(frozen=True, eq=False)
class Observation:
    """A scalar function of an equilibrium: a weighted sum of nodal displacements plus a weighted sum of reactions.

    `nodes` (k,): nodes whose displacement is used; repeated nodes add up; `weights` (k, 3): weights of the
    displacement's components in mm; `held_nodes` (r,): held nodes whose reaction is used; `held_weights` (r, 3):
    weights of the reaction's components in mN.
    """

    nodes: Any = ()
    weights: Any = ()
    held_nodes: Any = ()
    held_weights: Any = ()


def core_cause(simulator: Simulator, cause: Cause) -> _core.Cause:
    """Return a cause (a parameter, modulus field or load by which to differentiate) for the compiled solver.

    `simulator`: the analysed body; `cause`: the cause. It is checked as far as possible without a material law. Raises
    `TissueRegError` if there is no such parameter or field; `LoadError` or `ShapeError` if rates do not fit the body.
    """
    if isinstance(cause, Parameter):
        return _core.Cause.parameter(cause.name, cause.term)
    if isinstance(cause, Load):
        return _core.Cause.load(**simulator.load_parts(cause))
    rates = np.asarray(cause.rates, np.float64)
    shape = (simulator.mesh.n_tets, simulator.n_points)
    if rates.ndim == 1:
        rates = np.repeat(rates[:, None], simulator.n_points, axis=1)
    return _core.Cause.field(cause.name, float_array(f"rates of {cause.name}", rates, shape))


def core_observation(observation: Observation) -> tuple[IntArray, FloatArray, IntArray, FloatArray]:
    """Return the arrays of an observation, checked for the compiled solver.

    Result: nodes (k,) and weights (k, 3) of displacements, held nodes (r,) and weights (r, 3) of reactions. Raises
    `ShapeError` if there is not one row of weights per node.
    """
    nodes = index_array("nodes", observation.nodes, (None,))
    held = index_array("held_nodes", observation.held_nodes, (None,))
    weights = np.reshape(observation.weights, (-1, 3)) if len(nodes) == 0 else observation.weights
    held_weights = np.reshape(observation.held_weights, (-1, 3)) if len(held) == 0 else observation.held_weights
    return (
        nodes,
        float_array("weights", weights, (len(nodes), 3)),
        held,
        float_array("held_weights", held_weights, (len(held), 3)),
    )


__all__ = [
    "Adjoints",
    "Cause",
    "Compliance",
    "Derivatives",
    "Linearised",
    "ModulusField",
    "Observation",
    "Parameter",
    "core_cause",
    "core_observation",
]


@dataclass(frozen=True, eq=False)
class Derivatives:
    """Derivatives of an equilibrium by each of n_causes causes, per unit of the cause.

    A cause is a parameter, a modulus field or a load. `displacement` (n_causes, n_nodes, 3): of the displacement of the
    mesh's nodes, mm; `reactions` (n_causes, n_held, 3): of the force on the body at every held node, mN;
    `all_displacement` (n_causes, n_element_nodes, 3): of the displacement of all nodes, mm: those of the mesh, then the
    mid-edge nodes of ten-node elements.
    """

    displacement: FloatArray
    reactions: FloatArray
    all_displacement: FloatArray


@dataclass(frozen=True, eq=False)
class Adjoints:
    """Derivatives of each observation by all inputs (adjoint solutions).

    An observation is a scalar: a weighted sum of displacements and reactions. Its unit precedes each "per" below.
    `young` (n_obs, n_tets, n_points): derivative by Young's modulus at every quadrature point, per kPa. The derivative
    by a field of moduli is the sum over points, weighted by the field; `poisson` (n_obs, n_tets, n_points): derivative
    by Poisson's ratio at every quadrature point; `forces` (n_obs, n_element_nodes, 3): derivative by the force at every
    node, per mN; `body_force` (n_obs, 3): derivative by the body force, per mN/mm^3; `prescribed` (n_obs, n_held, 3):
    derivative by the prescribed displacement of every held node, per mm; `springs` (n_obs, n_sets, 2): derivative by
    the stiffness of every set of springs along the normal and in the plane, per kPa/mm.
    """

    young: FloatArray
    poisson: FloatArray
    forces: FloatArray
    body_force: FloatArray
    prescribed: FloatArray
    springs: FloatArray


@dataclass(frozen=True, eq=False)
class Compliance:
    """Derivatives of observations (weighted sums of displacements) by forces and prescribed displacements.

    `forces` (n_obs, n_element_nodes, 3): derivative by the force at every node, per mN; zero at held nodes;
    `body_force` (n_obs, 3): by the body force, per mN/mm^3; `prescribed` (n_obs, n_held, 3): by the prescribed
    displacement of every held node, per mm.
    """

    forces: FloatArray
    body_force: FloatArray
    prescribed: FloatArray


class Linearised:
    """An equilibrium with its exact tangent, factored once for any number of causes and observations.

    A cause is a quantity by which to differentiate, an observation a weighted sum of displacements and reactions.
    `simulator`: the analysed body; `load`: the load; `material`: material of the body; `displacement` (n_element_nodes,
    3): equilibrium under them in mm (`Simulation.all_displacement`); `springs` (n_sets, 2): stiffness of the
    simulator's springs, along the normal and in the plane, in kPa/mm; by default that given to the simulator;
    `precision` {"double", "single"}: precision of the factor. A single one takes 60 to 80 % of the time and half the
    memory; its solutions are refined to a relative error of 1e-9. If the tangent is too close to singular for that, a
    double one is used; `threads`: threads to use; 0 takes all cores. The result does not depend on it. Raises
    `ConvergenceError` if the displacement is not an equilibrium, or not a stable one; `LoadError`, `MaterialError` or
    `ShapeError` if the input does not fit the body.

    Examples
    --------
    >>> from tissuereg import Mesh
    >>> block = Mesh([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1, 2, 3]], {"fixed": [0, 1, 2]})
    >>> simulator, pull = Simulator(block), Load(forces=[[0, 0, 0]] * 3 + [[0, 0, 30.0]])
    >>> silicone = Material(young=10.0, poisson=0.3)
    >>> found = simulator.solve(pull, silicone)
    >>> here = Linearised(simulator, pull, silicone, found.all_displacement)
    >>> by_young = here.derivatives([Parameter("young")]).displacement[0, 3, 2]
    >>> bool(by_young < 0)
    True
    >>> by_tet = here.adjoints([Observation([3], [[0, 0, 1.0]])]).young[0]
    >>> bool(abs(by_tet.sum() - by_young) < 1e-9)
    True
    """

    def __init__(
        self,
        simulator: Simulator,
        load: Load,
        material: Material,
        displacement: Any,
        *,
        springs: Any = None,
        precision: str = "double",
        threads: int = 0,
    ) -> None:
        self.simulator = simulator
        young, poisson = simulator.moduli(material)
        self._core = simulator.body.linearise(
            float_array("displacement", displacement, (simulator.body.n_nodes, 3)),
            young,
            poisson,
            law=material.core_law(),
            springs=stiffness_array(springs, (simulator.n_springs, 2)),
            precision=precision,
            threads=threads,
            **simulator.load_parts(load),
        )

    def derivatives(self, causes: Sequence[Cause]) -> Derivatives:
        """Return the derivatives of displacement (mm) and reactions (mN) by each cause.

        `causes`: parameters, modulus fields or loads; the cost is one solution each. Result: arrays with one row per
        cause, in their order. Raises `MaterialError` if the law does not have a parameter; `LoadError` or `ShapeError`
        if rates do not fit the body.
        """
        everything, reactions = self._core.derivatives([core_cause(self.simulator, cause) for cause in causes])
        n_nodes = self.simulator.mesh.n_nodes
        return Derivatives(everything[:, :n_nodes].copy(), reactions, everything)

    def adjoints(self, observations: Sequence[Observation]) -> Adjoints:
        """Return the derivatives of each observation by all inputs: moduli, forces, prescribed displacements, springs.

        `observations`: weighted sums of displacements and reactions; the cost is one solution each. Result: arrays with
        one row per observation, in their order. Raises `LoadError` if a node does not exist or is not held;
        `ShapeError` if there is not one row of weights per node.
        """
        found = self._core.adjoints([core_observation(observation) for observation in observations])
        return Adjoints(found.young, found.poisson, found.forces, found.body_force, found.prescribed, found.springs)

    def compliance(self, observations: Sequence[Observation]) -> Compliance:
        """Return the derivatives of observations of displacements by forces and supports only; fast for many.

        `observations`: weighted sums of displacements, without reactions. Result: arrays with one row per observation,
        in their order; each has the same bits whatever the others are. Raises `LoadError` if a node does not exist, or
        if an observation weighs reactions; `ShapeError` if there is not one row of weights per node.
        """
        found = self._core.compliance([core_observation(observation) for observation in observations])
        return Compliance(found.forces, found.body_force, found.prescribed)

    def responses(self, forces: Any) -> FloatArray:
        """Return the linear response of the displacement to each of many fields of nodal forces.

        `forces` (n_fields, n_element_nodes, 3): nodal forces in mN. Result: (n_fields, n_element_nodes, 3),
        displacement in mm, to first order; zero at held nodes. Raises `LoadError` or `ShapeError` if the forces are not
        finite or do not fit the body.
        """
        return self._core.responses(float_array("forces", forces, (None, self.simulator.body.n_nodes, 3)))

    def unbalanced(self, causes: Sequence[Cause]) -> FloatArray:
        """Return the nodal forces by which each cause disturbs the equilibrium while the displacement is kept.

        They are the derivative of inner minus applied force, (n_causes, n_element_nodes, 3), in mN per unit of the
        cause. The derivative of an observation ``o`` of free nodes by cause ``c`` is ``-sum(compliance.forces[o] *
        unbalanced[c])``: one matrix product for many of both. `causes`: parameters, modulus fields or loads. Raises
        `MaterialError` if the law does not have a parameter; `LoadError` or `ShapeError` if rates do not fit the body.
        """
        return self._core.unbalanced([core_cause(self.simulator, cause) for cause in causes])

    def solve_near(
        self,
        load: Load,
        *,
        springs: Any = None,
        tolerance: float = 1e-9,
        max_iterations: int = 1000,
        threads: int | None = None,
    ) -> Simulation:
        """Return the equilibrium under another load, starting from this one with its factor.

        `load`: the load; `springs` (n_sets, 2): stiffness of the simulator's springs, along the normal and in the
        plane, in kPa/mm; by default that given to the simulator; `tolerance`: norm of the residual over the norm of the
        load, free degrees of freedom; `max_iterations`: iterations allowed; `threads`: threads to use, by default those
        of this object. Several threads may call it at once. Result: displacement in mm and reactions in mN, with the
        material of this equilibrium. Raises `ConvergenceError` if no equilibrium is found; `LoadError` or `ShapeError`
        if the load does not fit the body.
        """
        found = self._core.solve_near(
            **self.simulator.load_parts(load),
            springs=stiffness_array(springs, (self.simulator.n_springs, 2)),
            tolerance=tolerance,
            max_iterations=max_iterations,
            threads=threads,
        )
        return self.simulator.simulation(found)

    @property
    def report(self) -> dict[str, Any]:
        """Record of the work so far, a dict of the factor's `precision`, "double" or "single", and three counts.

        They are `factorisations`, and for `compliance` and `responses` the `right_hand_sides` and their `corrections`
        (iterative refinements in double precision).
        """
        return self._core.report
