"""The page of a tracked body: what it says of a recording, and the body at any moment."""

import re
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.browser import needs_browser, opened
from support.pages import assert_sound_page, scenes_of, unpacked
from support.small_model import SMALL_MODEL
from tissuereg.report.curves import TimeCurve, charts
from tissuereg.report.tracked import Film, event_line, events_of, few_modes, tracked_page

NASTY = "<b>&'\"P</b></script>"


@pytest.fixture(scope="module")
def frames():
    """Six frames of the small phantom; a marker is not seen in two of them."""
    body = tr.phantom.phantom_mesh("small")
    nodes = np.setdiff1d(body.surface_nodes, body.fixed_nodes)[::60]
    names = [NASTY, *(f"P{i}" for i in range(1, len(nodes)))]
    markers = tr.Markers(body.nodes[nodes], np.full((len(nodes), 3), np.nan), 0.1, names)
    tracker = tr.Tracker(tr.Registrar(body, markers, SMALL_MODEL, {NASTY: (5.0, 5.0, 20.0), "deep": (0.0, 0.0, 15.0)}))
    found = []
    for k in range(6):
        lean = np.c_[0.2 * (1.0 + k) * body.nodes[:, 2] / 10.0, np.zeros((body.n_nodes, 2))]
        measured = (body.nodes + lean)[nodes] + 0.01 * np.random.default_rng(k).standard_normal((len(nodes), 3))
        if k in (2, 3):
            measured[1] = np.nan
        tracker.step(measured, 0.1 * k)
        found.append(tracker.last)
    return found


def written(frames):
    """Return what track.json holds of the frames."""
    rows = [
        {
            "time_s": frame.time_s,
            "targets": {name: one.to_json() for name, one in frame.registration.targets.items()},
            "markers_rms_mm": frame.registration.markers.after_rms_mm,
            "markers_used": len(frame.registration.markers.used),
            "dropped": [{"marker": n, "reason": why} for n, why in frame.registration.markers.dropped],
            "trust": {"ok": frame.time_s < 0.45, "reasons": [] if frame.time_s < 0.45 else ["stale: <i>old</i> 3 mm"]},
            "latency_ms": 10.0 + 100.0 * frame.time_s,
        }
        for frame in frames
    ]
    failed = [{"time_s": 0.35, "reason": "no <marker> was seen"}]
    made = frames[-1].registration
    return {
        "frames": rows,
        "failed": failed,
        "events": events_of(rows, failed),
        "hz": 40.0,
        "dropped_frames": 2,
        "provenance": made.provenance.to_json(made.given),
    }


@pytest.fixture(scope="module")
def page(frames, tmp_path_factory):
    film = Film()
    for frame in frames:
        film.add(frame)
    path = tmp_path_factory.mktemp("page") / "report.html"
    path.write_text(tracked_page(film, written(frames)), encoding="utf-8")
    return path


def test_the_page_is_sound_and_says_what_happened(page):
    text = page.read_text(encoding="utf-8")
    assert_sound_page(text)
    for tag in ("<b>&", "<i>", "<marker>"):
        assert tag not in text
    assert "Not to be trusted: 1 of 6 frames; 1 not registered." in text
    assert "<td>P1</td><td>not seen</td><td>2</td><td>0.2</td><td>0.3</td>" in text
    assert "no &lt;marker&gt; was seen" in text
    assert text.count("class='charts'") == 3  # two targets, and what the tracker did


def test_the_body_at_every_moment_is_the_registered_one(frames, page):
    (scene,) = scenes_of(page.read_text(encoding="utf-8"))
    modes = unpacked(scene["body"]["modes"])
    weights = unpacked(scene["body"]["weights"][0][0])[:, 0]
    moved = np.einsum("fk,knx->fnx", weights, modes)
    mesh = frames[0].registration.mesh
    for field, frame in zip(moved, frames, strict=True):
        assert np.abs(field - frame.registration.displacement[mesh.surface_nodes]).max() < 0.005
    layers = {layer["title"]: layer for layer in scene["layers"]}
    places = unpacked(layers["target"]["places"][0][0])
    means = [[one.mean for one in frame.registration.targets.values()] for frame in frames]
    flagged = [[one.flag is not None for one in frame.registration.targets.values()] for frame in frames]
    np.testing.assert_allclose(places[~np.array(flagged)], np.array(means)[~np.array(flagged)], atol=0.001)
    measured = unpacked(layers["marker, measured"]["places"][0][0])
    assert np.isnan(measured[[2, 3], 1]).all()
    assert np.isfinite(measured[[0, 1, 4, 5], 1]).all()
    lost = unpacked(layers["not seen: where it must be"]["places"][0][0])
    np.testing.assert_allclose(lost[2, 1], frames[2].registration.unseen["P1"].mean, atol=0.001)


@needs_browser
def test_the_slider_moves_the_body(frames, page):
    script = """const seen = [drawn()]; slide("time", 2); await settled(); seen.push(drawn());
        const said = viewers[0].querySelector(".figures").textContent, clock = viewers[0].querySelector("output");
        const at = clock.textContent; button("play"); await settled();
        for (let i = 0; i < 40; i += 1) await settled();
        return { seen, said, at, end: clock.textContent };"""
    found, wide = opened(page, script)
    mesh = frames[0].registration.mesh
    assert wide <= 0
    for drawn, row in zip(found["seen"], (0, 2), strict=True):
        places = (mesh.nodes + frames[row].registration.displacement)[mesh.surface_nodes]
        assert drawn["depth"] == pytest.approx(np.abs(places).sum(), rel=1e-4)
        assert drawn["frame"] == row
    n = len(frames[0].registration.all_markers)
    assert [one["signs"]["marker, measured"] for one in found["seen"]] == [n, n - 1]
    assert [one["signs"]["not seen: where it must be"] for one in found["seen"]] == [0, 1]
    assert found["said"].startswith(f"{n - 1} of {n} markers")
    assert "not used: P1" in found["said"]
    assert (found["at"], found["end"]) == ("0.20 s", "0.50 s")
    assert opened(page, width=390)[1] <= 0


def test_of_many_frames_every_nth_is_kept(frames):
    film = Film(most=10)
    for k in range(45):
        film.add(replace(frames[k % 6], time_s=float(k)))
    assert film.scene().cases[0].times == [float(k) for k in range(0, 45, 8)]
    assert "6 of 45 frames" in film.scene().cases[0].name


def test_few_modes_hold_the_fields_of_few_motions():
    rng = np.random.default_rng(0)
    fields = np.einsum("fk,knx->fnx", rng.standard_normal((50, 5)), rng.standard_normal((5, 80, 3)))
    modes, weights, off = few_modes(fields, 12)
    assert off < 1e-6
    assert len(modes) < 12
    np.testing.assert_allclose(np.einsum("fk,knx->fnx", weights, modes), fields, atol=1e-6)
    assert np.abs(weights).max() == pytest.approx(1.0)
    _, _, rough = few_modes(fields, 3)
    # Not less than what the best three modes leave, and not much more.
    flat = fields.reshape(50, -1)
    left, sizes, right = np.linalg.svd(flat, full_matrices=False)
    best = np.linalg.norm((flat - (left[:, :3] * sizes[:3]) @ right[:3]).reshape(fields.shape), axis=2).max()
    assert rough == pytest.approx(best, rel=0.2)
    still, _, nothing = few_modes(np.zeros((3, 4, 3)), 5)
    assert (len(still), nothing) == (1, 0.0)


def test_events_are_counted_by_marker_and_kind():
    def frame(time_s, dropped=(), reasons=()):
        lost = [{"marker": name, "reason": why} for name, why in dropped]
        return {"time_s": time_s, "dropped": lost, "trust": {"reasons": list(reasons)}}

    frames = [
        frame(0.0, [("P2", "not seen")]),
        frame(0.1, [("P2", "not seen"), ("P7", "lost: old")], ["swapped: P2 and P3 by 3.1 mm"]),
        frame(0.2, [], ["swapped: P2 and P3 by 3.3 mm", "unit: m"]),
        frame(0.3, [("P2", "not seen")]),
    ]
    assert [event_line(event) for event in events_of(frames, [{"time_s": 0.4, "reason": "no marker"}])] == [
        "P2 not used, not seen: 3 frames, 0 to 0.3 s",
        "swapped: P2 and P3 by 3.1 mm: 2 frames, 0.1 to 0.2 s",
        "P7 not used, lost: old: 1 frame, 0.1 s",
        "unit: m: 1 frame, 0.2 s",
        "no marker: 1 frame, 0.4 s",
    ]


def test_a_thinned_curve_keeps_its_peaks_its_band_and_its_gaps():
    n = 20_000
    times = np.arange(n) / 100.0
    values = np.sin(times)
    values[[7_777, 12_345]] = 9.0, -9.0
    values[15_000:16_000] = np.nan
    half = np.full(n, 0.1)
    half[3_333] = 5.0
    for band in (None, half):
        drawn = TimeCurve("x", times, values, band).thinned()
        assert len(drawn.times) <= 600
        assert (np.diff(drawn.times) > 0.0).all()
        assert {77.77, 123.45} <= set(drawn.times)
        np.testing.assert_array_equal(drawn.values, values[np.searchsorted(times, drawn.times)])
        assert np.isnan(drawn.values).any()
        if band is not None:
            assert drawn.half[np.searchsorted(drawn.times, 33.33)] == 5.0
    # The wave between the peaks stays whole.
    bins = np.array_split(np.abs(drawn.values[drawn.times < 77.0]), 10)
    assert all(np.nanmax(one) > 0.99 for one in bins)
    short = TimeCurve("x", times[:600], values[:600])
    assert short.thinned() is short


def test_a_chart_draws_values_band_and_doubted_frames():
    times = np.arange(5.0)
    curve = TimeCurve("x <mm>", times, np.array([0.0, 1.0, np.nan, 3.0, 4.0]), np.full(5, 0.5))
    text = charts([curve], np.array([False, False, False, True, True]))
    assert "x &lt;mm&gt;" in text
    lines = [
        np.array([float(x) for x in re.split("[ ,]", one)]).reshape(-1, 2)
        for one in re.findall("polyline points='([^']+)'", text)
    ]
    assert [len(one) for one in lines] == [2, 2]
    slope = (lines[0][1] - lines[0][0])[1]
    assert slope < 0  # up, on a page
    assert (lines[1][1] - lines[0][0])[1] == pytest.approx(4.0 * slope, abs=0.3)
    (band,) = re.findall("polygon points='([^']+)'", text)
    corners = np.array([float(x) for x in re.split("[ ,]", band)]).reshape(-1, 2)
    assert len(corners) == 8
    assert corners[0, 1] - lines[0][0, 1] == pytest.approx(0.5 * slope, abs=0.3)
    ((left, width),) = [(float(a), float(b)) for a, b in re.findall("<rect x='([^']+)'.*?width='([^']+)'", text)]
    step = (lines[0][1] - lines[0][0])[0]
    assert (left - lines[0][0, 0], width) == pytest.approx((2.5 * step, 1.5 * step), abs=0.3)
