"""``tissuereg demo``: the main job on the embedded phantom."""

import argparse
from typing import Any

from tissuereg.cli.common import Outcome, seconds_line
from tissuereg.cli.options import add_common, command_parser

_DETAILS = (
    "An embedded breast phantom, its physics simulation and a shipped network: simulation, encoder, ES-MDA over the "
    "ONNX decoder, registered mesh. The measurement was made with another model (other stiffness, a stiff lesion, "
    "ten-node elements, finer mesh), so the errors told are errors against a truth that the model does not know."
)


def add_parser(commands: Any) -> None:
    """Add the command's parser.

    Parameters
    ----------
    commands : argparse sub-parsers action
        Where to.
    """
    purpose = "register the embedded phantom, end to end"
    parser = command_parser(commands, "demo", purpose, _DETAILS, "tissuereg demo --out demo")
    text = "folder for the files that 'register' writes, and for its input (default: demo)"
    parser.add_argument("--out", default="demo", metavar="DIR", help=text)
    add_common(parser, seed="seed of markers, noise and ensemble (default: 0)")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> Outcome:
    """Run the demonstration.

    Parameters
    ----------
    args : argparse.Namespace
        Parsed command line.

    Returns
    -------
    Outcome
        Schema ``tissuereg.registration/1`` with ``truth``.
    """
    from tissuereg.demo import run_demo
    from tissuereg.io.atomic import check_folder_target

    check_folder_target(args.out)
    content = run_demo(args.out, seed=args.seed or 0, threads=args.threads)
    return Outcome(content, _table(content, args.out), args.threads)


def _table(content: dict[str, Any], out: str) -> str:
    truth, target, model = content["truth"], content["targets"]["lesion"], content["model"]
    lesion = truth["targets"]["lesion"]
    rows = [("markers", truth["markers"]), ("lesion", lesion), ("whole body", truth["body"])]
    axes = " x ".join(f"{radius:.2f}" for radius in target["region90_radii_mm"])
    inside = "inside" if lesion["inside_region90"] else "outside"
    return "\n".join(
        [
            "mean error, mm     before    after",
            *(f"  {name:<14} {row['before_mm']:8.3f} {row['after_mm']:8.3f}" for name, row in rows),
            f"90 % region of the lesion: half-axes {axes} mm; the truth lies {inside}",
            f"test error of the {model['kind']}: {_mm(model.get('test_error_mm'))}; of PCA-26 on the same split: "
            f"{_mm(model.get('pca26_test_error_mm'))}",
            seconds_line(content["seconds"]),
            f"written: {out}",
        ]
    )


def _mm(value: float | None) -> str:
    return "not known" if value is None else f"{value:.3f} mm"
