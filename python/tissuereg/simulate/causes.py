"""What may move an equilibrium, and what is read off it, as the compiled solver takes them."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._arrays import FloatArray, IntArray, float_array, index_array
from tissuereg.load import Load
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
