"""The page ``RESULTS.md`` and its picture, from the archive of `spread.spread`."""

from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
PAGE, PICTURE = HERE / "RESULTS.md", "spread.png"

_HEAD = """# Is the spread honest?

Registrations with the trained model, of shapes that it never saw: 15 random markers on the free surface with 0.1 mm of
noise, 20 random inner points each. Written by `make -C benchmarks/spread` from `archive/`; the method is
described in [Spread with a trained model](../../docs/theory/kinds-of-events.md).

* **Known physics**: {known} shapes of the test split, without a simulation. *Before* is the undeformed body.
* **Foreign physics**: {foreign} shapes of ten-node elements with a stiff inclusion, another Poisson's ratio (0.40 to
  0.48), another modulus and loads that are off, each with the believed model's simulation of the same event. *Before*
  is that simulation. {development} other pairs{pressed} were used to calibrate.

{calibrated} *paper*: Algorithm 1 as the paper has it: prior $q(z \\mid M_t)$, \
$C_d$ = 0.1 mm², 100 members, 5 assimilations;
$M_t$ is the simulation, or the undeformed body. *pca26*: 26 principal components in place of the network. The last
column: events whose mean error at the targets is larger than before. A method that is not given the simulation is
compared with it all the same.

![Coverage, ranks and p-values](spread.png)
"""

#: What a model with and without its calibration is, where it has ensembles in a mixture, and in archives before that.
_MIXTURE = """\
*ours*: the model with its calibration. *not calibrated*: the same model by what it states of itself, one kind of event
with errors of reconstruction, of any size."""
_ONE_GAUSSIAN = """\
*ours*: the model with its calibration; the ensemble is decoded before the first and the last update, or before every
one. *one Gaussian*: the same model without it (its prior and its errors one Gaussian
each)."""

_GAUSSIAN = """
One factor on all covariances makes 90 % regions hold 90 % of the targets in rehearsals. The posterior has heavier tails
than a Gaussian: regions of 50 % are too wide, and those of 95 % hold a little less.
"""

_HEAVY = """
Regions of *ours* and *pca26* are those of a t law: a factor on all covariances and degrees of freedom ({tails} for
*ours*) make 50 and 90 % regions hold their share of the targets in rehearsals. Ranks and CRPS are by that law. The
others' are Gaussian.
"""

_COLUMNS = (
    "method (events)",
    "50 % region holds",
    "90 % region holds",
    "95 % region holds",
    "CRPS, mm",
    "radius of the 90 % region, mean (median), mm",
    "error before, mm",
    "error after, mean (median), mm",
    "events that end worse",
)


def page(found: dict[str, Any]) -> str:
    """Return the page of the figures."""
    sets = found["sets"]
    text = _HEAD.format(
        known=sets["known"]["ours"]["events"],
        foreign=sets["foreign"]["ours"]["events"],
        development=found["n_development_pairs"],
        calibrated=_ONE_GAUSSIAN if "one Gaussian" in sets["known"] else _MIXTURE,
        pressed=", and pairs of bodies that pads press," if found.get("kinds_of_change", 0) > 1 else "",
    )
    tails = [tail for tail in found.get("tail", {}).values() if tail is not None]
    text += _HEAVY.format(tails=" and ".join(f"{tail:.1f}" for tail in tails)) if tails else _GAUSSIAN
    for name, title in (("known", "Known physics"), ("foreign", "Foreign physics")):
        text += f"\n## {title}\n\n{_table(sets[name])}"
    text += "\n" + _trust(found)
    model = found["model"]
    return text + (
        f"\nModel: {model['kind']}, {model['test_error_mm']:.3f} mm mean error on the test split (26 principal "
        f"components {model['pca26_test_error_mm']:.3f} mm). Ranges in brackets: 95 %, events drawn again.\n"
    )


def _table(methods: dict[str, Any]) -> str:
    lines = [f"| {' | '.join(_COLUMNS)} |", "|---" * len(_COLUMNS) + "|"]
    for name, row in methods.items():
        cover = [f"{100 * a:.0f} % ({100 * b:.0f}-{100 * c:.0f})" for a, b, c in row["coverage"].values()]
        radius, after = row["radius90_mm"], row["after_mm"]
        worse = f"{row['worse']}"
        if "worse_on_average" in row:
            silent = row["worse_on_average_without_a_word"]
            worse += f", {row['worse_on_average']} on average over noise, {silent} of them without a word"
        lines.append(
            f"| {name} ({row['events']}) | {' | '.join(cover)} | {row['crps_mm']:.3f} "
            f"| {radius['mean']:.2f} ({radius['median']:.2f}) | {row['before_mm']['mean']:.2f} "
            f"| {after['mean']:.2f} ({after['median']:.2f}) | {worse} |"
        )
    return "\n".join(lines) + "\n"


def _trust(found: dict[str, Any]) -> str:
    known, foreign = (found["sets"][name]["ours"] for name in ("known", "foreign"))
    lines = [
        "## Trust\n",
        "`result.trust` compares with the events of the calibration set; it is to warn of 1 % of them.\n",
        "| input | cases | warned or refused |",
        "|---|---|---|",
        f"| honest, known physics | {known['events']} | {100 * known['alarms']:.1f} % |",
        f"| honest, foreign physics | {foreign['events']} | {100 * foreign['alarms']:.1f} % |",
    ]
    for name, row in found["alarms"].items():
        lines.append(f"| {name} | {row['cases']} | {100 * row['fired'] / row['cases']:.0f} % |")
    return "\n".join(lines) + "\n"


def write_page(found: dict[str, Any]) -> None:
    """Write page and picture."""
    PAGE.write_text(page(found), encoding="utf-8")
    picture(found)


def picture(found: dict[str, Any]) -> None:
    """Draw coverage of all methods, and ranks and p-values of ours."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot as plt

    methods = list(dict.fromkeys(method for one in found["sets"].values() for method in one))
    colour = {method: f"C{number}" for number, method in enumerate(methods)}
    figure, axes = plt.subplots(2, 3, figsize=(11.0, 6.0), constrained_layout=True)
    for row, (name, title) in zip(axes, (("known", "known physics"), ("foreign", "foreign physics")), strict=True):
        for method, one in found["sets"][name].items():
            levels = [float(level) for level in one["coverage"]]
            shares = [value[0] for value in one["coverage"].values()]
            row[0].plot(levels, shares, "o-", label=method, markersize=4, color=colour[method])
        row[0].plot([0, 1], [0, 1], color="0.7", zorder=0)
        row[0].set(xlabel="region", ylabel="share of targets inside", title=title, xlim=(0.4, 1.0), ylim=(0, 1))
        row[0].legend(fontsize=7)
        ours = found["sets"][name]["ours"]
        for axis, key, label in ((row[1], "ranks", "rank of the truth"), (row[2], "p_values", "p-value")):
            counts = ours[key]
            share = [len(counts) * count / max(1, sum(counts)) for count in counts]
            axis.bar([(i + 0.5) / len(counts) for i in range(len(counts))], share, 0.9 / len(counts), color="#4477aa")
            axis.axhline(1.0, color="0.4")
            axis.set(xlabel=label, ylabel="over uniform", title=f"ours, {title}")
    figure.savefig(HERE / PICTURE, dpi=90)
    plt.close(figure)
