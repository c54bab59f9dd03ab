"""Writes RESULTS.md from the archived verdicts: ``python -m rigs.page [--pack PREDICTIONS --half HALF]``.

``archive/HALF`` holds the verdicts of a half; ``--pack`` stores a folder of predictions there first.
"""

import argparse
import json
from pathlib import Path
from typing import Any

from blind.score import sizes_table
from common import commit, read_archive, write_archive
from rigs.run import ORACLE, OTHERS, WITHOUT
from rigs.score import INNER, TITLES, predictions_of, report
from rigs.scored import scored

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE = HERE / "archive", HERE / "RESULTS.md"
HALVES = tuple(TITLES)

_TOP = """# Rigs

Rigs drawn at random and solved by NGSolve and scikit-fem with ten-node elements, diagnosed on the user's own mesh of
four-node elements (how: `DATA.md`). *d*: length of the effect over markers and forces in standard deviations of noise
and gauges, after the best common factor of the forces is removed; *d of markers*: that of the markers alone. *Right
group*: the named cause, or the group it is in, contains the hidden one. Intervals are beta-binomial, by rig.
"""


def page(archives: dict[str, dict[str, Any]]) -> str:
    """Return the page of the halves that are archived."""
    sections = []
    for half in (half for half in HALVES if half in archives):
        kept = archives[half]
        section = report(scored(kept["rows"]), scored(kept.get(WITHOUT, {})), kept.get(ORACLE, {}), half)
        sizes = kept.get("sizes")
        said = ["", f"At commit {sizes['commit']}."] if sizes else []
        sections.append(section + "".join(f"{line}\n" for line in (*sizes_table(sizes, "###"), *said)))
    return "\n".join([_TOP, *sections])


def archives() -> dict[str, dict[str, Any]]:
    """Return the archived verdicts, by half."""
    found = {half: read_archive(ARCHIVE / half) for half in HALVES if (ARCHIVE / half / "run.json").exists()}
    for half, kept in found.items():
        sizes = ARCHIVE / half / "sizes.json"
        kept |= {"sizes": json.loads(sizes.read_text(encoding="utf-8"))} if sizes.exists() else {}
    return found


def pack(predictions: Path, half: str) -> None:
    """Store what the page needs of the predictions of a half, with those that lack the true cause, or all others."""
    folders = {"rows": predictions} | {method: predictions / method for method in OTHERS}
    tables = {
        name: {case: _row(answer) for case, answer in predictions_of(folder, half).items()}
        for name, folder in folders.items()
    }
    answer = {"schema": "tissuereg.rigs/1", **commit(), **tables}
    write_archive(ARCHIVE / half, answer, tuple(f"{name}/<case>" for name in folders))


def _row(answer: dict[str, Any]) -> dict[str, Any]:
    kept = ("verdict", "p_misfit", "seconds", "commit", "changed_files", "date")
    causes = [_finding(cause) for cause in answer["causes"]]
    return {key: answer[key] for key in kept if key in answer} | {"causes": causes}


def _finding(cause: dict[str, Any]) -> dict[str, Any]:
    kept = ("id", "group", "family", "probability", "log_bayes_factor", "parameters")
    inner = {key: value for key, value in cause.get("held_out", {}).items() if key in INNER}
    return {key: cause[key] for key in kept if key in cause} | ({"held_out": inner} if inner else {})


def main() -> None:
    parser = argparse.ArgumentParser(prog="python -m rigs.page", description=__doc__)
    parser.add_argument("--pack", type=Path, help="folder of predictions that becomes the archive of a half")
    parser.add_argument("--half", choices=HALVES, default="dev")
    options = parser.parse_args()
    if options.pack:
        pack(options.pack, options.half)
    PAGE.write_text(page(archives()), encoding="utf-8")


if __name__ == "__main__":
    main()
