"""The command ``tissuereg advise``: proposes where the next markers should be placed."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg._base.fields import number, whole
from tissuereg.cli.common import Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse, refuse_overwriting

if TYPE_CHECKING:
    from tissuereg._base.arrays import FloatArray
    from tissuereg.body.mesh import Mesh
    from tissuereg.io.datasets import Dataset
    from tissuereg.registration.advise import MarkerAdvice

HELP = Help(
    "Chooses, of the places where a marker may sit, those that shrink the expected error at the targets most: one "
    "after another, each given those before it. What may happen is an ensemble of displacement fields: members of a "
    "data set (--data), draws of a trained model (--model), or else random pushes and pulls of MESH. DIR gets "
    "markers.csv, the places, the most telling first, with the error that is expected once they are measured, and "
    "advise.json, both or none.",
    example="tissuereg advise markers body.vtu --targets targets.csv --out advice",
    seed="seed of the choice or the draws of fields (default: 0)",
)


#: Files of the answer.
_TABLE, _ANSWER = "markers.csv", "advise.json"

#: Largest displacement of a usual random push, mm, where none is given.
_LARGEST_MM = 5.0


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg advise`` to its parser."""
    parser.add_argument("what", metavar="markers", choices=["markers"], help="what is asked: markers")
    text = "mesh file; with --data left out, with --model the phantom's by default"
    parser.add_argument("path", metavar="MESH", nargs="?", help=text)
    text = "table target,x_mm,y_mm,z_mm, or points of 3D Slicer: inner points in the undeformed body"
    parser.add_argument("--targets", metavar="FILE", required=True, help=text)
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for the results")
    happens = parser.add_argument_group("what may happen")
    fields = happens.add_mutually_exclusive_group()
    fields.add_argument("--data", metavar="DATA", help="data set of the body, with its mesh")
    fields.add_argument("--model", metavar="FOLDER", help="folder of a trained model; phantom, phantom-graph: shipped")
    text = "of random pushes and pulls: how far a usual one moves the body at most"
    add_option(happens, "--largest", number(text, unit="mm", above=0.0, default=None, otherwise="5"), "MM")
    more = parser.add_argument_group("more")
    text = "held nodes of MESH; see `tissuereg register --help`"
    more.add_argument("--fixed", metavar="RULE", help=text)
    add_option(more, "--members", whole("fields", least=2, default=1000), "N")
    add_option(more, "--number", whole("markers to choose", least=1, default=15), "N")
    text = "table x_mm,y_mm,z_mm of places where a marker may sit (default: free surface nodes)"
    more.add_argument("--candidates", metavar="FILE", help=text)
    more.add_argument("--placed", metavar="FILE", help="table x_mm,y_mm,z_mm of markers that sit there already")
    add_option(more, "--std", number("noise of a marker coordinate", unit="mm", above=0.0, default=0.1), "MM")
    apart = number("least distance between markers", unit="mm", above=0.0, default=0.0, otherwise="none")
    add_option(more, "--apart", apart, "MM")


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg advise``: choose marker places and write them; JSON schema ``tissuereg.advise/1``."""
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.io.datasets import open_dataset
    from tissuereg.io.tables import read_surface, read_targets
    from tissuereg.registration.advise import advise_markers

    out = Path(args.out)
    _check(args)
    refuse_overwriting(
        [out / name for name in (_TABLE, _ANSWER)], [args.targets, args.candidates, args.placed, args.path]
    )
    check_folder_target(out)
    clock = Stopwatch()
    data = None if args.data is None else open_dataset(args.data)
    mesh = _mesh(args) if data is None else data.mesh
    targets = read_targets(args.targets, frame=mesh.frame)
    tables = (args.candidates, args.placed)
    candidates, placed = (None if f is None else read_surface(f, frame=mesh.frame) for f in tables)
    fields = _what_may_happen(args, mesh) if data is None else _of_data(args, data)
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
    content = {
        "schema": "tissuereg.advise/1",
        "members": len(fields),
        "std_mm": args.std,
        "apart_mm": args.apart,
        "seed": args.seed or 0,
        **advice.to_json(),
        "seconds": clock.seconds,
    }
    _write(out, advice, content)
    lines = [
        f"{name}: expected error {errors[0]:.2f} mm before, {errors[-1]:.2f} mm with {args.number} markers"
        for name, errors in content["expected_mm"].items()
    ]
    lines += [seconds_line(clock.seconds, verbose=args.verbose), f"written: {args.out}"]
    return Outcome(content, "\n".join(lines), args.threads)


def _check(args: argparse.Namespace) -> None:
    """Raise UsageError for options that contradict each other."""
    if args.data is not None and args.path is not None:
        refuse("MESH must be left out with --data, which has its own", "MESH")
    if args.data is None and args.model is None and args.path is None:
        refuse("MESH, --model or --data must be given, got none", "MESH")
    if args.path is None and args.fixed is not None:
        refuse("--fixed must come with MESH", "--fixed")
    if args.largest is not None and (args.data is not None or args.model is not None):
        refuse("--largest must be left out with --data and --model, whose fields have their sizes", "--largest")


def _mesh(args: argparse.Namespace) -> "Mesh":
    from tissuereg.io.meshes import read_mesh
    from tissuereg.phantom import phantom_mesh

    return phantom_mesh() if args.path is None else read_mesh(args.path, fixed=args.fixed)


def _what_may_happen(args: argparse.Namespace, mesh: "Mesh") -> "FloatArray":
    """Return displacement fields (members, n_nodes, 3), mm, of a model or of random pushes."""
    return _of_model(args, mesh) if args.model is not None else _of_pushes(args, mesh)


def _of_pushes(args: argparse.Namespace, mesh: "Mesh") -> "FloatArray":
    import numpy as np

    from tissuereg.body.material import Material
    from tissuereg.simulation.sampling import random_changes

    largest = _LARGEST_MM if args.largest is None else args.largest
    rng = np.random.default_rng(args.seed or 0)
    how = {"largest_mm": largest, "n_events": args.members, "rng": rng, "threads": args.threads}
    return random_changes(mesh, Material(), **how)


def _of_data(args: argparse.Namespace, data: "Dataset") -> "FloatArray":
    import numpy as np

    members = data.split["train"]
    rng = np.random.default_rng(args.seed or 0)
    drawn = np.sort(rng.choice(members, min(args.members, len(members)), replace=False))
    return np.asarray(data.displacement[drawn], np.float64)


def _of_model(args: argparse.Namespace, mesh: "Mesh") -> "FloatArray":
    import numpy as np

    from tissuereg.registration.learned.registration import as_model

    model = as_model(args.model, mesh, args.threads)
    family = model.prior()
    draws = np.random.default_rng(args.seed or 0).multivariate_normal(family.mean, family.covariance, args.members)
    return np.asarray(model.decode(draws.T), np.float64)


def _write(out: Path, advice: "MarkerAdvice", content: dict[str, Any]) -> None:
    from tissuereg.io.atomic import atomic_folder
    from tissuereg.io.csv import write_table
    from tissuereg.io.json import dumps

    names = [f"expected_{name}_mm" for name in advice.targets]
    rows = [
        (f"M{k}", *map(float, place), *map(float, errors))
        for k, (place, errors) in enumerate(zip(advice.places_mm, advice.expected_mm[1:], strict=True), start=1)
    ]
    with atomic_folder(out) as draft:
        write_table(draft / _TABLE, ("marker", "x_mm", "y_mm", "z_mm", *names), rows)
        (draft / _ANSWER).write_text(dumps(content), encoding="utf-8")
