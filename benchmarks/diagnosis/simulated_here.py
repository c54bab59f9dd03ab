"""Rigs without a hidden effect, simulated with the stated noise and diagnosed: how many are `consistent`.

``python -m diagnosis.simulated_here`` simulates and diagnoses what is missing in ``archive/simulated-here`` and
writes ``RESULTS-simulated-here.md``. The number of a rig seeds its random choices: a block or a dome of 300
to 700 nodes, one to three pads given by balls or by node sets, strokes of three to six millimetres, Poisson's ratio.
Every third one is simulated with ``--plain``, on the mesh as it is.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np

import tissuereg as tr
from common import read_archive, write_archive
from support.meshes import block
from tissuereg.cli import main as command
from tissuereg.cli.common import envelope
from tissuereg.io.meshes import write_vtu

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE = HERE / "archive" / "simulated-here", HERE / "RESULTS-simulated-here.md"
TABLES = ("rows/<rig>",)

#: Number of rigs, and frames of a rest case and of a push: up, held, down.
RIGS = 30
REST, PUSH = 12, np.concatenate([np.linspace(0.0, 1.0, 5), np.ones(6), np.linspace(1.0, 0.0, 5)])

#: Stated noise, mm and mN.
MARKER_STD, FORCE_STD = 0.05, 5.0


def body(rng: np.random.Generator) -> tr.Mesh:
    """Return a block or a dome, held at z = 0."""
    cells = rng.integers([7, 6, 5], [9, 9, 7])
    size = rng.uniform([50.0, 40.0, 30.0], [70.0, 60.0, 45.0])
    mesh = block(tuple(size), tuple(int(n) for n in cells))
    if rng.random() < 0.5:
        return mesh
    # A dome: the block's top bulges, its sides lean inwards.
    x, y, z = (mesh.nodes / size).T
    nodes = mesh.nodes.copy()
    nodes[:, :2] = 0.5 * size[:2] + (nodes[:, :2] - 0.5 * size[:2]) * (1.0 - 0.3 * z[:, None] ** 2)
    nodes[:, 2] += 0.25 * size[2] * z * np.sin(np.pi * x) * np.sin(np.pi * y)
    return tr.Mesh(nodes, mesh.tets, mesh.node_sets)


def write_rig(number: int, folder: Path) -> str:
    """Write the rig of a number as an experiment without measurements; return its description."""
    rng = np.random.default_rng([20, number])
    mesh = body(rng)
    surface, extent = mesh.surface_nodes, mesh.extent
    free = surface[mesh.nodes[surface, 2] > 0.45 * mesh.nodes[:, 2].max()]
    centres, pads = [], []
    by_balls = bool(rng.random() < 0.6)
    for pad in range(int(rng.integers(1, 4))):
        far = [p for p in free if all(np.linalg.norm(mesh.nodes[p] - c) > 0.35 * extent for c in centres)]
        if not far:
            break
        centre = mesh.nodes[rng.choice(far)]
        centres.append(centre)
        radius = float(rng.uniform(0.13, 0.17) * extent)
        inside = mesh.surface_nodes_within(centre, radius)
        if by_balls:
            rule = f"{{ centre_mm = {np.round(centre, 4).tolist()}, radius_mm = {radius:.3f} }}"
        else:
            mesh = mesh.with_node_set(f"pad_{pad}", inside)
            rule = f'"pad_{pad}"'
        towards = mesh.nodes.mean(axis=0) - centre
        motion = rng.uniform(3.0, 6.0) * towards / np.linalg.norm(towards) + rng.normal(0.0, 0.5, 3)
        pads.append((f"push_{pad}", rule, motion))
    others = np.array([p for p in free if all(np.linalg.norm(mesh.nodes[p] - c) > 0.2 * extent for c in centres)])
    markers = mesh.nodes[rng.choice(others, min(18, len(others)), replace=False)]
    poisson = float(rng.uniform(0.35, 0.47))
    lines = [f'name = "rig {number}"', "[mesh]", 'file = "mesh.vtu"', "[material]", "young_kpa = [10.0, 3.0]"]
    lines += [f"poisson = {poisson:.3f}", "[forces]", f"std_mN = {FORCE_STD}", "[markers]", f"std_mm = {MARKER_STD}"]
    lines += ['rest_case = "rest"', "[markers.reference]"]
    lines += [f"P{i} = {np.round(place, 4).tolist()}" for i, place in enumerate(markers)]
    lines += ["[[boundary]]", 'name = "base"', 'nodes = "fixed"', 'kind = "fixed"']
    for name, rule, _ in pads:
        lines += ["[[actuator]]", f'name = "{name}"', f"nodes = {rule}", 'kind = "displacement"']
    folder.mkdir(parents=True)
    (folder / "experiment.toml").write_text("\n".join(lines) + "\n", encoding="utf-8")
    write_vtu(folder / "mesh.vtu", mesh)
    felt = ["case,time_s,actuator,x_mN,y_mN,z_mN"]
    rows, seen = ["case,time_s,actuator,x_mm,y_mm,z_mm"], ["case,time_s,marker,x_mm,y_mm,z_mm"]
    place = ",".join(str(v) for v in np.round(markers[0], 4))
    seen += [f"rest,{0.5 * k},P0,{place}" for k in range(REST)]
    for case, (name, _, motion) in enumerate(pads, start=1):
        for k, share in enumerate(PUSH):
            moved = ",".join(f"{v:.4f}" for v in share * motion)
            rows.append(f"{name},{20.0 * case + 0.5 * k},{name},{moved}")
            seen.append(f"{name},{20.0 * case + 0.5 * k},P0,{place}")
            felt.append(f"{name},{20.0 * case + 0.5 * k},{name},0,0,0")
    (folder / "actuators.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    (folder / "forces.csv").write_text("\n".join(felt) + "\n", encoding="utf-8")
    (folder / "markers.csv").write_text("\n".join(seen) + "\n", encoding="utf-8")
    how = "balls" if by_balls else "node sets"
    return f"{mesh.n_nodes} nodes, {len(pads)} pads by {how}, Poisson's ratio {poisson:.2f}"


def diagnosed(number: int, work: Path) -> dict[str, object]:
    """Simulate and diagnose one rig by the commands, and return the answer."""
    rig, simulated, answer = work / f"rig{number}", work / f"sim{number}", work / f"answer{number}.json"
    words = write_rig(number, rig)
    plain = number % 3 == 2
    options = ["--plain"] if plain else []
    how = ["--noise", "--seed", str(number), "--threads", "1", "--quiet"]
    if command(["simulate", str(rig), *options, *how, "--out", str(simulated)]):
        message = f"rig {number} was not simulated"
        raise SystemExit(message)
    begin = time.perf_counter()
    options = ["--threads", "1", "--no-cache", "--quiet", "--json", str(answer)]
    if command(["diagnose", str(simulated), *options]):
        message = f"rig {number} was not diagnosed"
        raise SystemExit(message)
    found = json.loads(answer.read_text(encoding="utf-8"))
    return {
        "rig": words,
        "model": "plain" if plain else "fine",
        "verdict": found["verdict"],
        "causes": [cause["id"] for cause in found["causes"]],
        "p_misfit": found["p_misfit"],
        "seconds": time.perf_counter() - begin,
    }


def page(archive: dict) -> str:
    """Return the page of an archive."""
    rows = archive["rows"]
    lines = ["# Simulated and diagnosed by this package", ""]
    lines += [
        "Random rigs of 300 to 700 nodes without a hidden effect, simulated with their stated noise and then "
        "diagnosed: every one should be answered `consistent`. *fine*: simulated on a fine mesh, as usual; *plain*: on "
        "the mesh as it is. p: p-value of the misfit. Written by `make -C benchmarks/diagnosis simulated-here`.",
        "",
    ]
    lines += ["| model | rigs | `consistent` | smallest p | median p | median time, s |", "|---" * 6 + "|"]
    for model in ("fine", "plain", "all"):
        mine = [row for row in rows.values() if model in (row["model"], "all")]
        if mine:
            right = sum(row["verdict"] == "consistent" for row in mine)
            p, spent = ([row[key] for row in mine] for key in ("p_misfit", "seconds"))
            figures = f"{min(p):.2g} | {np.median(p):.2g} | {np.median(spent):.0f}"
            lines.append(f"| {model} | {len(mine)} | {right} | {figures} |")
    odd = {number: row for number, row in rows.items() if row["verdict"] != "consistent"}
    for number, row in odd.items():
        answer = f"{row['verdict']} {', '.join(row['causes'])}".strip()
        lines += ["", f"Rig {number} ({row['rig']}, {row['model']}): {answer}, p {row['p_misfit']:.2g}."]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Diagnose what is missing, save every answer at once, write the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rigs", type=int, default=RIGS)
    parser.add_argument("--page", action="store_true", help="write the page from the archive, diagnose nothing")
    options = parser.parse_args()
    fresh = {"schema": "tissuereg.simulated-here/1", **envelope(1), "rows": {}}
    archive = read_archive(ARCHIVE) if ARCHIVE.exists() else fresh
    for number in range(0 if options.page else options.rigs):
        if str(number) in archive["rows"]:
            continue
        with tempfile.TemporaryDirectory() as work:
            archive["rows"][str(number)] = diagnosed(number, Path(work))
        write_archive(ARCHIVE, archive, TABLES)
        print(number, archive["rows"][str(number)], flush=True)
    PAGE.write_text(page(archive), encoding="utf-8")


if __name__ == "__main__":
    main()
