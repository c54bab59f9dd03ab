"""The phantom experiment on the rigs of ``bench/twin``: every method, and the tables of the page.

``python -m scripts.phantom`` writes ``archive/phantom``, and tables and pictures of ``pages/phantom-experiment.md``;
``--page`` writes the page alone. ``--add METHOD`` (several times) runs these methods alone and lets their rows take
the place of those of the archive. ``tissuereg-paper`` does the work.
"""

import argparse
import json
import tempfile
from pathlib import Path

from common import read_archive, write_archive
from readme import write_table

from tissuereg._base.machine import machine
from tissuereg_paper import ContestInputs, reproduce
from tissuereg_paper.studies.phantom import PHANTOM_STUDIES, merged
from tissuereg_paper.studies.phantom_pages import phantom_markdown, phantom_picture

PAPER = Path(__file__).resolve().parents[2]
ARCHIVE, PAGE = PAPER / "archive" / "phantom", PAPER / "pages" / "phantom-experiment.md"

#: What of the archive are tables.
TABLES = ("studies/<study>/rows/#", "studies/<study>/methods/<method>", "curves/#")


def packed(content):
    """Return the archive's form of a run: the curves of its figures are rows of one table."""
    studies, rows = {}, []
    for name, study in content["studies"].items():
        studies[name] = {key: value for key, value in study.items() if key != "curves"}
        curves = study.get("curves")
        if curves is not None:
            each = {"the pads": (curves["motion_times_s"], curves["motion"])}
            each |= {method: (curves["times_s"], errors) for method, errors in curves["sensor_mm"].items()}
            facts = {"study": name, "rig": curves["rig"]}
            rows += [facts | {"curve": one, "times_s": when, "values": what} for one, (when, what) in each.items()]
    return {**content, "studies": studies, "curves": rows}


def read():
    """Return the run of the archive."""
    content = read_archive(ARCHIVE)
    for row in content.pop("curves"):
        study = content["studies"][row["study"]]
        if row["curve"] == "the pads":
            times = {"motion_times_s": row["times_s"], "motion": row["values"]}
            study["curves"] = {"rig": row["rig"], **times, "sensor_mm": {}}
        else:
            study["curves"]["times_s"] = row["times_s"]
            study["curves"]["sensor_mm"][row["curve"]] = row["values"]
    return content


def block(name, content):
    """Return a study's part of the page."""
    return f"![{name}](phantom-experiment-{name}.png)\n\n{phantom_markdown(content)}\n"


def main():
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", default=PAPER / "bench" / "twin" / "rigs")
    parser.add_argument("--fields")
    parser.add_argument("--variants")
    parser.add_argument("--keep", default="build/phantom-experiment")
    parser.add_argument("--threads", type=int, default=0)
    parser.add_argument("--add", action="append", metavar="METHOD")
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if not options.page:
        with tempfile.TemporaryDirectory() as folder:
            out = Path(folder) / "out"
            inputs = ContestInputs(options.data, options.fields, options.variants, options.add, options.keep)
            answer = reproduce(list(PHANTOM_STUDIES), out, contest=inputs, threads=options.threads)
            studies = {name: json.loads((out / f"{name}.json").read_text("utf-8")) for name in PHANTOM_STUDIES}
        if options.add is not None:
            known = read()["studies"]
            studies = {name: merged(known[name], new) for name, new in studies.items()}
        content = {"machine": machine(), "seconds": answer["seconds"], "studies": studies}
        write_archive(ARCHIVE, packed(content), TABLES)
    for name, content in read()["studies"].items():
        phantom_picture(content).savefig(PAGE.parent / f"phantom-experiment-{name}.png", dpi=90)
        write_table(name, block(name, content), PAGE)


if __name__ == "__main__":
    main()
