"""Does the page of the experiment format list what the readers take, and `tissuereg new` write the same?"""

import importlib.util
import re
from pathlib import Path

import numpy as np
import pytest

import tissuereg as tr
from support.files import EXPERIMENT, run_json, write_experiment
from support.meshes import block
from tissuereg.cli import skeleton
from tissuereg.cli.skeleton import new_experiment
from tissuereg.errors import ConvergenceError, ExperimentError, MeshError
from tissuereg.imaging.images import itk, read_image
from tissuereg.io import drafts
from tissuereg.io import experiment_keys as keys
from tissuereg.io.atomic import OutputError
from tissuereg.io.meshes import write_vtu
from tissuereg.io.surfaces import read_triangles
from tissuereg.phantom.samples import write_samples

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "experiment.md"


@pytest.fixture(scope="module")
def maker():
    """``tools/experiment_page.py`` as a module."""
    spec = importlib.util.spec_from_file_location("experiment_page", ROOT / "tools" / "experiment_page.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def begun(tmp_path):
    """A folder that `new_experiment` wrote."""
    write_vtu(tmp_path / "body.vtu", block())
    new_experiment(tmp_path / "rig", tmp_path / "body.vtu")
    return tmp_path / "rig"


def test_the_page_is_made_from_the_declarations(maker, monkeypatch):
    text = PAGE.read_text(encoding="utf-8")
    assert maker.made(text) == text, "run python tools/experiment_page.py"
    monkeypatch.setitem(maker.BLOCKS, "[forces]", lambda: maker.keys_of(keys.TargetKeys))
    assert maker.made(text) != text
    with pytest.raises(ValueError, match="each block once"):
        maker.made(text.replace("made by tools/experiment_page.py: laws", "made by tools/experiment_page.py: lows"))


@pytest.mark.parametrize("declaration", [*keys.RIG, keys.MaterialTestKeys], ids=lambda d: d.heading or "top")
def test_every_declared_key_is_on_the_page_and_read(declaration):
    text = PAGE.read_text(encoding="utf-8")
    for key in declaration.declared():
        assert f"| `{key.name}` |" in text
        assert key.check.meaning
        assert key.check.words


def test_a_key_that_is_not_declared_is_refused_in_every_table(tmp_path):
    for declaration in keys.RIG[1:-1]:
        heading = declaration.heading
        toml = (
            EXPERIMENT
            if heading in EXPERIMENT
            else EXPERIMENT + f"{heading}\ndirection = [0, 0, 1]\nin_reference = true\n"
        )
        toml = toml.replace(heading, f"{heading}\nunheard_of = 1\n", 1)
        with pytest.raises(ExperimentError, match=r"only the keys .* are known, got 'unheard_of'"):
            tr.read_experiment(write_experiment(tmp_path / "rig", toml=toml))


def test_a_new_experiment_holds_every_key_and_reads_with_all_of_them(begun):
    text = (begun / "experiment.toml").read_text(encoding="utf-8")
    for declaration in keys.RIG:
        assert declaration.heading in text
        for key in declaration.declared():
            assert re.search(rf"^#?\[?(?:markers\.)?{key.name}\b", text, flags=re.MULTILINE), key.name
    plain = tr.read_experiment(begun)
    # `reference_time_s` stands in place of the listed places.
    every = re.sub(r"^#(?! |reference_time_s)(.*)$", r"\1", text, flags=re.MULTILINE)
    assert every.count("\n#") < text.count("\n#")
    (begun / "experiment.toml").write_text(every, encoding="utf-8")
    full = tr.read_experiment(begun)
    assert (plain.gravity, plain.trial_share, plain.surface_std, plain.surface_length) == (None, 0.0, 0.0, None)
    assert full.gravity.in_reference
    assert (full.trial_share, full.surface_std, full.surface_length) == (0.02, 0.5, 10.0)
    assert [pad.edge_std for pad in full.actuators] == [1.0, 1.0]
    assert np.array_equal(full.marker_reference, plain.marker_reference)


def test_a_new_experiment_is_a_rig_on_the_users_body(begun):
    rig = tr.read_experiment(begun)
    assert list(rig.cases) == ["rest", "push_1", "push_2"]
    assert (rig.rest_case, rig.simulated.model, len(rig.marker_names)) == ("rest", "plain", 10)
    patches = [set(pad.nodes) for pad in rig.actuators]
    assert not patches[0] & patches[1]
    assert all(not patch & set(rig.mesh.fixed_nodes) for patch in patches)
    for case in rig.cases.values():
        assert np.isfinite(case.markers).all()
    rest, pushed = rig.cases["rest"], rig.cases["push_1"]
    assert np.abs(rest.markers - rig.marker_reference).max() < 6 * rig.marker_std
    assert np.abs(pushed.markers[2] - rig.marker_reference).max() > 6 * rig.marker_std
    inward = pushed.displacements["pad_1"][2]
    centre = rig.mesh.nodes.mean(axis=0)
    assert inward @ (centre - np.array(rig.actuator("pad_1").rule["centre_mm"])) > 0


def test_the_tables_of_a_new_experiment_are_what_its_model_predicts(begun):
    rig = tr.read_experiment(begun)
    answers = tr.simulate_experiment(rig, model="plain")
    for name, case in rig.cases.items():
        assert np.abs(case.markers - answers[name].markers).max() < 5 * rig.marker_std
        for pad, force in case.forces.items():
            assert np.abs(force - answers[name].forces[pad]).max() < 5 * rig.force_std


def test_a_new_experiment_wants_a_folder_of_its_own(begun):
    with pytest.raises(OutputError, match="must be new or empty"):
        new_experiment(begun, begun.parent / "body.vtu")


def test_a_new_experiment_takes_a_folder_that_holds_a_killed_ones_draft(tmp_path):
    write_vtu(tmp_path / "body.vtu", block())
    stale = tmp_path / "rig" / f"{drafts.DRAFT_PREFIX}{drafts._machine()}-0123abcd"
    stale.mkdir(parents=True)
    new_experiment(tmp_path / "rig", tmp_path / "body.vtu")
    assert not stale.exists()
    assert len(tr.read_experiment(tmp_path / "rig").cases) == 3


def test_a_new_experiment_names_its_mesh_through_links(tmp_path):
    (tmp_path / "deep" / "er" / "est").mkdir(parents=True)
    (tmp_path / "link").symlink_to(tmp_path / "deep" / "er" / "est")
    write_vtu(tmp_path / "body.vtu", block())
    new_experiment(tmp_path / "link" / "rig", tmp_path / "body.vtu")
    assert tr.read_experiment(tmp_path / "link" / "rig").mesh.n_nodes == block().n_nodes


@pytest.mark.parametrize(
    ("size", "cells"),
    [((100, 100, 5), (12, 12, 2)), ((60, 50, 12), (10, 8, 3)), ((20, 20, 90), (4, 4, 14)), ((40, 40, 40), (5, 5, 5))],
    ids=["sheet", "slab", "rod", "cube"],
)
def test_thin_and_long_bodies_get_pads_on_one_side_that_the_body_bears(size, cells, tmp_path):
    write_vtu(tmp_path / "body.vtu", block(size, cells))
    new_experiment(tmp_path / "rig", tmp_path / "body.vtu")
    rig = tr.read_experiment(tmp_path / "rig")
    one, two = (set(map(int, pad.nodes)) for pad in rig.actuators)
    assert not one & two
    assert not (one | two) & set(map(int, rig.mesh.fixed_nodes))
    for case in rig.cases.values():
        assert np.isfinite(case.markers).all()
        assert all(np.isfinite(force).all() for force in case.forces.values())


def test_a_body_without_room_for_pads_is_refused(tmp_path):
    write_vtu(tmp_path / "body.vtu", block((100, 100, 5), (2, 2, 1)))
    with pytest.raises(MeshError, match=r"free ones at least|must find room"):
        new_experiment(tmp_path / "rig", tmp_path / "body.vtu")
    assert not (tmp_path / "rig").exists()


def test_pushes_that_no_body_bears_are_refused(tmp_path, monkeypatch):
    write_vtu(tmp_path / "body.vtu", block())
    monkeypatch.setattr(skeleton, "_HALVINGS", 0)
    monkeypatch.setattr(skeleton, "_STROKE", np.array([0.0, 1e4]))
    with pytest.raises(ConvergenceError, match="must have an equilibrium on this mesh"):
        new_experiment(tmp_path / "rig", tmp_path / "body.vtu")
    assert not (tmp_path / "rig").exists()


def test_new_says_what_it_guessed_and_takes_a_rule(tmp_path, capsys):
    write_vtu(tmp_path / "body.vtu", tr.Mesh(block().nodes, block().tets))
    code, report, err = run_json(capsys, "new", tmp_path / "a", "--mesh", tmp_path / "body.vtu")
    assert code == 0, err
    assert len(report["guessed"]) == 1
    assert "lowest along z" in report["guessed"][0]
    rule = "plane 1 0 0 0 0.1"
    code, report, err = run_json(capsys, "new", tmp_path / "b", "--mesh", tmp_path / "body.vtu", "--fixed", rule)
    assert (code, report["guessed"]) == (0, [])
    assert tr.read_experiment(tmp_path / "b").boundaries[0].rule == {"plane": [1, 0, 0, 0], "tolerance_mm": 0.1}


def test_the_sample_rig_is_read_and_its_truth_is_hidden(tmp_path):
    files = write_samples(tmp_path / "first")
    assert all((tmp_path / "first" / file).is_file() for file in files)
    rig = tr.read_experiment(tmp_path / "first" / "rig")
    assert (rig.effects, list(rig.cases)) == ((), ["rest", "push top", "push side"])
    markers = tr.read_markers(tmp_path / "first" / "surface" / "markers.csv")
    assert (len(markers), sorted(tr.read_targets(tmp_path / "first" / "surface" / "targets.csv"))) == (
        15,
        ["lesion", "vessel"],
    )


def test_the_sample_scan_is_the_organ_of_the_surface_with_its_markers(tmp_path):
    write_samples(tmp_path)
    scan, surface = tmp_path / "scan", tmp_path / "surface"
    image = read_image(scan / "segmentation.seg.nrrd")
    assert [image.GetMetaData(f"Segment{k}_Name") for k in range(2)] == ["organ", "lesion"]
    voxels = int((itk().GetArrayFromImage(image) > 0).sum()) * float(np.prod(image.GetSpacing()))
    assert voxels == pytest.approx(read_triangles(surface / "organ.stl").volume, rel=0.01)
    markers = tr.read_markers(scan / "markers.mrk.json", measured=scan / "measured.mrk.json")
    wanted = tr.read_markers(surface / "markers.csv")
    assert markers.names == wanted.names
    assert markers.reference == pytest.approx(wanted.reference, abs=1e-3)
    assert markers.measured == pytest.approx(wanted.measured, abs=1e-3)


def test_the_samples_never_replace_files_of_the_user(tmp_path):
    mine = tmp_path / "mine" / "rig" / "markers.csv"
    mine.parent.mkdir(parents=True)
    mine.write_text("my measured data")
    with pytest.raises(OutputError, match=r"markers\.csv must be absent"):
        write_samples(tmp_path / "mine")
    assert mine.read_text() == "my measured data"
    assert not (tmp_path / "mine" / "surface").exists()
    mine.unlink()
    write_samples(tmp_path / "mine")
    write_samples(tmp_path / "mine")


def test_demo_writes_its_files_and_nothing_else(tmp_path, capsys):
    code, report, err = run_json(capsys, "demo", "--files", tmp_path / "first")
    assert code == 0, err
    assert "surface/organ.stl" in report["files"]
    assert "rig/experiment.toml" in report["files"]
    code, report, _ = run_json(capsys, "demo", "--files", tmp_path / "x", "--out", tmp_path / "y")
    assert (code, report["error"]) == (2, "UsageError")
    assert not (tmp_path / "x").exists()
