"""The HTML page of a diagnosis: its sections in order, with the text of each, and the view's data and script."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg.diagnosis.noise import UNDERSTATED
from tissuereg.diagnosis.report import EXTENDED_FILE, STYLE, charts
from tissuereg.diagnosis.report.scene import scene
from tissuereg.errors import ExperimentError
from tissuereg.io.experiment_out import experiment_text
from tissuereg.report.markup import document, escape, table
from tissuereg.report.provenance import provenance_section
from tissuereg.report.svg import AFTER, BEFORE, FLOOR, GENERIC, swatch
from tissuereg.report.viewer import viewer, viewer_script

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import BodyDiagnosis, DiagnosisDetails, Finding
    from tissuereg.diagnosis.noise import Noise


def page(found: "BodyDiagnosis", folder: Path) -> str:
    """Return the page of a diagnosis, HTML, for its folder; without `details` it has text and the ranking alone."""
    parts = [summary(found), "<h2>Findings</h2>", findings(found)]
    if found.details is not None:
        parts += [_body(found, found.details), _history(found, found.details)]
    parts += [_ranking(found), "<h2>Prediction of what was not fitted</h2>", charts.proved(found)]
    parts += ["<h2>Causes that cannot be distinguished, and what to measure next</h2>", ties(found)]
    parts += ["<h2>What was assumed</h2>", assumed(found), _model(found, folder)]
    parts.append(provenance_section(found.provenance.to_json(found.settings)))
    if found.details is not None:
        parts.append(viewer_script())
    return document("Diagnosis", parts, STYLE)


def _body(found: "BodyDiagnosis", details: "DiagnosisDetails") -> str:
    same = "" if details.search.final.parts else " No cause was added, so that both are the same."
    return f"""<h2>Where the simulation is wrong</h2>
<p>The body at rest, with the residual (measured minus predicted) at every marker:
<b style='color:{BEFORE}'>before</b>, of the believed model, and <b style='color:{AFTER}'>after</b>, of the extended
one.{same} Residuals of forces at pads are <b style='color:{FLOOR}'>green</b>, on a scale of their own.
A red cage is an inclusion that was found, a grey one was in the believed model;
circles mark markers that a finding names.</p>
{viewer(scene(found, details))}"""


def _history(found: "BodyDiagnosis", details: "DiagnosisDetails") -> str:
    after = swatch(AFTER, "after, with the findings") if details.search.final.parts else ""
    lines = swatch(BEFORE, "before") + after
    return f"""<h2>When, and under which load</h2>
<p>Root mean square residual of every frame in noise deviations, whitened by noise and nuisance parameters. Noise alone
lies in the green band in {100 * charts.SHARE:.0f} % of all frames.</p>
<p class='key'>{lines}{swatch(FLOOR, "noise")}</p>
{charts.histories(found.extended, details)}"""


def _ranking(found: "BodyDiagnosis") -> str:
    return f"""<h2>All causes that were tried</h2>
<p>The log Bayes factor (in nats) measures how much better a cause predicts the data than the model without it; it
includes the penalty for the cause's free parameters. Red lines are the thresholds of the causes, which data without any
effect exceed rarely. The axis is linear near 0 and logarithmic beyond; bars end at -10. "Size" is the norm of the
change that the cause makes, in noise deviations: about 8 are needed for detection.</p>
<p class='key'>{swatch(AFTER, "found, or tied with what was found")}{swatch(GENERIC, "not accepted")}</p>
{charts.rankings(found)}"""


def _model(found: "BodyDiagnosis", folder: Path) -> str:
    try:
        text = f"<pre>{escape(experiment_text(found.extended, folder))}</pre>"
    except ExperimentError as error:
        text = f"<p>It cannot be written as a file: {escape(error)}</p>"
    return (
        f"<h2>The extended model</h2><p>The believed experiment with the findings as effects, and with the fitted "
        "modulus where the data determine it, "
        f"<a href='{EXTENDED_FILE}'>{EXTENDED_FILE}</a>, runs in <code>simulate</code>, <code>register</code> and "
        f"<code>diagnose</code> like any other.</p><details><summary>Its text</summary>{text}</details>"
    )


def verdict_sentence(found: "BodyDiagnosis") -> str:
    """Return the verdict of a diagnosis in one sentence, plain text."""
    if found.verdict == "consistent":
        return "The measurements are consistent with the simulation, within noise and nuisance parameters."
    if found.verdict == UNDERSTATED:
        return "The measurements are consistent with the simulation, but their noise is larger than stated."
    if found.suspicions and not found.candidates:
        return "The recording is probably misread, so that no cause was looked for."
    if found.verdict == "unexplained":
        return "The simulation does not explain the measurements, and no cause in the catalogue accounts for it."
    names = [_name(finding) for finding in found.findings]
    if found.verdict == "group":
        return (
            "The simulation does not explain the measurements; the cause is known up to a group that these data cannot "
            f"distinguish: {_listed(names)}."
        )
    what = "one cause does" if len(names) == 1 else f"{len(names)} causes together do"
    return f"The simulation does not explain the measurements; {what}: {_listed(names)}."


def summary(found: "BodyDiagnosis") -> str:
    """Return the top of the page as HTML: title, verdict, size of the residual, and what is provisional."""
    tone = "yes" if found.verdict == "consistent" else "no"
    parts = [
        f"<h1>What the simulation of {escape(found.extended.name)} gets wrong</h1>",
        f"<p class='verdict'><b class='{tone}'>{escape(verdict_sentence(found))}</b></p>",
    ]
    said = [*(one.sentence for one in found.suspicions), *(one.sentence for one in found.understated)]
    parts += [f"<p>{escape(sentence)}.</p>" for sentence in said]
    if found.candidates or not found.suspicions:
        parts.append(f"<p>{escape(_discrepancy(found))} {escape(_left(found))}</p>")
    if found.verdict in ("unexplained", UNDERSTATED) and found.next_experiment is not None:
        parts.append(f"<p><b>Next:</b> {escape(found.next_experiment['action'])}.</p>")
    if found.provisional:
        least = found.numbers.report.least_cases
        parts.append(f"<p>Provisional: with fewer than {least} load cases, none was predicted from several others.</p>")
    return "\n".join(parts)


def findings(found: "BodyDiagnosis") -> str:
    """Return every finding with its parameters and evidence, as HTML."""
    parts = [finding_section(finding, charts.gain_words(finding)) for finding in found.findings]
    parts = parts or ["<p>No cause was accepted.</p>"]
    said = [charts.inconstant_words(one.to_json()) for one in found.constancy if not one.holds]
    said += [charts.outside_words(one.to_json()) for one in found.outside if not one.holds]
    said += [charts.possible_words(one) for one in found.possible]
    return "\n".join([*parts, *(f"<p>{escape(sentence)}</p>" for sentence in said)])


def ties(found: "BodyDiagnosis") -> str:
    """Return the causes that cannot be distinguished and the experiment that would do so, as HTML."""
    groups = [finding for finding in found.findings if len(finding.group) > 1]
    if not groups:
        distinct = "These data distinguish every finding from all other causes that were tried."
        return f"<p>{distinct if found.findings else 'There is no tie.'}</p>"
    parts = []
    for finding in groups:
        named = ((charts.plain_name(name), charts.gloss(name)) for name in finding.group)
        meant = "".join(f"<li><b>{escape(name)}</b>: {escape(gloss)}</li>" for name, gloss in named)
        parts.append(
            "<p>These causes explain the data about equally well; the likeliest is listed first, and only that one is "
            f"in the extended model.</p><ul>{meant}</ul>"
        )
    advice = found.next_experiment
    if advice is None:
        parts.append("<p>No further push, hold or force of the present rig was found that would distinguish them.</p>")
    else:
        parts.append(
            f"<p><b>Next experiment: {escape(advice['action'])}.</b> It separates {escape(charts.separated(advice))}: "
            f"the predictions of the fitted models differ by {advice['separability']:.1f} noise deviations, given the "
            "uncertainty of the tracker's frame, the modulus and the forces "
            f"({found.numbers.search.separable:.0f} are needed to distinguish two causes).</p>"
        )
    return "\n".join(parts)


def assumed(found: "BodyDiagnosis") -> str:
    """Return noise model, nuisance parameters, modulus, prior probabilities, seed and versions, as HTML."""
    details = found.details
    items = [] if details is None else _noise(details.target.noise, found)
    items += _nuisances(["stiffness"] if details is None else details.nuisances.names)
    if details is not None:
        search, target = details.search, details.target
        young = target.bench.young
        spread = young * float(np.sqrt(search.final.covariance[0, 0])) * float(np.exp(search.final.x[0]))
        believed = target.bench.young_spread * young
        items.append(
            f"Young's modulus: prior {young:.4g} \u00b1 {believed:.2g} kPa; fitted together with the causes: "
            f"{search.final.young(young):.4g} \u00b1 {spread:.2g} kPa."
        )
    evidence = found.numbers.evidence
    items += [
        "Probabilities are posterior ones among the causes of the catalogue, no cause, and the generic rival, with "
        f"equal priors; log Bayes factors are divided by {evidence.temper:g} first, because the models of noise and "
        f"discretisation error are not exact, and {100 * evidence.look_alike:.0f} % of every cause's probability is "
        "assigned to effects outside the catalogue that look like it.",
        f"Seed of all random draws: {found.seed}.",
        "Versions: " + ", ".join(f"{name} {version}" for name, version in found.versions.items()) + ".",
    ]
    return "<ul>" + "".join(f"<li>{escape(item)}</li>" for item in items) + "</ul>"


def _discrepancy(found: "BodyDiagnosis") -> str:
    discrepancy = found.discrepancy
    if not discrepancy:
        return ""
    text = (
        f"The residual of the believed model with fitted modulus is {discrepancy['rms_mm']:.3f} mm in a marker's "
        f"coordinate (rms), {discrepancy['in_sigma']:.1f} times the noise"
    )
    if discrepancy.get("where"):
        text += f"; worst at {_listed([str(name) for name in discrepancy['where']])}"
    text += f"; largest under case {discrepancy['under']}, {discrepancy['when']}."
    after = discrepancy.get("after")
    if after and found.findings:
        text += f" With the findings it is {after['rms_mm']:.3f} mm, {after['in_sigma']:.1f} times the noise."
    return text


def _left(found: "BodyDiagnosis") -> str:
    given = "With the findings in the model, data" if found.findings else "Data"
    text = f"{given} without further effects would misfit as much with probability {charts.chance(found.p_misfit)}."
    return text if found.left is None else f"{text} {found.left['sentence']}"


def finding_section(finding: "Finding", gain: str = "") -> str:
    """Return a finding with its parameters and evidence, as HTML; `gain`: what it predicts better, plain text."""
    rows = [(escape(key), _pair(value, finding.deviations.get(key))) for key, value in finding.parameters.items()]
    tied = ""
    if len(finding.group) > 1:
        others = _listed([charts.plain_name(name) for name in finding.group[1:]], "or")
        tied = f"<p>These data cannot distinguish it from: {escape(others)}.</p>"
    if finding.membership is not None and not finding.membership.holds:
        tied += f"<p>{escape(charts.family_words(finding.membership.to_json()))}</p>"
    figures = (
        f"{charts.probable(finding.probability, finding.group_probability, len(finding.group))}; log Bayes factor "
        f"{finding.log_bayes_factor:.1f} (threshold {finding.threshold:.1f})."
    )
    return (
        f"<section class='finding'><h3>{escape(charts.plain_name(finding.id))} <code>{escape(finding.id)}</code></h3>"
        f"<p>{escape(finding.sentence)}</p><p>{figures}</p>{tied}"
        + table(("parameter", "value \u00b1 standard deviation"), rows)
        + (f"<p>{escape(gain)}</p>" if gain else "")
        + "</section>"
    )


def _pair(value: Any, spread: Any) -> str:
    if isinstance(value, Sequence) and not isinstance(value, str):
        spreads = spread if isinstance(spread, Sequence) else [None] * len(value)
        return "<br>".join(_pair(v, s) for v, s in zip(value, spreads, strict=True))
    if isinstance(value, bool) or not isinstance(value, int | float):
        return escape(value)
    return f"{value:.4g}" if spread is None else f"{value:.4g} \u00b1 {float(spread):.2g}"


def _noise(noise: "Noise", found: "BodyDiagnosis") -> list[str]:
    source = "Noise, as stated or as rest frames show" if noise.from_rest else "Noise as stated"
    low, high = float(noise.marker_std.min()), float(noise.marker_std.max())
    size = f"{low:.3g}" if high - low < 1e-9 else f"{low:.3g} to {high:.3g}"
    shared = f"; a motion common to all markers, {noise.common_std:.3g} mm" if noise.common_std > 0 else ""
    memory = max(noise.memory, noise.common_memory)
    in_time = f"; correlation after {noise.step_s:.3g} s: {100 * memory:.0f} %" if memory > 0 else "; white in time"
    items = [f"{source}: {size} mm for a coordinate of a marker{shared}{in_time}."]
    if found.extended.force_std is not None:
        items.append(f"Noise of a force component: {noise.force_std:.3g} mN, white.")
    return items


def _nuisances(names: Sequence[str]) -> list[str]:
    kinds = {
        "stiffness": "Young's modulus within its prior",
        "frame shift": "a small shift of the tracker's frame",
        "frame turn": "a small rotation of it",
        "drift": "a drift of the camera",
        "mesh": "the discretisation error, which grows with the load",
        "place": "position, size, rim, height and tilt of the pads",
        "edge": "the edges of supports",
        "surface": "the shape of the surface",
        "trial": "differences between trials of one case",
    }
    fitted = [words for key, words in kinds.items() if any(name.startswith(key) for name in names)]
    return [f"Nuisance parameters of every model: {_listed(fitted)}. An effect that they can explain is not named."]


def _name(finding: "Finding") -> str:
    """Return the cause that a finding states, its group, or its family with the best member."""
    names = [charts.plain_name(name) for name in finding.group]
    name = names[0] if len(names) == 1 else f"either {_listed(names, 'or')}"
    if finding.membership is None or finding.membership.holds:
        return name
    return f"one of the {finding.membership.words} (best: {name})"


def _listed(names: list[str], last: str = "and") -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} {last} {names[-1]}" if names else "nothing"
