"""Markups of 3D Slicer as JSON (``.mrk.json``, schema 1.x): reading and writing of lists of points."""

import json
import math
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NoReturn

from tissuereg._base.arguments import place as path_of
from tissuereg._base.choices import FRAMES, Frame
from tissuereg.errors import FormatError
from tissuereg.io.atomic import OutputError
from tissuereg.io.bounds import FILES, existing_file, read_text
from tissuereg.io.json import write_json
from tissuereg.io.points import MM_PER_UNIT, NamedPoints

#: What Slicer 4.11 and later write and read; it wants this identifier, of any 1.x.
_SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
_SCHEMA_1 = re.compile(r"markups-schema-v1\.[0-9]+\.[0-9]+\.json#*$", re.IGNORECASE)
_NOT_SEEN = ("undefined", "preview", "missing")
_UNKNOWN = (math.nan, math.nan, math.nan)


def read_mrk_json(path: str | os.PathLike[str]) -> NamedPoints:
    """Read the named points in a markups file of 3D Slicer, with their places in mm in the file's frame.

    `path`: a file with one list of points. Where the file does not state them, the frame is LPS and the unit mm, as in
    Slicer. A point whose ``positionStatus`` is not ``defined`` gets NaN as its place. Raises `FormatError` if the file
    is missing or no such list; the message names the place in it.
    """
    file = existing_file(path, FILES.text_mb)
    markup = _only_list(file, _content(file))
    frame = markup.get("coordinateSystem", "LPS")
    if frame not in FRAMES:
        _refuse(file, "coordinateSystem", f"must be LPS or RAS, got {frame!r}")
    scale = _mm_per_unit(file, markup.get("coordinateUnits", "mm"))
    points = markup.get("controlPoints", [])
    if not isinstance(points, list):
        _refuse(file, "controlPoints", f"must be a list, got {type(points).__name__}")
    return NamedPoints.of(file, frame, [_point(file, row, point, scale) for row, point in enumerate(points, 1)])


def write_mrk_json(
    path: str | os.PathLike[str], points: Mapping[str, tuple[Sequence[float], str]], frame: Frame | None = None
) -> None:
    """Write a list of points as a markups file that 3D Slicer opens, whole or not at all.

    `path`: the file; its name should end in ``.mrk.json``; `points`: for each point by its label, its place (3,) in mm
    and its description; `frame`: ``"LPS"`` or ``"RAS"``, the frame of the places; for None the file states LPS, which
    Slicer assumes.
    """
    name = path_of("path", path, error=OutputError).name.removesuffix(".json").removesuffix(".mrk")
    markup = {
        "type": "Fiducial",
        "name": name,
        "coordinateSystem": frame or "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "controlPoints": [
            {
                "id": str(number),
                "label": label,
                "description": words,
                "position": [float(x) for x in place],
                "selected": True,
                "locked": True,
                "visibility": True,
                "positionStatus": "defined",
            }
            for number, (label, (place, words)) in enumerate(points.items(), 1)
        ],
    }
    write_json(path, {"@schema": _SCHEMA, "markups": [markup]})


def _content(file: Path) -> dict[str, Any]:
    try:
        # Whole numbers of any length become floats: none is counted here.
        content = json.loads(read_text(file), parse_int=float)
    except json.JSONDecodeError as error:
        message = f"{file} must be JSON; it is not, at line {error.lineno} column {error.colno}: {error.msg}"
        raise FormatError(message, where=f"{file}:{error.lineno}") from error
    except (UnicodeDecodeError, OSError, RecursionError) as error:
        message = f"{file} must be JSON in UTF-8 text; it cannot be read: {error}"
        raise FormatError(message, where=str(file)) from error
    schema = content.get("@schema") if isinstance(content, dict) else None
    if not isinstance(content, dict) or not isinstance(schema, str) or not _SCHEMA_1.search(schema):
        _refuse(file, "@schema", f"must name a markups schema of 3D Slicer, version 1, got {schema!r}")
    return content


def _only_list(file: Path, content: dict[str, Any]) -> dict[str, Any]:
    markups = content.get("markups")
    if not isinstance(markups, list) or len(markups) != 1 or not isinstance(markups[0], dict):
        found = f"{len(markups)}" if isinstance(markups, list) else repr(markups)
        _refuse(file, "markups", f"must hold one list of points, got {found}")
    markup: dict[str, Any] = markups[0]
    if markup.get("type") != "Fiducial":
        _refuse(file, "markups[0].type", f"must be Fiducial, a list of points, got {markup.get('type')!r}")
    return markup


def _mm_per_unit(file: Path, unit: object) -> float:
    """Return the number of mm in a unit of length, given as its UCUM code or as [code, "UCUM", meaning]."""
    code = unit
    if isinstance(unit, list):
        code = unit[0] if len(unit) == 3 and unit[1] == "UCUM" else None
    if not isinstance(code, str) or code not in MM_PER_UNIT:
        _refuse(file, "coordinateUnits", f"must be one of {', '.join(MM_PER_UNIT)} of UCUM, got {unit!r}")
    return MM_PER_UNIT[code]


def _point(file: Path, row: int, point: object, scale: float) -> tuple[str, str, tuple[float, float, float]]:
    where = f"control point {row}"
    if not isinstance(point, dict):
        _refuse(file, where, f"must be a table, got {type(point).__name__}")
    label, status = point.get("label", ""), point.get("positionStatus", "defined")
    if not isinstance(label, str):
        _refuse(file, where, f"must have text for its label, got {label!r}")
    if status != "defined":
        if status not in _NOT_SEEN:
            _refuse(file, where, f"must have positionStatus defined, {', '.join(_NOT_SEEN)}, got {status!r}")
        return where, label.strip(), _UNKNOWN
    place = point.get("position")
    if not (isinstance(place, list) and len(place) == 3 and all(_is_finite(x) for x in place)):
        _refuse(file, where, f"('{label}') must have a position of three finite numbers, got {place!r}")
    x, y, z = (scale * float(value) for value in place)
    return where, label.strip(), (x, y, z)


def _is_finite(value: object) -> bool:
    return isinstance(value, float) and math.isfinite(value)


def _refuse(file: Path, where: str, words: str) -> NoReturn:
    message = f"{where} of {file} {words}"
    raise FormatError(message, where=f"{file}: {where}")
