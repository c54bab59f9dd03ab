"""The command ``tissuereg-paper``: the paper's studies, with output, errors and exit codes of ``tissuereg``."""

import argparse
from collections.abc import Sequence
from typing import Any

from tissuereg.cli import run_program
from tissuereg.cli.common import Outcome, seconds_line
from tissuereg.cli.options import Help, Parser, UsageError
from tissuereg.cli.progress import progress_bar

HELP = Help(
    "Runs the simulation studies of the seed paper (section III) with a trained model: ten random test shapes as "
    "start meshes, ten targets each, 15 markers on the surface, Algorithm 1, and the same with our own prior. "
    "STUDY, one or more: table2 (the network), fig6 (C_d and N_e), fig7 (N_a and N_e), fig8 (the error after each "
    "assimilation). Test shapes are solved anew from the model's recipe, so no data set is needed. DIR gets a table "
    "(.md, .csv), a picture and a JSON of each study, with what the paper states and whether it holds here. "
    "Of the phantom experiment (section IV): fig10 and fig11 (error at the buried sensor over time, one and two "
    "actuators) and phantom (every method on every rig, with markers lost, wrong and noisy). Rigs are files that "
    "another solver has made (--data).",
    example="tissuereg-paper fig6 --out fig6",
    seed="seed of shapes, markers and ensembles (default: 0)",
)

_STUDIES = ("table2", "fig6", "fig7", "fig8", "fig10", "fig11", "phantom")


def main(argv: Sequence[str] | None = None) -> int:
    """Run studies.

    Parameters
    ----------
    argv : sequence of str, optional
        Words after the program's name; those of the process where absent.

    Returns
    -------
    int
        Exit code, as of ``tissuereg``.
    """
    return run_program(build_parser, argv)


def build_parser(_words: Sequence[str] | None = None) -> Parser:
    """Return the parser of the command line."""
    from tissuereg_paper import __version__

    parser = Parser(prog="tissuereg-paper", **HELP.words("run the paper's studies"))
    parser.add_argument("--version", action="version", version=f"tissuereg-paper {__version__}")
    HELP.fill(parser, options)
    parser.set_defaults(run=run)
    return parser


def options(parser: Parser) -> None:
    """Add the command's arguments."""
    parser.add_argument("studies", metavar="STUDY", nargs="+", help=f"one or more of {', '.join(_STUDIES)}")
    parser.add_argument("--out", metavar="DIR", required=True, help="folder for tables, pictures and JSON")
    text = "folder of a trained model (default: the one that ships with the package)"
    parser.add_argument("--model", metavar="FOLDER", help=text)
    phantom = parser.add_argument_group("of the phantom experiment")
    text = "folder of rigs, *.npz (default: paper/bench/twin/rigs)"
    phantom.add_argument("--data", metavar="RIGS", help=text)
    text = "data set of the model's body, for methods that need training fields (default: they are left out)"
    phantom.add_argument("--fields", metavar="DATA", help=text)
    text = "folder of variants of the rigs' simulations, for methods that need them (default: they are left out)"
    phantom.add_argument("--variants", metavar="FOLDER", help=text)
    text = "a method to run besides the simulation; may be given several times (default: all)"
    phantom.add_argument("--method", action="append", metavar="NAME", help=text)
    text = "folder that keeps what each method did on each rig: the same command goes on where it was stopped"
    phantom.add_argument("--keep", metavar="FOLDER", help=text)
    parser.set_defaults(late="studies", room=len(_STUDIES))


def run(args: argparse.Namespace) -> Outcome:
    """Run the requested studies.

    Schema ``tissuereg.reproduce/1``.

    Raises
    ------
    UsageError
        If a study is unknown.
    """
    unknown = [name for name in args.studies if name not in _STUDIES]
    if unknown:
        message = f"STUDY must be one or more of {', '.join(_STUDIES)}, got {', '.join(unknown)}"
        raise UsageError(message, where="STUDY")
    from tissuereg_paper.studies import ContestInputs, reproduce

    with progress_bar("registrations", quiet=args.quiet) as report:
        progress = None if report is None else lambda _, done, in_all: report(done, in_all)
        content = reproduce(
            args.studies,
            args.out,
            model=args.model,
            contest=ContestInputs(args.data, args.fields, args.variants, args.method, args.keep),
            seed=args.seed or 0,
            threads=args.threads,
            progress=progress,
        )
    return Outcome(content, _summary(content, args.out), args.threads)


def _summary(content: dict[str, Any], out: str) -> str:
    model = content["model"]
    lines = [f"{model['kind']} ({model['source']}), {model['n_nodes']} nodes, {model['n_latent']} latents"]
    for study, verdict in content["agree"].items():
        rows = [row for row in content["rows"] if row["study"] == study and row.get("end_mean_mm", 0.0) is not None]
        lines.append(f"{study}: {len(rows)} rows; agrees with the paper: {verdict['agree']}")
        for claims in verdict["claims"].values():
            lines += [f"  {'holds' if one['holds'] else 'fails'}: {one['claim']} ({one['found']})" for one in claims]
    return "\n".join([*lines, seconds_line(content["seconds"]), f"written: {out}"])
