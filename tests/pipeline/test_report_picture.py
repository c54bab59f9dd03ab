"""The picture of a registration stays readable: words apart and whole, targets enlarged to scale."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib.patches import Polygon
from scipy.stats import chi2

import tissuereg as tr
from support.meshes import block
from tissuereg.report.inset import round_length
from tissuereg.report.picture import registration_figure, write_heading
from tissuereg.report.style import STYLE


@pytest.fixture(scope="module")
def found(block_mesh):
    """A block with three contacts, a wrong marker and one that was not seen."""
    middles = block_mesh.nodes[block_mesh.surface].mean(axis=1)
    top = block_mesh.surface[(middles[:, 2] > 39.0) & (middles[:, 0] > 15.0)]
    truth = tr.simulate(block_mesh, tr.Load(traction=(top, (0.5, 0.1, 0.2))), tr.Material(8.0, 0.45)).displacement
    nodes = np.random.default_rng(3).choice(np.setdiff1d(block_mesh.surface_nodes, block_mesh.fixed_nodes), 14, False)
    measured = block_mesh.nodes[nodes] + truth[nodes]
    measured[2] += (3.0, -3.0, 3.0)
    measured[5] = np.nan
    result = tr.register(block_mesh, tr.Markers(block_mesh.nodes[nodes], measured, 0.05), targets={"a": (18, 12, 22)})
    assert result.contacts
    return result


def crowded(found, n_targets, n_contacts, *, together):
    """The same result with so many targets and contacts: at one place, or spread over the body."""
    one, contact = found.target("a"), found.contacts[0]
    nodes = found.mesh.surface_nodes[:: len(found.mesh.surface_nodes) // n_contacts]
    targets = {}
    for index in range(n_targets):
        away = 0.0 if together else (index + 1.0) / n_targets - 0.5
        shift = away * np.array([8.0, -6.0, 14.0])
        flag = "no marker tells" if index % 3 == 2 else None
        name = f"target {index}" + " with a long name" * (index % 2)
        targets[name] = replace(one, reference=one.reference + shift, mean=one.mean + shift, flag=flag)
    contacts = [
        contact if together else replace(contact, centre_mm=found.mesh.nodes[nodes[index]])
        for index in range(n_contacts)
    ]
    return replace(found, targets=targets, search=lambda: tuple(contacts))


def texts(figure):
    """All words that are drawn, those of axes and the legend included."""
    inner = [text for axes in figure.axes if axes.axison for text in (*axes.texts, *axes.get_xticklabels())]
    legend = [text for entry in figure.legends for text in entry.get_texts()]
    return [text for text in (*figure.texts, *inner, *legend) if text.get_text() and text.get_visible()]


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize(("n_targets", "n_contacts"), [(1, 1), (3, 3), (8, 8), (11, 3)])
def test_words_and_panels_never_lie_over_each_other_nor_leave_the_page(found, n_targets, n_contacts, together):
    figure = registration_figure(crowded(found, n_targets, n_contacts, together=together))
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()
    boxes = [(text.get_text(), text.get_window_extent(renderer)) for text in texts(figure)]
    for index, (said, one) in enumerate(boxes):
        assert min(one.x0, one.y0) >= 0.0, said
        assert (one.max <= figure.bbox.max).all(), said
        for other_said, other in boxes[index + 1 :]:
            assert not one.overlaps(other), (said, other_said)
    panels = [axes for axes in figure.axes if axes.get_zorder() == 30]
    assert len(panels) == min(n_targets, STYLE.panels)
    for panel in panels:
        around = panel.get_window_extent(renderer)
        for text, (said, box) in zip(texts(figure), boxes, strict=True):
            assert text.axes is panel or not around.overlaps(box), said


def test_few_labels_all_find_room(found):
    figure = registration_figure(crowded(found, 5, 3, together=False))
    assert not any("no room" in text.get_text() for text in figure.texts)


def test_labels_without_room_are_counted(found):
    """Two dozen flagged targets with names as wide as a view: some are left out, and the picture says how many."""
    one = replace(found.target("a"), flag="no marker tells")
    many = {f"a target with a name as wide as the view {index}": one for index in range(24)}
    figure = registration_figure(replace(found, targets=many))
    labels = [text for text in figure.texts if text.get_zorder() == 21 and "a target" in text.get_text()]
    missing = [text.get_text() for text in figure.texts if "no room" in text.get_text()]
    assert len(missing) == 1
    # Labels of contacts and markers may be among those left out.
    assert int(missing[0].split()[0]) >= 2 * len(many) - len(labels) > 0


def test_a_panel_shows_the_region_to_scale(found):
    """The outline is that of the ellipsoid across the line of sight; lengths are equal along both sides."""
    figure = registration_figure(found)
    figure.canvas.draw()
    panel = next(axes for axes in figure.axes if axes.get_zorder() == 30)
    outline = next(patch for patch in panel.patches if isinstance(patch, Polygon)).get_xy()
    view = figure.axes[0]
    up, around = np.radians(view.elev), np.radians(view.azim)
    right = np.array([-np.sin(around), np.cos(around), 0.0])
    upwards = np.array([-np.sin(up) * np.cos(around), -np.sin(up) * np.sin(around), np.cos(up)])
    target = found.target("a")
    across = np.stack([right, upwards])
    plane = across @ target.covariance @ across.T
    distance = np.einsum("ni,ij,nj->n", outline, np.linalg.inv(plane), outline)
    np.testing.assert_allclose(distance, chi2.ppf(0.9, 3), rtol=1e-9)
    pixels = panel.transData.transform([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
    assert np.linalg.norm(pixels[1] - pixels[0]) == pytest.approx(np.linalg.norm(pixels[2] - pixels[0]), rel=1e-6)
    # Seen as in the view: the target's motion points the same way there.
    crosses = [line for line in panel.lines if line.get_marker() == "x"]
    np.testing.assert_allclose(crosses[0].get_xydata()[0], across @ (target.reference - target.mean), atol=1e-9)


def test_the_scale_bar_is_as_long_as_it_says(found):
    panel = next(axes for axes in registration_figure(found).axes if axes.get_zorder() == 30)
    bar = next(line for line in panel.lines if line.get_linewidth() == 2.5)
    said = next(text.get_text() for text in panel.texts if text.get_text().endswith(" mm"))
    assert np.ptp(bar.get_xdata()) == pytest.approx(float(said.removesuffix(" mm")), rel=1e-9)
    assert round_length(0.0999) == 0.05


def test_a_target_that_comes_from_far_keeps_its_region_visible(found):
    far = replace(found.target("a"), mean=found.target("a").mean + 20.0, covariance=1e-4 * np.eye(3))
    panel = next(
        axes for axes in registration_figure(replace(found, targets={"far": far})).axes if axes.get_zorder() == 30
    )
    radius = far.region(0.90).radii[-1]
    assert np.ptp(panel.get_xlim()) <= 6.5 * 1.4 * radius
    assert np.ptp(panel.get_ylim()) <= 9.0 * radius


def test_a_region_without_size_is_drawn(found):
    sure = replace(found.target("a"), covariance=np.zeros((3, 3)))
    still = replace(sure, mean=sure.reference)
    figure = registration_figure(replace(found, targets={"sure": sure, "still": still}))
    for axes in figure.axes:
        assert np.isfinite([*axes.get_xlim(), *axes.get_ylim()]).all()


def test_views_begin_below_the_reasons(found):
    reasons = tuple(f"misfit: {'a long reason with many words ' * 9}{index}" for index in range(5))
    result = replace(found, trust=replace(found.trust, ok=False, reasons=reasons))
    figure = registration_figure(result)
    views = [axes for axes in figure.axes if axes.name == "3d"]
    assert len(views) == 2
    assert max(axes.get_position(original=True).y1 for axes in views) <= write_heading(figure, result)


def simulated(colour, matrix):
    """A colour as a dichromat sees it, after H. Brettel, F. Viénot, J. D. Mollon 1997 in the form of Viénot 1999."""
    from matplotlib.colors import to_rgb

    value = np.array(to_rgb(colour))
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.clip(np.array(matrix) @ linear, 0.0, 1.0) ** (1.0 / 2.2)


def test_signs_that_differ_by_colour_differ_for_every_eye():
    """Markers before and after, and contacts, have other colours for red-green-blind eyes too."""
    from tissuereg.report import scene

    protan = [[0.1124, 0.8876, 0.0], [0.1124, 0.8876, 0.0], [0.0040, -0.0040, 1.0]]
    deutan = [[0.2928, 0.7072, 0.0], [0.2928, 0.7072, 0.0], [-0.0223, 0.0223, 1.0]]
    colours = (scene.BEFORE, scene.FITTED, scene.CONTACT, scene.MEASURED)
    for eye in (np.eye(3), protan, deutan):
        seen = [simulated(colour, eye) for colour in colours]
        for index, one in enumerate(seen):
            for other in seen[index + 1 :]:
                assert np.linalg.norm(one - other) > 0.25


def test_a_long_body_is_drawn_whole():
    """Views wider than high: nothing of a body is cut at the square in their middle."""
    mesh = block(size=(160.0, 30.0, 30.0), cells=(16, 3, 3))
    skin = np.setdiff1d(mesh.surface_nodes, mesh.fixed_nodes)[::9]
    result = tr.register(mesh, tr.Markers(mesh.nodes[skin], mesh.nodes[skin], 0.1))
    reasons = [f"misfit: {'word ' * 60}{number}" for number in range(4)]  # which leave the views low
    figure = registration_figure(replace(result, trust=replace(result.trust, ok=False, reasons=reasons)))
    figure.canvas.draw()
    pixels = np.asarray(figure.canvas.buffer_rgba())[:, :, :3]
    view = figure.axes[0]
    square = view.get_window_extent()
    frame = view.get_position(original=True).transformed(figure.transFigure)
    left = int(np.floor(square.x0)) - 6
    assert frame.x0 < left
    middle = pixels.shape[0] - int(0.5 * (square.y0 + square.y1))
    drawn = pixels[middle - 40 : middle + 40, int(frame.x0) : left].min(axis=(0, 2)) < 250
    assert drawn.any(), "the body ends at the square"


def test_distances_are_before_unless_a_simulation_was_believed(found):
    assert not found.starts_simulated
    shown = " ".join(text.get_text() for text in texts(registration_figure(found)))
    assert "mm before," in shown
    assert "in the simulation" not in shown
    moved = replace(found, start_markers=found.start_markers + 0.1)
    assert moved.starts_simulated
    shown = " ".join(text.get_text() for text in texts(registration_figure(moved)))
    assert "mm in the simulation," in shown
