"""The tables of a study from its JSON: Markdown for reading, CSV with every row and key."""

from typing import Any

from tissuereg_paper.studies.settings import READING_WORDS

#: Columns of Table II's errors.
_ERRORS = (
    ("what", "what", "{}"),
    ("n_pairs", "shapes", "{}"),
    ("start_mean_mm", "constant mean shape", "{:.2f}"),
    ("end_mean_mm", "error", "{:.3f}"),
    ("end_rms_mm", "rms", "{:.3f}"),
    ("end_max_mm", "largest", "{:.2f}"),
    ("paper_mm", "paper", "{:.3f}"),
)

#: Columns of Table II's samples.
_SAMPLES = (
    ("latents", "latents from", "{}"),
    ("samples", "samples", "{}"),
    ("min_det_f", "smallest det F", "{:.3f}"),
    ("share_inverted_tets", "share of inverted tets", "{:.1e}"),
    ("samples_with_inverted", "samples with any", "{}"),
)


def markdown(content: dict[str, Any]) -> str:
    """Return the tables of a study and its agreement as Markdown.

    Parameters
    ----------
    content : dict
        JSON of one study.

    Returns
    -------
    str
        Without a heading.
    """
    study = content["rows"][0]["study"]
    verdict = content["agree"][study]
    lines = [f"Agrees with the paper: **{verdict['agree']}**.", "", *claim_lines(verdict)]
    if "family" in verdict:
        found = verdict["family"]["agree"]
        lines += [f"The same statements with the prior of all training codes: **{found}**.", ""]
        lines += claim_lines(verdict["family"])
    if study == "table2":
        layers = [{"number": k, **one} for k, one in enumerate(content["layers"], start=1)]
        columns = (("number", "", "{}"), ("layer", "layer", "{}"), ("paper", "paper", "{}"), ("here", "here", "{}"))
        lines += [*_table(columns, layers), "", *_table(_ERRORS, content["rows"]), ""]
        samples = [{"latents": name, **one} for name, one in content["samples"].items()]
        return "\n".join([*lines, *_table(_SAMPLES, samples), ""])
    if study == "fig8":
        goal = content["goal"]
        met = "met" if goal["met"] else "not met"
        lines += [
            f"Our goal, below {goal['goal_mm']} mm: **{met}** ({goal['method']}: {goal['end_mean_mm']:.3f} mm).",
            "",
        ]
        lines += [*_steps(content["rows"]), ""]
    spread = content["encoder_spread"]
    lines += [f"The encoder's q(z | start mesh) is {spread:.2g} times as wide as all training codes (median).", ""]
    return "\n".join([*lines, *_sweep(content["rows"], "n_a" if study == "fig7" else "n_e"), ""])


#: How the columns of a sweep are headed.
_HEADS = {"n_e": "N_e", "n_a": "N_a"}


def _sweep(rows: list[dict[str, Any]], across: str) -> list[str]:
    """Return a sweep with one quantity across; a cell holds the end errors, and the share inside regions."""
    down = "n_a" if across == "n_e" else "n_e"
    first = rows[0]
    lines = [
        f"{first['n_pairs']} pairs, start error {first['start_mean_mm']:.2f} mm in the mean. Cells: end error in mm, "
        "mean / root mean square / largest over nodes and pairs, and the share of inner points inside their 90 % "
        "regions.",
        "",
    ]
    columns = sorted({row[across] for row in rows})
    lines += [
        f"| method | C_d | {_HEADS[down]} | " + " | ".join(f"{_HEADS[across]} = {one}" for one in columns) + " |",
        "| --- | --- | --- | " + " | ".join(["---"] * len(columns)) + " |",
    ]
    by_line: dict[tuple[Any, ...], dict[int, str]] = {}
    for row in rows:
        unit = f"{row['cd']:g} {READING_WORDS[row['reading']]}"
        shown = f"{row['end_mean_mm']:.3f} / {row['end_rms_mm']:.2f} / {row['end_max_mm']:.0f}, {row['coverage90']:.0%}"
        by_line.setdefault((row["method"], unit, row[down]), {})[row[across]] = shown
    for key, cells in by_line.items():
        lines.append("| " + " | ".join([*map(str, key), *(cells[one] for one in columns)]) + " |")
    return lines


def csv(content: dict[str, Any]) -> str:
    """Return the rows of a study as CSV, one column a key; intervals take two."""
    rows = []
    for row in content["rows"]:
        ends = row.get("end_mean_interval95_mm", ())
        rest = {key: value for key, value in row.items() if key not in ("steps_mm", "end_mean_interval95_mm")}
        rows.append(rest | dict(zip(("end_mean_low_mm", "end_mean_high_mm"), ends, strict=False)))
    return csv_lines(rows)


def csv_lines(rows: list[dict[str, Any]]) -> str:
    """Return rows with the same keys as CSV, one column a key."""
    lines = [",".join(rows[0])]
    lines += [",".join(_cell(row[key]) for key in rows[0]) for row in rows]
    return "\n".join(lines) + "\n"


def claim_lines(verdict: dict[str, Any]) -> list[str]:
    """Return the paper's statements on a study as Markdown tables, and whether each holds."""
    lines = []
    for reading, claims in verdict["claims"].items():
        lines += [f"| {reading}: the paper's statement | holds | found |", "| --- | --- | --- |"]
        lines += [f"| {one['claim']} | {'yes' if one['holds'] else 'no'} | {one['found']} |" for one in claims]
        lines.append("")
    return lines


def _cell(value: Any) -> str:
    text = "" if value is None else f"{value:.6g}" if isinstance(value, float) else str(value)
    return f'"{text}"' if "," in text else text


def _steps(rows: list[dict[str, Any]]) -> list[str]:
    n = len(rows[0]["steps_mm"])
    heads = ["start", *(f"after {k}" for k in range(1, n))]
    columns = [("method", "method", "{}"), ("reading", "C_d read as", "{}")]
    table = [{**row, **dict(zip(heads, row["steps_mm"], strict=True))} for row in rows]
    ends = (("min_det_f", "smallest det F", "{:.3f}"), ("inverted_tets", "inverted tets", "{}"))
    return _table((*columns, *((head, head, "{:.3f}") for head in heads), *ends), table)


def _table(columns: Any, rows: list[dict[str, Any]]) -> list[str]:
    heads = [title for _, title, _ in columns]
    lines = ["| " + " | ".join(heads) + " |", "| " + " | ".join(["---"] * len(heads)) + " |"]
    for row in rows:
        cells = ["-" if row.get(key) is None else form.format(row[key]) for key, _, form in columns]
        lines.append("| " + " | ".join(cells) + " |")
    return lines
