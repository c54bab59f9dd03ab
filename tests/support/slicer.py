"""Point lists as 3D Slicer writes them, as JSON and as text, for tests to read."""

import json

SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)


def control_point(label, position, status="defined"):
    """Return one control point with all fields that Slicer writes; it writes no place if there is none."""
    return {
        "id": label.rpartition("-")[2],
        "label": label,
        "description": "",
        "associatedNodeID": "vtkMRMLScalarVolumeNode1",
        "position": [float(x) for x in position] if status == "defined" else "",
        "orientation": [-1.0, -0.0, -0.0, -0.0, -1.0, -0.0, 0.0, 0.0, 1.0],
        "selected": True,
        "locked": False,
        "visibility": True,
        "positionStatus": status,
    }


def markups(points, frame="LPS", units="mm", **changes):
    """Return the content of a .mrk.json; a change to None drops a key of the list."""
    markup = {
        "type": "Fiducial",
        "coordinateSystem": frame,
        "coordinateUnits": units,
        "locked": False,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(points),
        "controlPoints": points,
        "measurements": [],
        "display": {"visibility": True, "color": [0.4, 1.0, 1.0], "glyphType": "Sphere3D"},
        **changes,
    }
    return {"@schema": SCHEMA, "markups": [{key: value for key, value in markup.items() if value is not None}]}


def write_mrk(path, points, frame="LPS", units="mm", scale=1.0, not_seen=()):
    """Write places by label as a .mrk.json; those in `not_seen` are not defined, each with a status in turn."""
    states = ("undefined", "missing", "preview")
    status = {label: states[i % 3] for i, label in enumerate(not_seen)}
    rows = [
        control_point(label, [scale * x for x in place], status.get(label, "defined"))
        for label, place in points.items()
    ]
    path.write_text(json.dumps(markups(rows, frame, units), indent=4), encoding="utf-8")
    return path


def fcsv_text(points, frame="LPS", beyond=""):
    """Return places by label as Slicer's text; `beyond` follows on every line, as in Slicer 5."""
    head = [
        "# Markups fiducial file version = 5.2",
        f"# CoordinateSystem = {frame}",
        "# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID",
    ]
    rows = [
        f"{i},{x!r},{y!r},{z!r},0,0,0,1,1,1,0,{label},,vtkMRMLScalarVolumeNode1{beyond}"
        for i, (label, (x, y, z)) in enumerate(points.items(), 1)
    ]
    return "\n".join([*head, *rows]) + "\n"


def other_frame(points):
    """Return places by label in the other frame of a patient: x and y with their signs changed."""
    return {label: (-x, -y, z) for label, (x, y, z) in points.items()}
