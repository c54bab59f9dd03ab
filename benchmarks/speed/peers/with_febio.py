"""FEBio (`febio4` on the path), whole process: neo-Hookean, nodal forces, one step; `--method bfgs` or `newton`.

Its `rtol` bounds the squared residual over the first one, so a residual of 1e-6 is 1e-12 there.
"""

import argparse
import os
import re
import subprocess
import tempfile
import time
from pathlib import Path

import numpy as np

import common


def input_text(problem: dict, options: argparse.Namespace) -> str:
    """Return the .feb, spec 4.0: mm, mN, kPa."""
    loaded = np.flatnonzero(np.any(problem["forces_mN"], axis=1))
    nodes = "".join(
        f'<node id="{i}">{x:.12g},{y:.12g},{z:.12g}</node>\n' for i, (x, y, z) in enumerate(problem["nodes_mm"], 1)
    )
    tets = "".join(f'<elem id="{i}">{a},{b},{c},{d}</elem>\n' for i, (a, b, c, d) in enumerate(problem["tets"] + 1, 1))
    force = "".join(
        f'<node lid="{i}">{x:.12g},{y:.12g},{z:.12g}</node>\n'
        for i, (x, y, z) in enumerate(problem["forces_mN"][loaded], 1)
    )
    return f"""<?xml version="1.0" encoding="UTF-8"?>
<febio_spec version="4.0">
<Module type="solid"/>
<Control>
<analysis>STATIC</analysis><time_steps>1</time_steps><step_size>1</step_size><plot_level>PLOT_NEVER</plot_level>
<solver type="solid">
<symmetric_stiffness>symmetric</symmetric_stiffness><max_refs>50</max_refs>
<dtol>0</dtol><etol>0</etol><rtol>{options.tolerance**2:g}</rtol>
<qn_method type="BFGS"><max_ups>{10 if options.method == "bfgs" else 0}</max_ups></qn_method>
</solver>
</Control>
<Material><material id="1" name="tissue" type="neo-Hookean">
<density>1</density><E>{float(problem["young_kPa"]):.12g}</E><v>{float(problem["poisson"]):.12g}</v>
</material></Material>
<Mesh>
<Nodes name="all">
{nodes}</Nodes>
<Elements type="tet4" name="body">
{tets}</Elements>
<NodeSet name="base">{",".join(map(str, problem["fixed_nodes"] + 1))}</NodeSet>
<NodeSet name="loaded">{",".join(map(str, loaded + 1))}</NodeSet>
</Mesh>
<MeshDomains><SolidDomain name="body" mat="tissue"/></MeshDomains>
<MeshData><NodeData name="force" node_set="loaded" data_type="vec3">
{force}</NodeData></MeshData>
<Boundary><bc name="base" type="zero displacement" node_set="base">
<x_dof>1</x_dof><y_dof>1</y_dof><z_dof>1</z_dof></bc></Boundary>
<Loads><nodal_load name="pull" type="nodal_force" node_set="loaded">
<value lc="1" type="map">force</value></nodal_load></Loads>
<LoadData><load_controller id="1" type="loadcurve"><interpolate>LINEAR</interpolate>
<points><pt>0,0</pt><pt>1,1</pt></points></load_controller></LoadData>
<Output><logfile><node_data data="ux;uy;uz" delim="," file="moved.csv"/></logfile></Output>
</febio_spec>
"""


def cold(problem: dict, options: argparse.Namespace) -> common.Found:
    if options.element != "tet4":
        message = "ten-node tets are not written for FEBio here"
        raise NotImplementedError(message)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "body.feb").write_text(input_text(problem, options), encoding="ascii")
        environment = {**os.environ, "OMP_NUM_THREADS": str(options.threads), "MKL_NUM_THREADS": str(options.threads)}
        words = ["febio4", "-i", "body.feb"]
        start = time.perf_counter()
        done = subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, check=False)
        seconds = time.perf_counter() - start
        if "N O R M A L   T E R M I N A T I O N" not in done.stdout:
            raise RuntimeError(done.stdout[-500:])
        rows = [
            line.split(",")
            for line in Path(folder, "moved.csv").read_text(encoding="ascii").splitlines()
            if line[:1].isdigit()
        ]
        log = Path(folder, "body.log").read_text(encoding="utf-8")
    last = np.array(rows[-len(problem["nodes_mm"]) :], dtype=float)

    def count(name: str) -> int | None:
        counts = re.findall(rf"{name}[ .]*:\s*(\d+)", log)
        return int(counts[-1]) if counts else None

    factorisations = count("Total number of stiffness reformations")
    return common.Found(last[:, 1:], count("Total number of equilibrium iterations"), factorisations, None, seconds)


def about(options: argparse.Namespace) -> dict:
    output = subprocess.run(["febio4", "-noconfig"], input="quit\n", capture_output=True, text=True, check=False).stdout
    version = re.search(r"version\s+(\S+)", output)
    settings = "BFGS, 10 updates a factor" if options.method == "bfgs" else "full Newton"
    return {"version": f"FEBio {version[1] if version else '4'}", "settings": f"{settings}; whole process"}


if __name__ == "__main__":
    common.run("FEBio", cold, about)
