"""One self-contained HTML page of a registration."""

import base64
import io
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from tissuereg.io.atomic import atomic_file
from tissuereg.report.markup import document, escape, table

if TYPE_CHECKING:
    from tissuereg.result import Registration


def write_page(result: "Registration", path: Path) -> Path:
    """Write the page, whole or not at all.

    Parameters
    ----------
    result : Registration
        What to show.
    path : Path
        File to write.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    OutputError
        If the file cannot be written.
    """
    parts = [
        _summary(result),
        _picture(result),
        _targets(result),
        _markers(result),
        _surface(result),
        _model(result),
        _times(result),
    ]
    text = document("Registration", parts)
    with atomic_file(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return path


def _summary(result: "Registration") -> str:
    trust = result.trust
    verdict = "<b class='yes'>Nothing speaks against this result.</b>" if trust.ok else "<b class='no'>Be careful.</b>"
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in trust.reasons)
    return (
        f"<h1>Registration</h1><p>{verdict} {_met(result)} Misfit {trust.chi_square:.1f} for {trust.n_obs} measured "
        f"coordinates, p = {trust.p_value:.2g}. Smallest volume ratio of a tet {result.min_det_f:.2f}, "
        f"{result.inverted_tets} inverted.</p>"
        f"<ul>{reasons}</ul>"
    )


def _met(result: "Registration") -> str:
    """Return how far the data lie from the registered body, in sentences."""
    fit, surface, words = result.markers, result.surface, []
    if fit.used:
        words.append(
            f"{len(fit.used)} markers lie {fit.after_rms_mm:.2f} mm (rms) from the registered body, "
            f"{fit.before_rms_mm:.2f} mm before."
        )
    if surface is not None:
        words.append(
            f"{surface.used} of {surface.points} surface points lie {surface.after_rms_mm:.2f} mm (rms) from its "
            f"surface, {surface.before_rms_mm:.2f} mm before."
        )
    return " ".join(words)


def _picture(result: "Registration") -> str:
    stream = io.BytesIO()
    result.plot().savefig(stream, dpi=110, format="png")
    data = base64.b64encode(stream.getvalue()).decode("ascii")
    return f"<img alt='body before and after' src='data:image/png;base64,{data}'>"


def _targets(result: "Registration") -> str:
    rows = [
        (
            escape(name),
            _triple(t.reference),
            _triple(t.mean),
            _triple(t.region(0.90).radii),
            _norm(t.mean - t.reference),
        )
        for name, t in {**result.targets, **{f"{n} (not seen)": t for n, t in result.unseen.items()}}.items()
    ]
    if not rows:
        return ""
    head = ("target", "undeformed, mm", "registered, mm", "90 % region, half-axes, mm", "moved, mm")
    return "<h2>Targets</h2>" + table(head, rows)


def _markers(result: "Registration") -> str:
    rows = [(escape(name), _triple(row), _norm(row)) for name, row in result.markers.residual_mm.items()]
    rows += [(escape(name), escape(reason), "") for name, reason in result.markers.dropped]
    if not rows:
        return ""
    return "<h2>Markers</h2>" + table(("marker", "measured - registered, mm", "length, mm"), rows)


def _surface(result: "Registration") -> str:
    surface = result.surface
    if surface is None:
        return ""
    rows = [
        ("points", str(surface.points)),
        ("thinned from", "-" if surface.thinned_from is None else str(surface.thinned_from)),
        ("outliers", str(len(surface.outliers))),
        ("distance along the normal before, mm rms", f"{surface.before_rms_mm:.2f}"),
        ("distance along the normal after, mm rms", f"{surface.after_rms_mm:.2f}"),
    ]
    return "<h2>Surface</h2>" + table(("", ""), rows)


def _model(result: "Registration") -> str:
    rows = [
        (key.replace("_", " "), escape(f"{v:.3g}" if isinstance(v, float) else str(v)))
        for key, v in result.model.items()
    ]
    return "<h2>Model</h2>" + table(("", ""), [*rows, ("seed", str(result.seed))])


def _times(result: "Registration") -> str:
    rows = [(stage, f"{1000 * seconds:.0f}") for stage, seconds in result.seconds.items()]
    return "<h2>Time</h2>" + table(("stage", "ms"), rows)


def _triple(vector: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> str:
    return ", ".join(f"{x:.2f}" for x in vector)


def _norm(vector: "np.ndarray[tuple[int], np.dtype[np.float64]]") -> str:
    return f"{float(np.linalg.norm(vector)):.2f}"
