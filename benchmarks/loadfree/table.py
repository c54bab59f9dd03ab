"""Writes ``RESULTS.md`` from ``archive/``: ``python -m loadfree.table``."""

from dataclasses import dataclass
from pathlib import Path

from loadfree import supports, times
from loadfree.archive import read_results, result_path
from loadfree.bench import LOADFREE, Bench
from loadfree.events import BODIES, KINDS
from loadfree.layouts import LAYOUTS
from loadfree.reference import PROBLEMS, REFERENCE
from loadfree.score import figures
from loadfree.supports import SUPPORTS

PAGE = Path(__file__).resolve().parent / "RESULTS.md"

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

INTRODUCTION = """# Registration with an unknown load: accuracy

Five bodies (dome, breast phantom, half ellipsoid with a hole, slab glued on one side, clamped beam) with forty events
each: dead tractions, bonded pads, sliding pads, two contacts at once, own weight with a contact. The ground truth comes
from another solver and other meshes: ten-node elements of scikit-fem, finer under the contacts. Half of the events have
another Poisson's ratio, Young's modulus or material law, or a ball five times as stiff. Each event is registered with
four layouts of fifteen markers (0.1 mm noise): spread over the surface, at random, in the third of the surface nearest
to the contacts, and in the third farthest from them. How the truth is made: `DATA.md`.

The error of a body is the mean over its nodes. *Targets that move most*: the upper third of sixty inner points. M2:
squared Mahalanobis distance of a target. *Good* targets have an error of less than 20 % of their motion. Brackets hold
95 % intervals by resampling whole events.
"""

#: One line on each method.
METHODS_IN_WORDS = {
    "contacts": "`register(mesh, markers)`, load unknown",
    "rigid": "the best rigid motion of the markers",
    "spline": "a thin-plate spline through the markers",
    "gaussian": "Gaussian-process prior on the surface tractions, linear model",
    "oracle": "`load=` is the true load: the contacts as smooth tractions of the true force and place, and the weight",
    "wrong_load": "`load=` is wrong: every force and the weight have half their size and are turned by 30 degrees, "
    "every contact is 12 mm from its place",
    "perhaps": '`held="perhaps"`, load unknown: how firmly the base is held is estimated from the markers',
    "sure": '`held="sure"`, load unknown: the base is held as the mesh states',
    "none": "no motion at all",
}

SUPPORTS_INTRODUCTION = """## Partly wrong supports

Dome, phantom and half ellipsoid with a hole again, each with eight further events. The user states that the whole base
is held. In truth only an outer *ring* of it is held, or its *middle*, or three *patches*, or a *band* of the skin above
it as well; otherwise the body is as the user believes. *perhaps*: `Body(mesh, held="perhaps")`, for supports that
the user doubts; *sure*: `held="sure"`. The test half was registered once more, with a version in which some sixty cells
of the base hold or give way one by one. On the development half, where it was worked out, it reduced the error from
0.28 to 0.24 mm; on the test half it raised it from 0.32 to 0.35 mm (coverage 92 %), and it was rejected. The figures of
`perhaps` are those of the release, measured after that.
"""


#: Prefix of a group that leaves one value out.
ALL_BUT = "all but "


REFERENCE_INTRODUCTION = """## Reference problems

Half ellipsoids pulled or pushed by a dead load on a small patch, solved by four other solvers on the user's own mesh
(three of 4,227 nodes, one with a Poisson's ratio of 0.49, and one of 19,957). The model is right; the load is unknown,
or a wrong one is given. Two draws of markers and noise each; brackets hold intervals by resampling draws of problems.
"""


@dataclass(frozen=True)
class Part:
    """A part of the page: the results of one bench.

    Attributes
    ----------
    bench : Bench
    introduction : str
    titles : dict
        By half.
    level : int
        Of the halves' headings.
    splits : tuple
        Heading, key of a row or of its event, and its values in order.
    shown : str
        The method whose figures are shown in full by every split.
    """

    bench: Bench
    introduction: str
    titles: dict[str, str]
    level: int
    splits: tuple[tuple[str, str, tuple[str, ...]], ...]
    shown: str


PARTS = (
    Part(
        LOADFREE,
        "",
        {"dev": "Development half (even events)", "test": "Test half (odd events), evaluated once"},
        2,
        (("layout", "layout", (*LAYOUTS, f"{ALL_BUT}far")), ("kind of event", "kind", KINDS), ("body", "body", BODIES)),
        "contacts",
    ),
    Part(
        SUPPORTS,
        SUPPORTS_INTRODUCTION,
        {"dev": "Supports, development half (even events)", "test": "Supports, test half (odd events)"},
        3,
        (("what truly holds", "support", supports.KINDS), ("layout", "layout", SUPPORTS.layouts)),
        "perhaps",
    ),
    Part(
        REFERENCE,
        REFERENCE_INTRODUCTION,
        {"both": "All draws (development data)"},
        3,
        (("layout", "layout", REFERENCE.layouts), ("problem", "body", PROBLEMS)),
        "contacts",
    ),
)


def page() -> str:
    """Return the page from the archived results."""
    parts = [[(half, read_results(result_path(half, part.bench))) for half in part.titles] for part in PARTS]
    used = {method for halves in parts for _, answer in halves for method in answer["rows"]}
    text = [INTRODUCTION, *_listed([method for method in METHODS_IN_WORDS if method in used])]
    for part, halves in zip(PARTS, parts, strict=True):
        some = [section(part, half, answer) for half, answer in halves if answer["rows"]]
        text += [part.introduction, *some] if some and part.introduction else some
    return "\n".join([*text, *filter(None, [times.section()])])


def section(part: Part, half: str, answer: dict) -> str:
    """Return the tables of one half."""
    events = {(event["body"], event["event"]): event for event in answer["events"]}
    rows = {method: answer["rows"][method] for method in part.bench.methods if method in answer["rows"]}
    below = "#" * (part.level + 1)
    lines = [f"{'#' * part.level} {part.titles[half]}", "", *_conditions(answer, list(rows)), ""]
    lines += _table("method", rows, events)
    for heading, key, names in part.splits:
        split = {method: _split(some, events, key, names) for method, some in rows.items()}
        lines += ["", f"{below} Mean body error in mm, by {heading}", ""]
        lines += _side_by_side(heading, names, split, events)
        if part.shown in split:
            lines += ["", f"{below} {part.shown}, by {heading}", "", *_table(heading, split[part.shown], events)]
    return "\n".join(lines) + "\n"


def _split(rows: list[dict], events: dict, key: str, names: tuple[str, ...]) -> dict[str, list[dict]]:
    """Return rows grouped by the value that they, or their events, have (or lack) under a key."""
    values = [(row | events[row["body"], row["event"]])[key] for row in rows]

    def belongs(value: str, name: str) -> bool:
        return value != name.removeprefix(ALL_BUT) if name.startswith(ALL_BUT) else value == name

    groups = {name: [row for row, value in zip(rows, values, strict=True) if belongs(value, name)] for name in names}
    return {name: some for name, some in groups.items() if some}


def _listed(methods: list[str]) -> list[str]:
    """Return a table with one line on each method."""
    return [
        "| method | what it is |",
        "| --- | --- |",
        *(f"| {name} | {METHODS_IN_WORDS[name]} |" for name in methods),
        "",
    ]


def _side_by_side(heading: str, names: tuple[str, ...], split: dict, events: dict) -> list[str]:
    lines = [f"| {heading} | " + " | ".join(split) + " |", "| --- " * (len(split) + 1) + "|"]
    for name in names:
        cells = [_cell(figures(groups.get(name, []), events), "body_mm", 2, 1) for groups in split.values()]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def _conditions(answer: dict, methods: list[str]) -> list[str]:
    """Return date, machine and commit, one line for all methods that share them, with the number of failures."""
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
    used = [column for column in COLUMNS if any(_keys(column[1])[0] in values for values in found.values())]
    lines = [f"| {heading} | n | " + " | ".join(column[0] for column in used) + " |", "| --- " * (len(used) + 2) + "|"]
    for name, values in found.items():
        cells = [_cell(values, *column[1:]) for column in used]
        lines.append(f"| {name} | {values['n']['value']} | " + " | ".join(cells) + " |")
    return lines


def _keys(key: str | tuple[str, ...]) -> tuple[str, ...]:
    return (key,) if isinstance(key, str) else key


def _cell(found: dict, key: str | tuple[str, ...], digits: int, factor: float) -> str:
    parts = [found.get(name, {"value": None}) for name in _keys(key)]
    if any(part["value"] is None for part in parts):
        return "-"
    values = " / ".join(f"{factor * part['value']:,.{digits}f}" for part in parts)
    last = parts[len(parts) // 2]
    if "low" not in last:
        return values
    return f"{values} ({factor * last['low']:.{digits}f} to {factor * last['high']:.{digits}f})"


def write(path: Path = PAGE) -> None:
    """Write the page."""
    path.write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    write()
