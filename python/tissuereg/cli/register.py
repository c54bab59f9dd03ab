"""``tissuereg register``: one moment of a body, from mesh and markers or from an experiment."""

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

from tissuereg.cli.common import Outcome, Stopwatch, envelope, progress_bar, seconds_line
from tissuereg.cli.options import (
    Parser,
    UsageError,
    add_common,
    command_parser,
    finite_number,
    positive_number,
    refuse_overwriting,
    whole_number,
)
from tissuereg.errors import MeshError

if TYPE_CHECKING:
    from tissuereg.mesh import Mesh
    from tissuereg.registration import RegisterSettings

_DETAILS = (
    "Where is every point of a soft body now, given where a few markers were before and are after? Nothing need be "
    "known of what pushed or pulled: contacts on the surface that explain the markers are found, and the body is "
    "brought to equilibrium under them. Input: MESH (tetrahedra in mm, .vtu .vtk .msh .npz, held nodes in the node set "
    "'fixed') and MARKERS (csv: marker,x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm[,std_mm], empty = not seen), "
    "points of the deformed surface (--surface), or both; or one frame of an experiment folder. DIR gets "
    "registered.vtu (displacement, its standard deviation, forces of the contacts), targets.csv, registration.json and "
    "registered.png, all or none. The last line says whether to trust the answer; exit code 0 means that there is one."
)
_WRITTEN = ("registered.vtu", "targets.csv", "registration.json", "registered.png")
_EXAMPLE = """tissuereg register breast.vtu markers.csv --targets lesion.csv --out registered
  tissuereg register liver.vtu --surface points.csv --out registered
  tissuereg register liver.vtu markers.csv --held perhaps --std 0.5 --out registered
  tissuereg register my-rig --case push_x --time 14.0 --out registered"""


def add_parser(commands: Any) -> None:
    """Add the command's parser.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to.
    """
    purpose = "register a body to its markers, load unknown, with regions"
    parser = command_parser(commands, "register", purpose, _DETAILS, _EXAMPLE)
    parser.add_argument("path", metavar="MESH|EXPERIMENT", help="mesh file, or experiment folder or file")
    parser.add_argument("markers", metavar="MARKERS", nargs="*", help="table of markers; with a mesh only")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    _add_input_options(parser)
    how = parser.add_argument_group("method")
    text = "folder of a trained model, or 'phantom' for the one that is shipped (default: unknown contacts)"
    how.add_argument("--model", metavar="DIR", help=text)
    text = "elements of our own simulations (default: auto, those that suit the mesh)"
    choices = ["auto", "tet4", "tet4-averaged", "tet10"]
    how.add_argument("--element", choices=choices, default="auto", help=text)
    how.add_argument("--polish", action="store_true", help="with a model: make its answer an equilibrium")
    how.add_argument(
        "--members", type=whole_number(8), metavar="N", help="ensemble members, with a model (default: 200)"
    )
    how.add_argument("--steps", type=whole_number(1), metavar="N", help="assimilation steps, with a model (default: 5)")
    add_common(parser, seed="seed of all chance (default: 0)")
    parser.set_defaults(run=run, late="markers", room=1)


def _add_input_options(parser: Parser) -> None:
    frame = parser.add_argument_group("frame of an experiment")
    frame.add_argument("--case", metavar="C", help="name of the case")
    frame.add_argument("--time", type=finite_number, metavar="T", help="time in s on the experiment's clock")
    more = parser.add_argument_group("more input")
    text = "displacement_mm (n, 3) that a simulation, from any simulator, says of this moment"
    more.add_argument("--simulation", metavar="U.npz", help=text)
    text = "table target,x_mm,y_mm,z_mm of inner points in the undeformed body"
    more.add_argument("--targets", metavar="FILE", help=text)
    text = "held nodes: 'plane nx ny nz d tol' (within tol mm of n . x = d mm), or the name of a node set"
    more.add_argument("--fixed", metavar="RULE", help=text)
    text = "whether the node set 'fixed' is held for sure, perhaps, or not at all (default: sure)"
    more.add_argument("--held", choices=["sure", "perhaps", "free"], help=text)
    text = "table x_mm,y_mm,z_mm of points on the deformed surface, or on a part of it, without labels"
    more.add_argument("--surface", metavar="FILE", help=text)
    text = "noise of such a point along the surface's normal, in mm (default: 0.1)"
    more.add_argument("--surface-std", type=positive_number, metavar="MM", help=text)
    text = "whether the tracker kept its place beside the supports (default: known)"
    more.add_argument("--frame", choices=["known", "drifts"], help=text)
    text = "graded: softer towards one side by an amount that the markers tell (default: believed)"
    more.add_argument("--stiffness", choices=["believed", "graded"], help=text)
    text = "noise of a marker coordinate without its own std_mm, in mm (default: 0.1)"
    more.add_argument("--std", type=positive_number, metavar="MM", help=text)


def run(args: argparse.Namespace) -> Outcome:
    """Register and write.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed command line.

    Returns
    -------
    Outcome
        Schema ``tissuereg.registration/1``.
    """
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.registration import register

    inputs = [args.path, *args.markers, args.simulation, args.targets, args.surface, Path(args.path) / "targets.csv"]
    refuse_overwriting([Path(args.out) / name for name in _WRITTEN], inputs)
    check_folder_target(args.out)
    clock = Stopwatch()
    given = _input(args)
    reading = clock.lap("read")
    with progress_bar("passes", quiet=args.quiet) as progress:
        result = register(
            **{"element": args.element, **given},
            model=args.model,
            polish=args.polish,
            **{name: value for name in ("held", "frame", "stiffness") if (value := getattr(args, name)) is not None},
            seed=args.seed or 0,
            threads=args.threads,
            settings=_settings(args),
            progress=progress,
        )
    clock.lap("register")
    stages = {name: spent for name, spent in result.seconds.items() if name != "total"}
    result.save(args.out, {**envelope(args.threads), "seconds": {"read": reading, **stages, **_total(clock)}})
    writing = clock.lap("write")
    seconds = {"read": reading, **stages, "write": writing, **_total(clock)}
    content = {**result.to_json(), "seconds": seconds}
    return Outcome(content, _summary(content, args.out), args.threads)


def _total(clock: Stopwatch) -> dict[str, float]:
    return {"total": clock.seconds["total"]}


def _settings(args: argparse.Namespace) -> "RegisterSettings":
    from tissuereg.registration import RegisterSettings

    settings = RegisterSettings()
    chosen = {"n_members": args.members, "n_steps": args.steps}
    return replace(settings, **{name: value for name, value in chosen.items() if value is not None})


def _input(args: argparse.Namespace) -> dict[str, Any]:
    """Return what `register` is given, by argument."""
    from tissuereg.io.experiments import is_experiment
    from tissuereg.io.problems import read_simulation
    from tissuereg.io.tables import read_surface, read_targets

    given = _from_experiment(args) if is_experiment(args.path) else _from_files(args)
    if args.targets is not None:
        given["targets"] = {**given["targets"], **read_targets(args.targets)}
    if args.simulation is not None:
        given["simulation"] = read_simulation(args.simulation, given["mesh"].n_nodes)
    if args.surface is not None:
        given["surface"] = read_surface(args.surface)
        if args.surface_std is not None:
            given["surface_std"] = args.surface_std
    elif args.surface_std is not None:
        _refuse("--surface-std must come with --surface", "--surface-std")
    return given


def _from_files(args: argparse.Namespace) -> dict[str, Any]:
    from tissuereg.io.meshes import read_mesh

    if len(args.markers) > 1 or (not args.markers and args.surface is None):
        found = f"got {len(args.markers)} files"
        _refuse(f"one MARKERS must be given with a mesh file (only an experiment brings its own), {found}", "MARKERS")
    for name in ("case", "time"):
        if getattr(args, name) is not None:
            _refuse(f"--{name} must be left out with a mesh file; it chooses a frame of an experiment", f"--{name}")
    mesh = read_mesh(args.path, fixed=args.fixed)
    if args.model is None and (args.held == "free" or "perhaps_fixed" in mesh.node_sets):
        return _with_markers(mesh, args)
    try:
        _ = mesh.fixed_nodes  # says at once that nothing is held
    except MeshError as error:
        error.args = (f"{args.path}: {error}; name the held nodes with --fixed, or say --held free",)
        raise
    return _with_markers(mesh, args)


def _with_markers(mesh: "Mesh", args: argparse.Namespace) -> dict[str, Any]:
    from tissuereg.io.tables import read_markers

    markers = read_markers(args.markers[0], std=args.std) if args.markers else None
    return {"mesh": mesh, "markers": markers, "targets": {}}


def _from_experiment(args: argparse.Namespace) -> dict[str, Any]:
    from tissuereg.frames import frame_input
    from tissuereg.io.experiments import read_experiment

    for name in ("markers", "fixed", "std"):
        if getattr(args, name) not in (None, []):
            option = "MARKERS" if name == "markers" else f"--{name}"
            _refuse(f"{option} must be left out with an experiment, which states its own", option)
    for name in ("case", "time"):
        if getattr(args, name) is None:
            _refuse(f"--{name} must be given with an experiment", f"--{name}")
    experiment = read_experiment(args.path)
    plain = "tet4" if args.element == "auto" else args.element
    given = frame_input(experiment, args.case, args.time, element=plain, threads=args.threads)
    # What the frame's simulation is made of is what the registration goes on with.
    return {**given, "element": plain}


def _refuse(message: str, where: str) -> NoReturn:
    raise UsageError(message, where=where)


def _surface_line(surface: dict[str, Any]) -> str:
    thinned = "" if surface["thinned_from"] is None else f" (thinned evenly from {surface['thinned_from']})"
    return (
        f"{surface['used']} of {surface['points']} surface points used{thinned}, {len(surface['outliers'])} outliers; "
        f"rms distance along the normal {surface['before_rms_mm']:.3f} mm before, "
        f"{surface['after_rms_mm']:.3f} mm after"
    )


def _summary(content: dict[str, Any], out: str) -> str:
    """Return what was found; contacts, flags and the verdict stand last."""
    markers, trust, body, model = (content[name] for name in ("markers", "trust", "body", "model"))
    p_value = "not known" if trust["p_value"] is None else f"{trust['p_value']:.3g}"
    return "\n".join(
        [
            *([_marker_line(markers)] if markers["used"] or markers["dropped"] else []),
            *([_surface_line(content["surface"])] if content["surface"] is not None else []),
            *(_target_line(name, target) for name, target in content["targets"].items()),
            f"smallest det F {body['min_det_f']:.3f}, {body['inverted_tets']} inverted tets; p-value of the "
            f"residuals {p_value}",
            f"model: {model.get('kind')}, {model.get('source')}",
            seconds_line(content["seconds"]),
            f"written: {out}",
            *(_contact_line(contact) for contact in content["contacts"]),
            *_verdict_lines(content["targets"], trust),
        ]
    )


def _marker_line(markers: dict[str, Any]) -> str:
    lost = ", ".join(f"{item['marker']} ({item['reason']})" for item in markers["dropped"])
    return (
        f"{len(markers['used'])} markers used{f'; dropped: {lost}' if lost else ''}; rms distance "
        f"{markers['before_rms_mm']:.3f} mm before, {markers['after_rms_mm']:.3f} mm after"
    )


def _target_line(name: str, target: dict[str, Any]) -> str:
    place = ", ".join(f"{x:.2f}" for x in target["mean_mm"])
    axes = " x ".join(f"{x:.2f}" for x in target["region90_radii_mm"])
    return f"target {name}: at ({place}) mm, 90 % region with half-axes {axes} mm"


def _contact_line(contact: dict[str, Any]) -> str:
    place = ", ".join(f"{x:.0f}" for x in contact["centre_mm"])
    towards = ", ".join(f"{x:.2f}" for x in contact["direction"])
    return (
        f"contact at ({place}) mm: surface moved by {contact['size_mm']:.1f} mm, {contact['force_mN']:.0f} mN at the "
        f"believed modulus towards ({towards}), probability {contact['probability']:.2f}"
    )


def _verdict_lines(targets: dict[str, Any], trust: dict[str, Any]) -> list[str]:
    """Return flags and the verdict; one that is not trusted has its reasons above it and their kinds in it."""
    from tissuereg.report.words import silent, verdict

    flagged = [name for name, target in targets.items() if target["flag"]]
    kinds = dict.fromkeys(reason.partition(":")[0] for reason in trust["reasons"])
    last = verdict(trust["ok"])
    return [
        *([silent(flagged)] if flagged else []),
        *trust["reasons"],
        last if trust["ok"] else f"{last.removesuffix('.')}: {', '.join(kinds)}.",
    ]
