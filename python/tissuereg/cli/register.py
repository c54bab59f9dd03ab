"""The command ``tissuereg register``: one state of a body, from mesh and markers or from an experiment."""

import argparse
import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg._base.choices import Element, Frame
from tissuereg._base.fields import number
from tissuereg.cli.body_input import (
    add_belief_options,
    add_body_options,
    add_match_option,
    add_method_options,
    beliefs_of,
    believed_body,
    frames_of,
    method_of,
    only_given,
    read_body,
    stiffness_of,
)
from tissuereg.cli.common import UNTRUSTED, Outcome, Stopwatch, envelope, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse, refuse_overwriting
from tissuereg.cli.progress import Stages, stage_lines
from tissuereg.report.words import fallback_lines, markers_used, silent, start_word, target_line, verdict

if TYPE_CHECKING:
    from tissuereg.body.markers import Markers
    from tissuereg.registration.body import Body
    from tissuereg.registration.result import Registration

HELP = Help(
    "Where is every point of a soft body now, given where a few markers were before and are after? Nothing need be "
    "known of what pushed or pulled: contacts on the surface that explain the markers are found, and the body is "
    "brought to equilibrium under them. Input: MESH (tetrahedra in mm, .vtu .vtk .msh .npz, held nodes in the node set "
    "'fixed') and MARKERS (csv: marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm[,std_mm], empty = not seen; or "
    "points of 3D Slicer, .mrk.json, .fcsv or a table of them, with those where they were seen in --measured), points "
    " of the deformed surface (--surface), or both; or one frame of an experiment folder. DIR gets "
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
    """Add the arguments of ``tissuereg register`` to its parser."""
    parser.add_argument("path", metavar="MESH|EXPERIMENT", help="mesh file, or experiment folder or file")
    parser.add_argument("markers", metavar="MARKERS", nargs="*", help="table or points of markers; with a mesh only")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    text = "write registered_deformed.vtu too, its nodes where they are now"
    parser.add_argument("--deformed", action="store_true", help=text)
    parser.add_argument("--no-picture", action="store_true", help="draw nothing: no registered.png, a page of text")
    text = "image of the undeformed body, laid under sections through the targets in report.html; in the frame of MESH"
    parser.add_argument("--image", metavar="IMAGE", help=text)
    _add_input_options(parser)
    add_method_options(parser.add_argument_group("method"))
    parser.set_defaults(late="markers", room=1)


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg register``; schema ``tissuereg.registration/1``; exit code 4 if it is not to be trusted."""
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.registration.register import register
    from tissuereg.report.files import DEFORMED, PAGE, WRITTEN

    more = [args.measured, args.simulation, args.variants, args.targets, args.seen, args.surface, args.image]
    given_files = [args.path, *args.markers, *more]
    written = [Path(args.out) / name for name in (*WRITTEN, PAGE, DEFORMED)]
    refuse_overwriting(written, [*given_files, Path(args.path) / "targets.csv"])
    check_folder_target(args.out)
    if args.image is not None:
        from tissuereg.imaging.images import read_image

        read_image(args.image)  # before the work, not after it
    clock = Stopwatch()
    given = _input(args)
    reading = clock.lap("read")
    with stage_lines(quiet=args.quiet, verbose=args.verbose) as shown:
        result = register(**given, **method_of(args), progress=shown)
        clock.lap("register")
        stages = {name: spent for name, spent in result.seconds.items() if name != "total"}
        extra = {**envelope(args.threads), "seconds": {"read": reading, **stages, **_total(clock)}}
        _write(result, args, extra, shown)
    writing = clock.lap("write")
    seconds = {"read": reading, **stages, "write": writing, **_total(clock)}
    content = {**result.to_json(), "seconds": seconds}
    text = summary(content, args.out, verbose=args.verbose)
    return Outcome(content, text, args.threads, 0 if result.trust.ok else UNTRUSTED)


def _write(result: "Registration", args: argparse.Namespace, extra: dict[str, Any], shown: Stages) -> None:
    """Write all files of a registration, or none; add `extra` to the JSON; show the stages by `shown`."""
    from tissuereg._base.clock import Progress
    from tissuereg.io.atomic import atomic_folder
    from tissuereg.report.files import PAGE

    with atomic_folder(args.out) as draft:
        shown(Progress("stage", "draws"))
        _ = result.std  # computed when it is first read
        shown(Progress("stage", "files"))
        result.save(draft, extra, deformed=args.deformed, picture=not args.no_picture)
        result.report(draft / PAGE, picture=not args.no_picture, image=args.image)


def _total(clock: Stopwatch) -> dict[str, float]:
    return {"total": clock.seconds["total"]}


def _add_input_options(parser: Parser) -> None:
    """Add the options for further input, the frame of an experiment, and the user's beliefs."""
    frame = parser.add_argument_group("frame of an experiment")
    frame.add_argument("--case", metavar="C", help="name of the case")
    add_option(frame, "--time", number("time in s on the experiment's clock", unit="s", default=None), "T")
    _add_files(parser.add_argument_group("more input"))
    add_belief_options(parser.add_argument_group("what is believed"))


def _input(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `register` that are read from files; raise UsageError where options clash."""
    from tissuereg.body.surface import SurfacePoints
    from tissuereg.io.experiments import is_experiment
    from tissuereg.io.problems import read_simulation, read_variants
    from tissuereg.io.tables import read_markers, read_surface, read_targets
    from tissuereg.registration.inputs import SimulationVariants

    given = _from_experiment(args) if is_experiment(args.path) else _from_files(args)
    body: Body = given["mesh"]
    frames = frames_of(args, body.mesh, [*args.markers, args.surface], [args.targets, args.seen])
    if args.markers:
        joined = {**frames, **only_given(measured=args.measured, match=args.match)}
        given["markers"] = read_markers(args.markers[0], args.std, **joined)
    if frames["frame"] is not None:
        given["mesh"] = body = replace(body, mesh=body.mesh.in_frame(frames["frame"]))
    if args.targets is not None:
        given["targets"] = {**given["targets"], **read_targets(args.targets, **frames)}
    if args.seen is not None:
        given["markers"] = _with_seen(args, given, frames)
    if args.simulation is not None:
        given["simulation"] = read_simulation(args.simulation, body.mesh.n_nodes)
    if args.variants is not None:
        fields = read_variants(args.variants, body.mesh.n_nodes)
        given["simulation"] = SimulationVariants(fields, given.get("simulation"))
    if args.surface is not None:
        std = {} if args.surface_std is None else {"std": args.surface_std}
        given["surface"] = SurfacePoints(read_surface(args.surface, **frames), **std)
    elif args.surface_std is not None:
        refuse("--surface-std must come with --surface", "--surface-std")
    return given


def _with_seen(args: argparse.Namespace, given: dict[str, Any], frames: dict[str, Frame | None]) -> "Markers":
    """Return the markers given, with the targets of ``--seen`` after them; errors name the file."""
    from tissuereg.errors import MarkerError
    from tissuereg.io.tables import read_seen
    from tissuereg.registration.inputs import as_markers

    places, std = read_seen(args.seen, args.std, **frames)
    try:
        return as_markers(given["markers"]).with_seen(given["targets"], places, std)
    except MarkerError as error:
        error.args = (f"{args.seen}: {error}",)
        raise


def _add_files(more: Any) -> None:
    text = "points of 3D Slicer where the markers of MARKERS, such points too, were seen"
    more.add_argument("--measured", metavar="FILE", help=text)
    text = (
        "table target,x_mm,y_mm,z_mm[,std_mm], or points of 3D Slicer: targets that were seen in the deformed body, or "
        "corrected by hand; they count as markers inside the body"
    )
    more.add_argument("--seen", metavar="FILE", help=text)
    add_match_option(more, "MARKERS and --measured")
    text = "displacement_mm (n, 3) of this moment, predicted by any simulator"
    more.add_argument("--simulation", metavar="U.npz", help=text)
    text = "displacement_mm (k, n, 3): this moment simulated with other values of what is uncertain; with --model"
    more.add_argument("--variants", metavar="U.npz", help=text)
    text = "table x_mm,y_mm,z_mm (or Slicer's points) on the deformed surface, or on a part of it, without labels"
    more.add_argument("--surface", metavar="FILE", help=text)
    text = "noise of such a point along the surface's normal"
    add_option(more, "--surface-std", number(text, unit="mm", above=0.0, default=None, otherwise="0.1"), "MM")
    add_body_options(more, "MARKERS, --targets and --surface")


def _from_files(args: argparse.Namespace) -> dict[str, Any]:
    if len(args.markers) > 1 or (not args.markers and args.surface is None and args.seen is None):
        found = f"got {len(args.markers)} files"
        refuse(f"one MARKERS must be given with a mesh file (only an experiment brings its own), {found}", "MARKERS")
    if args.measured is not None and not args.markers:
        refuse("--measured must come with MARKERS, where the markers sit", "--measured")
    for name in ("case", "time"):
        if getattr(args, name) is not None:
            refuse(f"--{name} must be left out with a mesh file; it chooses a frame of an experiment", f"--{name}")
    material, load = beliefs_of(args, "--simulation")
    body = believed_body(args, read_body(args, args.path), material)
    return {"mesh": body, "markers": None, "targets": {}, "load": load}


def _from_experiment(args: argparse.Namespace) -> dict[str, Any]:
    from tissuereg.io.experiments import read_experiment
    from tissuereg.registration.frame import frame_input

    for name in (
        "markers",
        "measured",
        "match",
        "fixed",
        "coincident",
        "std",
        "young",
        "poisson",
        "gravity",
        "density",
    ):
        if getattr(args, name) not in (None, []):
            option = "MARKERS" if name == "markers" else f"--{name}"
            refuse(f"{option} must be left out with an experiment, which states its own", option)
    for name in ("case", "time"):
        if getattr(args, name) is None:
            refuse(f"--{name} must be given with an experiment", f"--{name}")
    experiment = read_experiment(args.path)
    plain: Element = "tet4" if args.element == "auto" else args.element
    frame = frame_input(experiment, args.case, args.time, element=plain, threads=args.threads)
    # The registration uses the same elements as the simulation of the frame.
    return {**frame, "mesh": replace(frame["mesh"], **only_given(held=args.held), **stiffness_of(args))}


def summary(content: dict[str, Any], out: str, *, verbose: bool = False) -> str:
    """Return the content of ``registration.json`` as text; contacts, flags and the verdict come last."""
    markers, trust = content["markers"], content["trust"]
    simulated = any(target["simulation_mm"] is not None for target in content["targets"].values())
    start = start_word(simulated)
    return "\n".join(
        [
            *([_marker_line(markers, start)] if markers["used"] or markers["dropped"] else []),
            *([_surface_line(content["surface"])] if content["surface"] is not None else []),
            *(target_line(name, target) for name, target in content["targets"].items()),
            *(_figures(content) if verbose else []),
            seconds_line(content["seconds"], verbose=verbose),
            f"written: {out}",
            *(_contact_line(contact) for contact in content["contacts"]),
            *([] if content["fallback"] is None else fallback_lines(content["fallback"]["targets_mm"])),
            *_verdict_lines(content["targets"], trust),
        ]
    )


def _figures(content: dict[str, Any]) -> list[str]:
    """Return lines for numericists: volume ratio, p-value, kind of model."""
    body, model, p_value = content["body"], content["model"], content["trust"]["p_value"]
    known = p_value is not None and math.isfinite(p_value)
    return [
        f"smallest det F {body['min_det_f']:.3f}, {body['inverted_tets']} inverted tets; p-value of the residuals "
        f"{f'{p_value:.3g}' if known else 'not known'}",
        f"model: {model.get('kind')}, {model.get('source')}",
    ]


def _surface_line(surface: dict[str, Any]) -> str:
    thinned = "" if surface["thinned_from"] is None else f" (thinned evenly from {surface['thinned_from']})"
    return (
        f"{surface['used']} of {surface['points']} surface points used{thinned}, {len(surface['outliers'])} outliers; "
        f"rms distance along the normal {surface['before_rms_mm']:.3f} mm before, "
        f"{surface['after_rms_mm']:.3f} mm after"
    )


def _marker_line(markers: dict[str, Any], start: str) -> str:
    lost = ", ".join(f"{item['marker']} ({item['reason']})" for item in markers["dropped"])
    used = f"{markers_used(markers['used'], markers['inner'])} used{f'; dropped: {lost}' if lost else ''}"
    if not markers["used"]:
        return used
    return f"{used}; rms distance {markers['before_rms_mm']:.3f} mm {start}, {markers['after_rms_mm']:.3f} mm after"


def _contact_line(contact: dict[str, Any]) -> str:
    place = ", ".join(f"{x:.0f}" for x in contact["centre_mm"])
    towards = ", ".join(f"{x:.2f}" for x in contact["direction"])
    pulls = contact["pull_probability"]
    sense = "" if min(pulls, 1.0 - pulls) <= 0.05 else f"; pull or push is not known (pull {pulls:.2f})"
    return (
        f"contact at ({place}) mm: surface moved by {contact['size_mm']:.1f} mm, {contact['force_mN']:.0f} mN at the "
        f"believed modulus towards ({towards}), probability {contact['probability']:.2f} of one somewhere there, "
        f"give or take {contact['place_std_mm']:.0f} mm{sense}"
    )


def _verdict_lines(targets: dict[str, Any], trust: dict[str, Any]) -> list[str]:
    """Return lines with the flags of targets, the reasons for distrust, and the verdict, which names their types."""
    flagged = [name for name, target in targets.items() if target["flag"]]
    kinds = dict.fromkeys(reason.partition(":")[0] for reason in trust["reasons"])
    last = verdict(trust["ok"])
    return [
        *([silent(flagged)] if flagged else []),
        *trust["reasons"],
        last if trust["ok"] else f"{last.removesuffix('.')}: {', '.join(kinds)}.",
    ]
