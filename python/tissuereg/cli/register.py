"""``tissuereg register``: one moment of a body, from mesh and markers or from an experiment."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg.cli.body_input import add_method_options, method_of
from tissuereg.cli.common import UNTRUSTED, Outcome, Stopwatch, envelope
from tissuereg.cli.options import Help, Parser, refuse_overwriting
from tissuereg.cli.register_input import add_input_options, registration_input
from tissuereg.cli.stages import Stages, stage_lines
from tissuereg.cli.words import registration_words

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration

HELP = Help(
    "Where is every point of a soft body now, given where a few markers were before and are after? Nothing need be "
    "known of what pushed or pulled: contacts on the surface that explain the markers are found, and the body is "
    "brought to equilibrium under them. Input: MESH (tetrahedra in mm, .vtu .vtk .msh .npz, held nodes in the node set "
    "'fixed') and MARKERS (csv: marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm[,std_mm], empty = not seen; or "
    "points of 3D Slicer, .mrk.json or .fcsv, with those where they were seen in --measured), "
    "points of the deformed surface (--surface), or both; or one frame of an experiment folder. DIR gets "
    "registered.vtu (undeformed nodes; displacement_mm warps them, its standard deviation, forces of the contacts), "
    "targets.csv, targets.mrk.json (for 3D Slicer), registration.json, registered.png and report.html, all or none. "
    "The last line says whether to trust the answer. Exit code 0: there is one, and nothing speaks against it; 4: it "
    "was found and written, but is not to be trusted; 2: bad usage or input; 3: it could not be done.",
    example=(
        "tissuereg register breast.vtu markers.csv --targets lesion.csv --out registered\n"
        "tissuereg register liver.vtu --surface points.csv --out registered\n"
        "tissuereg register liver.vtu markers.csv --held perhaps --std 0.5 --out registered\n"
        "tissuereg register liver.vtu was.mrk.json --measured is.mrk.json --frame RAS --out registered\n"
        "tissuereg register my-rig --case push_x --time 14.0 --out registered"
    ),
    seed="seed of all random numbers (default: 0)",
)


def options(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument("path", metavar="MESH|EXPERIMENT", help="mesh file, or experiment folder or file")
    parser.add_argument("markers", metavar="MARKERS", nargs="*", help="table or points of markers; with a mesh only")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    text = "write registered_deformed.vtu too, its nodes where they are now"
    parser.add_argument("--deformed", action="store_true", help=text)
    add_input_options(parser)
    add_method_options(parser.add_argument_group("method"))
    parser.set_defaults(late="markers", room=1)


def run(args: argparse.Namespace) -> Outcome:
    """Register and write, schema ``tissuereg.registration/1``; exit code 4 where it is not to be trusted."""
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.registration.register import register
    from tissuereg.report.files import DEFORMED, WRITTEN

    given_files = [args.path, *args.markers, args.measured, args.simulation, args.variants, args.targets, args.surface]
    written = [Path(args.out) / name for name in (*WRITTEN, "report.html", DEFORMED)]
    refuse_overwriting(written, [*given_files, Path(args.path) / "targets.csv"])
    check_folder_target(args.out)
    clock = Stopwatch()
    given = registration_input(args)
    reading = clock.lap("read")
    with stage_lines(quiet=args.quiet) as shown:
        result = register(**given, **method_of(args), progress=shown)
        clock.lap("register")
        stages = {name: spent for name, spent in result.seconds.items() if name != "total"}
        extra = {**envelope(args.threads), "seconds": {"read": reading, **stages, **_total(clock)}}
        _write(result, args, extra, shown)
    writing = clock.lap("write")
    seconds = {"read": reading, **stages, "write": writing, **_total(clock)}
    content = {**result.to_json(), "seconds": seconds}
    return Outcome(content, registration_words(content, args.out), args.threads, 0 if result.trust.ok else UNTRUSTED)


def _write(result: "Registration", args: argparse.Namespace, extra: dict[str, Any], shown: Stages) -> None:
    """Write all files or none."""
    from tissuereg._base.clock import Progress
    from tissuereg.io.atomic import atomic_folder

    with atomic_folder(args.out) as draft:
        shown(Progress("stage", "draws"))
        _ = result.std  # computed when it is first read
        shown(Progress("stage", "files"))
        result.save(draft, extra, deformed=args.deformed)
        result.report(draft / "report.html")


def _total(clock: Stopwatch) -> dict[str, float]:
    return {"total": clock.seconds["total"]}
