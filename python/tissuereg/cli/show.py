"""The command ``tissuereg show``: draws a body with its node sets, markers and targets to a page that turns."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from tissuereg.cli.body_input import add_body_options, frames_of, only_given
from tissuereg.cli.common import Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import Help, Parser, refuse, refuse_overwriting

if TYPE_CHECKING:
    from tissuereg.report.shown import GivenBody

HELP = Help(
    "BODY is a mesh as 'register' takes it, or an experiment folder. BODY.html is one page that works offline: the "
    "body to turn, with what --fixed picked, all node sets, where the markers sit and where the targets are. The "
    "summary says how far each marker is from the surface, and whether a target is inside.",
    example=(
        "tissuereg show liver.vtu --fixed 'plane 0 0 1 0' --markers markers.csv --targets lesion.csv --out body.html\n"
        "tissuereg show my-rig --out body.html"
    ),
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg show`` to its parser."""
    parser.add_argument("path", metavar="BODY", help="mesh file, or experiment folder or file")
    parser.add_argument("--out", required=True, metavar="BODY.html", help="page to write")
    more = parser.add_argument_group("more input")
    text = "where the markers sit on the undeformed body: table marker,x_mm,y_mm,z_mm, or points of 3D Slicer"
    more.add_argument("--markers", metavar="FILE", help=text)
    add_body_options(more, "--markers and --targets", noise=False)


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg show``: write the page; JSON schema ``tissuereg.show/1``."""
    from tissuereg.io.atomic import atomic_file, check_file_target
    from tissuereg.report.shown import lies, shown_page

    out = Path(args.out)
    if out.suffix.lower() not in (".html", ".htm"):
        refuse(f"--out must end in .html, got '{args.out}'", "--out")
    refuse_overwriting([out], [args.path, args.markers, args.targets])
    check_file_target(out)
    clock = Stopwatch()
    given = _given(args)
    clock.lap("read")
    page = shown_page(given, Path(args.path).name)
    with atomic_file(out) as draft:
        draft.write_text(page, encoding="utf-8")
    clock.lap("write")
    content = {"schema": "tissuereg.show/1", **given.found(), "seconds": clock.seconds}
    lines = [
        f"{content['nodes']} nodes, {content['tets']} tets",
        "node sets: " + (", ".join(f"{name} ({n})" for name, n in content["node_sets"].items()) or "none"),
        *(f"{kind} {name}: {lies(one)}" for kind in ("marker", "target") for name, one in content[f"{kind}s"].items()),
        seconds_line(clock.seconds, verbose=args.verbose),
        f"written: {args.out}",
        *([] if content["node_sets"].get("fixed") else ["No node is held: name the held nodes with --fixed."]),
    ]
    return Outcome(content, "\n".join(lines), args.threads)


def _given(args: argparse.Namespace) -> "GivenBody":
    """Return the body with markers and targets; raise UsageError where options clash."""
    from tissuereg.io.experiments import is_experiment
    from tissuereg.io.meshes import read_mesh
    from tissuereg.io.tables import read_reference, read_targets
    from tissuereg.report.shown import GivenBody

    if is_experiment(args.path):
        given = _of_experiment(args)
    else:
        given = GivenBody(read_mesh(args.path, args.fixed, frame=args.frame, **only_given(coincident=args.coincident)))
    frames = frames_of(args, given.mesh, [args.markers], [args.targets])
    mesh = given.mesh if frames["frame"] is None else given.mesh.in_frame(frames["frame"])
    if args.markers is not None:
        given = replace(given, markers=read_reference(args.markers, None, **frames))
    if args.targets is not None:
        given = replace(given, targets={**given.targets, **read_targets(args.targets, **frames)})
    return replace(given, mesh=mesh)


def _of_experiment(args: argparse.Namespace) -> "GivenBody":
    """Return the body of an experiment, its supports and actuators as node sets."""
    import numpy as np

    from tissuereg.body.markers import Markers
    from tissuereg.body.mesh import Mesh
    from tissuereg.io.experiments import read_experiment
    from tissuereg.report.shown import GivenBody

    for name in ("fixed", "coincident", "markers"):
        if getattr(args, name) is not None:
            refuse(f"--{name} must be left out with an experiment, which states its own", f"--{name}")
    rig = read_experiment(args.path)
    held = {"fixed": np.concatenate([one.nodes for one in rig.boundaries])} if rig.boundaries else {}
    sets = {**rig.mesh.node_sets, **held, **{actuator.name: actuator.nodes for actuator in rig.actuators}}
    unseen = np.full_like(rig.marker_reference, np.nan)
    markers = Markers(rig.marker_reference, unseen, rig.marker_std, rig.marker_names)
    return GivenBody(Mesh(rig.mesh.nodes, rig.mesh.tets, sets, rig.mesh.frame), markers, rig.targets)
