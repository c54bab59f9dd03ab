"""What a user sees: picture, page, fields and last lines of a registration without a known load."""

import json
from dataclasses import replace

import numpy as np
import pytest

import tissuereg as tr
from support.files import run
from tissuereg.io.foreign import read_grid
from tissuereg.io.meshes import write_vtu
from tissuereg.io.tables import write_markers, write_points
from tissuereg.report.picture import registration_figure

TARGETS = {"deep": (18.0, 12.0, 22.0), "at the top": (12.0, 8.0, 38.0)}


@pytest.fixture(scope="module")
def pulled(block_mesh):
    """A block pulled at a corner of its top; all markers but two sit on its lower half."""
    middles = block_mesh.nodes[block_mesh.surface].mean(axis=1)
    top = block_mesh.surface[(middles[:, 2] > 39.0) & (middles[:, 0] > 15.0)]
    truth = tr.simulate(block_mesh, tr.Load(traction=(top, (0.5, 0.1, 0.2))), tr.Material(8.0, 0.45)).displacement
    free = np.setdiff1d(block_mesh.surface_nodes, block_mesh.fixed_nodes)
    low = free[block_mesh.nodes[free, 2] < 25.0]
    rng = np.random.default_rng(3)
    nodes = rng.choice(low, 10, replace=False)
    measured = block_mesh.nodes[nodes] + truth[nodes] + 0.05 * rng.standard_normal((10, 3))
    return block_mesh.nodes[nodes], measured


@pytest.fixture(scope="module")
def spoilt(block_mesh, pulled):
    """The same with a marker that is wrong by far and one that was not seen."""
    reference, measured = pulled
    measured = measured.copy()
    measured[2] += (3.0, -3.0, 3.0)
    measured[5] = np.nan
    return tr.register(block_mesh, tr.Markers(reference, measured, 0.05), targets=TARGETS)


@pytest.fixture(scope="module")
def figure(spoilt):
    return registration_figure(spoilt)


def words(figure):
    return [text.get_text() for text in figure.texts]


def test_the_picture_states_the_verdict_and_names_markers_that_do_not_count(spoilt, figure):
    assert dict(spoilt.markers.dropped) == {"M3": "wrong", "M6": "not seen"}
    assert "Do not trust this registration." in words(figure)
    assert any("wrong marker: M3 " in text for text in words(figure))
    # Behind the body in one view it is before it in the other.
    assert "M3: wrong" in words(figure)


def test_every_contact_in_sight_has_its_figures(spoilt, figure):
    assert spoilt.contacts
    first = spoilt.contacts[0]
    summary = f"{first.size_mm:.1f} mm, {first.force_mN:,.0f} mN\nprobability {first.probability:.2f} "
    summary += f"within about {first.place_std_mm:.0f} mm"
    assert sum(text.endswith(summary) for text in words(figure)) >= 1


def test_labels_do_not_cover_each_other(figure):
    renderer = figure.canvas.get_renderer()
    labels = [text for text in figure.texts if text.get_zorder() == 21]
    boxes = [text.get_window_extent(renderer) for text in labels]
    assert len(boxes) >= 4
    for index, one in enumerate(boxes):
        for other in boxes[index + 1 :]:
            assert not one.overlaps(other)


def test_a_flagged_target_is_dashed_and_stated_in_words(spoilt):
    flagged = replace(spoilt.target("at the top"), constrained=0.3, flag="no marker tells")
    result = replace(spoilt, targets={**spoilt.targets, "at the top": flagged})
    figure = result.plot()
    assert any(text.startswith("at the top: no marker tells") for text in words(figure))
    assert any(text.startswith("No marker tells of at the top: ") for text in words(figure))
    dashed = [line for axes in figure.axes for line in axes.lines if line.get_linestyle() == "--"]
    assert len(dashed) == 6  # three ellipses in each of two views


def test_the_page_has_contacts_flags_and_reasons(spoilt, tmp_path):
    page = spoilt.report(tmp_path / "report.html").read_text(encoding="utf-8")
    assert "never against a measurement inside an organ" in page
    assert spoilt.to_json()["trust"]["regions_checked"] in page
    for name, size in spoilt.explained_mm.items():
        assert f"<td>{name}</td><td>{size:.2f}</td>" in page
    assert "<p class='verdict no'>Do not trust this registration.</p>" in page
    for heading in ("Contacts", "Targets", "Markers that are not used", "Work", "Time"):
        assert f"<h2>{heading}</h2>" in page
    assert f"{spoilt.contacts[0].force_mN:,.0f}" in page
    assert "<td>M3</td><td>wrong</td>" in page


def test_the_forces_hold_the_body_and_are_written(block_mesh, spoilt, tmp_path):
    assert spoilt.forces.shape == (block_mesh.n_nodes, 3)
    assert np.array_equal(spoilt.forces[block_mesh.fixed_nodes], np.zeros((len(block_mesh.fixed_nodes), 3)))
    spoilt.save(tmp_path / "out")
    written = read_grid(tmp_path / "out" / "registered.vtu", "mesh").point_data["contact_force_mN"]
    np.testing.assert_array_equal(written, spoilt.forces)
    contact = spoilt.contacts[0]
    near = np.linalg.norm(block_mesh.nodes - contact.centre_mm, axis=1) <= 1.2 * contact.radius_mm
    np.testing.assert_allclose(
        spoilt.forces[near].sum(axis=0), contact.force_mN * contact.direction, rtol=1e-9, atol=1e-9
    )


def test_an_untrusted_answer_is_stated_on_the_last_line(block_mesh, pulled, tmp_path, capsys):
    reference, measured = pulled
    measured = measured.copy()
    measured[2] += (3.0, -3.0, 3.0)
    write_vtu(tmp_path / "mesh.vtu", block_mesh)
    write_points(tmp_path / "targets.csv", TARGETS)
    for name, places, last, expected in (
        ("good", pulled[1], "Nothing speaks against this registration.", 0),
        ("bad", measured, "Do not trust this registration: wrong marker.", 4),
    ):
        write_markers(tmp_path / f"{name}.csv", tr.Markers(reference, places, 0.05))
        files = (tmp_path / "mesh.vtu", tmp_path / f"{name}.csv", "--targets", tmp_path / "targets.csv")
        code, out, _ = run(capsys, "register", *files, "--out", tmp_path / name)
        assert code == expected
        lines = out.splitlines()
        assert lines[-1] == last
        summary = json.loads((tmp_path / name / "registration.json").read_text(encoding="utf-8"))
        assert sum(line.startswith("contact at ") for line in lines) == len(summary["contacts"])


def test_every_reason_starts_with_its_kind(spoilt):
    kinds = (
        "misfit: ",
        "wrong marker: ",
        "inverted tets: ",
        "repeated: ",
        "rigid motion: ",
        "swapped: ",
        "unrelated: ",
    )
    assert spoilt.trust.reasons
    for reason in spoilt.trust.reasons:
        assert reason.startswith(kinds), reason


def test_a_registration_is_one_line_when_printed(spoilt):
    shown = repr(spoilt)
    assert shown.startswith(f"ContactRegistration({spoilt.mesh.n_nodes} nodes, ")
    assert shown.endswith("not to be trusted)")
    assert len(shown) < 120
