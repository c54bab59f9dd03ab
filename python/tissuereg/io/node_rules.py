"""Rules that choose nodes of a mesh: a plane, a ball or the name of a node set.

Experiment files, the command line and Python use the same notation.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NoReturn

import numpy as np

from tissuereg._base.arguments import found, text
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.fields import checked
from tissuereg.body.mesh import Mesh
from tissuereg.errors import FormatError, MeshError, TissueRegError
from tissuereg.io.toml import parsed_toml

#: The name of a node set; ``"plane nx ny nz d [tol]"`` or those numbers; ``"ball x y z r"``; a table with the keys
#: ``plane`` and ``tolerance_mm``, or ``centre_mm`` and ``radius_mm``, or the text of such a table.
NodeRule = str | Sequence[float] | Mapping[str, Any]

#: How far a node may lie from a plane by default, mm.
TOLERANCE = 0.1

_FORMS = "the name of a node set, 'plane nx ny nz d [tol]' or 'ball x y z r'"
_PLANE_KEYS, _BALL_KEYS = ("plane", "tolerance_mm"), ("centre_mm", "radius_mm")


def nodes_by_rule(mesh: Mesh, rule: NodeRule, name: str = "fixed") -> IntArray:
    """Return the indices of the nodes that a rule chooses: a node set, the nodes near a plane, or those in a ball.

    `mesh`: the body, mm; `rule`: the name of a node set. Or all nodes near a plane: ``"plane nx ny nz d [tol]"``
    (normal n, distance d from the origin along n brought to length 1, tolerance, both in mm), those four or five
    numbers, or ``{"plane": [nx, ny, nz, d], "tolerance_mm": tol}``; `tol` is 0.1 mm where it is absent. Or the surface
    nodes in a ball of centre x, y, z and radius r in mm: ``"ball x y z r"`` or ``{"centre_mm": [x, y, z], "radius_mm":
    r}``. A table may be given as TOML text; `name`: name of the argument or key, for the message. Result: int64 (n,),
    sorted indices, at least one. Raises `FormatError` if the rule cannot be read; `MeshError` if there is no such node
    set, or the plane or ball catches no node.
    """
    kind, numbers = parsed_rule(rule, name)
    if kind == "plane":
        return nodes_near_plane(mesh, numbers[:3], numbers[3], numbers[4])
    if kind == "ball":
        return surface_nodes_in_ball(mesh, numbers[:3], numbers[3])
    return mesh.node_set(kind)


def parsed_rule(rule: NodeRule, name: str = "fixed") -> tuple[str, list[float]]:
    """Return the kind and the numbers of a rule that chooses nodes, so that a wrong rule is refused before long work.

    `rule`: the name of a node set; or a plane or ball as text, numbers or table in a form that `nodes_by_rule` accepts;
    `name`: name of the argument or key, for the message. Result: ``plane`` with [nx, ny, nz, d, tol], ``ball`` with [x,
    y, z, r], lengths in mm, or the name of a node set with an empty list. Raises `FormatError` if a plane or a ball is
    not given by such numbers.
    """
    kind, given = _kind_and_words(rule, name)
    if kind not in ("plane", "ball"):
        return text(name, rule, error=FormatError), []
    numbers = _numbers(given)
    finite = bool(np.isfinite(numbers).all())
    if kind == "plane":
        if len(numbers) == 4:
            numbers.append(TOLERANCE)
        if not (finite and len(numbers) == 5 and numbers[4] >= 0 and any(numbers[:3])):
            rules = "'plane nx ny nz d [tol]', normal not zero and tol at least 0 mm"
            _refuse(name, rules, rule)
    elif not (finite and len(numbers) == 4 and numbers[3] > 0):
        _refuse(name, "'ball x y z r', the radius r positive, in mm", rule)
    return kind, numbers


def rule_for_file(rule: NodeRule, name: str = "nodes") -> str | dict[str, Any]:
    """Return a rule that chooses nodes as an experiment file holds it: the name of a node set, or a table.

    `rule`: the name of a node set; or a plane or ball as text, numbers or table in a form that `nodes_by_rule` accepts;
    `name`: name of the argument or key, for the message. Result: the name, or ``{"plane": [nx, ny, nz, d],
    "tolerance_mm": tol}``, or ``{"centre_mm": [x, y, z], "radius_mm": r}``. Raises `FormatError` if the rule cannot be
    read.
    """
    kind, numbers = parsed_rule(rule, name)
    if kind == "plane":
        return dict(zip(_PLANE_KEYS, (numbers[:4], numbers[4]), strict=True))
    if kind == "ball":
        return dict(zip(_BALL_KEYS, (numbers[:3], numbers[3]), strict=True))
    return kind


def _kind_and_words(rule: Any, name: str) -> tuple[str, list[Any]]:
    """Split a rule that chooses nodes: return ``plane`` or ``ball`` and its numbers, not converted yet.

    For the name of a node set, return its words: the first, and the list of the others. `name`: name of the argument,
    for the message.
    """
    if isinstance(rule, str):
        if rule.lstrip().startswith("{"):
            return _of_table(_table_from_text(rule, name), name)
        words = rule.split()
        return (words[0], list(words[1:])) if words else ("", [])
    if isinstance(rule, Mapping):
        return _of_table(rule, name)
    if not isinstance(rule, Sequence | np.ndarray) or isinstance(rule, bytes):
        _refuse(name, _FORMS, rule)
    return "plane", [_as_given(number) for number in rule]


def _as_given(number: Any) -> Any:
    """Return a number of Python or numpy as Python's; return None for a value of another type, texts included."""
    if isinstance(number, np.integer | np.floating):
        return number.item()
    return number if isinstance(number, int | float) else None


def _numbers(given: Sequence[Any]) -> list[float]:
    """Return texts or numbers as floats, NaN for true and false; return an empty list if one of them is no number."""
    try:
        return [math.nan if isinstance(one, bool) else float(one) for one in given]
    except (TypeError, ValueError, OverflowError):
        return []


def _table_from_text(rule: str, name: str) -> Mapping[str, Any]:
    try:
        content = parsed_toml(f"nodes = {rule}")
    except ValueError:
        content = {}
    table = content.get("nodes")
    if len(content) != 1 or not isinstance(table, dict):
        _refuse(name, "one table, { plane = [nx, ny, nz, d] } or { centre_mm = [x, y, z], radius_mm = r }", rule)
    return table


def _of_table(rule: Mapping[str, Any], name: str) -> tuple[str, list[Any]]:
    if "plane" in rule and set(rule) <= set(_PLANE_KEYS):
        plane = rule["plane"]
        if not (isinstance(plane, Sequence) and len(plane) == 4 and not isinstance(plane, str)):
            _refuse(name, "a table whose `plane` is a list of 4 numbers, [nx, ny, nz, d]", dict(rule))
        return "plane", [_as_given(number) for number in (*plane, rule.get("tolerance_mm", TOLERANCE))]
    if set(rule) != set(_BALL_KEYS):
        _refuse(name, "a node set, { plane, tolerance_mm } or { centre_mm, radius_mm }", dict(rule))
    centre = rule["centre_mm"]
    if not (isinstance(centre, Sequence) and len(centre) == 3 and not isinstance(centre, str)):
        _refuse(name, "a table whose `centre_mm` is a list of 3 numbers", dict(rule))
    return "ball", [_as_given(number) for number in (*centre, rule["radius_mm"])]


def _refuse(name: str, rules: str, rule: Any) -> NoReturn:
    shown = repr(rule)[:120] if isinstance(rule, Mapping | Sequence) and not isinstance(rule, str) else found(rule)
    message = f"`{name}` must be {rules}, got {shown}"
    raise FormatError(message, where=name)


def nodes_near_plane(mesh: Mesh, normal: Sequence[float], offset: float, tolerance: float) -> IntArray:
    """Return the indices of the nodes near a plane, ``|n . x - offset| <= tolerance`` with the unit normal n.

    `mesh`: the body with node places x, mm; `normal`: normal of the plane, of any length but zero; `offset`: distance
    of the plane from the origin along the unit normal, mm; `tolerance`: how far a node may lie from the plane, mm.
    Result: int64 (n,), sorted indices, at least one. Raises `MeshError` if no node is that close.
    """
    unit = np.asarray(normal, dtype=np.float64)
    unit = unit / np.abs(unit).max()  # the squares of very long or short normals are no numbers
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
    """Return the indices of the nodes of the body's surface within a distance of a point.

    `mesh`: the body, mm; `centre`: the point (3,), mm; `radius`: the distance, mm. Result: int64 (n,), sorted indices,
    at least one. Raises `MeshError` if no node of the surface is that close.
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


def node_rule(meaning: str, **more: Any) -> Any:
    """Declare a dataclass field that holds a rule which chooses nodes: the name of a node set, or a table.

    The table describes a plane or a ball, in the form that `rule_for_file` returns. `meaning`: the field's meaning in
    one sentence; `more`: its default and further attributes of `Check`.
    """

    def take(name: str, value: Any, error: type[TissueRegError] = FormatError) -> str | dict[str, Any]:
        try:
            return rule_for_file(value, name)
        except FormatError as wrong:
            raise error(str(wrong), where=name) from wrong

    return checked(take, "node set, plane or ball", meaning, unit="mm", **more)
