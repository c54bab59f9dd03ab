"""``tissuereg advise``: where the next markers should go."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg.cli.common import Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import (
    UsageError,
    add_common,
    command_parser,
    positive_number,
    refuse_overwriting,
    whole_number,
)

if TYPE_CHECKING:
    from tissuereg._arrays import FloatArray
    from tissuereg.advise import MarkerAdvice
    from tissuereg.mesh import Mesh

_DETAILS = (
    "Chooses, of the places where a marker may sit, those that shrink the expected error at the targets most: one "
    "after another, each given those before it. What may happen is an ensemble of displacement fields: members of a "
    "data set (--data), or draws of a trained model (--model). OUT.csv lists the places, the most telling first, with "
    "the error that is expected once they are measured."
)


def add_parser(commands: Any) -> None:
    """Add the command's parser.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to.
    """
    example = "tissuereg advise markers --model phantom --targets targets.csv --out markers.csv"
    parser = command_parser(commands, "advise", "say where the next markers should go", _DETAILS, example)
    parser.add_argument("what", metavar="markers", choices=["markers"], help="what is asked: markers")
    text = "table target,x_mm,y_mm,z_mm, or points of 3D Slicer: inner points in the undeformed body"
    parser.add_argument("--targets", metavar="FILE", required=True, help=text)
    parser.add_argument("--out", metavar="OUT.csv", required=True, help="table of the chosen places")
    fields = parser.add_argument_group("what may happen").add_mutually_exclusive_group(required=True)
    fields.add_argument("--data", metavar="DATA", help="data set of the body, with its mesh")
    fields.add_argument("--model", metavar="FOLDER", help="folder of a trained model, or phantom for the shipped one")
    more = parser.add_argument_group("more")
    more.add_argument("--mesh", metavar="MESH", help="mesh of --model (default: the phantom's)")
    more.add_argument("--members", type=whole_number(2), default=1000, metavar="N", help="fields (default: 1000)")
    more.add_argument("--number", type=whole_number(1), default=15, metavar="N", help="markers to choose (default: 15)")
    text = "table x_mm,y_mm,z_mm of places where a marker may sit (default: free surface nodes)"
    more.add_argument("--candidates", metavar="FILE", help=text)
    more.add_argument("--placed", metavar="FILE", help="table x_mm,y_mm,z_mm of markers that sit there already")
    text = "noise of a marker coordinate, in mm (default: 0.1)"
    more.add_argument("--std", type=positive_number, default=0.1, metavar="MM", help=text)
    text = "least distance between markers, in mm (default: none)"
    more.add_argument("--apart", type=positive_number, default=0.0, metavar="MM", help=text)
    add_common(parser, seed="seed of the choice or the draws of fields (default: 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> Outcome:
    """Choose and write.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed command line.

    Returns
    -------
    Outcome
        Schema ``tissuereg.advise/1``.

    Raises
    ------
    UsageError
        If a mesh is given with a data set, or the table would replace an input.
    """
    from tissuereg.advise import advise_markers
    from tissuereg.io.atomic import check_file_target
    from tissuereg.io.tables import read_surface, read_targets

    if args.data is not None and args.mesh is not None:
        message = "--mesh must come with --model, since a data set has its own"
        raise UsageError(message, where="--mesh")
    refuse_overwriting([Path(args.out)], [args.targets, args.candidates, args.placed, args.mesh])
    check_file_target(args.out)
    clock = Stopwatch()
    targets = read_targets(args.targets)
    candidates, placed = (None if f is None else read_surface(f) for f in (args.candidates, args.placed))
    mesh, fields = _of_data(args) if args.model is None else _of_model(args)
    clock.lap("fields")
    advice = advise_markers(
        mesh,
        fields,
        targets,
        args.number,
        candidates_mm=candidates,
        placed_mm=placed,
        std=args.std,
        apart_mm=args.apart,
    )
    clock.lap("choose")
    _write(Path(args.out), advice)
    clock.lap("write")
    content = {
        "schema": "tissuereg.advise/1",
        "members": len(fields),
        "std_mm": args.std,
        "apart_mm": args.apart,
        "seed": args.seed or 0,
        **advice.to_json(),
        "seconds": clock.seconds,
    }
    lines = [
        f"{name}: expected error {errors[0]:.2f} mm before, {errors[-1]:.2f} mm with {args.number} markers"
        for name, errors in content["expected_mm"].items()
    ]
    return Outcome(content, "\n".join([*lines, seconds_line(clock.seconds), f"written: {args.out}"]), args.threads)


def _of_data(args: argparse.Namespace) -> "tuple[Mesh, FloatArray]":
    import numpy as np

    from tissuereg.io.datasets import open_dataset

    data = open_dataset(args.data)
    members = data.split["train"]
    rng = np.random.default_rng(args.seed or 0)
    drawn = np.sort(rng.choice(members, min(args.members, len(members)), replace=False))
    return data.mesh, np.asarray(data.displacement[drawn], np.float64)


def _of_model(args: argparse.Namespace) -> "tuple[Mesh, FloatArray]":
    import numpy as np

    from tissuereg.io.meshes import read_mesh
    from tissuereg.latent_registration import as_model
    from tissuereg.phantom import phantom_mesh

    mesh = phantom_mesh() if args.mesh is None else read_mesh(args.mesh)
    model = as_model(args.model, mesh, args.threads)
    family = model.prior(None)
    draws = np.random.default_rng(args.seed or 0).multivariate_normal(family.mean, family.covariance, args.members)
    return mesh, np.asarray(model.decode(draws.T), np.float64)


def _write(path: Path, advice: "MarkerAdvice") -> None:
    from tissuereg.io.csv import write_table

    names = [f"expected_{name}_mm" for name in advice.targets]
    rows = [
        (f"M{k}", *map(float, place), *map(float, errors))
        for k, (place, errors) in enumerate(zip(advice.places_mm, advice.expected_mm[1:], strict=True), start=1)
    ]
    write_table(path, ("marker", "x_mm", "y_mm", "z_mm", *names), rows)
