"""Coverage and size of regions by family of truth, beside rivals -> archive/, RESULTS.md.

``python -m regions.regions [--jobs N] [--page]``
"""

import argparse
import time
import warnings
from pathlib import Path

import numpy as np
from scipy.stats import chi2

import tissuereg as tr
from common import commit, read_archive, write_archive
from loadfree.score import SHARES, crps, mahalanobis
from regions.cases import Case, Make, body_of, families
from regions.intervals import interval
from regions.rivals import RIVALS
from tissuereg._base.machine import machine
from tissuereg.parallel import Failed, InProcess, Processes

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive", HERE / "RESULTS.md", ("rows/#",)

#: A trusted answer should cover at least this share of its targets by its 90 % regions.
LEAST_COVERED = 0.75


HEAD = f"""Written by `make -C benchmarks/regions` from `archive/`; edit neither. Nothing is told but mesh, markers and
their noise (reference problems: Poisson's ratio and elements). Errors are root mean squares over all targets, mm (gels:
um); *50, 90, 95*: share of targets, %, inside the regions of that probability, the truth's own noise included;
*half-axis*: the median longest one of the 90 % regions; CRPS: mean over targets and axes. *Trusted, below*: trusted
answers, and those among them whose 90 % regions hold less than {LEAST_COVERED:.0%} of their targets. Locked and pushed
bodies are of this package's own solver.

Brackets: 95 % intervals of the share on further bodies of the kind. Cases on one body, whatever the event, layout or
draw, are one cluster. Shares of clusters follow a beta law, numbers inside it a binomial one, mean and correlation are
uniform before: bootstraps of three to five clusters are too narrow. One cluster has no interval."""


def answered(task: tuple[str, int, Make]) -> list[dict]:
    """Return the rows of one case, one a method."""
    family, number, make = task
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)
        case = make()
        begun = time.perf_counter()
        result = tr.register(
            case.body,
            case.markers,
            targets={str(i): place for i, place in enumerate(case.targets)},
            settings=tr.RegisterSettings(threads=1),
        )
    seconds = time.perf_counter() - begun
    given = {"family": family, "case": number, "cluster": case.cluster}
    found = list(result.targets.values())
    mean, covariance = np.array([one.mean for one in found]), np.array([one.covariance for one in found])
    own = {"trusted": bool(result.trust.ok), "seconds": round(seconds, 3), "reasons": list(result.trust.reasons)}
    rows = [given | {"method": "register"} | _scored(case, mean, covariance) | own]
    moved = case.markers.measured - case.markers.reference
    for name, rival in RIVALS.items():
        mean, covariance = rival(case.markers.reference, moved, case.markers.axis_std, case.targets)
        rows.append(given | {"method": name} | _scored(case, case.targets + mean, covariance))
    return rows


def _scored(case: Case, mean: np.ndarray, covariance: np.ndarray) -> dict:
    off, whole = case.truth - mean, covariance + np.diag(np.square(case.noise)) + 1e-12 * np.eye(3)
    squares = mahalanobis(off, whole)
    axes = np.sqrt(chi2.ppf(0.9, 3) * np.linalg.eigvalsh(whole)[:, -1])
    return {
        "n": len(off),
        "square_mm2": float(np.mean(np.sum(off**2, axis=1))),
        "crps_mm": float(crps(off, whole).mean()),
        "half_axis_mm": float(np.median(axes)),
        **{f"inside{100 * share:.0f}": float(np.mean(squares <= chi2.ppf(share, 3))) for share in SHARES},
    }


def page(content: dict) -> str:
    """Return the page of an archive."""
    rows = content["rows"]
    named = list(dict.fromkeys(row["family"] for row in rows))
    lines = [
        "# Do regions hold?",
        "",
        HEAD,
        "",
        "| family | clusters | cases | method | error | 50 | 90 | 95 | half-axis | CRPS | trusted, below |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for family in named:
        for method in ("register", *RIVALS):
            own = [row for row in rows if (row["family"], row["method"]) == (family, method)]
            mean = {key: np.mean([row[key] for row in own]) for key in ("square_mm2", "crps_mm")}
            inside = " | ".join(_covered(own, f"inside{100 * share:.0f}") for share in SHARES)
            trusted = ""
            if method == "register":
                kept = [row for row in own if row["trusted"]]
                trusted = f"{len(kept)} of {len(own)}, {sum(row['inside90'] < LEAST_COVERED for row in kept)}"
            first = f"{family} | {len(_clusters(own))} | {len(own)}" if method == "register" else " |  | "
            axis = np.median([row["half_axis_mm"] for row in own])
            lines.append(
                f"| {first} | {method} | {np.sqrt(mean['square_mm2']):.2f} | {inside} | {axis:.2f} | "
                f"{mean['crps_mm']:.3f} | {trusted} |"
            )
    return "\n".join([*lines, "", _reasons(rows)]) + "\n"


def _clusters(rows: list[dict]) -> dict[str, list[dict]]:
    """Return the rows of each body."""
    found: dict[str, list[dict]] = {}
    for row in rows:
        found.setdefault(body_of(row["cluster"]), []).append(row)
    return found


def _covered(rows: list[dict], key: str) -> str:
    """Return the share of targets inside, %, with its interval where there are several clusters."""
    mean, clusters = f"{100 * np.mean([row[key] for row in rows]):.0f}", _clusters(rows).values()
    if len(clusters) == 1:
        return mean
    counts = [(sum(round(row["n"] * row[key]) for row in some), sum(row["n"] for row in some)) for some in clusters]
    low, high = interval(tuple(counts))
    return f"{mean} ({100 * low:.0f} to {100 * high:.0f})"


def _reasons(rows: list[dict]) -> str:
    """Return how often each reason of the body's evidence is given, by family."""
    found = []
    for family in dict.fromkeys(row["family"] for row in rows):
        own = [row for row in rows if row["family"] == family and row["method"] == "register"]
        counts = {
            kind: sum(any(reason.startswith(f"{kind}: ") for reason in row["reasons"]) for row in own)
            for kind in ("unexplained", "stiffness", "noise")
        }
        if any(counts.values()):
            words = ", ".join(f"`{kind}` {count}" for kind, count in counts.items() if count)
            found.append(f"{family}: {words} of {len(own)}")
    return "Reasons that contradict what is believed: " + ("; ".join(found) or "none") + "."


def main() -> None:
    """Run all cases and write; `--page` writes the page alone."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=1, help="cases side by side, one thread each")
    parser.add_argument("--quick", action="store_true", help="the first case of each family only")
    parser.add_argument("--page", action="store_true", help="write the page from the archive, register nothing")
    options = parser.parse_args()
    if not options.page:
        tasks = [(family, i, make) for family, cases in families().items() for i, make in enumerate(cases)]
        tasks = [task for task in tasks if task[1] == 0 or not options.quick]
        rows: dict[int, list[dict]] = {}
        with InProcess() if options.jobs == 1 else Processes(options.jobs) as executor:
            for outcome in executor.run(answered, tasks):
                if isinstance(outcome, Failed):
                    raise outcome.error
                rows[outcome.index] = outcome.result
        content = {"rows": [row for i in sorted(rows) for row in rows[i]], "machine": machine(), **commit()}
        write_archive(ARCHIVE, content, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")


if __name__ == "__main__":
    main()
