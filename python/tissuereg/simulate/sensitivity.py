"""How an equilibrium follows its causes, and how an observation follows the stiffness of every point.

Exact derivatives by the tangent of the equilibrium, which is factored once: many causes cost one solution each, and so
do many observations. `tissuereg.simulate.frame_sensitivity` is the same through time frames.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._arrays import FloatArray, IntArray, float_array, index_array
from tissuereg.load import Load
from tissuereg.material import Material
from tissuereg.simulate.solve import Simulator


@dataclass(frozen=True)
class Parameter:
    """A number of the law, moved alike everywhere, or one of what it does and of what lies on the body.

    Parameters
    ----------
    name : str
        ``"young"``, ``"poisson"``, a shape parameter (``"excess"``, ``"share"``, ``"c2_over_c1"``, ``"c3_over_c1"``,
        ``"alpha"``, ``"weight"``, ``"b"``), or ``"k1_over_mu"`` and ``"k2"`` of fibres. Through frames also those of a
        behaviour (``"relaxation.g"``, ``"relaxation.tau_s"``, ``"rate.viscosity_kpa_s"``, ``"softening.r"``,
        ``"softening.m_kpa"``, ``"softening.beta"``, ``"set.fraction"``, ``"drainage.share"``, ``"drainage.tau_s"``,
        ``"swelling.linear_strain"``, ``"swelling.from_time_s"``, ``"swelling.to_time_s"``), of springs
        (``"springs.normal_kpa_per_mm"``, ``"springs.tangential_kpa_per_mm"``) and of skins (``"skins.young_kpa"``,
        ``"skins.thickness_mm"``). Only the viscosity has a derivative where its behaviour is absent.
    term : int
        Which term of an Ogden law or of the relaxation, which springs or skin; from 0 on.
    """

    name: str
    term: int = 0


@dataclass(frozen=True, eq=False)
class Field:
    """A modulus along a field of rates: an inclusion or a layer is 1 where it lies.

    Parameters
    ----------
    name : {"young", "poisson"}
        Which modulus.
    rates : array_like of float, shape (n_tets,) or (n_tets, n_points)
        Change of the modulus over that of the cause.
    """

    name: str
    rates: Any


#: What a derivative may be taken by. A load is a rate of the load that acts; through frames, of all of them.
Cause = Parameter | Field | Load


@dataclass(frozen=True, eq=False)
class Observation:
    """A number read off an equilibrium: weights times displacements plus weights times reactions.

    Parameters
    ----------
    nodes : array_like of int, shape (k,)
        Nodes whose displacement counts; repeated nodes add up.
    weights : array_like of float, shape (k, 3)
        Weights of their components.
    held_nodes : array_like of int, shape (r,)
        Held nodes whose reaction counts.
    held_weights : array_like of float, shape (r, 3)
        Weights of its components.
    """

    nodes: Any = ()
    weights: Any = ()
    held_nodes: Any = ()
    held_weights: Any = ()


@dataclass(frozen=True, eq=False)
class Derivatives:
    """How an equilibrium follows each cause, over the cause's unit.

    Attributes
    ----------
    displacement : ndarray of float64, shape (n_causes, n_nodes, 3)
        Of the mesh's nodes, mm.
    reactions : ndarray of float64, shape (n_causes, n_held, 3)
        Of the force on the body at every held node, mN.
    all_displacement : ndarray of float64, shape (n_causes, n_element_nodes, 3)
        Of all nodes, with the mid-edge nodes of ten-node elements behind the mesh's nodes.
    """

    displacement: FloatArray
    reactions: FloatArray
    all_displacement: FloatArray


@dataclass(frozen=True, eq=False)
class Adjoints:
    """How each observation follows everything.

    Attributes
    ----------
    young : ndarray of float64, shape (n_obs, n_tets, n_points)
        Derivative by Young's modulus of every quadrature point, per kPa. That by a field is the weighted sum.
    poisson : ndarray of float64, shape (n_obs, n_tets, n_points)
        By Poisson's ratio of every quadrature point.
    forces : ndarray of float64, shape (n_obs, n_element_nodes, 3)
        By the force at every node, per mN.
    body_force : ndarray of float64, shape (n_obs, 3)
        By the body force, per mN/mm^3.
    prescribed : ndarray of float64, shape (n_obs, n_held, 3)
        By the prescribed displacement of every held node, per mm.
    """

    young: FloatArray
    poisson: FloatArray
    forces: FloatArray
    body_force: FloatArray
    prescribed: FloatArray


class Linearised:
    """An equilibrium with its exact tangent, factored once for any number of causes and observations.

    Parameters
    ----------
    simulator : Simulator
        What was solved.
    load : Load
        What acts.
    material : Material
        What the body is made of.
    displacement : array_like of float, shape (n_element_nodes, 3)
        Equilibrium under them in mm: `Simulation.all_displacement`.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.

    Raises
    ------
    ConvergenceError
        If the displacement is no equilibrium, or not a stable one.
    LoadError, MaterialError, ShapeError
        If the input does not fit the body.

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
        self, simulator: Simulator, load: Load, material: Material, displacement: Any, *, threads: int = 0
    ) -> None:
        self.simulator = simulator
        young, poisson = simulator.moduli(material)
        self._core = simulator.body.linearise(
            float_array("displacement", displacement, (simulator.body.n_nodes, 3)),
            young,
            poisson,
            law=material.core_law(),
            threads=threads,
            **simulator.load_parts(load),
        )

    def derivatives(self, causes: Sequence[Cause]) -> Derivatives:
        """Return how displacement and reactions follow each cause.

        Parameters
        ----------
        causes : sequence of Parameter, Field or Load
            What is moved; one solution each.

        Returns
        -------
        Derivatives
            One entry a cause, in their order.

        Raises
        ------
        MaterialError
            If the law does not have a parameter.
        LoadError, ShapeError
            If rates do not fit the body.
        """
        everything, reactions = self._core.derivatives([core_cause(self.simulator, cause) for cause in causes])
        n_nodes = self.simulator.mesh.n_nodes
        return Derivatives(everything[:, :n_nodes].copy(), reactions, everything)

    def adjoints(self, observations: Sequence[Observation]) -> Adjoints:
        """Return how each observation follows everything.

        Parameters
        ----------
        observations : sequence of Observation
            What is read off; one solution each.

        Returns
        -------
        Adjoints
            One entry an observation, in their order.

        Raises
        ------
        LoadError
            If a node does not exist or is not held.
        ShapeError
            If there is not one row of weights a node.
        """
        found = self._core.adjoints([core_observation(observation) for observation in observations])
        return Adjoints(found.young, found.poisson, found.forces, found.body_force, found.prescribed)


def core_cause(simulator: Simulator, cause: Cause) -> _core.Cause:
    """Return a cause as the compiled solver takes it.

    Parameters
    ----------
    simulator : Simulator
        What it acts on.
    cause : Parameter, Field or Load
        What is moved.

    Returns
    -------
    _core.Cause
        Checked as far as it can be without a law.

    Raises
    ------
    TissueRegError
        If there is no such parameter or field.
    LoadError, ShapeError
        If rates do not fit the body.
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
    """Return an observation as the compiled solver takes it.

    Parameters
    ----------
    observation : Observation
        What is read off.

    Returns
    -------
    tuple of ndarray
        Nodes and weights of displacements, nodes and weights of reactions.

    Raises
    ------
    ShapeError
        If there is not one row of weights a node.
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
