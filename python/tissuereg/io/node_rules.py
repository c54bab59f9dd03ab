"""Rules that choose nodes of a mesh: a plane, a ball, a box, what is near a surface, or the name of a node set.

Experiment files, the command line and Python use the same notation.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

import numpy as np

from tissuereg._base.arguments import found, text
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg._base.fields import checked
from tissuereg.body.mesh import Mesh
from tissuereg.errors import FormatError, MeshError, TissueRegError
from tissuereg.io.toml import parsed_toml

#: The name of a node set; a rule as text, such as ``"plane nx ny nz d [tol]"``; the numbers of a plane; a table such as
#: ``{"centre_mm": [x, y, z], "radius_mm": r}``, or the text of such a table.
NodeRule = str | Sequence[float] | Mapping[str, Any]

#: How far a node may lie from a plane by default, mm.
TOLERANCE = 0.1


@dataclass(frozen=True)
class _Form:
    """A kind of rule.

    `text`: how it is written; `must`: what must hold besides; `keys`: of its table, each with the count of its numbers,
    0 for a single one; `holds`: whether values are such; `choose`: the nodes (n,) that values choose of a mesh.
    """

    text: str
    must: str
    keys: Mapping[str, int]
    holds: Callable[[list[Any]], bool]
    choose: Callable[[Mesh, list[Any]], IntArray]

    def table(self, values: list[Any]) -> dict[str, Any]:
        """Return values as a table."""
        left = list(values)
        return {key: [left.pop(0) for _ in range(count)] if count else left.pop(0) for key, count in self.keys.items()}


def nodes_by_rule(mesh: Mesh, rule: NodeRule, name: str = "fixed") -> IntArray:
    """Return the indices of the nodes that a rule chooses, of the whole body or of its surface.

    `mesh`: the body, mm; `rule`: the name of a node set. Or all nodes near a plane: ``"plane nx ny nz d [tol]"``
    (normal n, distance d from the origin along n brought to length 1, tolerance, both in mm), those four or five
    numbers, or ``{"plane": [nx, ny, nz, d], "tolerance_mm": tol}``; `tol` is 0.1 mm where it is absent. Or the surface
    nodes in a ball of centre x, y, z and radius r in mm: ``"ball x y z r"`` or ``{"centre_mm": [x, y, z], "radius_mm":
    r}``; in a box along the axes: ``"box x0 y0 z0 x1 y1 z1"`` or ``{"low_mm": [x0, y0, z0], "high_mm": [x1, y1, z1]}``;
    or within r mm of another surface: ``"near FILE r"``. A table may be given as TOML text; `name`: name of the
    argument or key, for the message. Result: int64 (n,), sorted indices, at least one. Raises `FormatError` if the rule
    or the file cannot be read; `MeshError` if there is no such node set, or no node is chosen.
    """
    kind, values = parsed_rule(rule, name)
    return _FORMS[kind].choose(mesh, values) if values else mesh.node_set(kind)


def parsed_rule(rule: NodeRule, name: str = "fixed") -> tuple[str, list[Any]]:
    """Return the kind and the values of a rule that chooses nodes, so that a wrong rule is refused before long work.

    `rule`: in a form that `nodes_by_rule` accepts; `name`: name of the argument or key, for the message. Result:
    ``plane`` with [nx, ny, nz, d, tol], ``ball`` with [x, y, z, r], ``box`` with its lowest and its highest corner, all
    in mm, ``near`` with the name of a file and a distance in mm, or the name of a node set with an empty list. Raises
    `FormatError` if the rule cannot be read.
    """
    kind, given = _kind_and_words(rule, name)
    if kind == "label" and given:
        _refuse(name, f"{_TEXTS}: labels choose nodes where a segmentation is meshed ('mesh SEGMENTATION')", rule)
    if kind not in _FORMS or not given:
        return text(name, rule, error=FormatError), []
    form = _FORMS[kind]
    values = [given[0], *_numbers(given[1:])] if kind == "near" else _numbers(given)
    if kind == "plane" and len(values) == 4:
        values.append(TOLERANCE)
    numbers = values[1:] if kind == "near" else values
    whole = len(values) == sum(max(count, 1) for count in form.keys.values()) and bool(np.isfinite(numbers).all())
    if not (whole and form.holds(values)):
        _refuse(name, f"'{form.text}', {form.must}", rule)
    return kind, values


def rule_for_file(rule: NodeRule, name: str = "nodes") -> str | dict[str, Any]:
    """Return a rule that chooses nodes as an experiment file holds it: the name of a node set, or a table.

    `rule`: in a form that `nodes_by_rule` accepts; `name`: name of the argument or key, for the message. Raises
    `FormatError` if the rule cannot be read, or depends on another file.
    """
    kind, values = parsed_rule(rule, name)
    if kind == "near" and values:
        must = "a rule that the file itself can hold; make a node set of the mesh from 'near' (tissuereg mesh --set)"
        _refuse(name, must, rule)
    return _FORMS[kind].table(values) if values else kind


def _kind_and_words(rule: Any, name: str) -> tuple[str, list[Any]]:
    """Split a rule that chooses nodes: return its kind and its values, not converted yet.

    For the name of a node set, return its words: the first, and the list of the others. `name`: name of the argument,
    for the message.
    """
    if isinstance(rule, str):
        if rule.lstrip().startswith("{"):
            return _of_table(_table_from_text(rule, name), name)
        kind, *words = rule.split() or [""]
        if kind == "near" and words:  # names of files may hold blanks
            words = rule.split(maxsplit=1)[1].rsplit(maxsplit=1)
        return kind, list(words)
    if isinstance(rule, Mapping):
        return _of_table(rule, name)
    if not isinstance(rule, Sequence | np.ndarray) or isinstance(rule, bytes):
        _refuse(name, f"the name of a node set, {_TEXTS}", rule)
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
    full = {"tolerance_mm": TOLERANCE, **rule} if "plane" in rule else rule
    kind = next((kind for kind in _IN_TABLES if set(full) == set(_FORMS[kind].keys)), None)
    if kind is None:
        _refuse(name, f"a node set, {_TABLES}", dict(rule))
    values: list[Any] = []
    for key, count in _FORMS[kind].keys.items():
        given = full[key]
        if count and not (isinstance(given, Sequence) and len(given) == count and not isinstance(given, str)):
            _refuse(name, f"a table whose `{key}` is a list of {count} numbers", dict(rule))
        values += [_as_given(number) for number in (given if count else [given])]
    return kind, values


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


def _surface_nodes_in_box(mesh: Mesh, low: Sequence[float], high: Sequence[float]) -> IntArray:
    places = mesh.nodes[mesh.surface_nodes]
    inside = ((places >= low) & (places <= high)).all(axis=1)
    if not inside.any():
        gaps = np.linalg.norm(np.maximum(0.0, np.maximum(np.subtract(low, places), np.subtract(places, high))), axis=1)
        message = (
            f"a surface node must lie in the box from {list(low)} to {list(high)}; "
            f"the nearest is {gaps.min():.4g} mm away"
        )
        raise MeshError(message, where="box")
    return np.asarray(mesh.surface_nodes[inside])


def _surface_nodes_near(mesh: Mesh, file: str, within: float) -> IntArray:
    from tissuereg.body.closest import ClosestTriangles
    from tissuereg.io.points import turned
    from tissuereg.io.surfaces import read_triangles

    other = read_triangles(file)
    vertices = turned(other.vertices, other.frame, mesh.frame)
    gaps = ClosestTriangles(vertices[other.triangles]).find(mesh.nodes[mesh.surface_nodes]).distances
    if gaps.min() > within:
        message = f"a surface node must lie within {within:g} mm of {file}; the nearest is {gaps.min():.4g} mm away"
        raise MeshError(message, where="near")
    return np.asarray(mesh.surface_nodes[gaps <= within])


def _forms() -> dict[str, _Form]:
    """Return every kind of rule by the word that it starts with."""
    return {
        "plane": _Form(
            "plane nx ny nz d [tol]",
            "normal not zero and tol at least 0 mm",
            {"plane": 4, "tolerance_mm": 0},
            lambda values: values[4] >= 0.0 and any(values[:3]),
            lambda mesh, values: nodes_near_plane(mesh, values[:3], values[3], values[4]),
        ),
        "ball": _Form(
            "ball x y z r",
            "the radius r positive, in mm",
            {"centre_mm": 3, "radius_mm": 0},
            lambda values: values[3] > 0.0,
            lambda mesh, values: surface_nodes_in_ball(mesh, values[:3], values[3]),
        ),
        "box": _Form(
            "box x0 y0 z0 x1 y1 z1",
            "the second corner above the first along each axis, in mm",
            {"low_mm": 3, "high_mm": 3},
            lambda values: all(low < high for low, high in zip(values[:3], values[3:], strict=True)),
            lambda mesh, values: _surface_nodes_in_box(mesh, values[:3], values[3:]),
        ),
        "near": _Form(
            "near FILE r",
            "a surface and a distance above 0 mm",
            {"near": 0, "within_mm": 0},
            lambda values: values[1] > 0.0,
            lambda mesh, values: _surface_nodes_near(mesh, values[0], values[1]),
        ),
    }


_FORMS = _forms()

#: Kinds that tables may state: they hold no names of files.
_IN_TABLES = ("plane", "ball", "box")

_TEXTS = ", ".join(f"'{form.text}'" for form in _FORMS.values())
_TABLES = " or ".join("{ " + ", ".join(_FORMS[kind].keys) + " }" for kind in _IN_TABLES)

#: Words that start a rule which is not the name of a node set.
KINDS = tuple(_FORMS)


def node_rule(meaning: str, **more: Any) -> Any:
    """Declare a dataclass field that holds a rule which chooses nodes: the name of a node set, or a table.

    The table describes a plane, a ball or a box, in the form that `rule_for_file` returns. `meaning`: the field's
    meaning in one sentence; `more`: its default and further attributes of `Check`.
    """

    def take(name: str, value: Any, error: type[TissueRegError] = FormatError) -> str | dict[str, Any]:
        try:
            return rule_for_file(value, name)
        except FormatError as wrong:
            raise error(str(wrong), where=name) from wrong

    return checked(take, "node set, plane, ball or box", meaning, unit="mm", **more)
