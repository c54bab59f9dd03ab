"""The phantom experiment on the rigs of ``benchmarks/twin``: every method, and the tables of the page.

``python benchmarks/phantom.py`` writes ``results/phantom.json``, and tables and pictures of
``docs/phantom-experiment.md``; ``--page`` writes the page alone. ``--add METHOD`` (several times) runs these methods
alone and lets their rows take the place of those of the archive. ``tissuereg reproduce`` does the work.
"""

import argparse
import json
import tempfile
from pathlib import Path

import tissuereg as tr
from tissuereg._base.machine import machine
from tissuereg_paper.studies.phantom import PHANTOM_STUDIES, merged
from tissuereg_paper.studies.phantom_pages import phantom_markdown, phantom_picture

HERE = Path(__file__).resolve().parent
RESULTS, PAGE = HERE / "results" / "phantom.json", HERE.parent / "docs" / "phantom-experiment.md"


def block(name, content):
    """Return a study's part of the page."""
    return f"![{name}](phantom-experiment-{name}.png)\n\n{phantom_markdown(content)}\n"


def main():
    """Run and write."""
    from readme import write_table

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", default=HERE / "twin" / "rigs")
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
            answer = tr.reproduce(
                list(PHANTOM_STUDIES),
                out,
                data=options.data,
                fields=options.fields,
                variants=options.variants,
                methods=options.add,
                keep=options.keep,
                threads=options.threads,
            )
            studies = {name: json.loads((out / f"{name}.json").read_text("utf-8")) for name in PHANTOM_STUDIES}
        if options.add is not None:
            known = json.loads(RESULTS.read_text(encoding="utf-8"))["studies"]
            studies = {name: merged(known[name], new) for name, new in studies.items()}
        content = {"machine": machine(), "seconds": answer["seconds"], "studies": studies}
        RESULTS.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")
    for name, content in json.loads(RESULTS.read_text(encoding="utf-8"))["studies"].items():
        phantom_picture(content).savefig(PAGE.parent / f"phantom-experiment-{name}.png", dpi=90)
        write_table(name, block(name, content), PAGE)


if __name__ == "__main__":
    main()
