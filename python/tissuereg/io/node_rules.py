"""Which nodes are meant: words that choose nodes by a plane, a ball or a name, the same wherever a user says them."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from tissuereg._arguments import found, text
from tissuereg._arrays import FloatArray, IntArray
from tissuereg.errors import FormatError, MeshError
from tissuereg.mesh import Mesh

#: A plane ``(nx, ny, nz, d, tolerance)`` in words or numbers, a ball in words, or the name of a node set.
NodeRule = str | Sequence[float]


def nodes_by_rule(mesh: Mesh, rule: NodeRule, name: str = "fixed") -> IntArray:
    """Return the nodes that a rule chooses.

    Parameters
    ----------
    mesh : Mesh
        The body, mm.
    rule : str or sequence of float
        ``"plane nx ny nz d tol"`` or those five numbers, ``"ball x y z r"``, or the name of a node set.
    name : str
        What the nodes are for, for the message.

    Returns
    -------
    ndarray of int64, shape (n,)
        Sorted indices, at least one.

    Raises
    ------
    FormatError
        If the rule cannot be read.
    MeshError
        If there is no such node set, or the plane or ball catches no node.
    """
    kind, numbers = parsed_rule(rule, name)
    if kind == "plane":
        return nodes_near_plane(mesh, numbers[:3], numbers[3], numbers[4])
    if kind == "ball":
        return surface_nodes_in_ball(mesh, numbers[:3], numbers[3])
    return mesh.node_set(kind)


def parsed_rule(rule: NodeRule, name: str = "fixed") -> tuple[str, list[float]]:
    """Return the kind and the numbers of a rule, so that a wrong one is told before long work.

    Parameters
    ----------
    rule : str or sequence of float
        As `nodes_by_rule` takes it.
    name : str
        What the nodes are for, for the message.

    Returns
    -------
    kind : str
        ``plane``, ``ball``, or the name of a node set.
    numbers : list of float
        ``nx, ny, nz, d, tol`` or ``x, y, z, r``, lengths in mm; none for a node set.

    Raises
    ------
    FormatError
        If a plane or a ball is not given by such numbers.
    """
    words: list[Any] = _words(rule, name)
    kind = words[0] if words else ""
    if kind not in ("plane", "ball"):
        return text(name, rule, error=FormatError), []
    try:
        numbers = [float(word) for word in words[1:]]
    except (TypeError, ValueError):
        numbers = []
    shown = found(rule) if isinstance(rule, str) else repr(words[1:7])
    finite = bool(np.isfinite(numbers).all())
    if kind == "plane" and not (finite and len(numbers) == 5 and numbers[4] >= 0 and any(numbers[:3])):
        message = f"`{name}` must be 'plane nx ny nz d tol', normal not zero and tol at least 0 mm, got {shown}"
        raise FormatError(message, where=name)
    if kind == "ball" and not (finite and len(numbers) == 4 and numbers[3] > 0):
        message = f"`{name}` must be 'ball x y z r', the radius r positive, in mm, got {shown}"
        raise FormatError(message, where=name)
    return kind, numbers


def _words(rule: Any, name: str) -> list[Any]:
    """Return a rule's words, or its numbers behind the word for a plane."""
    if isinstance(rule, str):
        return rule.split()
    try:
        return ["plane", *(float(number) for number in rule)]
    except (TypeError, ValueError):
        wanted = "'plane nx ny nz d tol', 'ball x y z r' or the name of a node set"
        message = f"`{name}` must be {wanted}, got {found(rule)}"
        raise FormatError(message, where=name) from None


def nodes_near_plane(mesh: Mesh, normal: Sequence[float], offset: float, tolerance: float) -> IntArray:
    """Return the nodes with ``|n . x - offset| <= tolerance``, n normalised.

    Parameters
    ----------
    mesh : Mesh
        The body, mm.
    normal : sequence of float, length 3
        Normal of the plane; any length but none.
    offset : float
        Distance of the plane from the origin along the unit normal, mm.
    tolerance : float
        How far a node may lie from the plane, mm.

    Returns
    -------
    ndarray of int64, shape (n,)
        Sorted indices, at least one.

    Raises
    ------
    MeshError
        If no node is that close.
    """
    unit = np.asarray(normal, dtype=np.float64)
    unit = unit / np.linalg.norm(unit)
    distance = np.abs(mesh.nodes @ unit - offset)
    near = np.flatnonzero(distance <= tolerance).astype(np.int64)
    if near.size == 0:
        message = (
            f"the plane {unit.tolist()} . x = {offset:g} mm must have a node within {tolerance:g} mm; "
            f"the nearest is {distance.min():.4g} mm away"
        )
        raise MeshError(message, where="plane")
    return near


def surface_nodes_in_ball(mesh: Mesh, centre: Sequence[float] | FloatArray, radius: float) -> IntArray:
    """Return the nodes of the surface within a distance of a point.

    Parameters
    ----------
    mesh : Mesh
        The body, mm.
    centre : sequence of float, length 3
        mm.
    radius : float
        mm.

    Returns
    -------
    ndarray of int64, shape (n,)
        Sorted indices, at least one.

    Raises
    ------
    MeshError
        If no node of the surface is that close.
    """
    middle = np.asarray(centre, dtype=np.float64)
    nodes = mesh.surface_nodes_within(middle, radius)
    if nodes.size == 0:
        distance = np.linalg.norm(mesh.nodes[mesh.surface_nodes] - middle, axis=1)
        message = (
            f"a surface node must lie within {radius:g} mm of {middle.tolist()}; "
            f"the nearest is {distance.min():.4g} mm away"
        )
        raise MeshError(message, where="ball")
    return nodes
