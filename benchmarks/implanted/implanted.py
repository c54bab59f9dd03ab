"""Markers inside the body compared with markers on the skin alone, on the events of `loadfree` -> archive/, RESULTS.md.

``python -m implanted.implanted [--half dev|test|both] [--limit N]``. In each event a lesion is one of the inner points
whose true motion the archive holds. Fifteen markers are on the skin; six seeds are inner points around the lesion, the
nearest that are `APART_MM` from it and from each other. A run that was stopped goes on.
"""

import argparse
import json
from pathlib import Path

import numpy as np

import tissuereg as tr
from common import REPOSITORY, commit, read_archive, write_archive
from loadfree.events import BODIES, HALVES, Body, Event, events_of, read_body
from loadfree.layouts import NOISE_MM, chosen
from tissuereg._base.machine import machine

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive", HERE / "RESULTS.md", ("rows/#",)
SCRATCH = REPOSITORY / "build" / "implanted.jsonl"

#: Seeds of one event, and the least distance between them and from the lesion, mm.
N_SEEDS, APART_MM = 6, 5.0

#: What is measured, by name: the skin alone, the skin and the seeds, the seeds alone.
LAYOUTS = ("skin", "both", "seeds")


def answered(body: Body, event: Event) -> dict:
    """Return the row of one event: the lesion's error in mm and whether its region holds it, for each layout."""
    rng = np.random.default_rng([42, BODIES.index(body.name), event.number])
    lesion = int(rng.integers(len(body.targets)))
    skin, inner = chosen(body, event, "spread"), seeds_around(body.targets, lesion)
    places = np.concatenate([body.pool[skin], body.targets[inner]])
    moved = np.concatenate([event.pool[skin], event.targets[inner]])
    measured = places + moved + NOISE_MM * rng.standard_normal(places.shape)
    names = [f"M{i}" for i in range(len(skin))] + [f"S{i}" for i in range(len(inner))]
    every = tr.Markers(places, measured, NOISE_MM, names)
    truth = body.targets[lesion] + event.targets[lesion]
    row = {"body": body.name, "event": event.number, "lesion": lesion}
    rows = {"skin": range(len(skin)), "both": range(len(names)), "seeds": range(len(skin), len(names))}
    for layout in LAYOUTS:
        result = tr.register(
            body.mesh,
            every.only(np.array(rows[layout])),
            targets={"lesion": body.targets[lesion]},
            settings=tr.RegisterSettings(threads=1),
        )
        found = result.target("lesion")
        row[layout] = {
            "error_mm": float(np.linalg.norm(found.mean - truth)),
            "spread_mm": float(np.sqrt(np.trace(found.covariance))),
            "inside": bool(found.region(0.90).contains(truth)),
            "trusted": bool(result.trust.ok),
            "seeds_dropped": sum(name.startswith("S") for name, _ in result.markers.dropped),
            "inner": len(result.markers.inner),
        }
    return row


def seeds_around(points: np.ndarray, lesion: int) -> list[int]:
    """Return the rows of inner points (n, 3), mm, that carry seeds: near the lesion, none near another."""
    kept: list[int] = []
    for point in np.argsort(np.linalg.norm(points - points[lesion], axis=1), kind="stable"):
        gaps = np.linalg.norm(points[[lesion, *kept]] - points[point], axis=1)
        if gaps.min() >= APART_MM:
            kept.append(int(point))
        if len(kept) == N_SEEDS:
            break
    return kept


def nearer_by_chance(without: np.ndarray, with_more: np.ndarray) -> float:
    """Return how often more measurements find a place nearer if the stated standard deviations (n,) are right, mm.

    `without`, `with_more`: of each event without and with those measurements. Both errors are isotropic Gaussians in
    three dimensions; that without them is the other one plus an independent part, as for two best linear estimates of
    which one has more data. Then it is the larger one with the probability P(T > -a sqrt(3) / 2), T of Student's law
    with three degrees of freedom, where a is the ratio of the standard deviations of that part and of the other error.
    """
    from scipy.stats import t

    ratio = (without / with_more) ** 2
    return float(t.cdf(np.sqrt(3.0 * np.maximum(ratio - 1.0, 0.0)) / 2.0, 3).mean())


def page(content: dict) -> str:
    """Return the page of an archive."""
    rows = content["rows"]
    lines = [
        "# Markers inside the body",
        "",
        f"`{content['command']}`: {len(rows)} events of another solver, load unknown; 15 markers on the skin, "
        f"{content['seeds']} seeds at least {content['apart_mm']:g} mm from the lesion, "
        f"noise {content['noise_mm']:g} mm. "
        "*Nearer*: events in which the lesion is found nearer than by the skin alone; *ideal*: that share if errors "
        "were Gaussian with the spreads that the regions state. Where the skin alone leaves more than 0.1 mm, the "
        f"seeds find it nearer in {_nearer_far(rows):.0%}.",
        "",
        "| markers | mean error (mm) | median (mm) | nearer | ideal | in its 90 % region | trusted | seeds dropped |",
        "|---|---|---|---|---|---|---|---|",
    ]
    skin = np.array([row["skin"]["error_mm"] for row in rows])
    for layout, words in zip(LAYOUTS, ("skin", "skin and seeds", "seeds alone"), strict=True):
        errors = np.array([row[layout]["error_mm"] for row in rows])
        share = {key: np.mean([row[layout][key] for row in rows]) for key in ("inside", "trusted")}
        nearer, ideal = "", ""
        if layout != "skin":
            nearer = f"{np.mean(errors < skin):.0%}"
        if layout == "both":
            spreads = [np.array([row[name]["spread_mm"] for row in rows]) for name in ("skin", "both")]
            ideal = f"{nearer_by_chance(*spreads):.0%}"
        dropped = sum(row[layout]["seeds_dropped"] for row in rows)
        lines.append(
            f"| {words} | {errors.mean():.2f} | {np.median(errors):.2f} | {nearer} | {ideal} | {share['inside']:.0%} | "
            f"{share['trusted']:.0%} | {dropped} of {sum(row[layout]['inner'] for row in rows)} |"
        )
    return "\n".join(lines) + "\n"


def _nearer_far(rows: list[dict]) -> float:
    """Return the share of events with more than 0.1 mm of error by the skin alone in which seeds find it nearer."""
    errors = np.array([[row[layout]["error_mm"] for layout in LAYOUTS[:2]] for row in rows])
    return float(np.mean(errors[errors[:, 0] > 0.1] @ [1.0, -1.0] > 0.0))


def main() -> None:
    """Run what is missing and write; `--page` writes the page alone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--half", choices=[*HALVES], default="dev")
    parser.add_argument("--limit", type=int, help="the first events of each body only")
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if not options.page:
        SCRATCH.parent.mkdir(parents=True, exist_ok=True)
        kept = SCRATCH.read_text(encoding="utf-8").splitlines() if SCRATCH.exists() else []
        done = {(row["body"], row["event"]): row for row in map(json.loads, kept)}
        wanted = [
            (read_body(name), event)
            for name in BODIES
            for event in events_of(read_body(name), options.half)[: options.limit]
        ]
        # One event of each body, then the next: what there is so far is of all bodies.
        wanted.sort(key=lambda one: one[1].number)
        for body, event in wanted:
            if (body.name, event.number) not in done:
                row = done[body.name, event.number] = answered(body, event)
                with SCRATCH.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(row) + "\n")
        rows = [done[body.name, event.number] for body, event in wanted]
        limit = "" if options.limit is None else f" --limit {options.limit}"
        content = {
            "command": f"python -m implanted.implanted --half {options.half}{limit}",
            "seeds": N_SEEDS,
            "apart_mm": APART_MM,
            "noise_mm": NOISE_MM,
            "rows": rows,
            "machine": machine(),
            **commit(),
        }
        write_archive(ARCHIVE, content, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")


if __name__ == "__main__":
    main()
