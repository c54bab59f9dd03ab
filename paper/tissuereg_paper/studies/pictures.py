"""Pictures of the studies by matplotlib, without a display, from their JSON."""

from typing import Any

from tissuereg_paper.studies.figures import ASSIMILATIONS, MEMBERS, PAPER_END_MM, PAPER_START_MM
from tissuereg_paper.studies.settings import METHODS, READING_WORDS, READINGS

#: Colours by N_e, and by method.
_COLOURS = ("tab:orange", "tab:blue", "tab:green", "tab:purple")


def picture(content: dict[str, Any]) -> Any:
    """Return the picture of one study.

    Parameters
    ----------
    content : dict
        JSON of one study.

    Returns
    -------
    matplotlib.figure.Figure
        Not bound to any window.
    """
    draw = {"table2": _table2, "fig6": _fig6, "fig7": _fig7, "fig8": _fig8}
    return draw[content["rows"][0]["study"]](content)


def _panels(title: str, rows: int, columns: int, height: float, width: float | None = None) -> tuple[Any, Any]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width or 4.0 * columns + 0.6, height), layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=11)
    return figure, figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False)


def _line(axes: Any, x: list[float], rows: list[dict[str, Any]], colour: str, label: str) -> None:
    ends = [row["end_mean_mm"] for row in rows]
    low, high = zip(*(row["end_mean_interval95_mm"] for row in rows), strict=True)
    axes.plot(x, ends, "o-", color=colour, label=label, markersize=4)
    axes.fill_between(x, low, high, color=colour, alpha=0.15, linewidth=0)


def _words(content: dict[str, Any]) -> str:
    model, row = content["model"], content["rows"][0]
    return f"{model['kind']} on {model['n_nodes']} nodes, {row['n_pairs']} pairs, start {row['start_mean_mm']:.2f} mm"


def _fig6(content: dict[str, Any]) -> Any:
    figure, panels = _panels(f"Fig. 6: C_d and N_e at N_a = 5 ({_words(content)})", 1, len(METHODS), 3.8)
    for axes, method in zip(panels[0], METHODS, strict=True):
        for colour, n_e in zip(_COLOURS, MEMBERS, strict=False):
            rows = {r["cd_mm2"]: r for r in content["rows"] if (r["method"], r["n_e"]) == (method.name, n_e)}
            order = sorted(rows)
            _line(axes, order, [rows[cd] for cd in order], colour, f"N_e = {n_e}")
        axes.set_xscale("log")
        axes.set_title(method.name, fontsize=10)
        axes.set_xlabel("C_d, mm²  (0.1 to 10: read as cm²; 0.001 to 0.1: as mm²)", fontsize=8)
        axes.grid(alpha=0.3)
    _finish(panels)
    return figure


def _fig7(content: dict[str, Any]) -> Any:
    figure, panels = _panels(f"Fig. 7: N_a and N_e at C_d = 0.001 ({_words(content)})", 2, len(METHODS), 6.2)
    for line, reading in zip(panels, READINGS, strict=True):
        for axes, method in zip(line, METHODS, strict=True):
            for colour, n_e in zip(_COLOURS, MEMBERS, strict=False):
                wanted = (method.name, reading, n_e)
                rows = [r for r in content["rows"] if (r["method"], r["reading"], r["n_e"]) == wanted]
                _line(axes, [r["n_a"] for r in rows], rows, colour, f"N_e = {n_e}")
            axes.set_title(f"{method.name}, C_d in {READING_WORDS[reading]}", fontsize=10)
            axes.set_xticks(ASSIMILATIONS)
            axes.grid(alpha=0.3)
    for axes in panels[-1]:
        axes.set_xlabel("assimilations N_a")
    _finish(panels)
    return figure


def _fig8(content: dict[str, Any]) -> Any:
    figure, panels = _panels(f"Fig. 8: error after each assimilation ({_words(content)})", 1, len(READINGS), 5.0)
    for axes, reading in zip(panels[0], READINGS, strict=True):
        last = 0
        for colour, method in zip(_COLOURS, content["methods"], strict=True):
            row = next(r for r in content["rows"] if (r["method"], r["reading"]) == (method, reading))
            steps = row["steps_mm"]
            last = len(steps) - 1
            label = f"{method}, ends at {steps[-1]:.2f} mm"
            axes.plot(range(len(steps)), steps, "o-", color=colour, markersize=4, label=label)
        paper = f"the paper, ends at {PAPER_END_MM} mm"
        axes.plot([0, last], [PAPER_START_MM, PAPER_END_MM], "kx", label=paper)
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter("{x:g}")
        axes.yaxis.set_minor_formatter("{x:g}")
        axes.tick_params(axis="y", which="minor", labelsize=7)
        axes.set_title(f"C_d = 0.001 {READING_WORDS[reading]}", fontsize=10)
        axes.set_xlabel("assimilations")
        axes.grid(alpha=0.3, which="both")
        axes.legend(fontsize=8, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)
    panels[0][0].set_ylabel("mean error, mm")
    return figure


def _table2(content: dict[str, Any]) -> Any:
    title = f"Table II: errors of reconstruction ({content['model']['kind']})"
    figure, panels = _panels(title, 1, 1, 3.6, width=8.5)
    axes = panels[0][0]
    rows = [row for row in content["rows"] if row["end_mean_mm"] is not None]
    constant = next((row["start_mean_mm"] for row in reversed(rows) if row["start_mean_mm"] is not None), None)
    names, values = [row["what"] for row in rows], [row["end_mean_mm"] for row in rows]
    if constant is not None:
        names, values = [*names, "constant mean shape, test shapes made here"], [*values, constant]
    places = range(len(names))
    axes.barh(places, values, color="tab:blue", label="here")
    papers = [(k, row["paper_mm"]) for k, row in enumerate(rows) if row["paper_mm"] is not None]
    axes.plot([p for _, p in papers], [k for k, _ in papers], "kx", label="the paper")
    ends = dict(papers)
    for k, value in zip(places, values, strict=True):
        beside = max(value, ends.get(k, 0.0))  # right of the bar, and of the paper's cross
        axes.annotate(f"{value:.3f}", (beside, k), (6, 0), textcoords="offset points", va="center", fontsize=8)
    axes.set_yticks(list(places), names, fontsize=8)
    axes.set_xlim(0.0, 1.15 * max(values))
    axes.invert_yaxis()
    axes.set_xlabel("mean distance of the nodes, mm")
    axes.legend(fontsize=8)
    return figure


def _finish(panels: Any) -> None:
    for line in panels:
        line[0].set_ylabel("mean error at the end, mm")
    panels[0][0].set_ylim(bottom=0.0)
    panels[0][-1].legend(fontsize=8)
