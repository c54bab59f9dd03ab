"""The HTML page of a tracked body: targets over time, markers used and lost, trust, and the body at any moment."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.report import scene
from tissuereg.report.curves import TimeCurve, charts
from tissuereg.report.markup import document, escape, table
from tissuereg.report.provenance import provenance_section
from tissuereg.report.registered import PATCHES, axes_of, half_axes, target_layers
from tissuereg.report.solid import DrawnBody
from tissuereg.report.viewer import Paint, ShownCase, Signs, ViewScene, top_of, viewer, viewer_script
from tissuereg.report.words import at_time, counted

if TYPE_CHECKING:
    from tissuereg.registration.result import Registration
    from tissuereg.tracking.frame import TrackedFrame


class Kept(NamedTuple):
    """How much of a recording a page holds.

    `frames`: in which the body can be seen, at most; of more every nth; `triangles`: of its surface; `modes`: of its
    motion; `targets`: with charts; `rows`: of a table; `lines`: of such a list in the command's summary.
    """

    frames: int = 2000
    triangles: int = 6000
    modes: int = 40
    targets: int = 6
    rows: int = 60
    lines: int = 8


KEPT = Kept()

_STYLE = """
.verdict { font-size: 1.5rem; font-weight: bold; margin: .5rem 0; } svg { display: block; }
.events td:nth-child(2), .events th:nth-child(2) { text-align: left; }
.charts { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(19rem, 100%), 1fr)); gap: .4rem .8rem; }
"""


class Film:
    """What is kept of the frames of a recording as they come, so that the body can be shown at any of them."""

    def __init__(self, most: int = KEPT.frames) -> None:
        self._most, self._stride, self._count = most, 1, 0
        self._kept: list[_Moment] = []
        self.body: DrawnBody | None = None
        self.last: Registration | None = None

    def add(self, frame: "TrackedFrame") -> None:
        """Keep a frame, or not: where there are too many, every second is dropped, and of the later ones as many."""
        self.last = frame.registration
        if self.body is None:
            supports = self.last.body.supports
            self.body = DrawnBody.of(self.last.mesh, [supports.sure, supports.perhaps], KEPT.triangles)
        if self._count % self._stride == 0:
            self._kept.append(_Moment.of(frame, self.body))
        self._count += 1
        if len(self._kept) > self._most:
            self._kept, self._stride = self._kept[::2], 2 * self._stride

    def scene(self) -> ViewScene:
        """Return what the view shows; there must be a frame."""
        if self.body is None or self.last is None:
            message = "a film must have a frame, got none"
            raise ValueError(message)
        fields = np.stack([one.moved for one in self._kept])
        modes, weights, off = few_modes(fields, KEPT.modes)
        times = [round(one.time_s, 4) for one in self._kept]
        top = top_of(np.linalg.norm(fields, axis=2).max(axis=1))
        said = [one.said for one in self._kept]
        drawn = (
            f"{len(times):,} of {self._count:,} frames, each within {max(off, 0.001):.2g} mm of the registered body."
        )
        return ViewScene(
            title="The tracked body",
            body=self.body,
            modes=modes,
            weights=weights[:, None],
            patches=PATCHES,
            paints=[Paint("displacement", "mm", moved=True, top=top), Paint("supports")],
            layers=self._layers(),
            cases=[ShownCase(drawn, times, said)],
            clock="time",
            outline=True,
            axes=axes_of(self.last.mesh),
        )

    def _layers(self) -> list[Signs]:
        def stacked(name: str) -> FloatArray:
            return np.stack([getattr(one, name) for one in self._kept])

        names = list(self.last.all_markers.names) if self.last else []
        used, unused, predicted = stacked("used"), stacked("unused"), stacked("predicted")
        layers = []
        for title, colour, places, look in (
            ("marker, measured", scene.MEASURED, used, {"shape": "ring", "size": 5.0}),
            ("marker, registered", scene.FITTED, stacked("fitted"), {"size": 3.0}),
            ("marker not used", scene.WRONG, unused, {"shape": "cross", "size": 5.0, "width": 2.2, "labels": True}),
            ("not seen: where it must be", "#59626c", predicted, {"shape": "ring", "size": 5.0}),
        ):
            if np.isfinite(places).any():
                more: dict[str, Any] = {**look, "names": names}
                layers.append(Signs(kind="points", title=title, colour=colour, places=places, **more))
        targets = list(self.last.targets) if self.last else []
        if targets:
            layers += target_layers(targets, (stacked("targets"), stacked("axes"), stacked("flagged") > 0.0))
        return layers


class _Moment(NamedTuple):
    """One frame: displacement of the drawn nodes (n, 3), places of markers (n_markers, 3), regions of targets, mm."""

    time_s: float
    said: str
    moved: FloatArray
    used: FloatArray
    fitted: FloatArray
    unused: FloatArray
    predicted: FloatArray
    targets: FloatArray
    axes: FloatArray
    flagged: BoolArray

    @classmethod
    def of(cls, frame: "TrackedFrame", body: DrawnBody) -> "_Moment":
        """Return what is kept of a frame."""
        result = frame.registration
        every, fit = result.all_markers, result.markers
        nothing = np.full(3, np.nan)
        residual = np.array([fit.residual_mm.get(name, nothing) for name in every.names]).reshape(-1, 3)
        is_used = np.array([name in fit.residual_mm for name in every.names], dtype=bool)[:, None]
        must = [result.unseen[name].mean if name in result.unseen else nothing for name in every.names]
        missing = np.isnan(every.measured).any(axis=1, keepdims=True)
        lost = f", not used: {', '.join(name for name, _ in fit.dropped)}" if fit.dropped else ""
        trust = "nothing speaks against it" if result.trust.ok else f"do not trust it: {result.trust.reasons[0]}"
        targets = result.targets.values()
        return cls(
            frame.time_s,
            f"{len(fit.used)} of {counted(len(every), 'marker')}, {fit.after_rms_mm:.2f} mm (rms){lost}; {trust}.",
            body.field(result.displacement).astype(np.float32),
            np.where(is_used, every.measured, np.nan),
            every.measured - residual,
            np.where(is_used, np.nan, every.measured),
            np.where(missing & ~is_used, np.array(must).reshape(-1, 3), np.nan),
            np.array([one.mean for one in targets]).reshape(-1, 3),
            np.array([half_axes(one) for one in targets]).reshape(-1, 9),
            np.array([one.flag is not None for one in targets], dtype=bool),
        )


def few_modes(fields: FloatArray, most: int) -> tuple[FloatArray, FloatArray, float]:
    """Return modes (k, n, 3), mm, and weights (n_frames, k), at most 1, whose sums are nearly the fields of all frames.

    `fields` (n_frames, n, 3): mm; `most`: number of modes at most. Third: by how much a node is off at most, mm.
    """
    flat = np.asarray(fields, np.float64).reshape(len(fields), -1)
    rng = np.random.default_rng(0)
    # A random sketch of the columns, sharpened once, spans the modes that matter.
    sketch = flat @ rng.standard_normal((flat.shape[1], min(2 * most, len(flat))))
    sketch = flat @ (flat.T @ np.linalg.qr(sketch)[0])
    basis = np.linalg.qr(sketch)[0]
    left, sizes, right = np.linalg.svd(basis.T @ flat, full_matrices=False)
    kept = max(1, min(most, int(np.count_nonzero(sizes > 1e-6 * max(sizes[0], 1e-12)))))
    weights = (basis @ left[:, :kept]) * sizes[:kept]
    scale = np.maximum(np.abs(weights).max(axis=0), 1e-12)
    modes, weights = right[:kept] * scale[:, None], weights / scale
    off = (flat - weights @ modes).reshape(fields.shape)
    return modes.reshape(kept, *fields.shape[1:]), weights, float(np.linalg.norm(off, axis=2).max())


def events_of(frames: Sequence[Mapping[str, Any]], failed: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Return what went wrong in a recording, each once: markers not used, by reason; doubts, by kind; failed frames.

    `frames`, `failed`: those of ``track.json``. Each has ``what``, ``marker`` (or None), ``reason``, ``frames`` (their
    number), ``first_s``, ``last_s``, in the order of time.
    """
    found: dict[tuple[str, str | None, str], dict[str, Any]] = {}

    def note(what: str, marker: str | None, kind: str, reason: str, time_s: float) -> None:
        new = {"what": what, "marker": marker, "reason": reason, "frames": 0, "first_s": time_s}
        one = found.setdefault((what, marker, kind), new)
        one |= {"frames": one["frames"] + 1, "last_s": time_s}

    for frame in frames:
        for lost in frame["dropped"]:
            note("not used", lost["marker"], lost["reason"], lost["reason"], frame["time_s"])
        for reason in frame["trust"]["reasons"]:
            note("doubt", None, reason.partition(":")[0], reason, frame["time_s"])
    for frame in failed:
        note("failed", None, "", frame["reason"], frame["time_s"])
    return sorted(found.values(), key=lambda one: (one["first_s"], one["marker"] or ""))


def event_line(event: Mapping[str, Any]) -> str:
    """Return an event in words.

    >>> event_line({"what": "not used", "marker": "P7", "reason": "not seen", "frames": 2, "first_s": 0.5, "last_s": 1})
    'P7 not used, not seen: 2 frames, 0.5 to 1 s'
    """
    what = f"{event['marker']} not used, {event['reason']}" if event["marker"] is not None else str(event["reason"])
    first, last = at_time(event["first_s"]), at_time(event["last_s"])
    when = f"{first} s" if event["frames"] == 1 else f"{first} to {last} s"
    return f"{what}: {counted(event['frames'], 'frame')}, {when}"


def tracked_page(film: Film, content: Mapping[str, Any]) -> str:
    """Return the page of a recording, HTML; `film`: of its frames; `content`: of ``track.json``."""
    frames = content["frames"]
    times = np.array([frame["time_s"] for frame in frames])
    doubted = np.array([not frame["trust"]["ok"] for frame in frames])
    shown = film.scene()
    parts = [
        _summary(content, times, doubted),
        f"<h2>The body over time</h2><p>{escape(shown.cases[0].name)}</p>{viewer(shown)}",
        _targets(frames, times, doubted, shown.axes),
        "<h2>Markers, distance and latency</h2>",
        charts(
            [
                TimeCurve("markers used", times, _column(frames, "markers_used"), zero=True),
                TimeCurve("distance to the markers, mm (rms)", times, _column(frames, "markers_rms_mm"), zero=True),
                TimeCurve("latency, ms", times, _column(frames, "latency_ms"), zero=True),
            ],
            doubted,
        ),
        _events(content["events"]),
        provenance_section(content["provenance"]),
        viewer_script(),
    ]
    return document("Tracking", parts, _STYLE)


def _column(frames: Sequence[Mapping[str, Any]], name: str) -> FloatArray:
    return np.array([np.nan if frame[name] is None else frame[name] for frame in frames], np.float64)


def _summary(content: Mapping[str, Any], times: FloatArray, doubted: BoolArray) -> str:
    frames, failed = content["frames"], content["failed"]
    ok = not doubted.any() and not failed
    verdict = "Nothing speaks against any frame." if ok else (
        f"Not to be trusted: {int(doubted.sum())} of {counted(len(frames), 'frame')}"
        + (f"; {len(failed)} not registered" if failed else "") + "."
    )  # fmt: skip
    latency = _column(frames, "latency_ms")
    return (
        f"<h1>Tracking</h1><p class='verdict {'yes' if ok else 'no'}'>{verdict}</p>"
        f"<p>{counted(len(frames), 'frame')} from {at_time(times[0])} to {at_time(times[-1])} s, "
        f"{content['hz']:.1f} a second; {content['dropped_frames']} dropped. Latency: median "
        f"{np.nanmedian(latency):.0f} ms, 99 % {np.nanpercentile(latency, 99):.0f} ms. Distance to the markers: median "
        f"{np.nanmedian(_column(frames, 'markers_rms_mm')):.2f} mm (rms).</p>"
    )


def _targets(frames: Sequence[Mapping[str, Any]], times: FloatArray, doubted: BoolArray, axes: Sequence[str]) -> str:
    names = list(frames[-1]["targets"])
    if not names:
        return ""
    more = len(names) - KEPT.targets
    parts = [
        "<h2>Targets over time</h2><p>Motion of each target from its place in the undeformed body. The band is the "
        "extent of its 90 % region along the axis. Frames on red are not to be trusted."
        + (f" {more} more targets are in targets.csv." if more > 0 else "")
        + "</p>"
    ]
    for name in names[: KEPT.targets]:
        some = [frame["targets"][name] for frame in frames]
        moved = np.array([one["mean_mm"] for one in some]) - np.array([one["reference_mm"] for one in some])
        variance = np.array([np.diag(one["covariance_mm2"]) for one in some])
        # All half-axes of an ellipsoid are the same multiple of the deviations along them.
        largest = np.array([np.linalg.eigvalsh(one["covariance_mm2"])[-1] for one in some])
        reach = np.array([one["region90_radii_mm"][-1] for one in some]) / np.sqrt(np.maximum(largest, 1e-30))
        half = reach[:, None] * np.sqrt(variance)
        curves = [TimeCurve(f"{axis}, mm", times, moved[:, k], half[:, k]) for k, axis in enumerate(axes)]
        parts.append(f"<h3>{escape(name)}</h3>{charts(curves, doubted)}")
    return "\n".join(parts)


def _events(events: Sequence[Mapping[str, Any]]) -> str:
    if not events:
        return "<h2>What happened</h2><p>Every marker was used in every frame, and nothing was doubted.</p>"
    rows = [
        (
            escape(event["marker"] or event["what"]),
            escape(event["reason"]),
            f"{event['frames']:,}",
            at_time(event["first_s"]),
            at_time(event["last_s"]),
        )
        for event in events[: KEPT.rows]
    ]
    more = len(events) - len(rows)
    rest = f"<p>{more} more are in track.json.</p>" if more > 0 else ""
    listed = table(("marker", "what", "frames", "first, s", "last, s"), rows)
    return f"<h2>What happened</h2><div class='events'>{listed}</div>{rest}"
