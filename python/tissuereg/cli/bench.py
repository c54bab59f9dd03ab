"""The command ``tissuereg bench``: measures computing times by stage."""

import argparse
from typing import Any

from tissuereg._base.choices import ELEMENTS
from tissuereg._base.fields import choice, whole
from tissuereg.cli.common import Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse

HELP = Help(
    "Times whole solves, ensembles of solves, ES-MDA updates and whole registrations on the embedded phantom (or, for "
    "solve, on problem files), stage by stage, with the work counters that explain them. WHAT: solve, ensemble, "
    "esmda or register; all of them where left out.",
    example="tissuereg bench solve --problem dome.npz --repeats 20 --threads 2 --json times.json",
    seed="seed of random events and draws (default: 0)",
    threads="threads to use (default: all cores)",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg bench`` to its parser."""
    choices = ["solve", "ensemble", "esmda", "register"]
    parser.add_argument("what", metavar="WHAT", nargs="*", help=f"one or more of {', '.join(choices)} (default: all)")
    how = parser.add_argument_group("timing")
    add_option(how, "--repeats", whole("runs per row, after one that does not count", least=1, default=10), "N")
    text = "problem files for 'solve', as 'tissuereg solve' takes them (default: the phantom)"
    how.add_argument("--problem", nargs="+", default=[], metavar="FILE.npz", help=text)
    add_option(how, "--element", choice(ELEMENTS, "elements of the solves", default=None, otherwise="both"))
    add_option(how, "--members", whole("members of 'ensemble'", least=1, default=32), "N")
    text = "model folder to time in the row step/shipped of 'register' (default: the shipped one)"
    how.add_argument("--model", metavar="FOLDER", help=text)
    text = "model folder of a Table II network for the row step/table2 (default: one with random weights)"
    how.add_argument("--table2", metavar="FOLDER", help=text)
    add_option(how, "--sets", whole("random sets of markers of the rows step/...", least=1, default=20), "N")
    parser.set_defaults(choices=choices, late="what", room=len(choices))


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg bench``: measure the times of the requested parts; JSON schema ``tissuereg.bench/1``."""
    from tissuereg.cli.benchmark.stages import BENCHES, BenchSettings

    unknown = [name for name in args.what if name not in args.choices]
    if unknown:
        refuse(f"WHAT must be one or more of {', '.join(args.choices)}, got {', '.join(unknown)}", "WHAT")
    settings = BenchSettings(
        repeats=args.repeats,
        threads=args.threads,
        elements=("tet4", "tet10") if args.element is None else (args.element,),
        problems=tuple(args.problem),
        members=args.members,
        seed=args.seed or 0,
        model=args.model,
        table2=args.table2,
        n_sets=args.sets,
    )
    clock, rows = Stopwatch(), []
    for name in args.what or (["solve"] if args.problem else args.choices):
        rows += BENCHES[name](settings)
        clock.lap(name)
    content = {"schema": "tissuereg.bench/1", "rows": rows, "seed": settings.seed, "seconds": clock.seconds}
    return Outcome(content, _table(content), args.threads)


def _table(content: dict[str, Any]) -> str:
    width = max(len(row["name"]) for row in content["rows"])
    lines = [f"{'name':<{width}}  {'median ms':>10}  {'p99 ms':>10}  stages, ms"]
    for row in content["rows"]:
        stages = ", ".join(f"{name} {1e3 * spent:.3g}" for name, spent in row["stages_s"].items())
        lines.append(f"{row['name']:<{width}}  {1e3 * row['median_s']:>10.4g}  {1e3 * row['p99_s']:>10.4g}  {stages}")
        if "floor_s" in row:
            lines.append(_floor_line(row, width))
    return "\n".join([*lines, seconds_line(content["seconds"], verbose=True)])


def _floor_line(row: dict[str, Any], width: int) -> str:
    """Return a line of text that compares a step's time with that of its multiply-adds at the machine's rate."""
    work, rate, floor = row["multiply_adds"], row["sgemm_multiply_adds_per_s"], row["floor_s"]
    return (
        f"{'':<{width}}  its decodes have {work / 1e9:.3g} G multiply-adds, {1e3 * floor:.3g} ms at the "
        f"{rate / 1e9:.3g} G/s of large products here: {row['times_floor']:.3g} times that; weights {row['weights']}"
    )
