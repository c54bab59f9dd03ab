"""Text around the views of a registration: verdict and reasons above, legend below."""

import math
import textwrap
from typing import TYPE_CHECKING, Any

from tissuereg.report import scene
from tissuereg.report.style import STYLE
from tissuereg.report.words import contacts_of, counted, silent, start_word, surface_of, verdict

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration


def write_heading(figure: Any, result: "Registration") -> float:
    """Write the verdict, large, with its reasons.

    `result`: the result that is described. Result: lower end of the text, over the figure's height.
    """
    trust = result.trust
    good = "#176f2c" if trust.ok else "#a3180d"
    figure.text(0.02, 0.972, verdict(trust.ok), fontsize=19, weight="bold", va="top", color=good)
    chance = f"chance of this misfit p = {trust.p_value:.2g}"
    facts = "   |   ".join([*_met(result), *([chance] if math.isfinite(trust.p_value) else [])])
    figure.text(0.02, 0.915, facts, fontsize=10, va="top")
    lines = [line for reason in trust.reasons[: STYLE.reasons] for line in _wrapped(reason, "• ", "   ")]
    more = len(trust.reasons) - STYLE.reasons
    if more > 0:
        lines.append(f"• and {more} more in the report")
    coloured = [(line, "#a3180d") for line in lines]
    flagged = [name for name, target in result.targets.items() if target.flag]
    if flagged:
        coloured += [(line, scene.FLAGGED) for line in _wrapped(silent(flagged))]
    for row, (line, colour) in enumerate(coloured):
        figure.text(0.02, 0.882 - STYLE.line * row, line, fontsize=9.5, va="top", color=colour)
    return 0.882 - STYLE.line * len(coloured)


def _wrapped(text: str, first: str = "", later: str = "") -> list[str]:
    """Return the wrapped lines of a text; a text that is too long ends in dots."""
    return textwrap.wrap(
        text, STYLE.letters, max_lines=STYLE.lines, placeholder=" …", initial_indent=first, subsequent_indent=later
    )


def _met(result: "Registration") -> list[str]:
    """Return how far the data lay from the body before and after."""
    fit, surface, words, start = result.markers, surface_of(result), [], start_word(result.starts_simulated)
    if fit.used:
        words.append(
            f"{counted(len(fit.used), 'marker')}: {fit.before_rms_mm:.2f} mm {start}, "
            f"{fit.after_rms_mm:.2f} mm after (rms)"
        )
    if surface is not None:
        words.append(
            f"{counted(surface.used, 'surface point')}: {surface.before_rms_mm:.2f} mm {start}, "
            f"{surface.after_rms_mm:.2f} mm after"
        )
    return words or ["no marker was used"]


def write_legend(figure: Any, result: "Registration") -> None:
    """Write a legend below the views, with the signs that are drawn and no others."""
    signs = [_sign(*sign[:2], **sign[2]) for sign in _signs(result)]
    figure.legend(handles=signs, loc="lower left", bbox_to_anchor=(0.012, 0.0), ncols=STYLE.columns, fontsize=10,
                  frameon=False, columnspacing=1.6, handletextpad=0.5, labelspacing=0.35)  # fmt: skip


def _sign(label: str, colour: str, **style: Any) -> Any:
    from matplotlib.lines import Line2D

    return Line2D([], [], color=colour, label=label, **{"ls": "none", **style})


def _signs(result: "Registration") -> list[tuple[str, str, dict[str, Any]]]:
    """Return label, colour and style of every sign that the picture uses."""
    signs: list[tuple[str, str, dict[str, Any]]] = []
    if len(result.all_markers):
        signs += [
            ("before", scene.BEFORE, {"marker": "x", "ms": 6, "mew": 1.8}),
            ("marker, registered", scene.FITTED, {"marker": "o", "ms": 4.5}),
            ("marker, measured", scene.MEASURED, {"marker": "o", "ms": 7, "mfc": "none"}),
        ]
    if surface_of(result) is not None:
        signs.append(("surface points", scene.MEASURED, {"marker": ".", "ms": 4}))
    reasons = {reason for _, reason in result.markers.dropped}
    if "wrong" in reasons:
        signs.append(("wrong marker, not used", scene.WRONG, {"marker": "X", "ms": 8}))
    if "not seen" in reasons:
        signs.append(("not seen: where it must be", "dimgray", {"marker": "$?$", "ms": 7}))
    if contacts_of(result):
        signs.append(("contact: force on the body", scene.CONTACT, {"marker": r"$\rightarrow$", "ms": 12}))
    flags = {target.flag is not None for target in result.targets.values()}
    if False in flags:
        signs.append(("target, 90 % region", scene.TARGET, {"ls": "-", "lw": 1.2, "marker": "+", "ms": 7}))
    if True in flags:
        signs.append(("target, no marker tells", scene.FLAGGED, {"ls": "--", "lw": 1.2, "marker": "+", "ms": 7}))
    return signs
