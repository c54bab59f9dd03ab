"""The example for 3D Slicer's console, with a small stand-in for Slicer and the command as it is."""

import json
import os
import shutil
import stat
import sys
import types
from pathlib import Path

import numpy as np
import pytest
import SimpleITK as sitk  # noqa: N813 (its own habit)

import tissuereg as tr
from support.scripts import script
from tissuereg.io.mrk_json import read_mrk_json, write_mrk_json
from tissuereg.io.surfaces import read_triangles
from tissuereg.io.triangles_out import write_triangles
from tissuereg.phantom.samples import write_samples

pytest.importorskip("pytetwild", reason="the extra `mesh` is not installed")

FIXED = "plane 0 0 1 -18 2.5"


class Node:
    """A node of the scene: its file, and what was put above it."""

    def __init__(self, file):
        self.file, self.above = file, None

    def GetID(self):
        return f"node of {self.file.name}"

    def SetAndObserveTransformNodeID(self, above):
        self.above = above


#: How what is loaded is read.
READERS = {
    "loadSegmentation": sitk.ReadImage,
    "loadTransform": sitk.ReadTransform,
    "loadMarkups": read_mrk_json,
    "loadModel": read_triangles,
}


class Scene:
    """What the example asks of `slicer.util`: nodes are files, and are loaded by the readers of their kind."""

    def __init__(self, folder, nodes):
        self.folder, self.nodes, self.warned, self.loaded = folder, nodes, [], {}

    def __getattr__(self, name):
        def load(path):
            self.loaded[name, Path(path).name] = READERS[name](path)
            return Node(self.folder / Path(path).name)

        if name not in READERS:
            raise AttributeError(name)
        return load

    def getNode(self, name):
        return self.nodes[name]

    def exportNode(self, node, path, properties=None, world=False):
        assert world
        shutil.copyfile(node.file, path)

    def startupEnvironment(self):
        return {name: value for name, value in os.environ.items() if name != "PYTHONHOME"}

    def warningDisplay(self, text):
        self.warned.append(text)


@pytest.fixture
def scene(tmp_path, monkeypatch):
    """The sample scan as a scene, and the command where the variable says."""
    write_samples(tmp_path / "first")
    scan, surface = tmp_path / "first" / "scan", tmp_path / "first" / "surface"
    nodes = {
        "segmentation": Node(scan / "segmentation.seg.nrrd"),
        "markers": Node(scan / "markers.mrk.json"),
        "measured": Node(scan / "measured.mrk.json"),
        "skin": Node(tmp_path / "skin.ply"),
        "scan": Node(scan / "segmentation.seg.nrrd"),
        "inner": Node(tmp_path / "inner.mrk.json"),
    }
    organ = read_triangles(surface / "organ.stl")
    write_triangles(tmp_path / "skin.ply", tr.Triangles(organ.vertices, organ.triangles, "LPS"))
    inner = {name: (at, "") for name, at in tr.read_targets(surface / "targets.csv").items()}
    write_mrk_json(tmp_path / "inner.mrk.json", inner, "LPS")
    command = tmp_path / "bin" / "tissuereg"
    command.parent.mkdir()
    # Slicer's own home of Python would keep another Python from starting.
    command.write_text(
        f'#!/bin/sh\n[ -z "$PYTHONHOME" ] || exit 77\necho "$@" >> {tmp_path}/commands\n'
        f'exec {sys.executable} -m tissuereg "$@"\n'
    )
    command.chmod(command.stat().st_mode | stat.S_IXUSR)
    monkeypatch.setenv("PYTHONHOME", "/opt/Slicer/lib/Python")
    monkeypatch.setenv("PATH", f"{command.parent}:{os.environ['PATH']}")
    monkeypatch.delenv("TISSUEREG", raising=False)
    util = Scene(tmp_path, nodes)
    slicer = types.ModuleType("slicer")
    slicer.util = util
    monkeypatch.setitem(sys.modules, "slicer", slicer)
    return util


@pytest.mark.slow
def test_the_scene_gets_all_that_moved(scene, tmp_path):
    example = script("examples", "slicer/move_tumour")
    options = {"fixed": FIXED, "size_mm": 12.0, "folder": str(tmp_path / "kept")}
    nodes = example.move(
        "segmentation",
        ["organ", "lesion"],
        "markers",
        "measured",
        targets="inner",
        models=["skin"],
        volume="scan",
        **options,
    )
    assert set(nodes) == {"segmentation", "transform", "skin", "targets"}
    assert [line.split()[0] for line in (tmp_path / "commands").read_text().splitlines()] == (
        ["mesh", "register", "warp", "warp", "warp"]
    )
    assert scene.warned == []
    assert scene.nodes["scan"].above == nodes["transform"].GetID()
    true = tr.read_targets(tmp_path / "first" / "surface" / "truth.csv")["lesion"]
    rest = tr.read_targets(tmp_path / "first" / "surface" / "targets.csv")["lesion"]
    way = np.linalg.norm(true - rest)
    targets = scene.loaded["loadMarkups", "targets.mrk.json"]
    assert np.linalg.norm(targets.places[targets.names.index("lesion")] - true) < 0.5 * way
    image = scene.loaded["loadSegmentation", "moved.seg.nrrd"]
    assert [image.GetMetaData(f"Segment{k}_Name") for k in (0, 1)] == ["organ", "lesion"]
    voxels = np.argwhere(sitk.GetArrayFromImage(image) == 2)[:, ::-1].mean(axis=0)
    middle = np.array(image.TransformContinuousIndexToPhysicalPoint(voxels.tolist()))
    assert np.linalg.norm(middle - true) < 0.5 * way
    # ITK's transform leads back, from where the lesion is to where it was.
    back = np.array(scene.loaded["loadTransform", "field.h5"].TransformPoint(middle.tolist()))
    assert np.linalg.norm(back - rest) < 0.25 * way
    moved, still = scene.loaded["loadModel", "moved0.ply"], read_triangles(tmp_path / "skin.ply")
    assert moved.frame == "LPS"
    assert np.linalg.norm(moved.vertices - still.vertices, axis=1).max() > 5.0


def test_what_goes_wrong_is_shown(scene, tmp_path, monkeypatch):
    example = script("examples", "slicer/move_tumour")
    with pytest.raises(RuntimeError, match=r"tissuereg mesh ended with 3: error: [^;]*organ \(1\), lesion \(2\)"):
        example.move("segmentation", ["liver"], "markers", "measured", folder=str(tmp_path / "kept"))
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(RuntimeError, match="TISSUEREG"):
        example.tissuereg("--version")


@pytest.mark.slow
def test_a_doubtful_answer_is_loaded_with_its_reasons(scene, tmp_path, monkeypatch):
    example = script("examples", "slicer/move_tumour")
    words = json.loads(scene.nodes["measured"].file.read_text(encoding="utf-8"))
    for point in words["markups"][0]["controlPoints"]:
        point["position"] = [x / 10.0 for x in point["position"]]  # in cm
    scene.nodes["measured"].file.write_text(json.dumps(words), encoding="utf-8")
    options = {"fixed": FIXED, "size_mm": 12.0, "folder": str(tmp_path / "kept")}
    nodes = example.move("segmentation", ["organ", "lesion"], "markers", "measured", **options)
    assert set(nodes) == {"segmentation", "transform"}
    assert len(scene.warned) == 1
    assert scene.warned[0].startswith("Do not trust this registration: ")
