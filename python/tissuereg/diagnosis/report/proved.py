"""Tables and charts of the models' errors on held-out data, against the noise floor."""

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from tissuereg.diagnosis.proof import BELIEVED, GENERIC, NAMED
from tissuereg.diagnosis.report.ranking import plain_name
from tissuereg.report import svg
from tissuereg.report.markup import escape, table

if TYPE_CHECKING:
    from tissuereg.diagnosis.answer import BodyDiagnosis, Finding
    from tissuereg.diagnosis.proof import HeldOut
    from tissuereg.diagnosis.signals import SignalLayout

_MODELS = (
    ("base", "believed model", svg.BEFORE),
    ("named", "with the cause", svg.AFTER),
    ("generic", "with a generic patch", svg.GENERIC),
)


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
    if not parts:
        return "<p>No finding was proved on data held out.</p>"
    return "\n".join(parts)


def proofs_of(found: "BodyDiagnosis") -> dict[int, "HeldOut"]:
    """Return the held-out predictions of every finding by its number; a finding of the modulus has none."""
    steps = [] if found.details is None else [step for step in found.details.search.steps if step.found is not None]
    # Findings are in the order of the steps; only the modulus may precede them.
    first = len(found.findings) - len(steps)
    return {first + i: step.figures for i, step in enumerate(steps) if step.figures is not None}


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
    log_density = (
        f"<p>Held-out data are e<sup>{held['log_density_gain']:.1f}</sup> times as likely with the cause as without "
        "it.</p>"
    )
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
        groups.append(
            (part.name, [(name, float(x), colour) for (_, name, colour), x in zip(_MODELS, chi, strict=True)])
        )
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
