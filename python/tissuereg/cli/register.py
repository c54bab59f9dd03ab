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
    from tissuereg.registration import RegisterSettings

_DETAILS = (
    "From MESH (tetrahedra in mm, .vtu .vtk .msh .npz, held nodes in the node set 'fixed') and MARKERS (csv: marker,"
    "x_mm,y_mm,z_mm,moved_x_mm,moved_y_mm,moved_z_mm[,std_mm], empty = not seen), or from one frame of an experiment "
    "folder. DIR gets registered.vtu, targets.csv, registration.json and registered.png, all or none. Without "
    "--model the load is unknown: the body is brought to an equilibrium under the contacts that the markers suggest."
)
_WRITTEN = ("registered.vtu", "targets.csv", "registration.json", "registered.png")
_EXAMPLE = """tissuereg register breast.vtu markers.csv --targets lesion.csv --out registered
  tissuereg register my-rig --case push_x --time 14.0 --out registered"""


def add_parser(commands: Any) -> None:
    """Add the command's parser.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to.
    """
    purpose = "register a body to its markers, with its spread"
    parser = command_parser(commands, "register", purpose, _DETAILS, _EXAMPLE)
    parser.add_argument("path", metavar="MESH|EXPERIMENT", help="mesh file, or experiment folder or file")
    parser.add_argument("markers", metavar="MARKERS", nargs="*", help="table of markers; with a mesh only")
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    _add_input_options(parser)
    how = parser.add_argument_group("method")
    text = "folder of a trained model, or 'phantom' for the one that is shipped (default: unknown contacts)"
    how.add_argument("--model", metavar="DIR", help=text)
    text = "elements of our own simulations (default: tet4)"
    how.add_argument("--element", choices=["tet4", "tet4-averaged", "tet10"], default="tet4", help=text)
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
    text = "how the node set 'fixed' is taken (default: sure); a mesh without held nodes is free"
    more.add_argument("--held", choices=["sure", "perhaps", "free"], help=text)
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

    inputs = [args.path, *args.markers, args.simulation, args.targets, Path(args.path) / "targets.csv"]
    refuse_overwriting([Path(args.out) / name for name in _WRITTEN], inputs)
    check_folder_target(args.out)
    clock = Stopwatch()
    given = _input(args)
    reading = clock.lap("read")
    with progress_bar("passes", quiet=args.quiet) as progress:
        result = register(
            **given,
            model=args.model,
            element=args.element,
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
    from tissuereg.io.tables import read_targets

    given = _from_experiment(args) if is_experiment(args.path) else _from_files(args)
    if args.targets is not None:
        given["targets"] = {**given["targets"], **read_targets(args.targets)}
    if args.simulation is not None:
        given["simulation"] = read_simulation(args.simulation, given["mesh"].n_nodes)
    return given


def _from_files(args: argparse.Namespace) -> dict[str, Any]:
    from tissuereg.io.meshes import read_mesh
    from tissuereg.io.tables import read_markers

    if len(args.markers) != 1:
        found = f"got {len(args.markers)} files"
        _refuse(f"one MARKERS must be given with a mesh file (only an experiment brings its own), {found}", "MARKERS")
    for name in ("case", "time"):
        if getattr(args, name) is not None:
            _refuse(f"--{name} must be left out with a mesh file; it chooses a frame of an experiment", f"--{name}")
    mesh = read_mesh(args.path, fixed=args.fixed)
    if args.model is None and (args.held == "free" or "perhaps_fixed" in mesh.node_sets):
        return {"mesh": mesh, "markers": read_markers(args.markers[0], std=args.std), "targets": {}}
    try:
        _ = mesh.fixed_nodes  # says at once that nothing is held
    except MeshError as error:
        error.args = (f"{args.path}: {error}; name the held nodes with --fixed, or say --held free",)
        raise
    return {"mesh": mesh, "markers": read_markers(args.markers[0], std=args.std), "targets": {}}


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
    return frame_input(experiment, args.case, args.time, element=args.element, threads=args.threads)


def _refuse(message: str, where: str) -> NoReturn:
    raise UsageError(message, where=where)


def _summary(content: dict[str, Any], out: str) -> str:
    markers, trust, body, model = (content[name] for name in ("markers", "trust", "body", "model"))
    lost = ", ".join(f"{item['marker']} ({item['reason']})" for item in markers["dropped"])
    lines = [
        f"{len(markers['used'])} markers used{f'; dropped: {lost}' if lost else ''}; rms distance "
        f"{markers['before_rms_mm']:.3f} mm before, {markers['after_rms_mm']:.3f} mm after"
    ]
    for name, target in content["targets"].items():
        place = ", ".join(f"{x:.2f}" for x in target["mean_mm"])
        axes = " x ".join(f"{x:.2f}" for x in target["region90_radii_mm"])
        flag = f"; {target['flag']}" if target["flag"] else ""
        lines.append(f"target {name}: at ({place}) mm, 90 % region with half-axes {axes} mm{flag}")
    for contact in content["contacts"]:
        place = ", ".join(f"{x:.0f}" for x in contact["centre_mm"])
        lines.append(
            f"contact at ({place}) mm, moved {contact['size_mm']:.1f} mm, {contact['force_mN']:.0f} mN at the believed "
            f"modulus (probability {contact['probability']:.2f})"
        )
    verdict = "can be trusted" if trust["ok"] else f"do not trust it: {'; '.join(trust['reasons'])}"
    p_value = "not known" if trust["p_value"] is None else f"{trust['p_value']:.3g}"
    return "\n".join(
        [
            *lines,
            f"smallest det F {body['min_det_f']:.3f}, {body['inverted_tets']} inverted tets; p-value of the "
            f"residuals {p_value}; {verdict}",
            f"model: {model.get('kind')}, {model.get('source')}",
            seconds_line(content["seconds"]),
            f"written: {out}",
        ]
    )
