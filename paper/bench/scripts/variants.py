"""Variants of the simulation on development rigs of the phantom experiment: how many, and what stays beside them.

``python -m scripts.variants --variants FOLDER --halved FOLDER`` writes ``archive/variants`` and the table of
``docs/decisions/learned-model.md``; ``--page`` writes the table alone. Nothing here is a reported rig.
"""

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
from common import read_archive, write_archive
from readme import write_table
from threadpoolctl import threadpool_limits

from tissuereg._base.machine import machine
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


def measure(data, folder, other):
    """Return the rows of the table: errors of each registration on each rig that has variants.

    `folder`, `other`: variants from the ranges of the truth, and from ranges that are wrong by half.
    """
    mesh = phantom_mesh()
    model = as_model("phantom", mesh, 1)
    rigs = [rig for rig in read_rigs(data) if (folder / f"{rig.name}.npz").exists()]
    compared = settings()
    rows = [{"words": words, "bodies": count, "rigs": {}} for words, _, _, count in compared]
    for rig in rigs:
        right, wrong = (read_variants(one, rig, mesh.n_nodes) for one in (folder, other))
        markers = measured(rig, PLAIN, 0)
        believed = Believed(rig, mesh, 1)
        for row, (_, method, share, count) in zip(rows, compared, strict=True):
            variants = wrong if row["words"].startswith(HALVED) else right
            few = {part: getattr(variants, part)[:count] for part in ("fields_mm", "pushes")}
            believed.variants = replace(variants, **few)
            calibration.BESIDE_VARIANTS = share
            wide = {"spread": True} if method in (Network, VariedNetwork) else {}
            rival, trusted = method(believed.setting(PLAIN, model, None, 0), **wide), []
            noted(rival, trusted)
            run = run_method(rival, believed, markers, PLAIN)
            row["rigs"][rig.name] = {
                "trusted": trusted,
                "sensor_mm": float(run.sensor_mm.mean()),
                "inner_mm": float(run.inner_mm.mean()),
                "coverage90": run.coverage90,
                "failed": run.failed,
            }
            print(rig.name, row["words"], row["rigs"][rig.name], flush=True)
    return rows


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
    parser.add_argument("--page", action="store_true", help="write the table again from the archive")
    options = parser.parse_args()
    if not options.page:
        with threadpool_limits(limits=1, user_api="blas"):
            content = {"machine": machine(), "rows": measure(options.data, options.variants, options.halved)}
        write_archive(ARCHIVE, content, TABLES)
    write_table("variants", table(read_archive(ARCHIVE)), PAGE)


if __name__ == "__main__":
    main()
