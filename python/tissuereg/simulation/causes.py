"""Causes by which an equilibrium is differentiated, and observations of it, in the form of the compiled solver."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, IntArray, float_array, index_array
from tissuereg.body.load import Load
from tissuereg.simulation.solve import Simulator


@dataclass(frozen=True)
class Parameter:
    """A scalar parameter, changed uniformly: of the law, or of springs on the surface.

    `name`: ``"young"``, ``"poisson"``, a shape parameter of the law (as in `Material.shape`), or ``"k1_over_mu"`` and
    ``"k2"`` of fibres, or that of springs (``"springs.normal_kpa_per_mm"``, ``"springs.tangential_kpa_per_mm"``);
    `term`: index of the term of an Ogden law, or of the springs; from 0 on.
    """

    name: str
    term: int = 0


@dataclass(frozen=True, eq=False)
class ModulusField:
    """A change of a modulus by a field of rates; of an inclusion or a layer, 1 inside and 0 outside.

    `name` {"young", "poisson"}: which modulus; `rates` (n_tets,): change of the modulus per unit of the cause.
    """

    name: str
    rates: Any


#: Causes by which an equilibrium can be differentiated. A `Load` is a change of the load.
Cause = Parameter | ModulusField | Load


@dataclass(frozen=True, eq=False)
class Observation:
    """A scalar observation of an equilibrium: weights times displacements plus weights times reactions.

    `nodes` (k,): nodes whose displacement is used; repeated nodes add up; `weights` (k, 3): weights of their
    components; `held_nodes` (r,): held nodes whose reaction is used; `held_weights` (r, 3): weights of its components.
    """

    nodes: Any = ()
    weights: Any = ()
    held_nodes: Any = ()
    held_weights: Any = ()


def core_cause(simulator: Simulator, cause: Cause) -> _core.Cause:
    """Return a cause in the form of the compiled solver.

    `simulator`: the analysed body; `cause`: the cause. Result: checked as far as possible without a law. Raises
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
    """Return an observation in the form of the compiled solver.

    `observation`: the observation. Result: nodes and weights of displacements, nodes and weights of reactions. Raises
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
