"""Tables and pictures of the phantom experiment, from its JSON."""

from typing import Any

from tissuereg_paper.rivals import KfAdmm, Network, PhysicsPrior, VariedNetwork
from tissuereg_paper.studies.believed import PLAIN
from tissuereg_paper.studies.contest import Simulated
from tissuereg_paper.studies.tables import claim_lines, csv_lines

#: Methods that a figure names: the simulation, ours, and the paper's rival.
_NAMED = (Simulated.name, Network.name, VariedNetwork.name, PhysicsPrior.name, KfAdmm.name)


def phantom_markdown(content: dict[str, Any]) -> str:
    """Return the tables of a phantom study and its agreement as Markdown, without a heading."""
    study = content["rows"][0]["study"]
    verdict = content["agree"][study]
    lines = [f"Agrees with the paper: **{verdict['agree']}**.", "", *claim_lines(verdict)]
    if content.get("goals"):
        lines += ["| our goal | found | met |", "| --- | --- | --- |"]
        lines += [f"| {one['goal']} | {one['found']} | {'yes' if one['met'] else 'no'} |" for one in content["goals"]]
        lines.append("")
    for name, words in content["conditions"].items():
        rows = [row for row in content["rows"] if row["condition"] == name]
        lines += [f"**{words[0].upper()}{words[1:]}**, {rows[0]['rigs']} rigs:", "", *_table(rows), ""]
    if content["left_out"]:
        lines += [
            f"Not run, since a model, training fields or variants were not given: {', '.join(content['left_out'])}.",
            "",
        ]
    if content["rigs_left_out"]:
        names = ", ".join(content["rigs_left_out"])
        lines += [f"Left out, since the believed body has no equilibrium under the pads of the rig: {names}.", ""]
    return "\n".join(lines)


def _table(rows: list[dict[str, Any]]) -> list[str]:
    lines = [
        "| method | at the sensor, mm | 95 % below | at inner points, mm | 95 % below | lowered by | coverage of 90 % "
        "| ms a frame | failed |",
        "| --- | --- | --- | --- | --- | --- | --- | --- | --- |",
    ]
    for row in sorted(rows, key=lambda row: float(row["sensor_mean_mm"])):
        covered, reduction = row["coverage90"], row["reduction"]
        cells = [
            row["method"],
            _with_interval(row["sensor_mean_mm"], row["sensor_interval95_mm"]),
            f"{row['sensor_q95_mm']:.2f}",
            _with_interval(row["inner_mean_mm"], row["inner_interval95_mm"]),
            f"{row['inner_q95_mm']:.2f}",
            "" if reduction is None else f"{reduction:.0%}",
            "" if covered is None else f"{covered:.0%}",
            f"{row['ms']:.3g}",
            f"{row['failed']} of {row['frames']}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def _with_interval(mean: float, interval: tuple[float, float]) -> str:
    low, high = interval
    return f"{mean:.2f} ({low:.2f} to {high:.2f})"


def phantom_csv(content: dict[str, Any]) -> str:
    """Return the rows of a phantom study as CSV; intervals take two columns."""
    flat = []
    for row in content["rows"]:
        one: dict[str, Any] = {}
        for key, value in row.items():
            if "interval95" in key:
                low, high = (None, None) if value is None else value
                one |= {key.replace("interval95", "low"): low, key.replace("interval95", "high"): high}
            else:
                one[key] = value
        flat.append(one)
    return csv_lines(flat)


def phantom_picture(content: dict[str, Any]) -> Any:
    """Return the picture of a phantom study (matplotlib.figure.Figure): errors over time, or by method."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 5.2), layout="constrained")
    FigureCanvasAgg(figure)
    if "curves" in content:
        _curves(figure, content)
    else:
        _bars(figure, content)
    return figure


def _curves(figure: Any, content: dict[str, Any]) -> None:
    curves, study = content["curves"], content["rows"][0]["study"]
    number, scenario = study.removeprefix("fig"), content["rows"][0]["scenario"]
    figure.suptitle(f"Fig. {number}: error at the buried sensor, scenario {scenario}, {curves['rig']}", fontsize=11)
    axes, below = figure.subplots(2, 1, sharex=True, height_ratios=(4, 1))
    others = "others, see the table"
    for method, errors in curves["sensor_mm"].items():
        if method not in _NAMED:
            axes.plot(curves["times_s"], errors, color="0.8", linewidth=0.8, label=others)
            others = "_"
    for method in _NAMED:
        if method in curves["sensor_mm"]:
            axes.plot(curves["times_s"], curves["sensor_mm"][method], "o-", markersize=2.5, linewidth=1.8, label=method)
    axes.set_ylabel("error at the sensor, mm")
    axes.set_ylim(bottom=0.0)
    axes.grid(alpha=0.3)
    axes.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    below.plot(curves["motion_times_s"], curves["motion"], color="tab:gray")
    below.set_ylabel("share of\nthe stroke", fontsize=8)
    below.set_xlabel("time, s")


def _bars(figure: Any, content: dict[str, Any]) -> None:
    rows = [row for row in content["rows"] if row["condition"] == PLAIN.name]
    rows.sort(key=lambda row: float(row["sensor_mean_mm"]))
    figure.suptitle(f"Phantom experiment, {rows[0]['rigs']} rigs, all markers", fontsize=11)
    axes = figure.subplots()
    for shift, kind, colour in ((-0.2, "sensor", "tab:blue"), (0.2, "inner", "tab:orange")):
        places = [k + shift for k in range(len(rows))]
        means = [row[f"{kind}_mean_mm"] for row in rows]
        off = [[abs(row[f"{kind}_interval95_mm"][end] - row[f"{kind}_mean_mm"]) for row in rows] for end in (0, 1)]
        label = "buried sensor" if kind == "sensor" else "inner points"
        axes.barh(places, means, height=0.38, color=colour, xerr=off, label=label, error_kw={"linewidth": 0.8})
    axes.set_yticks(range(len(rows)), [row["method"] for row in rows], fontsize=8)
    axes.invert_yaxis()
    axes.set_xlabel("mean error, mm; 95 % interval over rigs")
    axes.legend(fontsize=8)
