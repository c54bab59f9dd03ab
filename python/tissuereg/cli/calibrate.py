"""The command ``tissuereg calibrate``: measures how accurate and how certain a trained model's answers are."""

import argparse
from pathlib import Path

from tissuereg.cli.common import Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import Help, Parser

HELP = Help(
    "MODEL is a folder that 'tissuereg train' made, DATA the data set it was trained on. Codes of the training split "
    "give the kinds of events, the validation split the model's errors and how honest measurements look: its events "
    "are registered from random markers. Pairs of what is believed and what happens tell how far truths lie from "
    "simulations: those of the data set, if its recipe asked for some, and those of PAIRS, a folder of files "
    "pairs_*.npz with simulation_mm and truth_mm (n, n_nodes, 3). Each is a kind of change of its own: the markers say "
    "of which kind an event is. "
    "The folder gets calibration.npz; 'tissuereg register --model' uses it.",
    example="tissuereg calibrate model --data data --pairs pairs --json -",
    seed="seed of kinds, places and noise (default: 0)",
)


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg calibrate`` to its parser."""
    parser.add_argument("model", metavar="MODEL", help="folder of a trained model")
    parser.add_argument("--data", required=True, metavar="DATA", help="data set that it was trained on")
    text = "folder of further pairs of simulation and truth; may be given several times, once for each kind of change"
    parser.add_argument("--pairs", metavar="PAIRS", action="append", default=[], help=text)


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg calibrate``: calibrate a model and write the result; JSON schema ``tissuereg.calibrate/1``."""
    import numpy as np

    from tissuereg.io.datasets import open_dataset
    from tissuereg.io.fields import read_pairs
    from tissuereg.registration.learned.calibrate import RehearsalSettings, calibrate, codes_of
    from tissuereg.registration.learned.calibration_file import write_calibration
    from tissuereg.registration.learned.network import NetworkModel

    clock = Stopwatch()
    data = open_dataset(args.data)
    # Its calibration may be of an older version.
    model = NetworkModel(args.model, data.mesh, threads=1, calibrated=False)
    unseen = np.asarray(data.displacement[data.split["valid"]], np.float64)
    own = data.pairs
    pairs = [] if own is None else [(np.asarray(own[0], np.float64), np.asarray(own[1], np.float64))]
    pairs += [read_pairs(folder, data.mesh.n_nodes) for folder in args.pairs]
    clock.lap("read")
    codes = codes_of(model, data.displacement, data.split["train"])
    clock.lap("encode")
    settings = RehearsalSettings(seed=args.seed or 0)
    made = calibrate(model, data.mesh, codes, unseen, pairs, settings=settings)
    clock.lap("rehearse")
    write_calibration(Path(args.model), made)
    clock.lap("write")
    content = {
        "schema": "tissuereg.calibrate/1",
        "kinds": len(made.kinds.weights),
        "events": len(unseen),
        "pairs": sum(len(one[0]) for one in pairs),
        "kinds_of_change": len(pairs),
        "widening": {
            "alone": made.alone.widening,
            "simulated": None if made.anchored is None else made.anchored.widening,
        },
        "tail_degrees_of_freedom": {
            "alone": made.alone.tail,
            "simulated": None if made.anchored is None else made.anchored.tail,
        },
        "seed": args.seed or 0,
        "seconds": clock.seconds,
    }
    lines = [f"{content['kinds']} kinds of events, {content['events']} rehearsals, {content['pairs']} pairs"]
    return Outcome(content, "\n".join([*lines, seconds_line(clock.seconds)]), args.threads)
