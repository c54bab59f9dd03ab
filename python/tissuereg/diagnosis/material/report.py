"""The self-contained HTML page of a diagnosed material test: curves, findings, ranking, held-out errors."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.material.model import predicted_stresses, stress_of
from tissuereg.diagnosis.report import STYLE
from tissuereg.diagnosis.report.charts import chance, possible_words, ranking, separated
from tissuereg.diagnosis.report.page import finding_section
from tissuereg.io.experiment_out import experiment_text
from tissuereg.report import svg
from tissuereg.report.markup import document, escape, table
from tissuereg.report.provenance import provenance_section

if TYPE_CHECKING:
    from tissuereg.diagnosis.material.answer import MaterialDiagnosis
    from tissuereg.experiment.material_experiment import Curve

_SAID = {
    "named": "The believed law does not explain the curves; the cause is named.",
    "group": "The believed law does not explain the curves; the cause is known up to a group that these curves cannot "
    "distinguish.",
    "consistent": "The curves are consistent with the believed law.",
    "unexplained": "The believed law does not explain the curves, nor does any cause of the catalogue.",
}

_MEASURED = "#555"
_WIDTH, _LEFT, _RIGHT, _HEIGHT = 900.0, 70.0, 20.0, 300.0

#: Number of points of a curve that are drawn, at most.
_MOST_POINTS = 300


def material_page(found: "MaterialDiagnosis", folder: Path) -> str:
    """Return the HTML page of a diagnosed material test; `folder`: paths in the extended model are relative to it."""
    answer = found.to_json()
    of_findings = {finding.sentence for finding in found.findings}
    named = {name for finding in found.findings for name in finding.group}
    thresholds = {row["id"]: found.outcome.threshold for row in found.candidates if row["id"] != "unknown"}
    shown = [(_MEASURED, "measured"), (svg.BEFORE, "believed law, fitted"), (svg.AFTER, "with the findings")]
    tone = "yes" if answer["verdict"] == "consistent" else "no"
    parts = [
        f"<h1>What the law of {escape(found.experiment.name)} gets wrong</h1>",
        f"<p class='verdict'><b class='{tone}'>{_SAID[answer['verdict']]}</b></p>",
        *(f"<p>{escape(sentence)}</p>" for sentence in answer["sentences"] if sentence not in of_findings),
        f"<p>{escape(_discrepancy(answer))}</p>",
        *(finding_section(finding) for finding in found.findings),
        *(f"<p>{escape(possible_words(one))}</p>" for one in answer["possible"]),
        "<h2>Curves</h2>",
        f"<p class='key'>{''.join(svg.swatch(*one) for one in shown[: 3 if found.findings else 2])}</p>",
        *_charts(found),
        "<h2>All causes that were tried</h2>",
        "<p>The log Bayes factor (in nats) measures how much better a cause predicts the curves than the law without "
        "it; it includes the penalty for the cause's free parameters. The red line is the threshold, which curves "
        "without any effect exceed rarely.</p>",
        ranking(found.candidates, thresholds, named, "First round"),
        "<h2>Prediction of held-out data</h2>",
        _held_out(answer["held_out"]),
        "<h2>What to measure next</h2>",
        f"<p>{escape(_advice(answer['next_experiment']))}</p>",
        provenance_section(answer["provenance"]),
        "<h2>What was assumed</h2>",
        _assumed(answer),
        f"<h2>The extended model</h2><pre>{escape(experiment_text(found.extended, folder))}</pre>",
    ]
    return document("Diagnosis", parts, STYLE)


def _discrepancy(answer: dict[str, Any]) -> str:
    before = answer["discrepancy"]
    return (
        f"The residual of the believed law, fitted, is {before['rms_kpa']:.3g} kPa (rms), {before['in_sigma']:.1f} "
        f"times the uncertainty of the stress; largest in {before['under']} and {before['when']}, worst in "
        f"{' and '.join(before['where'])}. With the findings, curves without further effects would misfit as much with "
        f"probability {chance(answer['p_misfit'])}."
    )


def _charts(found: "MaterialDiagnosis") -> list[str]:
    """Return one HTML chart for each mode, with the measured and modelled stresses (kPa) of all of its curves."""
    curves = found.experiment.curves
    models = [[stress_of(found.outcome.believed.model, curve) for curve in curves]]
    models += [predicted_stresses(found.extended)] if found.findings else []
    drawn = list(zip(curves, zip(*models, strict=True), strict=True))
    modes = dict.fromkeys(curve.mode for curve in curves)
    return [f"<h3>{escape(mode)}</h3>{_chart(mode, [one for one in drawn if one[0].mode == mode])}" for mode in modes]


def _chart(mode: str, drawn: Sequence[tuple["Curve", Sequence[FloatArray]]]) -> str:
    """Return the chart of a mode's curves, each with the stresses (n_rows,), kPa, of one model or two."""
    amounts = np.concatenate([curve.amounts for curve, _ in drawn])
    stresses = np.concatenate([row for curve, models in drawn for row in (curve.stress, *models)])
    known = stresses[np.isfinite(stresses)]
    across = svg.PixelScale(float(amounts.min()), float(amounts.max()), _LEFT, _WIDTH - _RIGHT)
    up = svg.PixelScale(min(float(known.min()), 0.0), max(float(known.max()), 0.0), _HEIGHT - 40.0, 20.0)
    parts = [
        svg.level(up(tick), _LEFT, _WIDTH - _RIGHT, "#e3e6ea")
        + svg.text(_LEFT - 6.0, up(tick) + 4.0, f"{tick:g}", "end", more="font-size='11'")
        for tick in up.ticks()
    ]
    parts += [
        svg.text(across(tick), _HEIGHT - 24.0, f"{tick:g}", "middle", more="font-size='11'") for tick in across.ticks(8)
    ]
    what = "amount of shear" if mode == "simple-shear" else "stretch"
    parts.append(svg.text(_LEFT, 12.0, "nominal stress, kPa", more="font-size='12'"))
    parts.append(svg.text(_WIDTH - _RIGHT, _HEIGHT - 6.0, what, "end", more="font-size='12'"))
    for curve, models in drawn:
        rows = slice(None, None, -(-len(curve.amounts) // _MOST_POINTS))
        x = np.array([across(amount) for amount in curve.amounts[rows]])
        dots = zip(x, (up(stress) for stress in curve.stress[rows]), strict=True)
        parts += [f"<circle cx='{a:.1f}' cy='{b:.1f}' r='1.6' fill='{_MEASURED}'/>" for a, b in dots if np.isfinite(b)]
        for stress, colour in zip(models, (svg.BEFORE, svg.AFTER), strict=False):
            parts.append(svg.line(x, np.array([up(value) for value in stress[rows]]), colour, "stroke-width='1.6'"))
    return svg.picture(_WIDTH, _HEIGHT, parts, f"Curves in {mode}")


def _held_out(held: dict[str, Any]) -> str:
    def cell(value: float | None) -> str:
        return "-" if value is None or not np.isfinite(value) else f"{value:.3g}"

    rms, chi = ([what.format(key) for key in ("base", "named", "generic")] for what in ("rms_{}_kpa", "chi_{}"))
    rows = [(escape(case), *(cell(of_case[key]) for key in rms)) for case, of_case in held["by_case"].items()]
    rows.append(("all", *(cell(held[key]) for key in rms)))
    rows.append(("all, over their uncertainty", *(cell(held[key]) for key in chi)))
    head = (f"{held['unit']} held out, rms kPa", "believed law", "with the findings", "with a generic patch")
    return table(head, rows) + f"<p>Noise of a stress: {held['noise_kpa']:.2g} kPa (rms).</p>"


def _advice(advice: dict[str, Any] | None) -> str:
    if advice is None:
        return "There is no tie that a further test of the usual kinds would resolve."
    if not advice["separates"]:
        return f"Next: {advice['action']}."
    return f"{advice['action']}: it separates {separated(advice)} by {advice['separability']:.1f} noise deviations."


def _assumed(answer: dict[str, Any]) -> str:
    noise = answer["noise"]
    items = [
        *(f"{name}: noise of one stress {std:.2g} kPa." for name, std in noise["std_kpa"].items()),
        f"Specimens differ by {100 * noise['specimen_factor']:.1f} %; correlated errors along a curve: "
        f"{100 * noise['along_curve']:.1f} %; curves that repeat another: {noise['repeats']}.",
        f"Seed of all random draws: {answer['seed']}.",
        f"Versions: {', '.join(f'{name} {version}' for name, version in answer['versions'].items())}.",
    ]
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"
