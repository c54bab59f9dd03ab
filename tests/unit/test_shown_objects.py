"""What a prompt and a notebook show of results, bodies, markers and trackers: short, rounded, self-contained."""

import re
from html import unescape

import numpy as np
import pytest

import tissuereg as tr
from support.browser import needs_browser, opened
from support.pages import scenes_of, unpacked
from support.small_model import SMALL_MODEL
from tissuereg._base.shown import short

NASTY = "<b>&'\"P</b></script>"


@pytest.fixture(scope="module")
def shown():
    """Objects of every kind, by name."""
    body = tr.phantom.phantom_mesh("small")
    nodes = np.setdiff1d(body.surface_nodes, body.fixed_nodes)[::60]
    lean = np.c_[0.4 * body.nodes[:, 2] / 10.0, np.zeros((body.n_nodes, 2))]
    names = [NASTY, *(f"P{i}" for i in range(1, len(nodes)))]
    markers = tr.Markers(body.nodes[nodes], (body.nodes + lean)[nodes], 0.1, names)
    registrar = tr.Registrar(
        body, tr.Markers(markers.reference, std=0.1, names=names), SMALL_MODEL, {NASTY: (5.0, 5, 20)}
    )
    tracker = tr.Tracker(registrar)
    fresh = tr.Tracker(registrar)
    result = tracker.step(markers.measured, 0.5)
    return {
        "result": result,
        "frame": tracker.last,
        "tracker": tracker,
        "fresh tracker": fresh,
        "mesh": body,
        "body": tr.Body(body, tr.Material(young=5.0), held="perhaps"),
        "markers": markers,
        "registrar": registrar,
        "target": result.target(NASTY),
        "region": result.target(NASTY).region(),
        "answer": result.at(body.nodes[:50]),
        "fit": result.markers,
        "trust": result.trust,
        "field": result.field,
        "uncertainty": result.uncertainty,
        "simulation": tr.simulate(body, tr.Load(body_force=(0.0, 0.0, -1e-3)), tr.Material()),
        "material": tr.Material(young=np.full(body.n_tets, 3.0)),
    }


def test_every_repr_is_short_and_one_line(shown):
    for name, one in shown.items():
        assert len(repr(one)) < 700, name
        assert "\n" not in repr(one), name
        assert "object at 0x" not in repr(one), name
    assert repr(shown["tracker"]).endswith("last frame at 0.5 s, 0 dropped)")
    assert "no frame yet" in repr(shown["fresh tracker"])
    assert "array(1213 x 3)" in repr(shown["simulation"])
    mean = ", ".join(f"{x:.4g}" for x in shown["target"].mean)
    assert f"mean=[{mean}]" in repr(shown["target"])


def test_values_are_rounded_and_lists_are_cut():
    assert short(0.1) == "0.1"
    assert short(0.123456789) == "0.1235"
    assert short(np.array([[1.0, 2.0], [np.nan, 1e-9]])) == "[[1, 2], [nan, 1e-09]]"
    assert short(list(range(7))) == "[0, 1, 2, 3, ... 7 in all]"
    assert short({"a": np.zeros(20)}) == "{'a': array(20)}"
    assert short(len) == "<len>"
    assert short("x" * 300) == "'" + "x" * 99 + "..."


@pytest.mark.parametrize("name", ["result", "frame", "tracker", "fresh tracker", "mesh", "body"])
def test_a_notebook_shows_the_body(shown, name):
    text = shown[name]._repr_html_()
    assert len(text) < 1_000_000
    assert "<b>&" not in text
    (inside,) = re.findall(r"srcdoc='([^']*)'", text)
    (scene,) = scenes_of(unescape(inside))
    assert len(unpacked(scene["body"]["triangles"])) == len(shown["mesh"].surface)
    if name in ("result", "frame", "tracker"):
        assert "&lt;b&gt;&amp;&#x27;&quot;P&lt;/b&gt;&lt;/script&gt;" in text
        assert ", ".join(f"{x:.2f}" for x in shown["target"].mean) in text


def test_a_notebook_shows_markers_as_a_table(shown):
    text = shown["markers"]._repr_html_()
    assert "<b>&" not in text
    moved = np.linalg.norm(shown["markers"].displacement, axis=1)
    rows = re.findall(r"<tr><td>.*?</tr>", text)
    assert len(rows) == min(12, len(moved))
    for row, by in zip(rows, moved, strict=False):
        assert f"<td>{by:.2f}</td>" in row


def test_to_be_shown_costs_no_draws(shown):
    fresh = tr.register(shown["mesh"], shown["markers"], model=SMALL_MODEL)
    assert "spread" not in fresh._repr_html_()
    assert "uncertainty" not in vars(fresh)
    assert fresh.std.shape == (shown["mesh"].n_nodes,)
    assert "spread" in fresh._repr_html_()


@needs_browser
def test_the_frame_in_a_notebook_turns(shown, tmp_path):
    inside = unescape(re.findall(r"srcdoc='([^']*)'", shown["result"]._repr_html_())[0])
    (tmp_path / "cell.html").write_text(inside, encoding="utf-8")
    found, wide = opened(tmp_path / "cell.html", width=700)
    assert wide <= 0
    assert found["triangles"] > 0.9 * len(shown["mesh"].surface)
