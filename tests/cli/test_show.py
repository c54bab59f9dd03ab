"""The command show: a body with its node sets, markers and targets on a page that turns."""

import numpy as np
import pytest

from support.browser import needs_browser, opened
from support.files import run, run_json, write_experiment
from support.meshes import block
from support.pages import assert_sound_page, scenes_of, unpacked
from tissuereg.io.meshes import write_vtu

NASTY = "<img src=x onerror=faults.push(1)>"


@pytest.fixture
def files(tmp_path):
    mesh = block(cells=(3, 2, 4))
    low, high = mesh.nodes.min(axis=0), mesh.nodes.max(axis=0)
    top = np.flatnonzero(mesh.nodes[:, 2] > high[2] - 0.1)
    write_vtu(tmp_path / "body.vtu", mesh.with_node_set("top", top).with_node_set("fixed", []))
    middle = 0.5 * (low + high)
    rows = [("above", *(middle[:2]), high[2] + 3.0), (f'"{NASTY}"', *middle)]
    lines = [",".join(str(cell) for cell in row) for row in rows]
    for name, first in (("markers.csv", "marker"), ("targets.csv", "target")):
        (tmp_path / name).write_text(f"{first},x_mm,y_mm,z_mm\n" + "\n".join(lines) + "\n", encoding="utf-8")
    return mesh, tmp_path


def test_the_page_shows_what_a_rule_picked(files, capsys):
    mesh, folder = files
    low = mesh.nodes[:, 2].min()
    words = ["show", folder / "body.vtu", "--fixed", f"plane 0 0 1 {low} 0.1", "--out", folder / "body.html"]
    code, said, _ = run_json(capsys, *words, "--markers", folder / "markers.csv", "--targets", folder / "targets.csv")
    picked = np.flatnonzero(mesh.nodes[:, 2] < low + 0.1)
    assert code == 0
    assert said["schema"] == "tissuereg.show/1"
    assert said["node_sets"]["fixed"] == len(picked)
    assert said["markers"]["above"] == {"from_surface_mm": pytest.approx(3.0), "inside": False}
    assert said["targets"][NASTY]["inside"] is True
    text = (folder / "body.html").read_text(encoding="utf-8")
    assert_sound_page(text)
    assert NASTY not in text
    (scene,) = scenes_of(text)
    patch, names = unpacked(scene["body"]["patch"]), [one["name"] for one in scene["patches"]]
    for name, nodes in (("fixed", picked), ("top", np.flatnonzero(mesh.nodes[:, 2] > mesh.nodes[:, 2].max() - 0.1))):
        drawn = np.count_nonzero(patch == names.index(name))
        assert drawn == np.count_nonzero(np.isin(mesh.surface, nodes).all(axis=1)) > 0


@needs_browser
def test_the_page_is_drawn(files, capsys):
    mesh, folder = files
    words = ["show", folder / "body.vtu", "--fixed", f"plane 0 0 1 {mesh.nodes[:, 2].min()} 0.1"]
    more = ["--markers", folder / "markers.csv", "--out", folder / "body.html"]
    assert run(capsys, *words, *more)[0] == 0
    script = """slide("opacity", 1); button("top"); await settled(); const one = drawn();
        toggle("top: 12 nodes"); await settled(); return [one, drawn()];"""
    (closed, marked), wide = opened(folder / "body.html", script)
    assert wide <= 0
    held = int((mesh.nodes[:, 2] < mesh.nodes[:, 2].min() + 0.1).sum())
    assert closed["signs"][f"fixed: {held} nodes"] == held
    assert closed["signs"]["marker"] == 2
    assert closed["labels"] == 2
    assert marked["signs"]["top: 12 nodes"] == 12
    normals = np.cross(*np.moveaxis(np.diff(mesh.nodes[mesh.surface], axis=1), 1, 0))
    assert closed["triangles"] == np.count_nonzero(normals[:, 2] > 1e-6)
    assert opened(folder / "body.html", width=390)[1] <= 0


def test_a_body_that_nothing_holds_is_shown_and_said(files, capsys):
    _, folder = files
    code, out, _ = run(capsys, "show", folder / "body.vtu", "--out", folder / "body.html")
    assert code == 0
    assert out.splitlines()[-1] == "No node is held: name the held nodes with --fixed."
    assert "there is no set" in (folder / "body.html").read_text(encoding="utf-8")


def test_an_experiment_brings_its_own(tmp_path, capsys):
    rig = write_experiment(tmp_path / "rig")
    code, said, _ = run_json(capsys, "show", rig, "--out", tmp_path / "rig.html")
    assert code == 0
    assert {"fixed", "push"} <= said["node_sets"].keys()
    assert said["markers"].keys() == {"P1", "P2"}
    code, _, err = run(capsys, "show", rig, "--fixed", "plane 0 0 1 0", "--out", tmp_path / "other.html")
    assert (code, "--fixed must be left out" in err) == (2, True)


@pytest.mark.parametrize(("name", "said"), [("body.vtu", "must end in .html"), ("body.png", "must end in .html")])
def test_another_kind_of_file_is_refused(files, capsys, name, said):
    _, folder = files
    before = (folder / "body.vtu").read_bytes()
    code, _, err = run(capsys, "show", folder / "body.vtu", "--out", folder / name)
    assert (code, said in err) == (2, True)
    assert (folder / "body.vtu").read_bytes() == before
