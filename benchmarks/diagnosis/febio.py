"""Diagnoses of data made by another solver, compared with the truth -> archive/febio, RESULTS-febio.md.

``python -m diagnosis.febio [--data DIR] [--page]``: `DIR` holds experiment folders with a ``truth.json`` each
(default: the eight in ``../shared/examples/febio`` and the open ones next to it). Every answer is saved at once;
``--page`` writes the page from the archive alone.
"""

import argparse
import json
import tempfile
from pathlib import Path

from common import SHARED, read_archive, write_archive
from tissuereg.cli import main as command
from tissuereg.cli.common import envelope

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive" / "febio", HERE / "RESULTS-febio.md", ("rows/<experiment>",)

#: Detectability (markers, one frame fitted) below which finding nothing counts as right.
FAINT = 5.0

_INTRO = """# Data made by another solver

Simulated by FEBio 4.11 with ten-node tetrahedra on meshes of 11,000 to 15,000 nodes of a smooth ellipsoid, with pads
whose edges the mesh follows exactly. The user's mesh has 3,839 to 4,552 nodes, and its flat facets lie inside the
ellipsoid. `make -C benchmarks/diagnosis febio` diagnoses the experiments of `../shared/examples`. These are development
data: the prior standard deviations of the body's shape, and of the force error that grows with the square of the load,
were chosen on them, mostly on those without an effect.

Columns: the hidden cause, its detectability d, the answer, the log Bayes factor of each named cause in nats, the
p-value of the remaining misfit, and the time in seconds. A cause with a detectability below 5 need not be found.
"""


def diagnosed(folder: Path, threads: int) -> dict[str, object]:
    """Diagnose one folder by the command and return the answer with the truth."""
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    with tempfile.TemporaryDirectory() as work:
        answer = Path(work) / "answer.json"
        words = ["diagnose", str(folder), "--threads", str(threads), "--quiet", "--json", str(answer)]
        if command(words):
            message = f"{folder.name} was not diagnosed"
            raise SystemExit(message)
        found = json.loads(answer.read_text(encoding="utf-8"))
    return {
        "truth": truth["cause"],
        "detectability": truth.get("detectability"),
        "verdict": found["verdict"],
        "causes": [
            {key: cause[key] for key in ("id", "group", "probability", "log_bayes_factor")} for cause in found["causes"]
        ],
        "p_misfit": found["p_misfit"],
        "left": found["left"],
        "seconds": found["seconds"]["total"],
    }


def is_right(row: dict) -> bool:
    """Return whether each true cause is in a named group and each group holds one; faint causes may go unnamed."""
    groups = [set(cause["group"]) for cause in row["causes"]]
    if not row["truth"] or (not groups and row["verdict"] == "consistent" and row["detectability"] < FAINT):
        return row["verdict"] == "consistent"
    found = all(any(cause in group for group in groups) for cause in row["truth"])
    return found and all(group & set(row["truth"]) for group in groups)


def page(archive: dict) -> str:
    """Return the page of an archive."""
    rows = archive["rows"]
    lines = [_INTRO, "| experiment | hidden | d | answer | log Bayes factors | p | s | |", "|---" * 8 + "|"]
    for name, row in rows.items():
        answer = ", ".join(" or ".join(cause["group"]) for cause in row["causes"]) or row["verdict"]
        cells = (
            name,
            ", ".join(row["truth"]) or "nothing",
            f"{row['detectability']:.0f}" if row["truth"] and row["detectability"] is not None else "",
            answer,
            ", ".join(f"{cause['log_bayes_factor']:.1f}" for cause in row["causes"]),
            f"{row['p_misfit']:.2g}",
            f"{row['seconds']:.0f}",
            "right" if is_right(row) else "**wrong**",
        )
        lines.append("| " + " | ".join(cells) + " |")
    right = sum(is_right(row) for row in rows.values())
    times = f"Times from an empty cache, which experiments on one mesh share; threads: {archive['threads']}."
    return "\n".join([*lines, "", f"{right} of {len(rows)} are right. {times}"]) + "\n"


def main() -> None:
    """Diagnose what is missing, save every answer, write the page."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, default=SHARED / "examples")
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--page", action="store_true", help="write the page from the archive, diagnose nothing")
    options = parser.parse_args()
    fresh = {"schema": "tissuereg.febio/1", **envelope(options.threads), "rows": {}}
    archive = read_archive(ARCHIVE) if ARCHIVE.exists() else fresh
    folders = [] if options.page else sorted(file.parent for file in options.data.rglob("truth.json"))
    for folder in folders:
        if folder.name not in archive["rows"]:
            archive["rows"][folder.name] = diagnosed(folder, options.threads)
            write_archive(ARCHIVE, archive, TABLES)
            print(folder.name, archive["rows"][folder.name]["verdict"], flush=True)
    PAGE.write_text(page(archive), encoding="utf-8")


if __name__ == "__main__":
    main()
