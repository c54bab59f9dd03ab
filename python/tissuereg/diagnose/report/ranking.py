"""How likely every cause is that was tried: bars of log Bayes factors with their thresholds."""

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tissuereg.diagnose.candidates import required_thresholds
from tissuereg.diagnose.causes import CAUSES
from tissuereg.diagnose.report import svg
from tissuereg.diagnose.screen import UNKNOWN
from tissuereg.report.markup import escape

if TYPE_CHECKING:
    from tissuereg.diagnose.answer import Diagnosis
    from tissuereg.diagnose.search import Step

_WIDTH, _LEFT, _RIGHT, _ROW = 900.0, 160.0, 250.0, 21.0
_TICKS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 1e4, 1e5, 1e6)

#: Bars end here on the left: how unlikely a poor cause is interests nobody.
_LEAST = -10.0


def plain_name(cause: str) -> str:
    """Return a cause's id as words."""
    return "something else (generic)" if cause == UNKNOWN else cause.replace("_", " ")


def separated(advice: Mapping[str, Any]) -> str:
    """Return the pairs of causes that an advised action separates, plain text for a sentence."""
    return "; ".join(" from ".join(plain_name(name) for name in pair) for pair in advice["separates"])


def gloss(cause: str) -> str:
    """Return one line on what a cause means."""
    if cause == UNKNOWN:
        return "Any smooth change over the body, the load and time, without a physical cause."
    return ((type(CAUSES[cause]).__doc__ if cause in CAUSES else None) or "").partition("\n")[0].partition(" (`")[0]


def thresholds_of(found: "Diagnosis") -> dict[str, float]:
    """Return the thresholds of the first round by cause, those of the findings where details do not tell."""
    if "thresholds" in found.details:
        return dict(found.details["thresholds"])
    return {finding.id: finding.threshold for finding in found.findings if finding.id != "stiffness"}


def rankings(found: "Diagnosis") -> str:
    """Return the chart of the first round, and of later ones folded away, HTML."""
    thresholds = thresholds_of(found)
    search = found.details.get("search")
    steps = [] if search is None else search.steps
    # Findings stand in the order of the steps; only the modulus may stand before them.
    first = max(0, len(found.findings) - sum(step.found is not None for step in steps))
    rounds = [number for number, step in enumerate(steps) if step.found is not None]
    groups = {number: set(one.group) for number, one in zip(rounds, found.findings[first:], strict=False)}
    early = {name for finding in found.findings[: first if steps else None] for name in finding.group}
    parts = [ranking(found.candidates, thresholds, early | groups.get(0, set()), "First round")]
    for number, step in enumerate(steps[1:], start=1):
        before = [earlier.found.id for earlier in steps[:number] if earlier.found is not None]
        known = f"{', '.join(map(plain_name, before))} is" if before else "a cause that was dropped again was"
        said = f"Round {number + 1}: what else, once {known} in the model"
        chart = ranking(_rows(step, before), required_thresholds(thresholds, before), groups.get(number, set()), said)
        parts.append(f"<details><summary>{escape(said)}</summary>{chart}</details>")
    return "\n".join(parts)


def ranking(rows: Sequence[Mapping[str, Any]], thresholds: Mapping[str, float], named: "set[str]", title: str) -> str:
    """Return the bars of one round.

    Parameters
    ----------
    rows : sequence of mapping
        As `Diagnosis.candidates`; ``probability`` may be absent.
    thresholds : mapping of str to float
        By id; drawn as lines across the bars.
    named : set of str
        Ids that are shown as found.
    title : str
        Plain text.

    Returns
    -------
    str
        HTML.
    """
    if not rows:
        return "<p>No cause has a place in this experiment.</p>"
    values = [float(row["log_bayes_factor"]) for row in rows]
    asked = [thresholds.get(str(row["id"])) for row in rows]
    most = max([_bent(v) for v in [*values, *(a for a in asked if a is not None)]] + [1.0])
    least = min([_bent(max(v, _LEAST)) for v in values] + [0.0])
    across = svg.Scale(least, most, _LEFT, _WIDTH - _RIGHT)
    bottom = 26.0 + _ROW * len(rows)
    heads = (
        ("log_bayes_factor", "log Bayes factor", _WIDTH - _RIGHT + 10.0, "start"),
        ("probability", "probability", _WIDTH - 80.0, "end"),
        ("detectability", "size, sd", _WIDTH, "end"),
    )
    parts = [svg.text(x, 12.0, head, anchor, more="font-size='11'") for key, head, x, anchor in heads if key in rows[0]]
    for tick in (*(-t for t in _TICKS), 0.0, *_TICKS):
        if least <= _bent(tick) <= most:
            parts.append(svg.upright(across(_bent(tick)), 20.0, bottom, "#e3e6ea"))
            parts.append(svg.text(across(_bent(tick)), bottom + 13.0, f"{tick:g}", "middle", more="font-size='10'"))
    for i, (row, value, least_asked) in enumerate(zip(rows, values, asked, strict=True)):
        y = 22.0 + _ROW * i
        found, name = row["id"] in named, str(row["id"])
        colour = svg.AFTER if found else svg.GENERIC
        weight = "font-size='12' font-weight='700'" if found else "font-size='12'"
        line, told = "", gloss(name)
        if least_asked is not None:
            line = svg.upright(across(_bent(least_asked)), y, y + _ROW, "#a3180d", "stroke-width='1.5'")
            told += f" (threshold {least_asked:.1f})"
        parts.append(
            f"<g><title>{escape(told)}</title>"
            + svg.text(_LEFT - 8.0, y + 14.0, plain_name(name), "end", more=weight)
            + svg.bar(across(0.0), y + 3.0, across(_bent(max(value, _LEAST))) - across(0.0), _ROW - 6.0, colour)
            + svg.text(_WIDTH - _RIGHT + 10.0, y + 14.0, f"{value:.1f}", more=weight)
            + (
                svg.text(_WIDTH - 80.0, y + 14.0, chance(row["probability"]), "end", more=weight)
                if "probability" in row
                else ""
            )
            + (
                svg.text(_WIDTH, y + 14.0, f"{row['detectability']:.1f}", "end", more=weight)
                if "detectability" in row
                else ""
            )
            + line
            + "</g>"
        )
    parts.append(svg.upright(across(0.0), 20.0, bottom, "#555"))
    return svg.picture(_WIDTH, bottom + 20.0, parts, title)


def chance(probability: float) -> str:
    """Return a probability as people read it, never as certain."""
    if probability > 0.995:
        return "> 0.99"
    return f"{probability:.2f}" if probability >= 0.005 else "< 0.01"


def _bent(value: float) -> float:
    """Return a value on an axis that is linear about zero and logarithmic far away."""
    return math.copysign(math.log10(1.0 + abs(value)), value)


def _rows(step: "Step", before: Sequence[str]) -> list[dict[str, Any]]:
    """Return what was tried in a later round, without what was in the model already unless it was fitted again."""
    gains = {name: screened.log_bayes_factor for name, screened in step.screened.items()}
    gains |= {candidate.id: candidate.gain for candidate in step.candidates}
    tried = {candidate.id for candidate in step.candidates}
    order = sorted(gains.items(), key=lambda item: -item[1])
    return [{"id": name, "log_bayes_factor": gain} for name, gain in order if name in tried or name not in before]
