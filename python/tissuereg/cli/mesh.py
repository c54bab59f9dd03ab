"""The command ``tissuereg mesh``: fills a surface with tetrahedra."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING

from tissuereg._base.choices import FRAMES, UNITS
from tissuereg._base.fields import choice, number
from tissuereg.cli.common import Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse, refuse_overwriting

if TYPE_CHECKING:
    from tissuereg.meshing import FilledMesh

HELP = Help(
    "SURFACE is a .stl, .ply, .obj, .off, .vtp, .vtu, .vtk or .msh of triangles, or with --label a segmentation "
    "(.seg.nrrd, .nrrd, .nii.gz, .mha; pip install 'tissuereg[images]'; a DICOM SEG as .dcm: 'tissuereg[dicom]'). "
    "Its vertices are merged, holes closed "
    "and normals turned outwards; whatever was done is listed. BODY.vtu (or .npz) gets tetrahedra in mm, the node sets "
    "and the patient frame, and 'tissuereg register', 'simulate' and 'tr.read_mesh' take it. A rule is 'plane nx ny nz "
    "d [tol]' (nodes within tol mm of n . x = d mm), 'ball x y z r' (nodes of the surface within r mm), 'box x0 y0 z0 "
    "x1 y1 z1' or 'near FILE r' (those in a box, and within r mm of another surface), or the name of another set; all "
    "in mm. The mesher (pytetwild: pip install 'tissuereg[mesh]') uses random numbers and takes no seed: its answer "
    "differs from run to run.",
    example="tissuereg mesh liver.stl --size 6 --out liver.vtu --json -\n"
    "tissuereg mesh seg.nrrd --label liver --label tumour --size 6 --out liver.vtu",
    threads="threads of the mesher (default: all cores)",
)

#: Median edge over size below which a line says what makes edges short.
_SHORT = 0.75


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg mesh`` to its parser."""
    parser.add_argument("surface", metavar="SURFACE", help="surface of the body, with any defects")
    text = "target edge length in mm; three or more across the thinnest part that bends is a good start"
    add_option(parser, "--size", number(text, unit="mm", above=0.0), "MM")
    parser.add_argument("--out", required=True, metavar="BODY.vtu", help="file for the tetrahedra")
    usual = "that stated in the file, or else mm"
    unit = choice(UNITS, "unit of SURFACE's coordinates", default=None, otherwise=usual)
    add_option(parser, "--unit", unit)
    text = "LPS or RAS: patient frame of SURFACE's coordinates, which BODY then states; no number is turned"
    usual = "that stated in the file, if one is"
    add_option(parser, "--frame", choice(FRAMES, text, default=None, otherwise=usual))
    usual = "5 % of the size, at most 0.1 % of the diagonal"
    deviation = number("how far faces may lie from the surface", unit="mm", above=0.0, default=None, otherwise=usual)
    add_option(parser, "--deviation", deviation, "MM")
    text = "label of a segmentation, by name or number; several make one body together"
    parser.add_argument("--label", action="append", metavar="NAME-or-NUMBER", help=text)
    sets = parser.add_argument_group("node sets")
    text = "nodes that are held, by a rule; may be given several times"
    sets.add_argument("--fixed", action="append", metavar="RULE", help=text)
    text = "nodes of a set called NAME, by a rule; may be given several times"
    sets.add_argument("--set", action="append", nargs=2, default=[], metavar=("NAME", "RULE"), help=text)


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg mesh``: fill a surface, write the mesh; JSON schema ``tissuereg.mesh/1``."""
    from tissuereg.io.atomic import check_file_target
    from tissuereg.io.meshes import write_mesh_npz, write_vtu
    from tissuereg.meshing import tetrahedralize

    writer = {".vtu": write_vtu, ".npz": write_mesh_npz}.get(Path(args.out).suffix.lower())
    if writer is None:
        refuse(f"--out must end in .vtu or .npz, got '{args.out}'", "--out")
    refuse_overwriting([Path(args.out)], [args.surface])
    check_file_target(args.out)
    clock = Stopwatch()
    mesh = tetrahedralize(
        (args.surface, args.label) if args.label else args.surface,
        args.size,
        unit=args.unit,
        frame=args.frame,
        fixed=args.fixed,
        node_sets=_sets(args.set),
        deviation_mm=args.deviation,
        threads=args.threads,
    )
    clock.lap("mesh")
    writer(args.out, mesh)
    writing = clock.lap("write")
    seconds = {**mesh.seconds, "write": writing, "total": clock.seconds["total"]}
    content = {
        "schema": "tissuereg.mesh/1",
        "nodes": mesh.n_nodes,
        "tets": mesh.n_tets,
        **mesh.quality,
        "repaired": mesh.repaired,
        "labels": mesh.labels,
        "frame": mesh.frame,
        "node_sets": {name: len(nodes) for name, nodes in mesh.node_sets.items()},
        **mesh.settings,
        "repeatable": False,
        "seed": None,
        "seconds": seconds,
    }
    return Outcome(content, _summary(mesh, seconds_line(seconds, verbose=args.verbose), args.out), args.threads)


def _sets(given: list[list[str]]) -> dict[str, list[str]]:
    sets: dict[str, list[str]] = {}
    for name, rule in given:
        sets.setdefault(name, []).append(rule)
    return sets


def _of_deviation(mesh: "FilledMesh") -> list[str]:
    """Return a line of advice if edges are much shorter than asked for because faces follow the surface so closely."""
    size, deviation = float(mesh.settings["size_mm"]), float(mesh.settings["deviation_mm"])
    if mesh.quality["median_edge_mm"] > _SHORT * size:
        return []
    return [
        f"edges are shorter than the size of {size:g} mm, since faces follow the surface to {deviation:.2g} mm: "
        f"--deviation {0.1 * size:.2g} gives fewer elements"
    ]


def _of_label(name: str, found: dict[str, float]) -> str:
    """Return a line about a label: its tets, and its volume against that of its voxels."""
    change = 100.0 * (found["volume_mm3"] / found["voxels_mm3"] - 1.0)
    volumes = f"{found['volume_mm3']:.6g} mm^3, {change:+.2g} % against its voxels ({found['voxels_mm3']:.6g} mm^3)"
    return f"{name}: {found['tets']} tets, {volumes}"


def _summary(mesh: "FilledMesh", spent: str, out: str) -> str:
    found = mesh.quality
    lines = [
        f"{mesh.n_nodes} nodes, {mesh.n_tets} tets: shape quality at least {found['min_quality']:.2f}, median "
        f"{found['median_quality']:.2f} (1 is regular); edges at least {found['shortest_edge_mm']:.3g} mm, median "
        f"{found['median_edge_mm']:.3g} mm",
        f"{found['volume_mm3']:.6g} mm^3, {found['volume_change_percent']:+.2g} % against the surface; faces at most "
        f"{found['surface_distance_mm']:.2g} mm from it, the surface at most {found['missed_mm']:.2g} mm from them",
        *_of_deviation(mesh),
        *(_of_label(name, one) for name, one in mesh.labels.items()),
        *(f"repaired: {sentence}" for sentence in mesh.repaired),
        *([f"patient frame: {mesh.frame}"] if mesh.frame else []),
        "node sets: " + (", ".join(f"{name} ({len(nodes)})" for name, nodes in mesh.node_sets.items()) or "none"),
        spent,
        f"written: {out}",
    ]
    return "\n".join(lines)
