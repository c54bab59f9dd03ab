"""What is left of answers that are not to be trusted: errors of linear elasticity alone, on development rigs.

``python -m scripts.fallback`` writes ``archive/fallback`` and the table of ``docs/decisions/trust.md``;
``--page`` writes the table alone. Nothing here is a reported rig.
"""

import argparse
from pathlib import Path

import numpy as np
from common import read_archive, write_archive
from readme import write_table
from threadpoolctl import threadpool_limits

import tissuereg as tr
from tissuereg._base.machine import machine
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned.registration import as_model
from tissuereg_paper.studies.believed import BELIEVED, CONDITIONS, Believed, measured
from tissuereg_paper.studies.rigs import read_rigs

PAPER = Path(__file__).resolve().parents[2]
ARCHIVE, PAGE = PAPER / "archive" / "fallback", PAPER.parent / "docs" / "decisions" / "trust.md"

#: What of the archive is a table.
TABLES = ("rows/#",)

#: Every second scored frame, under these conditions.
EVERY, NAMES = 2, ("plain", "wrong", "dropped-60")


def measure(data):
    """Return errors over all scored points of each frame that is registered: answer, fallback, simulation, mm."""
    mesh = phantom_mesh()
    model = as_model("phantom", mesh, 1)
    found = []
    for rig in read_rigs(data):
        believed = Believed(rig, mesh, 1)
        for condition in (one for one in CONDITIONS if one.name in NAMES):
            markers, simulations = measured(rig, condition, 0), believed.simulation_mm(condition.drive)
            for name, known in (("network", model), ("contacts", None)):
                places = tr.Markers(rig.reference_mm, std=condition.noise_mm)
                how = tr.RegisterSettings(threads=1)
                registrar = tr.Registrar(tr.Body(mesh, BELIEVED), places, known, settings=how)
                for frame in believed.scored[::EVERY]:
                    result = registrar.register(markers[frame], simulations[frame])
                    left = result.fallback
                    fields = [result.displacement, None if left is None else left.displacement, simulations[frame]]
                    found.append(
                        {
                            "rig": rig.name,
                            "condition": condition.name,
                            "method": name,
                            "trusted": result.trust.ok,
                            "errors_mm": [error(believed, frame, field) for field in fields],
                        }
                    )
            print(rig.name, condition.name, flush=True)
    return found


def error(believed, frame, field):
    """Return the mean error over the sensor and the inner points, mm."""
    if field is None:
        return None
    return float(np.linalg.norm(believed.at_points(field) - believed.truth_mm[frame], axis=1).mean())


def table(content):
    """Return the lines of the table."""
    rigs = sorted({row["rig"] for row in content["rows"]})
    lines = [
        f"{len(rigs)} development rigs; means over the frames that are not trusted, mm.",
        "",
        "| markers | registration | not trusted | answer | linear elastic | simulation | answer farther "
        "than simulation | linear elastic farther |",
        "|---|---|---|---|---|---|---|---|",
    ]
    words = {condition.name: condition.words for condition in CONDITIONS}
    for name in NAMES:
        for method in ("network", "contacts"):
            rows = [row for row in content["rows"] if (row["condition"], row["method"]) == (name, method)]
            left = np.array([row["errors_mm"] for row in rows if not row["trusted"]]).reshape(-1, 3)
            cells = [words[name], method, f"{len(left)} of {len(rows)}"]
            if len(left):
                cells += [f"{one:.2f}" for one in left.mean(axis=0)]
                cells += [f"{int((left[:, k] > left[:, 2]).sum())}" for k in (0, 1)]
            else:
                cells += [""] * 5
            lines.append("| " + " | ".join(cells) + " |")
    return "\n".join([*lines, ""])


def main():
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=PAPER / "bench" / "twin" / "development")
    parser.add_argument("--page", action="store_true", help="write the table again from the archive")
    options = parser.parse_args()
    if not options.page:
        with threadpool_limits(limits=1, user_api="blas"):
            content = {"machine": machine(), "rows": measure(options.data)}
        write_archive(ARCHIVE, content, TABLES)
    write_table("fallback", table(read_archive(ARCHIVE)), PAGE)


if __name__ == "__main__":
    main()
