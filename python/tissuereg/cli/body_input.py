"""What every command that registers a body takes: its mesh, frames, targets and beliefs, and how to register."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np

from tissuereg._base.fields import number, whole
from tissuereg.cli.common import note
from tissuereg.cli.options import UsageError, add_option, option_type
from tissuereg.errors import MeshError

if TYPE_CHECKING:
    from tissuereg.body.load import Load
    from tissuereg.body.material import Material
    from tissuereg.body.mesh import Mesh
    from tissuereg.registration.body import Body
    from tissuereg.registration.settings import RegisterSettings

#: Accelerations below this, in mm/s^2, are refused: they were probably given in m/s^2.
_LEAST_GRAVITY = 20.0


def add_body_options(more: Any, tables: str) -> None:
    """Add the options for frames, targets, held nodes and noise.

    `more`: of the command; `tables`: the tables that ``--tables-frame`` is of.
    """
    text = (
        "LPS or RAS: frame of MESH, of tables and of the answer; points of 3D Slicer in the other one are converted "
        "(default: numbers as they are, and the frame of the first such file)"
    )
    more.add_argument("--frame", choices=["LPS", "RAS"], help=text)
    text = f"frame of the tables {tables}, where it is not --frame"
    more.add_argument("--tables-frame", choices=["LPS", "RAS"], help=text)
    text = "table target,x_mm,y_mm,z_mm, or points of 3D Slicer: inner points in the undeformed body"
    more.add_argument("--targets", metavar="FILE", help=text)
    text = (
        "held nodes: 'plane nx ny nz d [tol]' (within tol mm of n . x = d mm), 'ball x y z r' (of the surface, "
        "within r mm), or the name of a node set"
    )
    more.add_argument("--fixed", metavar="RULE", help=text)
    text = "noise of a marker coordinate without its own std_mm"
    add_option(more, "--std", number(text, unit="mm", above=0.0, default=None, otherwise="0.1"), "MM")


def add_belief_options(what: Any) -> None:
    """Add the options for what is believed of the body and its load. `what`: of the command."""
    text = "whether the node set 'fixed' is held for sure, perhaps, or not at all (default: sure)"
    what.add_argument("--held", choices=["sure", "perhaps", "free"], help=text)
    text = "whether the tracker kept its place relative to the supports, or may have drifted (default: fixed)"
    what.add_argument("--tracker", choices=["fixed", "drifts"], help=text)
    text = "graded: softer towards one side, by an amount that is estimated from the markers (default: believed)"
    what.add_argument("--stiffness", choices=["believed", "graded"], help=text)
    text = "Young's modulus in kPa; it scales forces, and sets how far gravity bends the body"
    add_option(what, "--young", number(text, unit="kPa", above=0.0, default=None, otherwise="10"), "KPA")
    add_option(what, "--poisson", number("Poisson's ratio", default=None, otherwise="0.45"), "NU")
    text = (
        "acceleration in mm/s^2, in the frame of MESH, that acts now and did not on MESH, e.g. '0 0 -9810'; of a body "
        "that was imaged in gravity, the difference"
    )
    what.add_argument("--gravity", type=_acceleration, metavar="'GX GY GZ'", help=text)
    text = "density in g/cm^3, with --gravity"
    add_option(what, "--density", number(text, unit="g/cm^3", above=0.0, default=None, otherwise="1"), "RHO")


def add_method_options(how: Any) -> None:
    """Add the options for the model and the method. `how`: of the command."""
    text = "folder of a trained model, or 'phantom' for the one that is shipped (default: unknown contacts)"
    how.add_argument("--model", metavar="DIR", help=text)
    text = "elements of the simulations (default: auto, those that suit the mesh)"
    choices = ["auto", "tet4", "tet4-averaged", "tet10"]
    how.add_argument("--element", choices=choices, default="auto", help=text)
    how.add_argument("--polish", action="store_true", help="with a model: make its answer an equilibrium")
    text = "with a model: an ensemble, or the most probable answer with its Gaussian (default: esmda)"
    how.add_argument("--update", choices=["esmda", "gauss-newton"], help=text)
    members = whole("ensemble members, with a model", least=8, default=None, otherwise="200")
    add_option(how, "--members", members, "N")
    add_option(how, "--steps", whole("assimilation steps, with a model", least=1, default=None, otherwise="5"), "N")


def method_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `register`, and of `Registrar`, that say how to register.

    `args`: parsed command line. Result: ``model``, ``seed`` and ``settings``.
    """
    return {"model": args.model, "seed": args.seed or 0, "settings": _settings(args)}


def _settings(args: argparse.Namespace) -> "RegisterSettings":
    from tissuereg.registration.settings import RegisterSettings, SmootherSettings

    smoother = _given(update=args.update, n_members=args.members, n_steps=args.steps)
    chosen = _given(tracker=args.tracker, smoother=SmootherSettings(**smoother) if smoother else None)
    return RegisterSettings(threads=args.threads, polish=args.polish, **chosen)


def _given(**options: Any) -> dict[str, Any]:
    """Return the options that were given."""
    return {name: value for name, value in options.items() if value is not None}


def believed_body(args: argparse.Namespace, mesh: "Mesh", material: "Material | None") -> "Body":
    """Return what is believed of a body, given its mesh and material.

    `args`: parsed command line; `mesh`: undeformed body; `material`: as `beliefs_of` returns it. Result: with the
    elements and supports of the options.
    """
    from tissuereg.registration.body import Body

    return Body(mesh, material, args.element, **_given(held=args.held, stiffness=args.stiffness))


def frames_of(args: argparse.Namespace, files: Sequence[str | Path | None]) -> dict[str, str | None]:
    """Return the frame of the answer and that of tables; note the first if it is that of a file of 3D Slicer.

    `args`: parsed command line; `files`: files that may be points of 3D Slicer; the first one that is counts. Result:
    ``frame`` and ``table_frame``, as readers take them. Raises `UsageError` if options do not go together.
    """
    from tissuereg.io.point_files import frame_of_files

    if args.tables_frame is not None and args.frame is None:
        refuse("--tables-frame must come with --frame", "--tables-frame")
    if args.frame is not None:
        return {"frame": args.frame, "table_frame": args.tables_frame}
    chosen = frame_of_files([path for path in files if path is not None])
    if chosen is None:
        return {"frame": None, "table_frame": None}
    note(f"MESH is taken to be in {chosen[0]}, the frame of {chosen[1]}; set --frame to change that")
    return {"frame": chosen[0], "table_frame": None}


def read_body(args: argparse.Namespace, path: str) -> "Mesh":
    """Return the body, of which something is held if something must be.

    `args`: parsed command line; `path`: the mesh file. Result: in the frame of the file. Raises `FormatError` or
    `MeshError` if the file cannot be used, or nothing is held.
    """
    from tissuereg.io.meshes import read_mesh

    mesh = read_mesh(path, fixed=args.fixed)
    if args.model is None and (args.held == "free" or "perhaps_fixed" in mesh.node_sets):
        return mesh
    try:
        _ = mesh.fixed_nodes  # raises at once if nothing is held
    except MeshError as error:
        error.args = (f"{path}: {error}; name the held nodes with --fixed, or use --held free",)
        raise
    return mesh


def beliefs_of(args: argparse.Namespace, simulation: str) -> "tuple[Material | None, Load | None]":
    """Return the believed material and load.

    `args`: parsed command line; `simulation`: name of the option for a simulation, which gravity must not come with.
    Result: None where they are not given. Raises `UsageError` if options do not go together; `MaterialError` if a
    modulus or a density is out of its range.
    """
    if args.density is not None and args.gravity is None:
        refuse("--density must come with --gravity", "--density")
    if args.gravity is not None and getattr(args, simulation.strip("-")) is not None:
        refuse(f"--gravity must be left out with {simulation}, which holds what acts", "--gravity")
    material = _material(args)
    return material, None if material is None or args.gravity is None else _weight(material, args.gravity)


def refuse(message: str, where: str) -> NoReturn:
    """Raise a `UsageError`."""
    raise UsageError(message, where=where)


def _acceleration(text: str) -> tuple[float, ...]:
    finite = option_type(number().metadata["check"])
    numbers = tuple(finite(word) for word in text.split())
    if len(numbers) != 3:
        message = f"must be three numbers, 'gx gy gz', got '{text}'"
        raise argparse.ArgumentTypeError(message)
    if np.linalg.norm(numbers) < _LEAST_GRAVITY:
        message = f"must be in mm/s^2, of {_LEAST_GRAVITY:g} or more (that of the earth is 9810), got '{text}'"
        raise argparse.ArgumentTypeError(message)
    return numbers


def _material(args: argparse.Namespace) -> "Material | None":
    from tissuereg.body.material import Material

    given = {"young": args.young, "poisson": args.poisson, "density": args.density}
    known = {name: value for name, value in given.items() if value is not None}
    return Material(**known) if known or args.gravity is not None else None


def _weight(material: "Material", gravity: tuple[float, ...]) -> "Load":
    from tissuereg.body.load import Load

    return Load(body_force=material.weight(gravity, float(np.linalg.norm(gravity))))
