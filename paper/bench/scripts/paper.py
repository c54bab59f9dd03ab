"""The paper's simulation studies -> archive/paper-*, pages/paper.md and its pictures.

    python -m scripts.paper [--table2 FOLDER] [--model FOLDER] [--threads N] [--page]

All studies with the two models that ship with the package, or with that of `--model` in place of the first; with
`--table2`, the folder of a trained network of Table II, also all studies with that one. `--page` writes the page again
from the archives.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from common import read_archive, write_archive

PAPER = Path(__file__).resolve().parents[2]
PAGE = PAPER / "pages" / "paper.md"

#: Archives, by the model that they are of.
ARCHIVES = {name: PAPER / "archive" / f"paper-{name}" for name in ("shipped", "graph", "table2")}

#: What of an archive is a table.
TABLES = ("studies/<study>/rows/#",)

TITLES = {
    "shipped": "The model for registrations",
    "graph": "The graph network that ships",
    "table2": "Table II's network, trained in one stage",
}
STUDY_TITLES = {
    "table2": "Table II: the network",
    "fig6": "Fig. 6: C_d and N_e",
    "fig7": "Fig. 7: N_a and N_e",
    "fig8": "Fig. 8: from a start error of 7.3 mm",
}

HEAD = """# The paper's simulation studies

Written by `make -C paper paper` from `paper/archive/paper-*`; edit neither. Single studies:
`tissuereg-paper fig6 --out DIR`. Source: M. Afshar et al., "Registration of deformed tissue: a GNN-VAE approach with
data assimilation for sim-to-real transfer", section III.

## Where we agree with the paper, and where not

{summary}

## How it is done

* **Shapes**: members of the test split of the data set, which no model was trained on; solved anew from the recipe.
  Ten random start meshes, ten random targets of each. For Fig. 8, pairs of the same shapes that lie 7.3 mm apart in
  the mean, within 0.5 mm.
* **Markers**: 15 nodes spread over the free surface. They are exact, as in the paper: noise is drawn inside ES-MDA
  alone.
* **Methods**: *paper*, Algorithm 1 with the encoder's q(z | start mesh) as prior; *family*, the same with the
  distribution of all training codes as prior, which knows nothing of the start mesh; *ours*, that prior with draws of
  exact sample moments, and the model's own typical errors added to C_d and to the regions. For Fig. 8 also *paper-std*:
  the paper's with q's standard deviations taken for variances, a mistake of public code of the method.
* **C_d**: the paper works in cm and states no unit; both readings are run. 0.001 cm² is 0.1 mm², a deviation of
  0.32 mm.
* **Inflation**: each coefficient is {decrease:g} times the next; the paper states only that they decrease.
* **Errors**: distance of a node from its true place. The paper's "MSE error" in cm is undefined; its figures are taken
  as means. Intervals (95 %) resample start meshes and targets, which pairs share (pigeonhole bootstrap).
* **Regions**: 90 % ellipsoids at {n_inner} inner nodes, from the posterior ensemble.
* **Statements**: *alike* holds if means differ by less than {alike:.0%} of the larger; *worse* if they differ by more,
  and the interval of the mean difference lies above zero. A study agrees if all statements hold in one of the readings
  of C_d, by the method *paper*.

In the JSON a row of a sweep has `study`, `method`, `prior`, `cd` and `reading` (as the paper writes it, and its unit),
`cd_mm2`, `n_e`, `n_a`, `n_pairs`, `start_mean_mm`; at the end `end_mean_mm` with `end_mean_interval95_mm`,
`end_rms_mm`, `end_max_mm` (the largest of all nodes and pairs), `end_max_median_mm` (the median over pairs of the
largest), `coverage90`, `worse` (pairs that end worse than they began); `paper_mm` where the paper states a figure; in
Fig. 8 `steps_mm` (start, and after each assimilation), `min_det_f` and `inverted_tets` of the registered meshes. A row
of Table II has `what`, with the error of the constant mean shape in `start_mean_mm` and that of reconstruction in
`end_mean_mm`. `agree` has, by study, `agree` (yes or no), `why`, and each statement with what was found.
"""


def page(archives: dict[str, dict[str, Any]]) -> str:
    """Return the page of some archives, by the names in `ARCHIVES`."""
    from tissuereg_paper.studies.algorithm import DECREASE
    from tissuereg_paper.studies.cases import N_INNER
    from tissuereg_paper.studies.claims import ALIKE
    from tissuereg_paper.studies.tables import markdown

    summary = [
        "| study | model | agrees | with the prior of all training codes | why not |",
        "| --- | --- | --- | --- | --- |",
    ]
    sections = []
    for name, archive in archives.items():
        model = next(iter(archive["studies"].values()))["model"]
        sections.append(_heading(name, archive, model))
        for study, content in archive["studies"].items():
            verdict = content["agree"][study]
            family = verdict.get("family", {}).get("agree", "-")
            why = verdict["why"] if verdict["agree"] == "no" else ""
            summary.append(f"| {study} | {name} | {verdict['agree']} | {family} | {why} |")
            picture = f"![{STUDY_TITLES[study]}]({_picture(name, study).name})"
            sections.append(f"### {STUDY_TITLES[study]}, {name}\n\n{picture}\n\n{markdown(content)}")
        goal = archive["studies"]["fig8"]["goal"]
        met = "met" if goal["met"] else "not met"
        found = f"{goal['method']}, {goal['reading']}: {goal['end_mean_mm']:.3f} mm"
        summary.append(f"| our goal: Fig. 8 below {goal['goal_mm']} mm | {name} | {met} | - | {found} |")
    head = HEAD.format(summary="\n".join(summary), decrease=DECREASE, n_inner=N_INNER, alike=ALIKE)
    return "\n".join([head, *sections]).rstrip() + "\n"


def _heading(name: str, archive: dict[str, Any], model: dict[str, Any]) -> str:
    what = f"{model['kind']} ({model['source']}), {model['n_nodes']} nodes, {model['n_latent']} latents"
    how = f"{archive['machine']['processor']}, {archive['threads']} threads, {archive['seconds']['total']:.0f} s"
    return f"## {TITLES[name]}\n\n{what}, trained on a data set of {model['members']} members; {how}.\n"


def _picture(name: str, study: str) -> Path:
    return PAGE.with_name(f"paper-{name}-{study}.png")


def run(model: str | None, threads: int) -> dict[str, Any]:
    """Return the archive of all studies with a model."""
    from tissuereg._base.machine import machine, n_cores, versions
    from tissuereg_paper.studies import SIMULATED, reproduce

    with tempfile.TemporaryDirectory() as folder:
        whole = reproduce(SIMULATED, Path(folder) / "out", model=model, threads=threads)
        studies = {name: json.loads((Path(folder) / "out" / f"{name}.json").read_text("utf-8")) for name in SIMULATED}
    return {
        "schema": "tissuereg.paper/1",
        "machine": machine(),
        "versions": versions(),
        "threads": threads or n_cores(),
        "seconds": whole["seconds"],
        "studies": studies,
    }


def read_archives() -> dict[str, dict[str, Any]]:
    """Return the archives that are there."""
    return {name: read_archive(folder) for name, folder in ARCHIVES.items() if folder.exists()}


def write_page() -> None:
    """Write the page and its pictures from the archives that are there."""
    from tissuereg_paper.studies.pictures import picture

    archives = read_archives()
    PAGE.write_text(page(archives), encoding="utf-8")
    for name, archive in archives.items():
        for study, content in archive["studies"].items():
            picture(content).savefig(_picture(name, study), dpi=100)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--model", help="folder of the model for registrations (default: the shipped one)")
    parser.add_argument("--table2", help="folder of a trained network of Table II")
    parser.add_argument("--threads", type=int, default=0, help="threads (default: all cores)")
    parser.add_argument("--page", action="store_true", help="write the page from the archives, run nothing")
    options = parser.parse_args()
    if not options.page:
        from tissuereg.phantom import shipped_model_folder

        graph = str(shipped_model_folder("phantom-graph"))
        runs = {"shipped": options.model, "graph": graph} | ({"table2": options.table2} if options.table2 else {})
        for name, model in runs.items():
            write_archive(ARCHIVES[name], run(model, options.threads), TABLES)
    write_page()
    return 0


if __name__ == "__main__":
    sys.exit(main())
