"""The page ``RESULTS.md`` and the tables of other pages, from the archive of `python -m learned`."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from readme import write_table

HERE = Path(__file__).resolve().parent
PAGE, RESULTS, README = HERE / "RESULTS.md", HERE.parents[1] / "docs" / "results.md", HERE.parents[1] / "README.md"

_SETS = {
    "known": "known physics",
    "foreign": "foreign physics",
    "foreign, no simulation": "the same, no simulation given",
    "demo": "demo, its lesion",
    "demo, no simulation": "the same, no simulation given",
}

_HEAD = """# Registration with the trained models

Written by `make -C benchmarks/learned` from `archive/`; edit neither. 15 random markers on the free surface with 0.1 mm
of noise; 20 random inner points each, or the demo's lesion. No model was trained or calibrated on any of these events.

* **Known physics**: shapes of the test split, without a simulation. *Before* is the undeformed body.
* **Foreign physics**: ten-node elements with a stiff inclusion, another Poisson's ratio (0.40 to 0.48), another modulus
  and loads that are off, each with the believed model's simulation of the same event; *before* is that simulation.
  Files from number {first} on; earlier ones were seen while the method was made. Pairs of a file are a cluster.
* **Demo**: one true field by another model than the simulation, with other markers and noise in every event.

*shipped*: `model="phantom"`, {shipped}. *graph*: `model="phantom-graph"`, {graph}. *not calibrated*: the shipped
network by what it states of itself. *without ES-MDA*: members stay where the prior has them, and only the model's own
error is told by the markers. Brackets: 95 %, clusters drawn again. *Silent*: trusted, no marker named, and at least
half of the targets that are not flagged lie outside their 90 % regions.
"""


def page(archive: dict[str, Any]) -> str:
    """Return the page."""
    rows = archive["rows"]
    models = {
        name: f"{model['kind']}, {model['trained_on']:,} fields, {model['errors_mm']['test']:.3f} mm on its test split"
        for name, model in archive["models"].items()
    }
    head = _HEAD.format(first=archive["first_foreign"], shipped=models["phantom"], graph=models["phantom-graph"])
    tail = f"\n{archive['machine']['processor']}, commit {archive['commit']}.\n"
    parts = ["## Honest input\n", *honest_table(rows), "\n## Spoilt input\n", *spoilt_tables(rows)]
    return head + "\n" + "\n".join(parts) + tail


def honest_table(rows: list[dict[str, Any]], methods: tuple[str, ...] | None = None) -> Iterator[str]:
    """Yield the lines of the table of honest input: a row for each set and method."""
    yield "| events | method | number | error before, mm | after, mm: mean | median | 50 / 90 / 95 % regions hold | \
90 % | radius, mm | distrusted | silent |"
    yield "|---" * 11 + "|"
    for name, words in _SETS.items():
        for method in dict.fromkeys(row["method"] for row in rows):
            own = _of(rows, method, name, "honest")
            if own and (methods is None or method in methods):
                yield _honest_row(words, method, own)


def _honest_row(words: str, method: str, own: list[dict[str, Any]]) -> str:
    start, after, radius = (_column(own, name) for name in ("before_mm", "after_mm", "radius90_mm"))
    held = {level: _column(own, f"held{level}") for level in (50, 90, 95)}
    low, high = _interval(after, own)
    low90, high90 = _interval(held[90], own)
    shares = " / ".join(f"{100 * one.mean():.0f}" for one in held.values())
    cells = [
        *(words, method, str(len(own)), f"{start.mean():.2f}", f"{after.mean():.3f} ({low:.3f} to {high:.3f})"),
        *(f"{np.median(after):.3f}", f"{shares} %", f"{100 * low90:.0f} to {100 * high90:.0f} %"),
        *(f"{np.median(radius):.2f}", _share(own, "trusted", wanted=False), _share(own, "silent")),
    ]
    return f"| {' | '.join(cells)} |"


def spoilt_tables(rows: list[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines of the tables of spoilt input: what was named or distrusted, and what was silently wrong."""
    for method in dict.fromkeys(row["method"] for row in rows if row["input"] != "honest"):
        yield f"**{method}**: the wrong marker is named, or the answer distrusted or refused (*n*: named); silent\n"
        names = [name for name in _SETS if _of(rows, method, name, "two markers swapped")]
        yield "| input | " + " | ".join(_SETS[name].replace("the same", _before(name)) for name in names) + " |"
        yield "|---" * (len(names) + 1) + "|"
        for change in dict.fromkeys(
            row["input"] for row in rows if row["method"] == method and row["input"] != "honest"
        ):
            yield f"| {change} | " + " | ".join(_spoilt_cell(_of(rows, method, name, change)) for name in names) + " |"
        strange = _of(rows, method, "another organ", "honest")
        if strange:
            yield f"| another organ's markers | {_share(strange, 'trusted', wanted=False)} of known" + " |" * len(names)
        yield ""


def _before(name: str) -> str:
    """Return the words of the set that another one repeats without a simulation."""
    return _SETS[name.split(",")[0]]


def _spoilt_cell(own: list[dict[str, Any]]) -> str:
    if not own:
        return ""
    if any(row.get("named") is not None for row in own):
        return f"n {_share(own, 'named')}; {_share(own, 'silent')}"
    return f"{_share(own, 'trusted', wanted=False)}; {_share(own, 'silent')}"


def results_table(rows: list[dict[str, Any]]) -> str:
    """Return the table of ``docs/results.md``."""
    return "\n".join(honest_table(rows, ("shipped", "graph", "not calibrated"))) + "\n"


def readme_table(rows: list[dict[str, Any]]) -> str:
    """Return the table of the repository's README: honest input of the shipped models."""
    methods = ("shipped", "graph")
    heads = [f"{method}: error, mm (95 %; events) | 90 % regions hold" for method in methods]
    lines = [f"| with a trained model | simulation, mm | {' | '.join(heads)} |", "|---" * 6 + "|"]
    for name in ("demo", "foreign"):
        cells = [_SETS[name], f"{_column(_of(rows, 'shipped', name, 'honest'), 'before_mm').mean():.2f}"]
        for method in methods:
            own = _of(rows, method, name, "honest")
            after = _column(own, "after_mm")
            low, high = _interval(after, own)
            cells += [f"{after.mean():.2f} ({low:.2f} to {high:.2f}; {len(own)})"]
            cells += [f"{100 * _column(own, 'held90').mean():.0f} %"]
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


def _of(rows: list[dict[str, Any]], method: str, name: str, change: str) -> list[dict[str, Any]]:
    return [row for row in rows if (row["method"], row["set"], row["input"]) == (method, name, change)]


def _column(rows: list[dict[str, Any]], name: str) -> Any:
    return np.array([row[name] for row in rows if row.get(name) is not None], float)


def _share(rows: list[dict[str, Any]], name: str, *, wanted: bool = True) -> str:
    """Return how many rows have a value, of how many; refused input has none but is distrusted."""
    return f"{sum(bool(row.get(name)) is wanted for row in rows)} of {len(rows)}"


def _interval(values: Any, rows: list[dict[str, Any]]) -> tuple[float, float]:
    """Return the 95 % interval of the mean: clusters are drawn again."""
    clusters = [
        values[[row["cluster"] == number for row in rows]] for number in sorted({row["cluster"] for row in rows})
    ]
    sums, counts = np.array([one.sum() for one in clusters]), np.array([len(one) for one in clusters])
    drawn = np.random.default_rng(1).integers(0, len(clusters), (2000, len(clusters)))
    low, high = np.quantile(sums[drawn].sum(axis=1) / counts[drawn].sum(axis=1), (0.025, 0.975))
    return float(low), float(high)


def write_page(archive: dict[str, Any]) -> None:
    """Write the page, and the tables of the results and of the README."""
    PAGE.write_text(page(archive), encoding="utf-8")
    write_table("learned", results_table(archive["rows"]), RESULTS)
    write_table("learned", readme_table(archive["rows"]), README)
