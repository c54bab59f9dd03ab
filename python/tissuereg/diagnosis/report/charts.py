"""The charts of the page, and what is said beside them: the evidence of causes, errors on held-out data, residuals.

Charts of the log Bayes factors of all causes that were tried, with their thresholds; tables and charts of the models'
errors on data that were held out, against the noise floor; and the residual over time in every case, before and after
the findings, against the noise.
"""

import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.stats import chi2

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.proof import BELIEVED, GENERIC, NAMED
from tissuereg.diagnosis.screen import UNKNOWN
from tissuereg.report import svg
from tissuereg.report.markup import escape, table

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import BodyDiagnosis, DiagnosisDetails, Finding
    from tissuereg.diagnosis.proof import HeldOut
    from tissuereg.diagnosis.search import Step
    from tissuereg.diagnosis.signals import CasePart, SignalLayout
    from tissuereg.experiment.experiment import Case, Experiment

#: Share of frames that lie in the band where there is noise alone.
SHARE = 0.95

#: Number of frames in a line, at most; of longer cases, the worst frame of every few.
MOST_FRAMES = 800

_WIDTH, _LEFT, _RIGHT, _ROW = 900.0, 160.0, 250.0, 21.0
_TICKS = (1.0, 3.0, 10.0, 30.0, 100.0, 300.0, 1e3, 1e4, 1e5, 1e6)

#: Both ends of axes of time.
_TIMES = (60.0, 880.0)

#: Lower end of the bars: differences among unlikely causes are of no interest.
_LEAST = -10.0

_MODELS = (
    ("base", "believed model", svg.BEFORE),
    ("named", "with the cause", svg.AFTER),
    ("generic", "with a generic patch", svg.GENERIC),
)


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
        f"Not stated: {plain_name(one['id'])}. It fits, but its change differs by {one['differs_by']} (p = "
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
    stated = _stated(found)
    groups = {number: set(found.findings[finding].group) for number, finding in stated.items()}
    early = {name for i, finding in enumerate(found.findings) if i not in stated.values() for name in finding.group}
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


def proved(found: "BodyDiagnosis") -> str:
    """Return the errors of every finding on data that were left out of its fit, as HTML."""
    details, proofs = found.details, proofs_of(found)
    parts = []
    for number, finding in enumerate(found.findings):
        if not finding.held_out:
            continue
        title = f"<h3>{escape(plain_name(finding.id))}</h3>"
        proof = proofs.get(number)
        by_case = "" if details is None or proof is None else _by_case(proof, details.target.bench.layout)
        parts.append(title + _overall(finding) + by_case)
    return "\n".join(parts) or "<p>No finding was proved on data held out.</p>"


def proofs_of(found: "BodyDiagnosis") -> dict[int, "HeldOut"]:
    """Return the held-out predictions of every finding by its number; a finding of the modulus has none."""
    steps = [] if found.details is None else found.details.search.steps
    return {finding: held for number, finding in _stated(found).items() if (held := steps[number].figures) is not None}


def _stated(found: "BodyDiagnosis") -> dict[int, int]:
    """Return the numbers of the findings by those of the rounds that found them."""
    rounds = {} if found.details is None else found.details.search.rounds()
    ids = [finding.id for finding in found.findings]
    stated = [number for number, (_, top) in rounds.items() if top.id in ids]
    # Findings are in the order of the rounds; only the modulus may precede them.
    return {number: len(ids) - len(stated) + i for i, number in enumerate(stated)}


def gain_words(finding: "Finding") -> str:
    """Return a finding's errors on held-out data in a sentence, plain text; empty where nothing was held out."""
    held = finding.held_out
    if not held:
        return ""
    better = "better" if held["chi_named"] < held["chi_generic"] else "no better"
    before, after = (f"{held[f'rms_{key}_mm']:.3f}" for key in ("base", "named"))
    change = f"falls from {before} to {after}" if float(after) < float(before) else f"goes from {before} to {after}"
    change = f"stays at {before}" if after == before else change
    return (
        f"On data that were not fitted ({blocks_words(held['cases'])}) the residual of a marker's coordinate {change} "
        f"mm (rms), where noise alone is {held['noise_mm']:.3f} mm; a generic patch without a physical cause leaves "
        f"{held['rms_generic_mm']:.3f} mm. For markers and forces together the cause predicts {better} than the patch: "
        f"{held['chi_named']:.2f} against {held['chi_generic']:.2f} noise deviations."
    )


def blocks_words(blocks: Sequence[str]) -> str:
    """Return the names of held-out blocks of data as plain text; blocks of frames of one case are joined.

    `blocks`: names of cases, or of every nth frame of one case from the first, the second, and so on.

    Examples
    --------
    >>> blocks_words(["push", "pull"])
    'push, pull'
    >>> blocks_words(["push, every 2th frame from 0", "push, every 2th frame from 1"])
    'push, every 2nd frame in turn'
    """
    names = []
    for block in map(str, blocks):
        found = re.fullmatch(r"(.*), every (\d+)th frame from \d+", block, re.DOTALL)
        if found is None:
            names.append(block)
        else:
            ending = {"2": "nd", "3": "rd"}.get(found[2], "th")
            names.append(f"{found[1]}, every {found[2]}{ending} frame in turn")
    return ", ".join(dict.fromkeys(names))


def _overall(finding: "Finding") -> str:
    held = finding.held_out
    rows = [(name, f"{held[f'rms_{key}_mm']:.3f}", f"{held[f'chi_{key}']:.2f}") for key, name, _ in _MODELS]
    rows.append(("noise floor", f"{held['noise_mm']:.3f}", "1.00"))
    head = ("held out", "markers, rms of a coordinate, mm", "markers and forces, noise deviations")
    times = f"e<sup>{held['log_density_gain']:.1f}</sup> times"
    log_density = f"<p>Held-out data are {times} as likely with the cause as without it.</p>"
    bars = [(name, float(held[f"chi_{key}"]), colour) for key, name, colour in _MODELS]
    return _bars([("all", bars)]) + table(head, rows) + log_density


def _by_case(proof: "HeldOut", layout: "SignalLayout") -> str:
    rows, groups = [], []
    for part in layout.parts:
        mine = layout.of_case(part.name) & layout.seen & np.isfinite(proof.residuals).all(axis=0)
        if not mine.any():
            continue
        chi = np.sqrt((proof.residuals[[BELIEVED, NAMED, GENERIC]][:, mine] ** 2).mean(axis=1))
        rows.append((escape(part.name), str(int(mine.sum())), *(f"{x:.2f}" for x in chi)))
        bars = [(name, float(x), colour) for (_, name, colour), x in zip(_MODELS, chi, strict=True)]
        groups.append((part.name, bars))
    if len(rows) < 2:
        return ""
    head = ("case held out, noise deviations", "numbers", *(name for _, name, _ in _MODELS))
    return _bars(groups) + table(head, rows)


def _bars(groups: list[tuple[str, list[tuple[str, float, str]]]]) -> str:
    left, width, row = 250.0, 900.0, 18.0
    across = svg.PixelScale(0.0, 1.05 * max([1.0] + [x for _, bars in groups for _, x, _ in bars]), left, width - 60.0)
    parts, at = [], 18.0
    for title, bars in groups:
        for i, (name, value, colour) in enumerate(bars):
            label = f"{title}: {name}" if len(groups) > 1 and i == 0 else name
            parts.append(svg.text(left - 8.0, at + 12.0, label, "end", more="font-size='12'"))
            parts.append(svg.bar(left, at + 2.0, across(value) - left, row - 5.0, colour))
            parts.append(svg.text(across(value) + 5.0, at + 12.0, f"{value:.2f}", more="font-size='11'"))
            at += row
        at += 6.0
    parts.append(svg.upright(across(1.0), 14.0, at, svg.FLOOR, "stroke-width='1.6' stroke-dasharray='5 3'"))
    parts.append(svg.text(across(1.0), 11.0, "noise floor", "middle", svg.FLOOR, "font-size='11'"))
    return svg.picture(width, at + 4.0, parts, "Residuals on held-out data over noise")


@dataclass(frozen=True, eq=False)
class ChannelCurve:
    """Residuals of the markers, or of one pad's force, in one case over time, in noise deviations.

    `title`: name of the curve; `times` (n_frames,): s; `before`, `after` (n_frames,): root mean squares over the
    components before and after the findings are included; NaN where nothing was measured; `low`, `high` (n_frames,):
    band in which noise alone lies in `SHARE` of all frames.
    """

    title: str
    times: FloatArray
    before: FloatArray
    after: FloatArray
    low: FloatArray
    high: FloatArray

    def worst(self, most: int = MOST_FRAMES) -> "ChannelCurve":
        """Return the curve in at most `most` frames: of every few successive ones the one with the largest `before`."""
        stride = -(-len(self.times) // most)
        size = np.where(np.isfinite(self.before), self.before, -1.0)
        rows = [i + int(np.argmax(size[i : i + stride])) for i in range(0, len(size), stride)]
        every = (self.times, self.before, self.after, self.low, self.high)
        return ChannelCurve(self.title, *(values[rows] for values in every))


def curves(details: "DiagnosisDetails") -> dict[str, list[ChannelCurve]]:
    """Return the curves of every case by its name: one of the markers, then one of every measured force.

    Residuals are whitened by noise and nuisances (tracker frame, drift, discretisation error), so that a correct model
    leaves uncorrelated noise of unit variance.
    """
    search, target, layout = details.search, details.target, details.target.bench.layout
    before = target.null.reduced(search.base.residual)
    after = target.null.reduced(search.final.residual)
    if search.final.parts and len(search.reduced):
        # Reduced also by the parameters of the causes found and by their discretisation error.
        after = search.reduced
    rows, charts = (before, after, layout.seen.astype(np.float64)), {}
    for part in layout.parts:
        several = [_curve("markers", part, *(part.markers(flat) for flat in rows))]
        for i, pad in enumerate(part.pads):
            several.append(_curve(f"force at {pad}", part, *(part.forces(flat)[:, i] for flat in rows)))
        charts[part.name] = [curve for curve in several if np.isfinite(curve.before).any()]
    return charts


def histories(extended: "Experiment", details: "DiagnosisDetails") -> str:
    """Return the charts of residuals over time in all cases of an experiment, as HTML."""
    parts = [
        f"<h3>{escape(name)}</h3>" + _chart(name, several, _load(extended.cases[name]))
        for name, several in curves(details).items()
        if several
    ]
    return "\n".join(parts)


def _curve(title: str, part: "CasePart", before: FloatArray, after: FloatArray, seen: FloatArray) -> ChannelCurve:
    count = seen.reshape(part.n_frames, -1).sum(axis=1)
    known = np.maximum(count, 1.0)

    def chi(white: FloatArray) -> FloatArray:
        power = (white.reshape(part.n_frames, -1) ** 2).sum(axis=1)
        return np.asarray(np.where(count > 0, np.sqrt(power / known), np.nan))

    low, high = (np.sqrt(chi2.ppf(p, known) / known) for p in (0.5 - SHARE / 2, 0.5 + SHARE / 2))
    return ChannelCurve(title, part.times, chi(before), chi(after), low, high)


def _load(case: "Case") -> dict[str, FloatArray]:
    """Return the size of every actuator's motion or force over its largest, each (n_frames,), by a label."""
    load = {}
    for given, unit in ((case.displacements, "mm"), (case.applied_forces, "mN")):
        for name, values in given.items():
            size = np.linalg.norm(values, axis=1)
            top = float(np.nanmax(size)) if len(size) else 0.0
            if top > 0.0:
                load[f"{name}, up to {top:.3g} {unit}"] = size / top
    return load


def _chart(name: str, several: list[ChannelCurve], load: dict[str, FloatArray]) -> str:
    times = several[0].times
    across = svg.PixelScale(float(times[0]), float(times[-1]), *_TIMES)
    parts, at = [], 4.0
    for curve in several:
        parts.append(_panel(curve.worst(), across, at, 120.0))
        at += 148.0
    if load:
        parts.append(_load_panel(load, times, across, at))
        at += 70.0
    parts += [svg.text(across(t), at + 6.0, f"{t:g}", "middle", more="font-size='11'") for t in across.ticks(8)]
    parts.append(svg.text(_TIMES[1], at + 22.0, "time, s", "end", more="font-size='12'"))
    return svg.picture(_WIDTH, at + 28.0, parts, f"Residuals of case {name} over time")


def _panel(curve: ChannelCurve, across: svg.PixelScale, top: float, height: float) -> str:
    largest = float(np.nanmax([curve.before, curve.after, curve.high]))
    up = svg.PixelScale(0.0, 1.08 * largest, top + height, top + 16.0)
    x = np.array([across(t) for t in curve.times])
    if len(x) == 1:
        high, low = up(curve.high[0]), up(curve.low[0])
        band = svg.bar(x[0] - 8.0, high, 16.0, low - high, svg.FLOOR, "opacity='.2'")
    else:
        edge = [f"{a:.1f},{up(b):.1f}" for a, b in zip(x, curve.high, strict=True)]
        edge += [f"{a:.1f},{up(b):.1f}" for a, b in zip(x[::-1], curve.low[::-1], strict=True)]
        band = f"<polygon points='{' '.join(edge)}' fill='{svg.FLOOR}' opacity='.2'/>"
    parts = [
        svg.text(_TIMES[0], top + 11.0, f"{curve.title}: residual over noise", more="font-size='12' font-weight='600'"),
        *(
            svg.level(up(tick), *_TIMES, "#e3e6ea")
            + svg.text(_TIMES[0] - 6.0, up(tick) + 4.0, f"{tick:g}", "end", more="font-size='11'")
            for tick in up.ticks(4)
        ),
        band,
        svg.line(x, np.array([up(y) for y in curve.before]), svg.BEFORE, "stroke-width='1.8'"),
        svg.line(x, np.array([up(y) for y in curve.after]), svg.AFTER, "stroke-width='1.8'"),
    ]
    return "".join(parts)


def _load_panel(load: dict[str, FloatArray], times: FloatArray, across: svg.PixelScale, top: float) -> str:
    up = svg.PixelScale(0.0, 1.05, top + 56.0, top + 18.0)
    stride = -(-len(times) // MOST_FRAMES)
    x = np.array([across(t) for t in times[::stride]])
    parts = [
        svg.text(_TIMES[0], top + 11.0, f"load: {'; '.join(load)}", more="font-size='12' font-weight='600'"),
        svg.level(up(0.0), *_TIMES, "#9aa2ab"),
    ]
    dashes = ("", "stroke-dasharray='6 3'", "stroke-dasharray='2 3'")
    for i, share in enumerate(load.values()):
        y = np.array([up(size) for size in share[::stride]])
        parts.append(svg.line(x, y, "#444", f"stroke-width='1.4' {dashes[i % 3]}"))
    return "".join(parts)
