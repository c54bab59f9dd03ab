"""Charts of the log Bayes factors of all causes that were tried, with their thresholds."""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.screen import UNKNOWN
from tissuereg.report import svg
from tissuereg.report.markup import escape

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import BodyDiagnosis
    from tissuereg.diagnosis.search import Step

_WIDTH, _LEFT, _RIGHT, _ROW = 900.0, 160.0, 250.0, 21.0
_TICKS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 1e4, 1e5, 1e6)

#: Lower end of the bars: differences among unlikely causes are of no interest.
_LEAST = -10.0


def plain_name(cause: str) -> str:
    """Return the id of a cause as words for a text."""
    return "something else (generic)" if cause == UNKNOWN else cause.replace("_", " ")


def separated(advice: Mapping[str, Any]) -> str:
    """Return the pairs of causes that an advised action separates, plain text for a sentence."""
    return "; ".join(" from ".join(plain_name(name) for name in pair) for pair in advice["separates"])


def probable(cause: float, group: float, n_ids: int) -> str:
    """Return the probabilities of a cause and of its group of `n_ids` ids as words for a text."""
    return f"Probability {chance(cause)}" + (f", of the group {chance(group)}" if n_ids > 1 else "")


def possible_words(one: Mapping[str, Any]) -> str:
    """Return a cause that came close and is not stated as a sentence, plain text."""
    return (
        f"Possible, but not stated: {plain_name(one['id'])} (probability {chance(one['probability'])}; log Bayes "
        f"factor {one['log_bayes_factor']:.1f}, threshold {one['threshold']:.1f})."
    )


def inconstant_words(one: Mapping[str, Any]) -> str:
    """Return a cause whose change differs from part to part of the data as a sentence, plain text."""
    return (
        f"Not stated: {plain_name(one['id'])}. It fits best, but its change differs by {one['differs_by']} (p = "
        f"{one['p']:.1g}), as that of the true cause would not: look for one that the catalogue lacks."
    )


def outside_words(one: Mapping[str, Any]) -> str:
    """Return a cause that an effect outside the catalogue beats as a sentence, plain text."""
    return (
        f"Not stated: {plain_name(one['id'])}. Of the causes it fits best, but {one['nearest']} explains the data as "
        f"well ({one['kinds'][one['nearest_id']]:.1f} nats, the cause {one['log_bayes_factor']:.1f})."
    )


def family_words(one: Mapping[str, Any]) -> str:
    """Return that the data hold the family of a cause alone as a sentence, plain text."""
    return f"These data hold its family alone, {one['words']}: {one['reason']}. It may be one that the catalogue lacks."


def gloss(cause: str) -> str:
    """Return one line of text that explains a cause, given its id."""
    if cause == UNKNOWN:
        return "Any smooth change over the body, the load and time, without a physical cause."
    return ((type(CAUSES[cause]).__doc__ if cause in CAUSES else None) or "").partition("\n")[0].partition(" (`")[0]


def rankings(found: "BodyDiagnosis") -> str:
    """Return the chart of causes in the first round, and those of later rounds in collapsed sections, as HTML."""
    thresholds = {} if found.details is None else found.details.thresholds
    steps = [] if found.details is None else found.details.search.steps
    # Findings are in the order of the steps; only the modulus may precede them.
    first = max(0, len(found.findings) - sum(step.found is not None for step in steps))
    rounds = [number for number, step in enumerate(steps) if step.found is not None]
    groups = {number: set(one.group) for number, one in zip(rounds, found.findings[first:], strict=False)}
    early = {name for finding in found.findings[: first if steps else None] for name in finding.group}
    parts = [ranking(found.candidates, thresholds, early | groups.get(0, set()), "First round")]
    for number, step in enumerate(steps[1:], start=1):
        title = f"Round {number + 1}: further causes, given {', '.join(map(plain_name, step.given))}"
        chart = ranking(_rows(step), thresholds, groups.get(number, set()), title)
        parts.append(f"<details><summary>{escape(title)}</summary>{chart}</details>")
    return "\n".join(parts)


def ranking(rows: Sequence[Mapping[str, Any]], thresholds: Mapping[str, float], named: "set[str]", title: str) -> str:
    """Return a chart of the log Bayes factors of causes in one round, as HTML.

    `rows`: one mapping for each cause, with ``id``, ``log_bayes_factor`` in nats, and optionally ``probability`` and
    ``detectability``; `thresholds`: nats by id, drawn as lines across the bars; `named`: ids that are highlighted as
    found; `title`: plain text.
    """
    if not rows:
        return "<p>No cause of the catalogue applies to this experiment.</p>"
    values = [float(row["log_bayes_factor"]) for row in rows]
    limits = [thresholds.get(str(row["id"])) for row in rows]
    most = max([_scaled(v) for v in [*values, *(limit for limit in limits if limit is not None)]] + [1.0])
    least = min([_scaled(max(v, _LEAST)) for v in values] + [0.0])
    across = svg.PixelScale(least, most, _LEFT, _WIDTH - _RIGHT)
    bottom = 26.0 + _ROW * len(rows)
    columns: tuple[tuple[str, str, float, str, Callable[[float], str]], ...] = (
        ("log_bayes_factor", "log Bayes factor", _WIDTH - _RIGHT + 10.0, "start", "{:.1f}".format),
        ("probability", "probability", _WIDTH - 80.0, "end", chance),
        ("detectability", "size, sd", _WIDTH, "end", "{:.1f}".format),
    )
    columns = tuple(column for column in columns if column[0] in rows[0])
    parts = [svg.text(x, 12.0, head, anchor, more="font-size='11'") for _, head, x, anchor, _ in columns]
    for tick in (*(-t for t in _TICKS), 0.0, *_TICKS):
        if least <= _scaled(tick) <= most:
            parts.append(svg.upright(across(_scaled(tick)), 20.0, bottom, "#e3e6ea"))
            parts.append(svg.text(across(_scaled(tick)), bottom + 13.0, f"{tick:g}", "middle", more="font-size='10'"))
    for i, (row, value, limit) in enumerate(zip(rows, values, limits, strict=True)):
        y = 22.0 + _ROW * i
        found, name = row["id"] in named, str(row["id"])
        colour = svg.AFTER if found else svg.GENERIC
        weight = "font-size='12' font-weight='700'" if found else "font-size='12'"
        line, tip = "", gloss(name)
        if limit is not None:
            line = svg.upright(across(_scaled(limit)), y, y + _ROW, "#a3180d", "stroke-width='1.5'")
            tip += f" (threshold {limit:.1f})"
        parts.append(
            f"<g><title>{escape(tip)}</title>"
            + svg.text(_LEFT - 8.0, y + 14.0, plain_name(name), "end", more=weight)
            + svg.bar(across(0.0), y + 3.0, across(_scaled(max(value, _LEAST))) - across(0.0), _ROW - 6.0, colour)
            + "".join(svg.text(x, y + 14.0, said(row[key]), anchor, more=weight) for key, _, x, anchor, said in columns)
            + line
            + "</g>"
        )
    parts.append(svg.upright(across(0.0), 20.0, bottom, "#555"))
    return svg.picture(_WIDTH, bottom + 20.0, parts, title)


def chance(probability: float) -> str:
    """Return a probability as text with two digits, never as 0 or 1."""
    if probability > 0.995:
        return "> 0.99"
    return f"{probability:.2f}" if probability >= 0.005 else "< 0.01"


def _scaled(value: float) -> float:
    """Return sign(value) log10(1 + abs(value)): an axis that is linear about zero and logarithmic far away."""
    return math.copysign(math.log10(1.0 + abs(value)), value)


def _rows(step: "Step") -> list[dict[str, Any]]:
    """Return the causes tried in a later round, likeliest first; those of the model before only if fitted again."""
    known = {*step.given} - {candidate.id for candidate in step.candidates}
    order = sorted(step.gains().items(), key=lambda item: -item[1])
    return [{"id": name, "log_bayes_factor": gain} for name, gain in order if name not in known]
