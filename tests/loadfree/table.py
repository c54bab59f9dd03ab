"""Writes ``docs/loadfree.md`` from ``benchmarks/results/loadfree-*.json``: ``python -m loadfree.table``."""

from pathlib import Path

from loadfree.archive import REPOSITORY, read_results, result_path
from loadfree.events import BODIES, KINDS
from loadfree.layouts import LAYOUTS
from loadfree.rivals import METHODS
from loadfree.score import figures

PAGE = REPOSITORY / "docs" / "loadfree.md"

#: Halves that have a section, and what it is called.
SECTIONS = {"dev": "Development half (even events)", "test": "Other half (odd events), asked once"}

#: Heading, figure, digits, factor of the value.
COLUMNS = (
    ("body, mm", "body_mm", 2, 1),
    ("targets that move most, mm", "moving_mm", 2, 1),
    ("worse than not moving, %", "worse", 0, 100),
    ("in 50 / 90 / 95 % regions, %", ("cover50", "cover90", "cover95"), 0, 100),
    ("largest M2", "largest_m2", 0, 1),
    ("largest half-axis, mm", "half_axis_mm", 2, 1),
    ("CRPS, mm", "crps_mm", 3, 1),
    ("flagged, %", "flagged", 0, 100),
    ("90 %, unflagged only, %", "cover90_unflagged", 0, 100),
    ("flags among good targets, %", "good_flagged", 0, 100),
    ("flags that hit good targets, %", "flags_good", 0, 100),
    ("trusted, %", "trusted", 0, 100),
    ("seconds", "seconds", 2, 1),
)

INTRODUCTION = """# Registration with nothing known of the load

Five bodies (dome, breast phantom, half ellipsoid with a hole, slab glued on one side, clamped beam) with forty events
each: dead tractions, bonded pads, sliding pads, two contacts at once, own weight with a contact. The truth comes from
another solver and other meshes: ten-node elements of scikit-fem, finer under the contacts; half of the events have
another Poisson's ratio, Young's modulus or law, or a ball five times as stiff. Each event is registered with four
layouts of fifteen markers (0.1 mm noise): spread over the surface, at random, in the third of it nearest to the
contacts, in the third farthest from them. A body counts by the mean over its nodes; *targets that move most*: the upper
third of sixty inner points. M2: squared Mahalanobis distance of a target. *Good* targets are off by less than 20 % of
their motion. In brackets: 95 % intervals by resampling whole events. How the truth is made:
`tests/loadfree/README.md`.
"""

#: What each method is.
SAID = {
    "contacts": "`register(mesh, markers)`: nothing is known of the load",
    "rigid": "the markers' best rigid motion",
    "spline": "a thin-plate spline through the markers",
    "gaussian": "tractions of a Gaussian field, to first order",
    "fitted": "principal components fitted to random events",
    "oracle": "`load=` is true: contacts as smooth tractions of their true force and place, and the weight",
    "wrong_load": "`load=` is wrong: every force and the weight have half their size and are turned by 30 degrees, "
    "every contact is 12 mm from its place",
    "none": "nothing moves",
}

#: The method whose figures are shown in full by layout, kind and body.
SHOWN = "contacts"


def page(results: dict[str, dict]) -> str:
    """Return the page from results by half."""
    used = [method for method in METHODS if any(method in answer["rows"] for answer in results.values())]
    parts = [INTRODUCTION, *_listed(used)]
    parts += [section(title, results[half]) for half, title in SECTIONS.items() if results[half]["rows"]]
    return "\n".join(parts)


def section(title: str, answer: dict) -> str:
    """Return the tables of one half."""
    events = {(event["body"], event["event"]): event for event in answer["events"]}
    rows = {method: answer["rows"][method] for method in METHODS if method in answer["rows"]}
    lines = [f"## {title}", "", *_conditions(answer, list(rows)), ""]
    lines += _table("method", rows, events)
    for heading, names, of in (
        ("layout", LAYOUTS, lambda row: row["layout"]),
        ("kind of event", KINDS, lambda row: events[row["body"], row["event"]]["kind"]),
        ("body", BODIES, lambda row: row["body"]),
    ):
        split = {
            method: {name: kept for name in names if (kept := [row for row in some if of(row) == name])}
            for method, some in rows.items()
        }
        lines += ["", f"### Mean body error in mm, by {heading}", "", *_side_by_side(heading, names, split, events)]
        if SHOWN in split:
            lines += ["", f"### {SHOWN}, by {heading}", "", *_table(heading, split[SHOWN], events)]
    return "\n".join(lines) + "\n"


def _listed(methods: list[str]) -> list[str]:
    """Return a table of what methods are."""
    return ["| method | what it is |", "| --- | --- |", *(f"| {name} | {SAID[name]} |" for name in methods), ""]


def _side_by_side(heading: str, names: tuple[str, ...], split: dict, events: dict) -> list[str]:
    lines = [f"| {heading} | " + " | ".join(split) + " |", "| --- " * (len(split) + 1) + "|"]
    for name in names:
        cells = [_cell(figures(groups.get(name, []), events), "body_mm", 2, 1) for groups in split.values()]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def _conditions(answer: dict, methods: list[str]) -> list[str]:
    """Return when, where and under which commit: one line for methods that share all of it; and what failed."""
    lines: dict[str, list[str]] = {}
    for method in methods:
        run = answer["methods"][method]
        failed = sum("error" in row for row in answer["rows"][method])
        version = ", ".join(f"{name} {number}" for name, number in run["versions"].items())
        line = (
            f"{run['n']} registrations{f', {failed} without an answer' if failed else ''}; {run['date']}, commit "
            f"{run['commit']}{' with changed files' if run['changed_files'] else ''}, {run['machine']['processor']}, "
            f"{run['settings']['jobs']} side by side, one thread each; {version}."
        )
        lines.setdefault(line, []).append(method)
    return [f"* {', '.join(names)}: {line}" for line, names in lines.items()]


def _table(heading: str, groups: dict[str, list[dict]], events: dict) -> list[str]:
    found = {name: figures(rows, events) for name, rows in groups.items()}
    used = [column for column in COLUMNS if any(_keys(column[1])[0] in told for told in found.values())]
    lines = [f"| {heading} | n | " + " | ".join(column[0] for column in used) + " |", "| --- " * (len(used) + 2) + "|"]
    for name, told in found.items():
        cells = [_cell(told, *column[1:]) for column in used]
        lines.append(f"| {name} | {told['n']['value']} | " + " | ".join(cells) + " |")
    return lines


def _keys(key: str | tuple[str, ...]) -> tuple[str, ...]:
    return (key,) if isinstance(key, str) else key


def _cell(told: dict, key: str | tuple[str, ...], digits: int, factor: float) -> str:
    parts = [told.get(name, {"value": None}) for name in _keys(key)]
    if any(part["value"] is None for part in parts):
        return "-"
    values = " / ".join(f"{factor * part['value']:,.{digits}f}" for part in parts)
    last = parts[len(parts) // 2]
    if "low" not in last:
        return values
    return f"{values} ({factor * last['low']:.{digits}f} to {factor * last['high']:.{digits}f})"


def write(path: Path = PAGE) -> None:
    """Write the page."""
    path.write_text(page({half: read_results(result_path(half)) for half in SECTIONS}), encoding="utf-8")


if __name__ == "__main__":
    write()
