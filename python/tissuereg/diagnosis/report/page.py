"""The HTML page of a diagnosis: its sections in order, with the view's data and script."""

from pathlib import Path
from typing import TYPE_CHECKING

from tissuereg.diagnosis.report import EXTENDED_FILE, STYLE
from tissuereg.diagnosis.report.history import SHARE, histories
from tissuereg.diagnosis.report.proved import proved
from tissuereg.diagnosis.report.ranking import rankings
from tissuereg.diagnosis.report.scene import scene
from tissuereg.diagnosis.report.words import assumed, findings, summary, ties
from tissuereg.errors import ExperimentError
from tissuereg.io.experiment_out import experiment_text
from tissuereg.report.markup import document, escape
from tissuereg.report.provenance import provenance_section
from tissuereg.report.svg import AFTER, BEFORE, FLOOR, GENERIC, swatch
from tissuereg.report.viewer import viewer, viewer_script

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import BodyDiagnosis, DiagnosisDetails


def page(found: "BodyDiagnosis", folder: Path) -> str:
    """Return the page of a diagnosis, HTML, for its folder; without `details` it has text and the ranking alone."""
    parts = [summary(found), "<h2>Findings</h2>", findings(found)]
    if found.details is not None:
        parts += [_body(found, found.details), _history(found, found.details)]
    parts += [_ranking(found), "<h2>Prediction of what was not fitted</h2>", proved(found)]
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
lies in the green band in {100 * SHARE:.0f} % of all frames.</p>
<p class='key'>{lines}{swatch(FLOOR, "noise")}</p>
{histories(found.extended, details)}"""


def _ranking(found: "BodyDiagnosis") -> str:
    return f"""<h2>All causes that were tried</h2>
<p>The log Bayes factor (in nats) measures how much better a cause predicts the data than the model without it; it
includes the penalty for the cause's free parameters. Red lines are the thresholds of the causes, which data without any
effect exceed rarely. The axis is linear near 0 and logarithmic beyond; bars end at -10. "Size" is the norm of the
change that the cause makes, in noise deviations: about 8 are needed for detection.</p>
<p class='key'>{swatch(AFTER, "found, or tied with what was found")}{swatch(GENERIC, "not accepted")}</p>
{rankings(found)}"""


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
