"""The command ``tissuereg demo``: a registration of the embedded phantom, or sample files."""

import argparse
from typing import Any

from tissuereg.cli.common import Outcome, seconds_line
from tissuereg.cli.options import Help, Parser, refuse

HELP = Help(
    "An embedded breast phantom, its physics simulation and a shipped model: simulation, encoder, ES-MDA over the "
    "ONNX decoder, registered mesh. The measurement was made with another model (other stiffness, a stiff lesion, "
    "ten-node elements, finer mesh), so errors are those against a truth that the model does not know. With --files "
    "nothing is computed: DIR gets surface/ (organ.stl, markers and targets, for 'mesh' and 'register'), scan/ (the "
    "same organ as a segmentation, with points of 3D Slicer) and rig/ (an experiment for 'simulate' and 'diagnose').",
    example="tissuereg demo --out demo",
    seed="seed of markers, noise and ensemble (default: 0)",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg demo`` to its parser."""
    text = "folder for the files that 'register' writes, and for its input (default: demo)"
    parser.add_argument("--out", metavar="DIR", help=text)
    parser.add_argument("--files", metavar="DIR", help="write sample files to try the other commands on, and stop")


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg demo``; schema ``tissuereg.registration/1`` with ``truth``, or ``tissuereg.samples/1``."""
    if args.files is not None:
        return _write_files(args)
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.phantom.demo import run_demo

    out = args.out or "demo"
    check_folder_target(out)
    content = run_demo(out, seed=args.seed or 0, threads=args.threads)
    return Outcome(content, _table(content, out), args.threads)


def _write_files(args: argparse.Namespace) -> Outcome:
    from tissuereg.phantom.samples import write_samples

    if args.out is not None or args.seed is not None:
        refuse("--files must be given without --out and --seed: it only writes files", "--files")
    files = write_samples(args.files)
    where = args.files
    given = f"{where}/surface/markers.csv --targets {where}/surface/targets.csv"
    lines = [
        f"written: {', '.join(files)} in {where}",
        "to try them:",
        f'  tissuereg mesh {where}/surface/organ.stl --size 7 --out body.vtu --fixed "plane 0 0 1 -18 2.5"',
        f"  tissuereg register body.vtu {given} --out registered",
        f"  tissuereg mesh {where}/scan/segmentation.seg.nrrd --label organ --label lesion --size 7 "
        '--fixed "plane 0 0 1 -18 2.5" --out organ.vtu',
        f"  tissuereg diagnose {where}/rig --out diagnosed",
    ]
    return Outcome({"schema": "tissuereg.samples/1", "files": files}, "\n".join(lines), args.threads)


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
