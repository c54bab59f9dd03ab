"""Variants of the simulation on development rigs of the phantom experiment: how many, and what stays beside them.

``python -m scripts.variants --variants FOLDER --halved FOLDER`` writes ``archive/variants`` and the table of
``docs/decisions/learned-model.md``; ``--rows WORDS`` measures the rows alone that begin so, on the rigs of the archive,
and keeps the others; ``--page`` writes the table alone. Nothing here is a reported rig.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import read_archive, write_archive
from readme import write_table
from threadpoolctl import threadpool_limits

from tissuereg._base.machine import machine
from tissuereg.parallel import Failed, InProcess, Processes, in_order
from tissuereg.phantom import phantom_mesh
from tissuereg.registration.learned import calibration
from tissuereg.registration.learned.registration import as_model
from tissuereg_paper.rivals import EnsembleOfSimulations, Network, VariedNetwork
from tissuereg_paper.studies.believed import PLAIN, Believed, measured
from tissuereg_paper.studies.contest import Simulated, run_method
from tissuereg_paper.studies.rigs import read_rigs
from tissuereg_paper.studies.variants import read_variants

PAPER = Path(__file__).resolve().parents[2]
ARCHIVE, PAGE = PAPER / "archive" / "variants", PAPER.parent / "docs" / "decisions" / "learned-model.md"

#: What of the archive is a table.
TABLES = ("rows/#/rigs/<rig>",)

#: Shares of the general variance that stay beside the variants, with all of them; the released one with fewer bodies.
SHARES, FEWER = (0.03, 0.1, 0.25, 1.0), (6, 12)

#: How rows of variants from ranges that are wrong by half begin.
HALVED = "variants of ranges wrong by half"


def settings():
    """Return the compared registrations: words, method, share of the general variance, number of bodies."""
    released = calibration.BESIDE_VARIANTS
    return [
        ("simulation", Simulated, None, None),
        ("network, no variants", Network, None, None),
        ("variants alone, one Kalman update", EnsembleOfSimulations, None, 24),
        *((f"network and variants, share {share:g}", VariedNetwork, share, 24) for share in SHARES),
        *((f"network and variants, share {released:g}", VariedNetwork, released, count) for count in FEWER),
        (f"{HALVED}, one Kalman update", EnsembleOfSimulations, None, 24),
        (f"{HALVED}, network, share {released:g}", VariedNetwork, released, 24),
    ]


def measure(data, folder, other, compared, names=None, jobs=1):
    """Return rows of the table: errors of each registration on each rig that has variants, or that is named.

    `folder`, `other`: variants from the ranges of the truth, and from ranges that are wrong by half, which only rows
    about these need; `compared`: as of `settings`; `jobs`: processes, which share the rigs.
    """
    rigs = [rig for rig in read_rigs(data) if (folder / f"{rig.name}.npz").exists()]
    if names is not None:
        rigs = [rig for rig in rigs if rig.name in names]
        if [rig.name for rig in rigs] != names:
            message = f"--variants must hold those of {', '.join(names)}"
            raise SystemExit(message)
    rows = [{"words": words, "bodies": count, "rigs": {}} for words, _, _, count in compared]
    with InProcess() if jobs == 1 else Processes(jobs) as executor:
        outcomes = in_order(executor.run(of_rig, [(one, folder, other, compared) for one in rigs]))
        for rig, outcome in zip(rigs, outcomes, strict=True):
            if isinstance(outcome, Failed):
                raise outcome.error
            for row, found in zip(rows, outcome.result, strict=True):
                row["rigs"][rig.name] = found
    return rows


def of_rig(given):
    """Return what each registration that is compared does on a rig."""
    rig, folder, other, compared = given
    mesh = phantom_mesh()
    model = as_model("phantom", mesh, 1)
    right = read_variants(folder, rig, mesh.n_nodes)
    markers = measured(rig, PLAIN, 0)
    believed = Believed(rig, mesh, 1)
    found = []
    for words, method, share, count in compared:
        variants = read_variants(other, rig, mesh.n_nodes) if words.startswith(HALVED) else right
        few = {part: getattr(variants, part)[:count] for part in ("fields_mm", "pushes")}
        believed.variants = replace(variants, **few)
        calibration.BESIDE_VARIANTS = share
        wide = {"spread": True} if method in (Network, VariedNetwork) else {}
        rival, trusted = method(believed.setting(PLAIN, model, None, 0), **wide), []
        noted(rival, trusted)
        with threadpool_limits(limits=1, user_api="blas"):
            run = run_method(rival, believed, markers, PLAIN)
        found.append(
            {
                "trusted": trusted,
                "sensor_mm": float(run.sensor_mm.mean()),
                "inner_mm": float(run.inner_mm.mean()),
                "coverage90": run.coverage90,
                "failed": run.failed,
            }
        )
        print(rig.name, words, found[-1], flush=True)
    return found


def noted(rival, trusted):
    """Let a method note whether each of its answers can be trusted, where it says so."""
    register = rival.register

    def registered(*given):
        found = register(*given)
        trusted.extend([found.kept["trusted"]] if "trusted" in found.kept else [])
        return found

    rival.register = registered


def table(content):
    """Return the lines of the table."""
    names = list(content["rows"][0]["rigs"])
    lines = [
        f"Means over {len(names)} development rigs ({', '.join(names)}), scored frames.",
        "",
        "| registration | bodies | sensor, mm | inner points, mm | 90 % intervals hold | not trusted |",
        "|---|---|---|---|---|---|",
    ]
    for row in content["rows"]:
        sensor, inner = (np.mean([one[part] for one in row["rigs"].values()]) for part in ("sensor_mm", "inner_mm"))
        covered = [one["coverage90"] for one in row["rigs"].values()]
        hold = "" if None in covered else f"{np.mean(covered):.0%}"
        trusted = [frame for one in row["rigs"].values() for frame in one["trusted"]]
        alarms = f"{trusted.count(False)} of {len(trusted)}" if trusted else ""
        lines.append(f"| {row['words']} | {row['bodies'] or ''} | {sensor:.3f} | {inner:.3f} | {hold} | {alarms} |")
    return "\n".join([*lines, ""])


def main():
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, default=PAPER / "bench" / "twin" / "development")
    parser.add_argument("--variants", type=Path)
    parser.add_argument("--halved", type=Path, help="the same from ranges that are wrong by half")
    parser.add_argument("--rows", help="measure the rows that begin with these words, and keep the others")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--page", action="store_true", help="write the table again from the archive")
    options = parser.parse_args()
    if not options.page:
        compared, kept, names = settings(), [], None
        if options.rows is not None:
            kept = read_archive(ARCHIVE)["rows"]
            compared, names = [one for one in compared if one[0].startswith(options.rows)], list(kept[0]["rigs"])
        rows = measure(options.data, options.variants, options.halved, compared, names, options.jobs)
        anew = {(row["words"], row["bodies"]): row for row in rows}
        rows = [anew.get((row["words"], row["bodies"]), row) for row in kept] or rows
        write_archive(ARCHIVE, {"machine": machine(), "rows": rows}, TABLES)
    write_table("variants", table(read_archive(ARCHIVE)), PAGE)


if __name__ == "__main__":
    main()
