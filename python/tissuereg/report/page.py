"""A self-contained HTML page that reports one registration."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.io.atomic import atomic_file
from tissuereg.report.markup import document, escape, table
from tissuereg.report.provenance import provenance_section
from tissuereg.report.registered import registered_scene
from tissuereg.report.scene import Surface, contact_verb, contacts_of, surface_of
from tissuereg.report.section import sections
from tissuereg.report.viewer import viewer, viewer_script
from tissuereg.report.words import fallback_lines, markers_used, silent, start_word, verdict

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration

_STYLE = """
.verdict { font-size: 1.9rem; font-weight: bold; margin: .5rem 0; } .silent { color: #7a12a8; }
.sections { display: grid; grid-template-columns: repeat(auto-fit, minmax(max(9.5rem, 30%), 1fr)); gap: .8rem; }
figure { margin: 0; } figcaption { text-align: center; font-size: 13.5px; color: #59626c; }
svg { display: block; border-radius: 6px; } @media (max-width: 40rem) { .verdict { font-size: 1.4rem; } }
"""


def write_page(result: "Registration", path: Path, *, picture: bool = True, image: Any = None) -> Path:
    """Write the HTML page of a registration, whole or not at all; return its path, or raise OutputError.

    `picture`: whether the body is drawn; `image`: file of an image of the undeformed body, laid under sections.
    """
    parts = [
        _summary(result),
        *(
            [f"<h2>The body</h2>{viewer(registered_scene(result))}", sections(result, image)]
            if picture or image is not None
            else []
        ),
        _contacts(result),
        _explained(result),
        _targets(result),
        _dropped(result),
        _markers(result),
        _surface(result),
        _model(result),
        _work(result),
        _times(result),
        provenance_section(result.to_json()["provenance"], _believed(result)),
        viewer_script() if picture or image is not None else "",
    ]
    text = document("Registration", parts, _STYLE)
    with atomic_file(path) as draft:
        draft.write_text(text, encoding="utf-8")
    return path


def _summary(result: "Registration") -> str:
    trust = result.trust
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in trust.reasons)
    left = [] if result.fallback is None else fallback_lines(result.fallback.targets)
    flagged = [name for name, target in result.targets.items() if target.flag]
    return (
        f"<h1>Registration</h1><p class='verdict {'yes' if trust.ok else 'no'}'>{verdict(trust.ok)}</p>"
        + (f"<ul class='no'>{reasons}</ul>" if reasons else "")
        + (f"<p class='silent'>{escape(silent(flagged))}</p>" if flagged else "")
        + "".join(f"<p>{escape(line)}</p>" for line in left)
        + f"<p>{_met(result)} Misfit {trust.chi_square:.1f} for {trust.n_obs} measured "
        f"coordinates, p = {trust.p_value:.2g}. Smallest volume ratio of a tet {result.min_det_f:.2f}, "
        f"{result.inverted_tets} inverted.</p><p>{result.checked}</p>"
    )


def _met(result: "Registration") -> str:
    """Return sentences on the distance of markers and surface points from the registered body, in mm (rms)."""
    fit, surface, words = result.markers, surface_of(result), []
    if fit.used:
        words.append(
            f"{markers_used(fit.used, fit.inner)}: {fit.after_rms_mm:.2f} mm (rms) from the registered body, "
            f"{fit.before_rms_mm:.2f} mm {start_word(result.starts_simulated)}."
        )
    if surface is not None:
        words.append(
            f"{surface.used} of {surface.points} surface points lie {surface.after_rms_mm:.2f} mm (rms) from its "
            f"surface, {surface.before_rms_mm:.2f} mm before."
        )
    return " ".join(words)


def _contacts(result: "Registration") -> str:
    if not contacts_of(result):
        return ""
    surface = Surface.of(result)
    rows = []
    for contact in contacts_of(result):
        node = surface.nearest(contact.centre_mm, result.mesh.nodes)
        rows.append(
            (
                contact_verb(contact, surface.normals[node]),
                _triple(contact.centre_mm, 1),
                f"{contact.place_std_mm:.0f}",
                f"{contact.radius_mm:.1f}",
                _triple(contact.direction),
                f"{contact.size_mm:.1f}",
                f"{contact.force_mN:,.0f}",
                f"{contact.probability:.2f}",
            )
        )
    head = (
        "",
        "centre on the undeformed surface, mm",
        "its standard deviation, mm",
        "radius, mm",
        "direction of the force on the body",
        "surface moved, mm",
        "force at the believed modulus, mN",
        "probability of one somewhere there",
    )
    return _section("Contacts", head, rows)


def _targets(result: "Registration") -> str:
    rows = [
        (
            escape(name),
            _triple(t.reference),
            _triple(t.mean),
            _triple(t.region(0.90).radii),
            _norm(t.mean - t.reference),
            "" if t.constrained is None else f"{t.constrained:.2f}",
            f"<span class='silent'>{escape(t.flag)}</span>" if t.flag else "",
        )
        for name, t in result.targets.items()
    ]
    head = ("target", "undeformed, mm", "registered, mm", "90 % region, half-axes, mm", "moved, mm", "constrained", "")
    note = (
        "<p>Constrained: the share of a target's variance under undetected contacts that the markers remove; "
        "1 is best.</p>"
    )
    known = any(target.constrained is not None for target in result.targets.values())
    return _section("Targets", head, rows) + (note if known else "")


def _dropped(result: "Registration") -> str:
    rows = [
        (
            escape(name),
            escape(reason),
            _triple(result.unseen[name].mean),
            _triple(result.unseen[name].region(0.90).radii),
        )
        for name, reason in result.markers.dropped
    ]
    head = ("marker", "reason", "where a tracker would see it, mm", "90 % region, half-axes, mm")
    return _section("Markers that are not used", head, rows)


def _markers(result: "Registration") -> str:
    fit = result.markers
    rows = [
        (escape(name), "inside" if name in fit.inner else "to the skin", _triple(row), _norm(row))
        for name, row in fit.residual_mm.items()
    ]
    return _section("Markers", ("marker", "attached", "measured - registered, mm", "length, mm"), rows)


def _surface(result: "Registration") -> str:
    surface = surface_of(result)
    if surface is None:
        return ""
    rows = [
        ("points", str(surface.points)),
        ("thinned from", "-" if surface.thinned_from is None else str(surface.thinned_from)),
        ("outliers", str(len(surface.outliers))),
        ("distance along the normal before, mm rms", f"{surface.before_rms_mm:.2f}"),
        ("distance along the normal after, mm rms", f"{surface.after_rms_mm:.2f}"),
    ]
    return _section("Surface", ("", ""), rows)


def _model(result: "Registration") -> str:
    rows = [
        (key.replace("_", " "), escape(f"{v:.3g}" if isinstance(v, float) else str(v)))
        for key, v in result.model.items()
    ]
    return _section("Model", ("", ""), [*rows, ("seed", str(result.seed))])


def _explained(result: "Registration") -> str:
    parts: dict[str, float] = getattr(result, "explained_mm", {})
    rows = [(name, f"{size:.2f}") for name, size in parts.items()]
    return _section("What explains the motion", ("", "mm rms over the body"), rows)


def _work(result: "Registration") -> str:
    counts: dict[str, int] = getattr(result, "work", {})
    rows = [(name.replace("_", " "), f"{count:,}") for name, count in counts.items()]
    return _section("Work", ("", "count"), rows)


def _times(result: "Registration") -> str:
    rows = [(stage, f"{1000 * seconds:.0f}") for stage, seconds in result.seconds.items()]
    return _section("Time", ("stage", "ms"), rows)


def _believed(result: "Registration") -> list[tuple[str, str]]:
    """Return what was believed before: noise, supports, material, elements and seed, each with words for it."""
    body, surface = result.body, surface_of(result)
    noise = [f"{_range(result.all_markers.axis_std, 'mm')} of a marker's coordinate"] if len(result.all_markers) else []
    noise += [] if surface is None else [f"{surface.std_mm:g} mm of a surface point along the normal"]
    held = len(result.mesh.node_sets.get("fixed", ()))
    law = body.material
    return [
        ("noise (standard deviation)", "; ".join(noise) or "none"),
        ("supports", f"{held} nodes in the set 'fixed', held: {body.held}; tracker: {result.tracker}"),
        (
            "material",
            f"{law.law}, Young's modulus {_range(law.young_array, 'kPa')} ({body.stiffness}), Poisson's ratio "
            f"{_range(law.poisson_array)}, {law.density:g} g/cm^3",
        ),
        ("elements", body.element),
        ("seed", str(result.seed)),
    ]


def _range(values: FloatArray, unit: str = "") -> str:
    """Return the smallest and the largest of some numbers, or the number if all are the same, with their unit."""
    low, high = float(np.min(values)), float(np.max(values))
    return f"{low:g}{'' if low == high else f' to {high:g}'} {unit}".rstrip()


def _section(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return an HTML table below a heading, or an empty text if it has no rows."""
    return f"<h2>{title}</h2>{table(head, rows)}" if rows else ""


def _triple(vector: FloatArray, digits: int = 2) -> str:
    return ", ".join(f"{x:.{digits}f}" if np.isfinite(x) else "-" for x in vector)


def _norm(vector: FloatArray) -> str:
    return f"{float(np.linalg.norm(vector)):.2f}" if np.isfinite(vector).all() else "-"
