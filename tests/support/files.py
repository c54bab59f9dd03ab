"""Valid input files, which tests write and change."""

import json
from pathlib import Path

import numpy as np

from support.meshes import block
from tissuereg.cli import main


def problem_arrays(**changes):
    """Return the arrays of a small static problem: a block pulled sideways at its top; None drops an array."""
    mesh = block()
    forces = np.zeros_like(mesh.nodes)
    top = mesh.nodes[:, 2] == 40.0
    forces[top, 0] = 200.0 / top.sum()
    arrays = {
        "nodes_mm": mesh.nodes,
        "tets": mesh.tets,
        "fixed_nodes": mesh.fixed_nodes,
        "forces_mN": forces,
        "young_kPa": 10.0,
        "poisson": 0.45,
        **changes,
    }
    return {name: array for name, array in arrays.items() if array is not None}


def write_problem(path: Path, **changes) -> Path:
    """Write `problem_arrays` as an .npz."""
    np.savez(path, **problem_arrays(**changes))
    return path


MARKERS_HEADER = "marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm\n"
GOOD_MARKERS = MARKERS_HEADER + "P1,30,10,40,31,10,40\nP2,0,10,40,1,10,40\nP3,15,0,20,,,\n"

#: Two frames of two of these markers, one of them not seen in the second.
GOOD_RECORDING = "time_s,marker,x_mm,y_mm,z_mm\n0.0,P1,30,10,40\n0.0,P2,0,10,40\n0.1,P1,31,10,40\n0.1,P2,,,\n"

#: Points of 3D Slicer where three markers sit.
FIDUCIALS = """\
# Markups fiducial file version = 4.11
# CoordinateSystem = LPS
# columns = id,x,y,z,ow,ox,oy,oz,vis,sel,lock,label,desc,associatedNodeID
1,30,10,40,0,0,0,1,1,1,0,P1,,
2,0,10,40,0,0,0,1,1,1,0,P2,,
3,15,0,20,0,0,0,1,1,1,0,P3,,
"""

EXPERIMENT = """\
name = "leaning block"
[mesh]
file = "mesh.vtu"
[material]
law = "neo-hookean"
young_kpa = [10.0, 3.0]
poisson = 0.45
density_g_per_cm3 = 1.0
[[boundary]]
name = "base"
nodes = { plane = [0.0, 0.0, 1.0, 0.0], tolerance_mm = 0.1 }
kind = "fixed"
[[actuator]]
name = "push"
nodes = { centre_mm = [30.0, 10.0, 40.0], radius_mm = 8.0 }
kind = "displacement"
contact = "bonded"
[forces]
std_mN = 5.0
[markers]
std_mm = 0.05
rest_case = "rest"
[markers.reference]
P1 = [0.0, 10.0, 40.0]
P2 = [15.0, 0.0, 20.0]
[[target]]
name = "deep"
reference = [15.0, 10.0, 20.0]
"""

TABLES = {
    "markers.csv": "case,time_s,marker,x_mm,y_mm,z_mm\n"
    "rest,0.0,P1,0.0,10.0,40.0\nrest,0.0,P2,15.0,0.0,20.0\nrest,0.5,P1,0.1,10.0,40.0\n"
    "lean,10.0,P1,0.0,10.0,40.0\nlean,10.0,P2,15.0,0.0,20.0\n"
    "lean,10.5,P1,1.0,10.0,40.0\nlean,10.5,P2,,,\nlean,11.0,P1,2.0,10.0,40.0\nlean,11.0,P2,16.0,0.0,20.0\n",
    "actuators.csv": "case,time_s,actuator,x_mm,y_mm,z_mm\nlean,10.0,push,0,0,0\nlean,11.0,push,2,0,0\n",
    "forces.csv": "case,time_s,actuator,x_mN,y_mN,z_mN\nlean,11.0,push,300,0,0\n",
    "targets.csv": "case,time_s,target,x_mm,y_mm,z_mm\nlean,11.0,deep,15.5,10.0,20.0\n",
}


def write_experiment(folder: Path, *, toml: str = EXPERIMENT, **tables: str | None) -> Path:
    """Write an experiment folder; a table named without its suffix is replaced, or dropped where None."""
    from tissuereg.io.meshes import write_vtu

    folder.mkdir(exist_ok=True)
    write_vtu(folder / "mesh.vtu", block())
    (folder / "experiment.toml").write_text(toml, encoding="utf-8")
    for name, text in {**TABLES, **{f"{name}.csv": text for name, text in tables.items()}}.items():
        if text is not None:
            (folder / name).write_text(text, encoding="utf-8")
    return folder


def run(capsys, *words, program=main):
    """Run a command line in this process; return its code, standard output and standard error."""
    code = program([str(word) for word in words])
    output = capsys.readouterr()
    return code, output.out, output.err


def run_json(capsys, *words, program=main):
    """Run a command line with ``--json -``; return its code, the JSON and standard error."""
    code, out, err = run(capsys, *words, "--json", "-", program=program)
    return code, json.loads(out, parse_constant=lambda name: (_ for _ in ()).throw(ValueError(name))), err
