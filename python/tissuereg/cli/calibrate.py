"""The command ``tissuereg calibrate``: measures how accurate and how certain a trained model's answers are."""

import argparse
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg._base.fields import whole
from tissuereg.cli.common import Outcome, Stopwatch, seconds_line
from tissuereg.cli.options import Help, Parser, add_option
from tissuereg.cli.progress import Report, progress_bar
from tissuereg.errors import FormatError

if TYPE_CHECKING:
    from tissuereg._base.arrays import FloatArray
    from tissuereg.body.mesh import Mesh
    from tissuereg.registration.worth import Worth

HELP = Help(
    "MODEL is a folder that 'tissuereg train' made, DATA the data set it was trained on. Codes of the training split "
    "give the kinds of events, the validation split the model's errors and how honest measurements look: its events "
    "are registered from random markers. Pairs of what is believed and what happens tell how far truths lie from "
    "simulations: those of the data set, if its recipe asked for some, and those of PAIRS, another data set with pairs "
    "or a folder of files pairs_*.npz with simulation_mm and truth_mm (n, n_nodes, 3). Each is a kind of change of its "
    "own: the markers say of which kind an event is. The folder gets calibration.npz, which 'tissuereg register "
    "--model' uses, and MODEL.md says what the model is worth beside registration without one.",
    example="tissuereg calibrate model --data data --pairs pairs --json -",
    seed="seed of kinds, places and noise (default: 0)",
)


#: Events that are registered with and without the model.
_COMPARED = 12


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg calibrate`` to its parser."""
    parser.add_argument("model", metavar="MODEL", help="folder of a trained model")
    parser.add_argument("--data", required=True, metavar="DATA", help="data set that it was trained on")
    add_pairs(parser)


def add_pairs(parser: Parser) -> None:
    """Add the options for further pairs of simulation and truth, and for the size of the file."""
    text = "folder of further pairs of simulation and truth; may be given several times, once for each kind of change"
    parser.add_argument("--pairs", metavar="PAIRS", action="append", default=[], help=text)
    text = "patterns at most that describe the model's errors; they make most of calibration.npz"
    add_option(parser, "--patterns", whole(text, least=1, default=80), "N")


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg calibrate``: calibrate a model and write the result; JSON schema ``tissuereg.calibrate/1``."""
    content = calibrated(args.model, args.data, args.pairs, args.patterns, args.seed or 0, quiet=args.quiet)
    counts = f"{content['kinds']} kinds of events, {content['events']} rehearsals, {content['pairs']} pairs"
    spent = seconds_line(content["seconds"], verbose=args.verbose)
    said = [counts, "", content["beside_contacts"]["text"], spent]
    return Outcome(content, "\n".join(said), args.threads)


def calibrated(
    folder: str, data_folder: str, pairs_folders: list[str], n_patterns: int, seed: int, *, quiet: bool = False
) -> dict[str, Any]:
    """Calibrate the model in a folder, write ``calibration.npz`` there, and return the content of the JSON.

    `data_folder`: data set that it was trained on; `pairs_folders`: folders of further pairs, each a kind of change;
    `n_patterns`: patterns of errors at most; `quiet`: whether no progress is shown.
    """
    import numpy as np

    from tissuereg.io.datasets import open_dataset
    from tissuereg.registration.learned.calibrate import RehearsalSettings, calibrate, codes_of
    from tissuereg.registration.learned.calibration_file import write_calibration
    from tissuereg.registration.learned.network import NetworkModel
    from tissuereg.registration.worth import worth, worth_text

    clock = Stopwatch()
    data = open_dataset(data_folder)
    # Its calibration may be of an older version.
    model = NetworkModel(folder, data.mesh, threads=1, calibrated=False)
    unseen = np.asarray(data.displacement[data.split["valid"]], np.float64)
    pairs = [] if data.pairs is None else [_in_mm(data.pairs)]
    pairs += [_pairs_in(other, data.mesh) for other in pairs_folders]
    clock.lap("read")
    with progress_bar("1 of 3, fields encoded", quiet=quiet) as shown:
        codes = codes_of(model, data.displacement, data.split["train"], shown)
    clock.lap("encode")
    how = RehearsalSettings(n_patterns=n_patterns, seed=seed)
    with progress_bar("2 of 3, trial registrations", quiet=quiet) as shown:
        made = calibrate(model, data.mesh, codes, unseen, pairs, settings=how, progress=shown)
    clock.lap("rehearse")
    model.calibration = made
    events: list[tuple[FloatArray, list[FloatArray | None]]] = [(unseen[-_COMPARED:], [None] * _COMPARED)]
    if pairs:
        simulations, truths = (np.concatenate(parts)[-_COMPARED:] for parts in zip(*pairs, strict=True))
        events.append((truths, list(simulations)))
    found: list[Worth | None] = []
    counts = [len(fields) for fields, _ in events]
    with progress_bar("3 of 3, events registered with the model and without", quiet=quiet) as shown:
        for fields, starts in events:
            counted = None if shown is None else partial(_after, shown, sum(counts[: len(found)]), sum(counts))
            found.append(worth(model, data.mesh, fields, starts[: len(fields)], seed, counted))
    alone, simulated = (*found, None)[:2]
    text = worth_text(alone, simulated)
    clock.lap("compare")
    write_calibration(Path(folder), made, text)
    clock.lap("write")
    laws = {"alone": made.alone, "simulated": made.anchored}
    return {
        "schema": "tissuereg.calibrate/1",
        "kinds": len(made.kinds.weights),
        "events": len(unseen),
        "pairs": sum(len(one[0]) for one in pairs),
        "kinds_of_change": len(pairs),
        "widening": {name: None if law is None else law.widening for name, law in laws.items()},
        "tail_degrees_of_freedom": {name: None if law is None else law.tail for name, law in laws.items()},
        "beside_contacts": {
            "alone": None if alone is None else asdict(alone),
            "simulated": None if simulated is None else asdict(simulated),
            "text": text,
        },
        "seed": seed,
        "seconds": clock.seconds,
    }


def _after(report: Report, before: int, in_all: int, done: int) -> None:
    report(before + done, in_all)


def _pairs_in(folder: str, mesh: "Mesh") -> "tuple[FloatArray, FloatArray]":
    """Return simulations and truths (n_pairs, n_nodes, 3), mm, of a data set with pairs, or of files pairs_*.npz."""
    from tissuereg.io.datasets import open_dataset
    from tissuereg.io.fields import read_pairs

    if not (Path(folder) / "dataset.json").exists():
        return read_pairs(folder, mesh.n_nodes)
    data = open_dataset(folder)
    if data.pairs is None or data.mesh.digest() != mesh.digest():
        message = f"{folder} must be a data set with pairs on the mesh of the model"
        raise FormatError(message, where=folder)
    return _in_mm(data.pairs)


def _in_mm(pairs: tuple[Any, Any]) -> "tuple[FloatArray, FloatArray]":
    import numpy as np

    return np.asarray(pairs[0], np.float64), np.asarray(pairs[1], np.float64)
