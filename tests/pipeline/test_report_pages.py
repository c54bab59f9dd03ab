"""The pages of a registration in a browser: the body turns, its signs are those of the result."""

import base64
import re
import struct
import zlib

import numpy as np
import pytest

import tissuereg as tr
from support.browser import needs_browser, opened
from support.pages import assert_sound_page, scenes_of, unpacked
from tissuereg.registration.target import region_of
from tissuereg.report.section import cut_region, loops, planes, png
from tissuereg.report.solid import DrawnBody

NASTY = "<b>&'\"P</b></script><img src=x onerror=faults.push(1)>"


@pytest.fixture(scope="module")
def pushed(block_mesh):
    """A block, pushed at its top; one marker is wrong, one was not seen, one has a nasty name."""
    middles = block_mesh.nodes[block_mesh.surface].mean(axis=1)
    top = block_mesh.surface[(middles[:, 2] > 39.0) & (middles[:, 0] > 10.0)]
    truth = tr.simulate(block_mesh, tr.Load(traction=(top, (0.3, 0.1, -0.4))), tr.Material(8.0, 0.45)).displacement
    rng = np.random.default_rng(3)
    free = np.setdiff1d(block_mesh.surface_nodes, block_mesh.fixed_nodes)
    nodes = rng.choice(free, 12, replace=False)
    measured = block_mesh.nodes[nodes] + truth[nodes] + 0.05 * rng.standard_normal((12, 3))
    measured[2] += (4.0, -4.0, 4.0)
    measured[5] = np.nan
    names = [NASTY, *(f"P{i}" for i in range(2, 13))]
    markers = tr.Markers(block_mesh.nodes[nodes], measured, 0.05, names)
    targets = {"deep": (12.0, 9.0, 20.0), NASTY: (14.0, 10.0, 28.0)}
    return tr.register(block_mesh.in_frame("LPS"), markers, targets=targets)


@pytest.fixture(scope="module")
def page(pushed, tmp_path_factory):
    return pushed.report(tmp_path_factory.mktemp("page") / "report.html")


def test_the_page_is_sound_and_names_are_text(page):
    text = page.read_text(encoding="utf-8")
    assert_sound_page(text)
    assert "<b>&" not in text
    assert "onerror" not in re.sub(r"&lt;.*?&gt;", "", re.sub(r"\\u003c.*?\\u003e", "", text))


def test_the_scene_is_the_result(pushed, page):
    (scene,) = scenes_of(page.read_text(encoding="utf-8"))
    nodes, shift = unpacked(scene["body"]["nodes"]), unpacked(scene["body"]["modes"])[0]
    skin = pushed.mesh.surface_nodes
    assert np.abs(nodes - pushed.mesh.nodes[skin]).max() < 0.0011
    assert np.abs(shift - pushed.displacement[skin]).max() < 0.0011
    assert [unpacked(one[0]).item() for one in scene["body"]["weights"]] == [0.0, 1.0]
    assert len(unpacked(scene["body"]["triangles"])) == len(pushed.mesh.surface)
    layers = {layer["title"]: layer for layer in scene["layers"]}
    for name, axes in zip(
        layers["target"]["names"], unpacked(layers["target: 90 % region"]["by"][0][0])[0], strict=True
    ):
        half = axes.reshape(3, 3)
        # Half-axes of the 90 % ellipsoid of a Gaussian: their outer products add up to 6.251 covariances.
        np.testing.assert_allclose(half.T @ half, 6.251 * pushed.target(name).covariance, rtol=2e-3, atol=2e-5)
    measured = unpacked(layers["marker, measured"]["places"][0][0])[0]
    registered = unpacked(layers["marker, registered"]["places"][0][0])[0]
    residual = np.array(list(pushed.markers.residual_mm.values()))
    np.testing.assert_allclose(measured - registered, residual, atol=0.0021)
    assert layers["marker not used"]["names"] == ["P3: wrong"]
    assert layers["not seen: where it must be"]["names"] == ["P6: not seen"]


@needs_browser
def test_the_body_is_drawn_and_its_controls_work(pushed, page):
    found, wide = opened(
        page,
        """const seen = [drawn()];
        button("before"); await settled(); seen.push(drawn());
        button("registered"); slide("opacity", 1); toggle("marker, measured"); await settled(); seen.push(drawn());
        const canvas = viewers[0].querySelector("canvas");
        const at = (kind, x, y) => {
          canvas.dispatchEvent(new PointerEvent(kind, { pointerId: 1, clientX: x, clientY: y }));
        };
        canvas.setPointerCapture = () => {};
        at("pointerdown", 300, 300); at("pointermove", 460, 330); at("pointerup", 460, 330);
        await settled(); seen.push(drawn());
        button("front"); await settled(); seen.push(drawn());
        const box = canvas.getBoundingClientRect(), tips = new Set();
        for (let x = 0; x < box.width; x += 6) for (let y = 0; y < box.height; y += 6) {
          at("pointermove", box.left + x, box.top + y);
          tips.add(viewers[0].querySelector(".tip").textContent);
        }
        return { seen, tips: [...tips] };""",
    )
    first, before, opaque, turned, front = found["seen"]
    triangles = len(pushed.mesh.surface)
    assert wide <= 0
    # Both sides of a body one can look through: every triangle, but those seen edge on.
    assert 0.9 * triangles < first["triangles"] <= triangles
    assert 0.2 * triangles < opaque["triangles"] < 0.8 * triangles
    assert turned["view"] == "-2.20,0.65"  # by a hundredth of a radian a pixel, from -0.6 and 0.35
    assert front["view"] == "0.00,0.00"
    assert first["signs"]["marker, measured"] == 10
    assert "marker, measured" not in opaque["signs"]
    assert "target: 90 % region" not in before["signs"]
    assert first["signs"]["target: 90 % region"] + first["signs"].get("target, no marker tells: 90 % region", 0) == 2
    skin = pushed.mesh.nodes[pushed.mesh.surface_nodes]
    moved = skin + pushed.displacement[pushed.mesh.surface_nodes]
    assert before["depth"] == pytest.approx(np.abs(skin).sum(), rel=1e-4)
    assert first["depth"] == pytest.approx(np.abs(moved).sum(), rel=1e-4)
    # From the front one sees along y: the triangles whose normals point against it.
    corners = (pushed.mesh.nodes + pushed.displacement)[pushed.mesh.surface]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 1]
    assert front["triangles"] == np.count_nonzero(across < 0.0)
    tips = [tip.split("\n") for tip in found["tips"]]
    assert any(tip[0] == NASTY for tip in tips)
    assert any(tip[0].startswith("displacement ") for tip in tips)


@needs_browser
def test_a_narrow_page_does_not_scroll_sideways(page):
    found, wide = opened(page, width=390)
    assert wide <= 0
    assert found["triangles"] > 0


def test_a_plane_cuts_a_block_in_its_outline(block_mesh):
    low, high = block_mesh.nodes.min(axis=0), block_mesh.nodes.max(axis=0)
    centre = 0.5 * (low + high) + 0.123
    (line,) = loops(block_mesh.nodes, block_mesh.surface, centre, np.array([0.0, 0.0, 1.0]))
    assert line[:, 2] == pytest.approx(centre[2])
    x, y = line[:, 0], line[:, 1]
    area = 0.5 * abs(np.sum(x * np.roll(y, 1) - y * np.roll(x, 1)))
    assert area == pytest.approx((high - low)[:2].prod())


def test_a_region_is_cut_where_its_points_have_ninety_per_cent():
    rng = np.random.default_rng(1)
    root = rng.standard_normal((3, 3))
    region = region_of(np.zeros(3), root @ root.T, 0.9, None)
    for plane in planes(None):
        places = cut_region(region, plane.across) @ plane.across
        assert np.einsum("ni,ij,nj->n", places, np.linalg.inv(root @ root.T), places) == pytest.approx(6.251, rel=1e-3)


def test_planes_are_seen_as_radiologists_do():
    for frame in ("LPS", "RAS"):
        axial, coronal, sagittal = planes(frame)
        left = np.array([1.0 if frame == "LPS" else -1.0, 0.0, 0.0])
        np.testing.assert_array_equal(axial.right, left)
        assert axial.edges == ("R", "L", "A", "P")
        np.testing.assert_array_equal(coronal.down, [0.0, 0.0, -1.0])
        assert axial.down[1] == sagittal.right[1] == left[0]


def grey_of(data):
    """The values of a grey PNG of one part, by its definition."""
    raw = base64.b64decode(data)
    width, height = struct.unpack(">II", raw[16:24])
    packed = raw[raw.index(b"IDAT") + 4 : -16]
    return np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, width + 1)[:, 1:]


def test_a_picture_holds_its_values():
    values = np.arange(12.0).reshape(3, 4)
    assert grey_of(png(values, (1.0, 11.0))).tolist() == np.clip(25.5 * (values - 1), 0, 255).round().tolist()


def test_the_image_lies_under_a_section_as_it_was_moved(pushed, tmp_path):
    sitk = pytest.importorskip("SimpleITK")
    low, high = pushed.mesh.nodes.min(axis=0) - 5.0, pushed.mesh.nodes.max(axis=0) + 5.0
    axes = [np.arange(a, b, 0.5) for a, b in zip(low, high, strict=True)]
    z, y, x = np.meshgrid(*axes[::-1], indexing="ij")
    # A bright ball at the target before the deformation.
    ball = 1000.0 * (sum((c - t) ** 2 for c, t in zip((x, y, z), (12.0, 9.0, 20.0), strict=True)) < 2.5**2) + 2.0 * z
    image = sitk.GetImageFromArray(ball.astype(np.float32))
    image.SetOrigin([float(axis[0]) for axis in axes])
    image.SetSpacing([0.5, 0.5, 0.5])
    sitk.WriteImage(image, str(tmp_path / "ct.nrrd"))
    text = pushed.report(tmp_path / "report.html", image=tmp_path / "ct.nrrd").read_text(encoding="utf-8")
    figures = re.findall(r"<figure>.*?</figure>", text, re.DOTALL)
    assert len(figures) == 12  # two targets, three planes, whole and enlarged
    for figure in figures[:3]:
        grey = grey_of(re.search(r"base64,([^']+)'", figure)[1])
        rows, columns = np.nonzero(grey > 200)
        # Its centre is where the crosses of the section meet: at the registered target.
        at = [float(re.search(rf"<line x1='[\d.]+' x2='{number}", figure)[1]) for number in (r"([\d.]+)",)]
        middle = np.array([at[0] + 9.0, float(re.search(r"<line x1='0' x2='[\d.]+' y1='([\d.]+)'", figure)[1])])
        centre = 360.0 / grey.shape[0] * np.array([columns.mean() + 0.5, rows.mean() + 0.5])
        scale = 360.0 / 50.0  # about, pixels a mm
        assert np.linalg.norm(centre - middle) < 0.5 * scale
    assert "undeformed" not in figures[0]


def test_an_image_that_cannot_lie_there_is_refused(pushed, tmp_path):
    sitk = pytest.importorskip("SimpleITK")
    for name, origin, pixel in (("far", 500.0, sitk.sitkFloat32), ("colours", 0.0, sitk.sitkVectorUInt8)):
        image = sitk.Image([8, 8, 8], pixel, 3 if pixel == sitk.sitkVectorUInt8 else 1)
        image.SetOrigin([origin] * 3)
        sitk.WriteImage(image, str(tmp_path / f"{name}.nrrd"))
    for name, said in (("far", "none of its nodes"), ("colours", "one value a voxel")):
        with pytest.raises(tr.errors.ArgumentError, match=said):
            pushed.report(tmp_path / "report.html", image=tmp_path / f"{name}.nrrd")
        with pytest.raises(tr.errors.ArgumentError, match=said):
            pushed.save(tmp_path / "out", image=tmp_path / f"{name}.nrrd")
    assert not (tmp_path / "report.html").exists()
    assert not (tmp_path / "out").exists()


def test_a_large_surface_is_coarsened_with_its_fields(block_mesh):
    whole = DrawnBody.of(block_mesh, [block_mesh.fixed_nodes])
    assert set(whole.patch.tolist()) == {0, 1}
    assert whole.words == ""
    few = DrawnBody.of(block_mesh, [block_mesh.fixed_nodes], most=60)
    assert 8 < len(few.triangles) <= 60
    assert np.ptp(few.nodes, axis=0) == pytest.approx(np.ptp(block_mesh.nodes, axis=0), rel=0.5)
    # A field that is the places themselves stays so.
    np.testing.assert_allclose(few.field(block_mesh.nodes), few.nodes, atol=1e-9)
    assert f"{len(block_mesh.surface):,} triangles" in few.words
