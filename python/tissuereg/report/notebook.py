"""What a notebook shows of results, bodies, markers and trackers: a small table, and the body to turn in a frame."""

from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.report.markup import document, escape, table
from tissuereg.report.registered import registered_scene
from tissuereg.report.shown import GivenBody
from tissuereg.report.viewer import ViewScene, framed, viewer, viewer_script
from tissuereg.report.words import at_time, counted, markers_used, verdict

if TYPE_CHECKING:
    from tissuereg.registration.body import Body
    from tissuereg.registration.result import Registration
    from tissuereg.tracking.frame import TrackedFrame
    from tissuereg.tracking.tracker import Tracker


class Cell(NamedTuple):
    """How much a notebook shows: triangles of a body, rows of a table, height of the frame in pixels."""

    triangles: int = 5000
    rows: int = 12
    height: int = 760


CELL = Cell()


def registration_html(result: "Registration") -> str:
    """Return a registration as HTML for a notebook: verdict, targets, and the body to turn."""
    trust, fit = result.trust, result.markers
    colour = "#176f2c" if trust.ok else "#a3180d"
    reasons = "".join(f"<li>{escape(reason)}</li>" for reason in trust.reasons)
    used = markers_used(fit.used, fit.inner)
    met = f"{used}: {fit.before_rms_mm:.2f} mm (rms) before, {fit.after_rms_mm:.2f} mm after."
    rows = [
        (
            escape(name),
            _places([target.mean])[0],
            " x ".join(f"{x:.2f}" for x in target.region(0.90).radii),
            escape(target.flag or ""),
        )
        for name, target in result.targets.items()
    ]
    return (
        f"<p><b style='color:{colour}'>{verdict(trust.ok)}</b> {met if fit.used else ''}</p>"
        + (f"<ul>{reasons}</ul>" if reasons else "")
        + _table(("target", "registered, mm", "90 % region, half-axes, mm", ""), rows)
        + _turnable(registered_scene(result, CELL.triangles, spread="std" in vars(result)))
    )


def body_html(mesh: Mesh, body: "Body | None" = None) -> str:
    """Return a mesh, or a body with what is believed of it, as HTML for a notebook."""
    believed = "" if body is None else f"<p>{escape(repr(body.material))}; {body.element}, held: {body.held}</p>"
    return f"<p>{escape(repr(mesh))}</p>{believed}{_turnable(GivenBody(mesh).scene(CELL.triangles))}"


def markers_html(markers: Markers) -> str:
    """Return markers as a table of places and motions, HTML for a notebook."""
    moved = np.linalg.norm(markers.displacement, axis=1)
    rows = [
        (escape(name), was, seen, f"{by:.2f}" if np.isfinite(by) else "-", f"{std:.3g}")
        for name, was, seen, by, std in zip(
            markers.names, _places(markers.reference), _places(markers.measured), moved, markers.std, strict=True
        )
    ]
    head = ("marker", "undeformed, mm", "measured, mm", "moved, mm", "noise, mm")
    return f"<p>{escape(repr(markers))}</p>{_table(head, rows)}"


def tracker_html(tracker: "Tracker") -> str:
    """Return a tracker as HTML for a notebook: its last frame, or its body with markers and targets."""
    said = f"<p>{escape(repr(tracker))}</p>"
    if tracker.last is not None:
        return said + frame_html(tracker.last)
    registrar = tracker.registrar
    inner = registrar.attached.targets
    targets = dict(zip(inner.names, inner.reference, strict=True))
    return said + _turnable(GivenBody(registrar.mesh, registrar.markers, targets).scene(CELL.triangles))


def frame_html(frame: "TrackedFrame") -> str:
    """Return a tracked frame as HTML for a notebook."""
    words = (
        f"{at_time(frame.time_s)} s: latency {1e3 * frame.latency_s:.0f} ms, {counted(frame.skipped, 'frame')} skipped"
    )
    return f"<p>{words}</p>{registration_html(frame.registration)}"


def _turnable(scene: ViewScene) -> str:
    page = document(
        "", [viewer(scene), viewer_script()], "body { margin: 0; padding: 0 2px; max-width: none; overflow-x: hidden; }"
    )
    return framed(page, CELL.height)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a table of the first rows, and how many more there are; empty without rows."""
    if not rows:
        return ""
    more = len(rows) - CELL.rows
    return table(head, rows[: CELL.rows]) + (f"<p>and {more} more</p>" if more > 0 else "")


def _places(places: Sequence[FloatArray] | FloatArray) -> list[str]:
    """Return places (n, 3), mm, as text; a dash for what is not known."""
    return [", ".join(f"{x:.2f}" if np.isfinite(x) else "-" for x in place) for place in places]
