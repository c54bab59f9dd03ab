"""Input of ``tissuereg register``: its options, and the arguments of `register` made from them."""

import argparse
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from tissuereg._base.fields import number
from tissuereg.cli.body_input import (
    add_belief_options,
    add_body_options,
    beliefs_of,
    believed_body,
    frames_of,
    read_body,
    refuse,
)
from tissuereg.cli.options import Parser, add_option

if TYPE_CHECKING:
    from tissuereg.registration.body import Body


def add_input_options(parser: Parser) -> None:
    """Add the options for data and beliefs about the moment. `parser`: of the command."""
    frame = parser.add_argument_group("frame of an experiment")
    frame.add_argument("--case", metavar="C", help="name of the case")
    add_option(frame, "--time", number("time in s on the experiment's clock", unit="s", default=None), "T")
    _add_files(parser.add_argument_group("more input"))
    add_belief_options(parser.add_argument_group("what is believed"))


def registration_input(args: argparse.Namespace) -> dict[str, Any]:
    """Return the arguments of `register`.

    `args`: parsed command line. Result: arguments of `register` by name. Raises `UsageError` if options do not go
    together; `FormatError`, `MeshError`, `MarkerError` or `ExperimentError` if a file cannot be used; `MaterialError`
    if a modulus or a density is out of its range.
    """
    from tissuereg.body.surface import SurfacePoints
    from tissuereg.io.experiments import is_experiment
    from tissuereg.io.problems import read_simulation, read_variants
    from tissuereg.io.tables import read_surface, read_targets
    from tissuereg.registration.inputs import SimulationVariants

    frames = frames_of(args, [*args.markers, args.targets])
    given = _from_experiment(args) if is_experiment(args.path) else _from_files(args, frames)
    body: Body = given["mesh"]
    if frames["frame"] is not None:
        given["mesh"] = body = replace(body, mesh=body.mesh.in_frame(frames["frame"]))
    if args.targets is not None:
        given["targets"] = {**given["targets"], **read_targets(args.targets, **frames)}
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


def _add_files(more: Any) -> None:
    text = "points of 3D Slicer where the markers of MARKERS, such points too, were seen; joined by label"
    more.add_argument("--measured", metavar="FILE", help=text)
    text = "displacement_mm (n, 3) of this moment, predicted by any simulator"
    more.add_argument("--simulation", metavar="U.npz", help=text)
    text = "displacement_mm (k, n, 3): this moment simulated with other values of what is uncertain; with --model"
    more.add_argument("--variants", metavar="U.npz", help=text)
    text = "table x_mm,y_mm,z_mm of points on the deformed surface, or on a part of it, without labels"
    more.add_argument("--surface", metavar="FILE", help=text)
    text = "noise of such a point along the surface's normal"
    add_option(more, "--surface-std", number(text, unit="mm", above=0.0, default=None, otherwise="0.1"), "MM")
    add_body_options(more, "MARKERS, --targets and --surface")


def _from_files(args: argparse.Namespace, frames: dict[str, str | None]) -> dict[str, Any]:
    from tissuereg.io.tables import read_markers

    if len(args.markers) > 1 or (not args.markers and args.surface is None):
        found = f"got {len(args.markers)} files"
        refuse(f"one MARKERS must be given with a mesh file (only an experiment brings its own), {found}", "MARKERS")
    if args.measured is not None and not args.markers:
        refuse("--measured must come with MARKERS, where the markers sit", "--measured")
    for name in ("case", "time"):
        if getattr(args, name) is not None:
            refuse(f"--{name} must be left out with a mesh file; it chooses a frame of an experiment", f"--{name}")
    material, load = beliefs_of(args, "--simulation")
    body = believed_body(args, read_body(args, args.path), material)
    markers = read_markers(args.markers[0], args.std, measured=args.measured, **frames) if args.markers else None
    return {"mesh": body, "markers": markers, "targets": {}, "load": load}


def _from_experiment(args: argparse.Namespace) -> dict[str, Any]:
    from tissuereg.io.experiments import read_experiment
    from tissuereg.registration.frame import frame_input

    for name in ("markers", "measured", "fixed", "std", "young", "poisson", "gravity", "density"):
        if getattr(args, name) not in (None, []):
            option = "MARKERS" if name == "markers" else f"--{name}"
            refuse(f"{option} must be left out with an experiment, which states its own", option)
    for name in ("case", "time"):
        if getattr(args, name) is None:
            refuse(f"--{name} must be given with an experiment", f"--{name}")
    experiment = read_experiment(args.path)
    plain = "tet4" if args.element == "auto" else args.element
    given = frame_input(experiment, args.case, args.time, element=plain, threads=args.threads)
    # The registration uses the same elements as the simulation of the frame.
    beliefs = {"held": args.held, "stiffness": args.stiffness}
    known = {name: value for name, value in beliefs.items() if value is not None}
    return {**given, "mesh": replace(given["mesh"], **known)}
