"""Options of every command that registers a body: mesh, frames, targets, beliefs and method; and their evaluation."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.choices import (
    BODY_ELEMENTS,
    COINCIDENT,
    FRAMES,
    HELD,
    MATCHES,
    STIFFNESS,
    TRACKERS,
    Frame,
)
from tissuereg._base.fields import choice, number, whole
from tissuereg.cli.common import note
from tissuereg.cli.options import add_option, option_type, refuse
from tissuereg.errors import MeshError

if TYPE_CHECKING:
    from tissuereg.body.load import Load
    from tissuereg.body.material import Material
    from tissuereg.body.mesh import Mesh
    from tissuereg.registration.body import Body
    from tissuereg.registration.settings import RegisterSettings

#: Accelerations below this, in mm/s^2, are refused: they were probably given in m/s^2.
_LEAST_GRAVITY = 20.0


def add_body_options(more: Any, tables: str, *, noise: bool = True) -> None:
    """Add options for frames, targets, held nodes and `noise`; `tables` names the tables of ``--tables-frame``."""
    text = (
        "LPS or RAS: frame of MESH, of tables and of the answer; points of 3D Slicer in the other one are converted "
        "(default: that which MESH states, or else that of the first such file of points on the surface; if none, "
        "numbers as they are)"
    )
    add_option(more, "--frame", choice(FRAMES, text, default=None))
    text = f"frame of the tables {tables}, where it is not --frame"
    add_option(more, "--tables-frame", choice(FRAMES, text, default=None))
    text = "table target,x_mm,y_mm,z_mm, or points of 3D Slicer: inner points in the undeformed body"
    more.add_argument("--targets", metavar="FILE", help=text)
    text = (
        "held nodes: 'plane nx ny nz d [tol]' (within tol mm of n . x = d mm), 'ball x y z r' (of the surface, "
        "within r mm), 'box x0 y0 z0 x1 y1 z1', 'near FILE r' (within r mm of another surface), or a node set's name"
    )
    more.add_argument("--fixed", metavar="RULE", help=text)
    text = "nodes of MESH at one place that no tets share: joined where whole faces coincide, all joined, or kept apart"
    add_option(more, "--coincident", choice(COINCIDENT, text, default=None, otherwise="certain"))
    if not noise:
        return
    text = "noise of a marker coordinate without its own std_mm"
    add_option(more, "--std", number(text, unit="mm", above=0.0, default=None, otherwise="0.1"), "MM")


def add_match_option(more: Any, what: str) -> None:
    """Add the option ``--match``: how the two lists of markers that `what` names are joined."""
    text = (
        f"how {what} are joined: by their labels, by order, or by the last number in each label, such as F-3 and F_1-3"
    )
    add_option(more, "--match", choice(MATCHES, text, default=None, otherwise="label"))


def add_belief_options(what: Any) -> None:
    """Add the options for what the user believes of the body and its load to an argparse group."""
    text = "whether the node set 'fixed' is held for sure, perhaps, or not at all"
    add_option(what, "--held", choice(HELD, text, default=None, otherwise="sure"))
    text = "fixed: the tracker surely kept its place relative to the supports; it may have drifted a little"
    add_option(what, "--tracker", choice(TRACKERS, text, default=None, otherwise="drifts"))
    text = (
        "graded: much softer towards one side, by an amount that the markers tell; SET=KPA[:STD]: modulus of the part "
        "of the body that a node set holds, such as tumour=40:10, with its standard deviation where it is uncertain; "
        "may be given several times (default: believed, as --young says)"
    )
    what.add_argument("--stiffness", action="append", type=_stiffness, metavar="WORD", help=text)
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
    """Add the options for trained model, elements and ensemble to an argparse group."""
    text = "folder of a trained model; phantom, phantom-graph: shipped ones (default: unknown contacts)"
    how.add_argument("--model", metavar="DIR", help=text)
    usual = "auto, those that suit the mesh"
    element = choice(BODY_ELEMENTS, "elements of the simulations", default="auto", otherwise=usual)
    add_option(how, "--element", element)
    members = whole("ensemble members, with a model", least=2, default=None, otherwise="40")
    add_option(how, "--members", members, "N")
    add_option(how, "--steps", whole("assimilation steps, with a model", least=1, default=None, otherwise="4"), "N")


def method_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments ``model``, ``seed`` and ``settings`` of `register` and `Registrar` from parsed options."""
    return {"model": args.model, "seed": args.seed or 0, "settings": _settings(args)}


def _settings(args: argparse.Namespace) -> "RegisterSettings":
    from tissuereg.registration.settings import RegisterSettings, SmootherSettings

    smoother = only_given(n_members=args.members, n_steps=args.steps)
    chosen = only_given(tracker=args.tracker, smoother=SmootherSettings(**smoother) if smoother else None)
    return RegisterSettings(threads=args.threads, **chosen)


def only_given(**options: Any) -> dict[str, Any]:
    """Return the keyword arguments that are not None."""
    return {name: value for name, value in options.items() if value is not None}


def believed_body(args: argparse.Namespace, mesh: "Mesh", material: "Material | None") -> "Body":
    """Return the body as the user believes it: mesh and material, with the elements and supports that options state."""
    from tissuereg.registration.body import Body

    return Body(mesh, material, args.element, **only_given(held=args.held), **stiffness_of(args))


def stiffness_of(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments ``stiffness`` and ``regions`` of a `Body` that ``--stiffness`` states."""
    words = args.stiffness or []
    stated = {one for one in words if isinstance(one, str)}
    if len(stated) > 1:
        refuse("--stiffness must be believed or graded, got both", "--stiffness")
    regions = {one[0]: one[1:] for one in words if not isinstance(one, str)}
    if len(regions) + len([one for one in words if isinstance(one, str)]) < len(words):
        refuse("--stiffness must name each node set once", "--stiffness")
    return only_given(stiffness=next(iter(stated), None), regions=regions or None)


def _stiffness(word: str) -> str | tuple[str, float, float]:
    """Return a word of ``--stiffness``, or a node set with its modulus and standard deviation, kPa."""
    if word in STIFFNESS:
        return word
    name, _, numbers = word.rpartition("=")
    young, _, std = numbers.partition(":")
    try:
        values = float(young), float(std or 0.0)
    except ValueError:
        values = None
    if not name or values is None:
        message = f"must be believed, graded or SET=KPA[:STD], such as tumour=40:10; got {word!r}"
        raise argparse.ArgumentTypeError(message)
    return name, *values


def frames_of(
    args: argparse.Namespace, mesh: "Mesh", files: Sequence[str | Path | None], inner: Sequence[str | Path | None]
) -> dict[str, Frame | None]:
    """Return the patient frames of the answer (``frame``) and of tables (``table_frame``): LPS, RAS, None if unknown.

    Where neither `mesh` nor ``--frame`` states it, it is that of the first of `files`, of points on the surface, that
    is one of 3D Slicer, which a note on standard error states: on the surface another frame would show. Raises
    UsageError where options clash, or where of all files only one of `inner` points states a frame; FormatError if
    ``--frame`` contradicts the mesh.
    """
    from tissuereg.io.notes import agreed_frame
    from tissuereg.io.point_files import frame_of_files

    frame = agreed_frame(mesh.frame, args.frame, args.path)
    if args.tables_frame is not None and frame is None:
        refuse("--tables-frame must come with --frame, or with a mesh that states its frame", "--tables-frame")
    if frame is not None:
        return {"frame": frame, "table_frame": args.tables_frame}
    chosen, alone = (frame_of_files([path for path in some if path is not None]) for some in (files, inner))
    if chosen is None and alone is not None:
        refuse(
            f"--frame must be given: {alone[1]} is in {alone[0]}, and nothing else says what frame it is in",
            "--frame",
        )
    if chosen is None:
        return {"frame": None, "table_frame": None}
    note(f"MESH is taken to be in {chosen[0]}, the frame of {chosen[1]}; set --frame to change that")
    return {"frame": chosen[0], "table_frame": None}


def read_tracked_body(args: argparse.Namespace) -> "tuple[Mesh, dict[str, Frame | None]]":
    """Return the mesh of a command that follows markers from ``--reference``, in its frame, and all `frames_of`."""
    mesh = read_body(args, args.path)
    frames = frames_of(args, mesh, [args.reference], [args.targets])
    return mesh if frames["frame"] is None else mesh.in_frame(frames["frame"]), frames


def read_body(args: argparse.Namespace, path: str) -> "Mesh":
    """Return the mesh of a file; raise MeshError if no node is held though the options need held nodes."""
    from tissuereg.io.meshes import read_mesh

    mesh = read_mesh(path, args.fixed, frame=args.frame, **only_given(coincident=args.coincident))
    if args.model is None and (args.held == "free" or "perhaps_fixed" in mesh.node_sets):
        return mesh
    try:
        _ = mesh.fixed_nodes  # raises at once if nothing is held
    except MeshError as error:
        error.args = (f"{path}: {error}; name the held nodes with --fixed, or use --held free",)
        raise
    return mesh


def beliefs_of(args: argparse.Namespace, simulation: str) -> "tuple[Material | None, Load | None]":
    """Return the believed material and the believed load from the options; each is None if the options do not state it.

    `simulation` is the name of the option for a simulation, which gravity must not come with. Raises UsageError where
    options clash, MaterialError if a modulus or a density is out of its range.
    """
    from tissuereg.body.load import Load
    from tissuereg.body.material import Material

    if args.density is not None and args.gravity is None:
        refuse("--density must come with --gravity", "--density")
    if args.gravity is not None and getattr(args, simulation.strip("-")) is not None:
        refuse(f"--gravity must be left out with {simulation}, which holds what acts", "--gravity")
    known = only_given(young=args.young, poisson=args.poisson, density=args.density)
    if args.gravity is None:
        return Material(**known) if known else None, None
    material = Material(**known)
    return material, Load(body_force=material.weight(args.gravity, float(np.linalg.norm(args.gravity))))


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
