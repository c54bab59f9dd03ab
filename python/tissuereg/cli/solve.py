"""The command ``tissuereg solve``: solves one static problem."""

import argparse
from pathlib import Path
from typing import Any

from tissuereg._base.choices import ELEMENTS
from tissuereg._base.fields import choice, number
from tissuereg._base.machine import peak_mib
from tissuereg.cli.common import Outcome, Stopwatch, note, seconds_line
from tissuereg.cli.options import Help, Parser, add_option, refuse_overwriting

HELP = Help(
    "PROBLEM is an .npz with nodes_mm (n, 3), tets (m, 4), fixed_nodes (f,), forces_mN (n, 3), young_kPa and poisson "
    "(one value, or one per tet). OUT gets displacement_mm (n, 3) and reactions_mN (f, 3); 'tissuereg register "
    "--simulation' takes it.",
    example="tissuereg solve dome.npz --out u.npz --element tet10 --json -",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg solve`` to its parser."""
    parser.add_argument("problem", metavar="PROBLEM.npz", help="mesh, supports, forces, moduli")
    parser.add_argument("--out", required=True, metavar="U.npz", help="file for the displacements")
    how = parser.add_argument_group("solving")
    add_option(how, "--element", choice(ELEMENTS, "kind of element", default="tet4"))
    text = "norm of the residual over the norm of the load, free degrees of freedom"
    add_option(how, "--tol", number(text, above=0.0, default=1e-9), "X")


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg solve``: solve a problem, write the displacement; JSON schema ``tissuereg.solve/1``."""
    import numpy as np

    from tissuereg.io.atomic import check_file_target
    from tissuereg.io.problems import read_problem, write_solution
    from tissuereg.simulation.size import SOLVE, BodySize, Estimate
    from tissuereg.simulation.solve import Simulator

    refuse_overwriting([Path(args.out)], [args.problem])
    check_file_target(args.out)
    clock = Stopwatch()
    problem = read_problem(args.problem)
    clock.lap("read")
    simulator = Simulator(problem.mesh, element=args.element)
    estimate = Estimate.of(BodySize.of(simulator), SOLVE, args.threads)
    if not (args.quiet or estimate.is_small):
        note(estimate.sentence())
    if args.verbose:
        note(estimate.work_sentence())
    estimate.check()
    clock.lap("analyse")
    found = simulator.solve(problem.load, problem.material, tolerance=args.tol, threads=args.threads)
    solving = clock.lap("solve")
    write_solution(args.out, problem, found.displacement, found.reactions)
    clock.lap("write")
    spent = clock.seconds
    factor = float(found.report["seconds"]["factor"])
    spent = {**spent, "factor": factor, "iterate": solving - factor}
    seconds = {stage: spent[stage] for stage in ("read", "analyse", "factor", "iterate", "write", "total")}
    content: dict[str, Any] = {
        "schema": "tissuereg.solve/1",
        "converged": True,
        "element": args.element,
        "n_nodes": problem.mesh.n_nodes,
        "n_tets": problem.mesh.n_tets,
        **{name: found.report[name] for name in _FROM_REPORT},
        "largest_mm": float(np.linalg.norm(found.displacement, axis=1).max()),
        "peak_mib": peak_mib(),
        "seconds": seconds,
    }
    if problem.reference is not None and args.element == "tet4":
        content["largest_difference_mm"] = float(np.abs(found.displacement - problem.reference).max())
    return Outcome(content, _summary(content, args.out, verbose=args.verbose), args.threads)


_FROM_REPORT = ("iterations", "solves", "factorisations", "load_steps", "load_fraction", "residual", "min_det_f")


def _summary(content: dict[str, Any], out: str, *, verbose: bool) -> str:
    lines = [
        f"{content['n_nodes']} nodes, {content['n_tets']} tets ({content['element']}): largest displacement "
        f"{content['largest_mm']:.4f} mm",
    ]
    if verbose:
        lines.append(
            f"smallest det F {content['min_det_f']:.3f}; {content['iterations']} iterations, "
            f"{content['factorisations']} factorisations, {content['load_steps']} load steps, residual "
            f"{content['residual']:.1e}"
        )
    if "largest_difference_mm" in content:
        lines.append(f"largest difference to the file's own displacement: {content['largest_difference_mm']:.2e} mm")
    return "\n".join([*lines, seconds_line(content["seconds"], verbose=verbose), f"written: {out}"])
