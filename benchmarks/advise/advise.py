"""Markers placed by advice compared with random and with evenly spread ones, on the breast phantom's data set.

``python -m advise.advise --data build/phantom-data`` writes ``archive/`` and ``RESULTS.md``. Members of the training
split choose; members of the test split, which no choice has seen, are the truth: the target of each is estimated from
its noisy markers by the linear-Gaussian rule of the training members, whoever placed the markers, and compared with
where it is.
"""

import argparse
import time
from pathlib import Path

import numpy as np

import tissuereg as tr
from common import read_archive, write_archive
from tissuereg._base.machine import machine
from tissuereg.body.observe import TargetObservation
from tissuereg.phantom.breast import inside_breast

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive", HERE / "RESULTS.md", ("rows/#",)

#: Targets, each with an advice of its own; random placements of each; numbers of markers; noise and spacing in mm.
N_TARGETS, N_RANDOM, NUMBERS = 20, 20, (3, 5, 10, 15)
STD_MM, APART_MM = 0.1, 8.0


def measure(data, n_train, n_test, seed=0):
    """Return the content of the JSON."""
    begun = time.perf_counter()
    rng = np.random.default_rng([27, seed])
    mesh = data.mesh
    train, test = (
        data.displacement[np.sort(rng.choice(data.split[name], min(n, len(data.split[name])), replace=False))]
        for name, n in (("train", n_train), ("test", n_test))
    )
    train, test = train.astype(np.float64), test.astype(np.float64)
    places = mesh.nodes[np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)]
    nodes = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)
    rows = []
    for number, point in enumerate(inner_points(rng, N_TARGETS)):
        target = TargetObservation(mesh, {"target": point})
        known, truth = (target.predict(fields[:, target.nodes])[:, 0] for fields in (train, test))

        def error(chosen, known=known, truth=truth):
            noise = STD_MM * np.random.default_rng(5).standard_normal((len(test), len(chosen), 3))
            return estimated(train[:, nodes[chosen]], known, test[:, nodes[chosen]] + noise, truth)

        advice = tr.advise_markers(
            mesh, train, {"target": point}, max(NUMBERS), candidates_mm=places, std=STD_MM, apart_mm=APART_MM
        )
        orders = [random_order(places, max(NUMBERS), rng) for _ in range(N_RANDOM)]
        rows += [
            {
                "target": number,
                "markers": n,
                "before_mm": float(np.sqrt(((truth - known.mean(axis=0)) ** 2).sum(axis=1).mean())),
                "expected_mm": float(advice.expected_mm[n, 0]),
                "advised_mm": error(advice.chosen[:n]),
                "spread_mm": error(spread_order(places, n)),
                "random_mm": float(np.mean([error(order[:n]) for order in orders])),
            }
            for n in NUMBERS
        ]
    return {
        "command": "python -m advise.advise",
        "members": len(train),
        "held_out": len(test),
        "targets": N_TARGETS,
        "random_placements": N_RANDOM,
        "std_mm": STD_MM,
        "apart_mm": APART_MM,
        "seed": seed,
        "rows": rows,
        "seconds": time.perf_counter() - begun,
        "machine": machine(),
    }


def estimated(seen, known, measured, truth):
    """Return the rms error of a target (mm): regression on markers over the training members, at held-out ones."""
    centre, middle = seen.mean(axis=0), known.mean(axis=0)
    away, towards = (seen - centre).reshape(len(seen), -1), known - middle
    square = away.T @ away / (len(seen) - 1) + STD_MM**2 * np.eye(away.shape[1])
    gain = np.linalg.solve(square, away.T @ towards / (len(seen) - 1))
    off = middle + (measured - centre).reshape(len(measured), -1) @ gain - truth
    return float(np.sqrt((off**2).sum(axis=1).mean()))


def inner_points(rng, count):
    """Return points at least 10 mm below the skin's horizontal outline and above the chest wall, mm."""
    found = []
    while len(found) < count:
        point = rng.uniform([-50.0, -60.0, 10.0], [50.0, 60.0, 42.0])
        if inside_breast(point[None])[0] > 10.0:
            found.append(point)
    return found


def random_order(places, count, rng):
    """Return places drawn at random, none nearer to another than `APART_MM`."""
    chosen = []
    for row in rng.permutation(len(places)):
        if all(np.linalg.norm(places[row] - places[k]) >= APART_MM for k in chosen):
            chosen.append(row)
        if len(chosen) == count:
            break
    return np.array(chosen)


def spread_order(places, count):
    """Return places as far from each other as can be: each the farthest from those before it, the first the apex."""
    chosen = [int(np.argmax(places[:, 2]))]
    while len(chosen) < count:
        gap = np.linalg.norm(places[:, None] - places[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(gap)))
    return np.array(chosen)


def page(content):
    """Return the page of an archive."""
    lines = [
        "# Markers placed by advice",
        "",
        f"`{content['command']}`: {content['targets']} targets, {content['members']} members choose, "
        f"{content['held_out']} held-out members are the truth, noise {content['std_mm']:g} mm, markers at least "
        f"{content['apart_mm']:g} mm apart. Root mean square error at the target in mm, mean over targets; "
        f"*random*: mean of {content['random_placements']} placements; *gain*: error over that of the advised ones, "
        "mean over targets with its 95 % interval (targets drawn with replacement).",
        "",
        "| markers | none | random | evenly spread | advised | as expected | gain over random | over evenly spread |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for n in sorted({row["markers"] for row in content["rows"]}):
        rows = [row for row in content["rows"] if row["markers"] == n]
        before, random, spread, advised, expected = (
            np.array([row[f"{name}_mm"] for row in rows])
            for name in ("before", "random", "spread", "advised", "expected")
        )
        cells = [f"{x.mean():.2f}" for x in (before, random, spread, advised, expected)]
        lines.append(f"| {n} | " + " | ".join([*cells, gain(random / advised), gain(spread / advised)]) + " |")
    return "\n".join(lines) + "\n"


def gain(ratios):
    """Return the mean of ratios with its 95 % interval by the bootstrap over targets."""
    draws = ratios[np.random.default_rng(0).integers(len(ratios), size=(2000, len(ratios)))].mean(axis=1)
    low, high = np.quantile(draws, (0.025, 0.975))
    return f"{ratios.mean():.2f} ({low:.2f} to {high:.2f})"


def main():
    """Measure and write; `--page` writes the page alone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", default="build/phantom-data")
    parser.add_argument("--train", type=int, default=2000)
    parser.add_argument("--test", type=int, default=500)
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if not options.page:
        content = measure(tr.open_dataset(options.data), options.train, options.test)
        write_archive(ARCHIVE, content, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")


if __name__ == "__main__":
    main()
