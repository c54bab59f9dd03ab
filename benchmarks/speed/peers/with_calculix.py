"""CalculiX (`ccx`), whole process: `*HYPERELASTIC, NEO HOOKE`, which is another law than the reference's.

Its energy is C10 (I1 J^(-2/3) - 3) + (J - 1)^2 / D1; with C10 = mu / 2 and D1 = 2 / K it agrees at small strain only,
so its displacement differs from the reference by the law, not by its accuracy. Its times stand for the work.
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


def input_text(problem: dict, tolerance: float) -> str:
    """Return the .inp: mm, mN, kPa (consistent: 1 kPa = 1 mN/mm^2)."""
    mu, lame = common.lame(problem)
    bulk = lame + 2 * mu / 3
    lines = ["*NODE, NSET=ALL"]
    lines += [f"{i}, {x:.12g}, {y:.12g}, {z:.12g}" for i, (x, y, z) in enumerate(problem["nodes_mm"].tolist(), 1)]
    lines += ["*ELEMENT, TYPE=C3D4, ELSET=BODY"]
    lines += [f"{i}, " + ", ".join(map(str, tet)) for i, tet in enumerate((problem["tets"] + 1).tolist(), 1)]
    lines += ["*BOUNDARY", *(f"{node}, 1, 3" for node in (problem["fixed_nodes"] + 1).tolist())]
    lines += ["*MATERIAL, NAME=TISSUE", "*HYPERELASTIC, NEO HOOKE", f"{mu / 2:.12g}, {2 / bulk:.12g}"]
    lines += ["*SOLID SECTION, ELSET=BODY, MATERIAL=TISSUE", "*STEP, NLGEOM, INC=100", "*STATIC", "1., 1."]
    lines += ["*CONTROLS, PARAMETERS=FIELD", f"{tolerance:g}, 1.", "*CLOAD"]
    rows, axes = np.nonzero(problem["forces_mN"])
    lines += [
        f"{n + 1}, {a + 1}, {problem['forces_mN'][n, a]:.12g}"
        for n, a in zip(rows.tolist(), axes.tolist(), strict=True)
    ]
    return "\n".join([*lines, "*NODE PRINT, NSET=ALL", "U", "*END STEP", ""])


def cold(problem: dict, options: argparse.Namespace) -> common.Found:
    if options.element != "tet4":
        message = "ten-node tets are not written for CalculiX here"
        raise NotImplementedError(message)
    with tempfile.TemporaryDirectory() as folder:
        Path(folder, "body.inp").write_text(input_text(problem, options.tolerance), encoding="ascii")
        threads = {name: str(options.threads) for name in ("OMP_NUM_THREADS", "CCX_NPROC_EQUATION_SOLVER")}
        start = time.perf_counter()
        done = subprocess.run(
            ["ccx", "body"], cwd=folder, env={**os.environ, **threads}, capture_output=True, text=True
        )
        seconds = time.perf_counter() - start
        if done.returncode or "Job finished" not in done.stdout:
            raise RuntimeError(done.stdout[-300:] + done.stderr[-300:])
        rows = [line.split() for line in Path(folder, "body.dat").read_text(encoding="ascii").splitlines()]
    values = np.array([[float(word) for word in row] for row in rows if len(row) == 4 and row[0].isdigit()])
    last = values[-len(problem["nodes_mm"]) :]
    iterations = len(re.findall(r"^ iteration\s+\d+", done.stdout, re.MULTILINE))
    return common.Found(last[:, 1:], iterations, iterations, None, seconds)


def about(options: argparse.Namespace) -> dict:
    output = subprocess.run(["ccx", "-v"], capture_output=True, text=True, check=False).stdout
    version = re.search(r"[Vv]ersion\s+(\S+)", output)
    return {
        "version": f"CalculiX {version[1] if version else '?'}",
        "settings": "Newton, default direct solver; largest residual <= tolerance x average force; whole process",
        "law": "isochoric neo-Hooke + (J-1)^2: another law, displacement differs by it",
    }


if __name__ == "__main__":
    common.run("CalculiX", cold, about)
