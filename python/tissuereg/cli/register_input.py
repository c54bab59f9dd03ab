"""Input of ``tissuereg register``: its options, and the arguments of `register` made from them."""

import argparse
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from tissuereg.cli.common import note
from tissuereg.cli.options import Parser, UsageError, finite_number, positive_number
from tissuereg.errors import MeshError

if TYPE_CHECKING:
    from tissuereg.load import Load
    from tissuereg.material import Material
    from tissuereg.mesh import Mesh

#: Accelerations below this, in mm/s^2, are refused: they were probably given in m/s^2.
_LEAST_GRAVITY = 20.0


class _FrameOption(argparse.Action):
    """``--frame``: frame of the mesh; with its former values ``known`` and ``drifts`` it sets ``--tracker`` instead."""

    def __call__(
        self,
        parser: argparse.ArgumentParser,
        namespace: argparse.Namespace,
        values: str | Sequence[Any] | None,
        option_string: str | None = None,
    ) -> None:
        setattr(namespace, "tracker" if values in ("known", "drifts") else "frame", values)


def add_input_options(parser: Parser) -> None:
    """Add the options for data and beliefs about the moment.

    Parameters
    ----------
    parser : Parser
        Of the command.
    """
    frame = parser.add_argument_group("frame of an experiment")
    frame.add_argument("--case", metavar="C", help="name of the case")
    frame.add_argument("--time", type=finite_number, metavar="T", help="time in s on the experiment's clock")
    _add_files(parser.add_argument_group("more input"))
    _add_beliefs(parser.add_argument_group("what is believed"))


def registration_input(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `register`.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed command line.

    Returns
    -------
    dict
        Arguments of `register` by name.

    Raises
    ------
    UsageError
        If options do not go together.
    FormatError, MeshError, MarkerError, ExperimentError
        If a file cannot be used.
    MaterialError
        If a modulus or a density is out of its range.
    """
    from tissuereg.io.experiments import is_experiment
    from tissuereg.io.problems import read_simulation
    from tissuereg.io.tables import read_surface, read_targets

    frames = _frames(args)
    given = _from_experiment(args) if is_experiment(args.path) else _from_files(args, frames)
    if frames["frame"] is not None:
        given["mesh"] = given["mesh"].in_frame(frames["frame"])
    if args.targets is not None:
        given["targets"] = {**given["targets"], **read_targets(args.targets, **frames)}
    if args.simulation is not None:
        given["simulation"] = read_simulation(args.simulation, given["mesh"].n_nodes)
    if args.surface is not None:
        given["surface"] = read_surface(args.surface, **frames)
        if args.surface_std is not None:
            given["surface_std"] = args.surface_std
    elif args.surface_std is not None:
        _refuse("--surface-std must come with --surface", "--surface-std")
    return given


def _add_files(more: Any) -> None:
    text = "points of 3D Slicer where the markers of MARKERS, such points too, were seen; joined by label"
    more.add_argument("--measured", metavar="FILE", help=text)
    text = (
        "LPS or RAS: frame of MESH, of tables and of the answer; points of 3D Slicer in the other one are converted "
        "(default: numbers as they are, and the frame of the first such file); the values of --tracker are accepted too"
    )
    choices = ["LPS", "RAS", "known", "drifts"]
    more.add_argument("--frame", action=_FrameOption, choices=choices, metavar="LPS|RAS", help=text)
    text = "frame of the tables MARKERS, --targets and --surface, where it is not --frame"
    more.add_argument("--tables-frame", choices=["LPS", "RAS"], help=text)
    text = "displacement_mm (n, 3) of this moment, predicted by any simulator"
    more.add_argument("--simulation", metavar="U.npz", help=text)
    text = "table target,x_mm,y_mm,z_mm, or points of 3D Slicer: inner points in the undeformed body"
    more.add_argument("--targets", metavar="FILE", help=text)
    text = (
        "held nodes: 'plane nx ny nz d [tol]' (within tol mm of n . x = d mm), 'ball x y z r' (of the surface, "
        "within r mm), or the name of a node set"
    )
    more.add_argument("--fixed", metavar="RULE", help=text)
    text = "table x_mm,y_mm,z_mm of points on the deformed surface, or on a part of it, without labels"
    more.add_argument("--surface", metavar="FILE", help=text)
    text = "noise of such a point along the surface's normal, in mm (default: 0.1)"
    more.add_argument("--surface-std", type=positive_number, metavar="MM", help=text)
    text = "noise of a marker coordinate without its own std_mm, in mm (default: 0.1)"
    more.add_argument("--std", type=positive_number, metavar="MM", help=text)


def _add_beliefs(what: Any) -> None:
    text = "whether the node set 'fixed' is held for sure, perhaps, or not at all (default: sure)"
    what.add_argument("--held", choices=["sure", "perhaps", "free"], help=text)
    text = "whether the tracker is known to have kept its place relative to the supports, or drifts (default: known)"
    what.add_argument("--tracker", choices=["known", "drifts"], help=text)
    text = "graded: softer towards one side, by an amount that is estimated from the markers (default: believed)"
    what.add_argument("--stiffness", choices=["believed", "graded"], help=text)
    text = "Young's modulus in kPa; it scales forces, and sets how far gravity bends the body (default: 10)"
    what.add_argument("--young", type=positive_number, metavar="KPA", help=text)
    what.add_argument("--poisson", type=finite_number, metavar="NU", help="Poisson's ratio (default: 0.45)")
    text = (
        "acceleration in mm/s^2, in the frame of MESH, that acts now and did not on MESH, e.g. '0 0 -9810'; of a body "
        "that was imaged in gravity, the difference"
    )
    what.add_argument("--gravity", type=_acceleration, metavar="'GX GY GZ'", help=text)
    text = "density in g/cm^3, with --gravity (default: 1)"
    what.add_argument("--density", type=positive_number, metavar="RHO", help=text)


def _acceleration(text: str) -> tuple[float, ...]:
    numbers = tuple(finite_number(word) for word in text.split())
    if len(numbers) != 3:
        message = f"must be three numbers, 'gx gy gz', got '{text}'"
        raise argparse.ArgumentTypeError(message)
    if np.linalg.norm(numbers) < _LEAST_GRAVITY:
        message = f"must be in mm/s^2, of {_LEAST_GRAVITY:g} or more (that of the earth is 9810), got '{text}'"
        raise argparse.ArgumentTypeError(message)
    return numbers


def _frames(args: argparse.Namespace) -> dict[str, str | None]:
    """Return the frame of the answer and that of tables; note the first if it is that of a file of 3D Slicer."""
    from tissuereg.io.point_files import frame_of_files

    if args.tables_frame is not None and args.frame is None:
        _refuse("--tables-frame must come with --frame", "--tables-frame")
    if args.frame is not None:
        return {"frame": args.frame, "table_frame": args.tables_frame}
    chosen = frame_of_files([path for path in (*args.markers, args.targets) if path is not None])
    if chosen is None:
        return {"frame": None, "table_frame": None}
    note(f"MESH is taken to be in {chosen[0]}, the frame of {chosen[1]}; set --frame to change that")
    return {"frame": chosen[0], "table_frame": None}


def _from_files(args: argparse.Namespace, frames: dict[str, str | None]) -> dict[str, Any]:
    from tissuereg.io.meshes import read_mesh

    if len(args.markers) > 1 or (not args.markers and args.surface is None):
        found = f"got {len(args.markers)} files"
        _refuse(f"one MARKERS must be given with a mesh file (only an experiment brings its own), {found}", "MARKERS")
    if args.measured is not None and not args.markers:
        _refuse("--measured must come with MARKERS, where the markers sit", "--measured")
    for name in ("case", "time"):
        if getattr(args, name) is not None:
            _refuse(f"--{name} must be left out with a mesh file; it chooses a frame of an experiment", f"--{name}")
    beliefs = _beliefs(args)
    mesh = read_mesh(args.path, fixed=args.fixed)
    if args.model is None and (args.held == "free" or "perhaps_fixed" in mesh.node_sets):
        return {**_with_markers(mesh, args, frames), **beliefs}
    try:
        _ = mesh.fixed_nodes  # raises at once if nothing is held
    except MeshError as error:
        error.args = (f"{args.path}: {error}; name the held nodes with --fixed, or use --held free",)
        raise
    return {**_with_markers(mesh, args, frames), **beliefs}


def _with_markers(mesh: "Mesh", args: argparse.Namespace, frames: dict[str, str | None]) -> dict[str, Any]:
    from tissuereg.io.tables import read_markers

    markers = read_markers(args.markers[0], args.std, measured=args.measured, **frames) if args.markers else None
    return {"mesh": mesh, "markers": markers, "targets": {}}


def _beliefs(args: argparse.Namespace) -> dict[str, Any]:
    """Return the believed material and load, as far as they are given."""
    if args.density is not None and args.gravity is None:
        _refuse("--density must come with --gravity", "--density")
    if args.gravity is not None and args.simulation is not None:
        _refuse("--gravity must be left out with --simulation, which holds what acts", "--gravity")
    material = _material(args)
    beliefs: dict[str, Any] = {} if material is None else {"material": material}
    if args.gravity is not None and material is not None:
        beliefs["load"] = _weight(material, args.gravity)
    return beliefs


def _material(args: argparse.Namespace) -> "Material | None":
    from tissuereg.material import Material

    given = {"young": args.young, "poisson": args.poisson, "density": args.density}
    known = {name: value for name, value in given.items() if value is not None}
    return Material(**known) if known or args.gravity is not None else None


def _weight(material: "Material", gravity: tuple[float, ...]) -> "Load":
    from tissuereg.load import Load

    return Load(body_force=material.weight(gravity, float(np.linalg.norm(gravity))))


def _from_experiment(args: argparse.Namespace) -> dict[str, Any]:
    from tissuereg.frames import frame_input
    from tissuereg.io.experiments import read_experiment

    for name in ("markers", "measured", "fixed", "std", "young", "poisson", "gravity", "density"):
        if getattr(args, name) not in (None, []):
            option = "MARKERS" if name == "markers" else f"--{name}"
            _refuse(f"{option} must be left out with an experiment, which states its own", option)
    for name in ("case", "time"):
        if getattr(args, name) is None:
            _refuse(f"--{name} must be given with an experiment", f"--{name}")
    experiment = read_experiment(args.path)
    plain = "tet4" if args.element == "auto" else args.element
    given = frame_input(experiment, args.case, args.time, element=plain, threads=args.threads)
    # The registration uses the same elements as the simulation of the frame.
    return {**given, "element": plain}


def _refuse(message: str, where: str) -> NoReturn:
    raise UsageError(message, where=where)
