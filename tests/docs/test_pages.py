"""Does every code block of the documentation do what its page says?"""

import json
import shutil

import numpy as np
import pytest

import tissuereg as tr
from support.blocks import REPOSITORY, blocks, run_page
from support.material_curves import believed, in_modes
from support.rig_folders import write_rig
from support.scripts import script
from support.surfaces import sphere, write_stl
from tissuereg.imaging.images import Grid, write_image
from tissuereg.io.material_experiments import write_test_table
from tissuereg.phantom.demo import run_demo

DOCS = REPOSITORY / "docs"
FIGURES = script("tools", "demo_figures")
PAGES = [REPOSITORY / "README.md", *sorted(DOCS.rglob("*.md"))]
#: Guides are followed by `test_guides.py`, in a copy of the sources.
WITH_BLOCKS = [page for page in PAGES if blocks(page) and page.parent.name != "guides"]


def name_of(page):
    return page.relative_to(REPOSITORY).as_posix()


def give_readme(folder):
    """What `make demo` writes, and the same files under the names of the command line."""
    run_demo(folder / "demo", seed=0)
    for file in ("body.vtu", "markers.csv", "targets.csv"):
        shutil.copy(folder / "demo" / "input" / file, folder / file)


def give_meshing(folder):
    """A surface of the size of the page's numbers: base at z = 0, top near (40, 20, 95)."""
    vertices, triangles = sphere(50.0, (40.0, 20.0, 0.0))
    vertices[:, 2] = np.maximum(vertices[:, 2], 0.0) * 1.9
    write_stl(folder / "liver.stl", (vertices, triangles))
    # Half an ellipsoid on the plane z = 0, with a ball in it, in voxels of 2 mm.
    z, y, x = 2.0 * np.indices((32, 62, 62)) - np.reshape([10.0, 60.0, 60.0], (3, 1, 1, 1))
    organ = (z >= 0.0) & ((x / 50.0) ** 2 + (y / 45.0) ** 2 + (z / 40.0) ** 2 < 1.0)
    tumour = organ & (x**2 + y**2 + (z - 18.0) ** 2 < 100.0)
    values = organ.astype(np.uint8) + tumour.astype(np.uint8)
    image = Grid((62, 62, 32), np.array([-60.0, -60.0, -10.0]), 2.0 * np.eye(3)).image(values)
    for number, name in enumerate(("liver", "tumour")):
        image.SetMetaData(f"Segment{number}_Name", name)
        image.SetMetaData(f"Segment{number}_LabelValue", str(1 + number))
    write_image(folder / "seg.seg.nrrd", image)


def give_diagnose(folder):
    write_rig(folder / "my-rig", "balls")


def give_material(folder):
    test = folder / "my-test"
    test.mkdir()
    curves = in_modes(np.random.default_rng(4), ("ogden", -10.0))
    write_test_table(test / "test.csv", curves)
    tr.write_experiment(believed(curves, folder=test), test / "experiment.toml")


#: What a page takes for granted, by a function of the folder in which its blocks run.
GIVEN = {
    "README.md": give_readme,
    "docs/meshing.md": give_meshing,
    "docs/diagnose.md": give_diagnose,
    "docs/material.md": give_material,
}

#: Pages whose blocks take tens of seconds.
SLOW = {
    "docs/diagnose.md",
    "docs/meshing.md",
    "docs/tutorial.md",
    "docs/howto/diagnose-a-rig.md",
    "docs/howto/own-network.md",
    "docs/howto/own-organ.md",
    "docs/howto/own-simulator.md",
    "docs/howto/own-tracker.md",
    "docs/howto/recording-to-report.md",
    "docs/howto/tumour-in-slicer.md",
}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run a page in a folder of its own, with a cache of its own."""

    def run(page):
        if "tissuereg mesh " in page.read_text(encoding="utf-8"):
            pytest.importorskip("pytetwild", reason="the extra `mesh` is not installed")
        folder, cache = tmp_path / "page", tmp_path / "cache"
        folder.mkdir()
        monkeypatch.chdir(folder)
        monkeypatch.setenv("TISSUEREG_CACHE", str(cache))
        GIVEN.get(name_of(page), lambda folder: None)(folder)
        return folder, run_page(page, folder, {"TISSUEREG_CACHE": str(cache)})

    return run


@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, id=name_of(page), marks=[pytest.mark.slow] if name_of(page) in SLOW else [])
        for page in WITH_BLOCKS
        if page.name != "README.md"
    ],
)
def test_the_blocks_of_a_page_run(page, run):
    run(page)


def test_the_readme_runs_and_finds_the_lesion(run):
    folder, names = run(REPOSITORY / "README.md")
    result = names["result"]
    answer = json.loads((folder / "demo" / "registration.json").read_text(encoding="utf-8"))
    true = answer["truth"]["targets"]["lesion"]["true_mm"]
    off = ((result.target("lesion").mean - true) ** 2).sum() ** 0.5
    rest = ((result.target("lesion").reference - true) ** 2).sum() ** 0.5
    assert off < 0.2 * rest
    assert (folder / "report.html").is_file()
    assert (folder / "registered" / "registered.vtu").is_file()
    assert isinstance(result, tr.Registration)


def test_the_results_show_the_errors_of_the_model_that_is_shipped():
    assert script("benchmarks", "readme").table("model", FIGURES.RESULTS) == FIGURES.model_table()


def test_blocks_that_are_not_run_are_known():
    left_out = {name_of(page): sum(block.not_run is not None for block in blocks(page)) for page in PAGES}
    assert {page: n for page, n in left_out.items() if n} == {
        "docs/tutorial.md": 1,  # pip install
        "docs/howto/recording-to-report.md": 1,  # the same
        "docs/howto/tumour-in-slicer.md": 1,  # the same
        "docs/cluster.md": 4,  # start processes, or take a cluster
        "docs/files.md": 1,  # reads a data set; run by tests/unit/test_datasets.py
        "docs/howto/own-network.md": 4,  # make training; three that need torch, run by training/tests/test_page.py
        "docs/realtime.md": 1,  # takes minutes
        "docs/howto/live.md": 2,  # run by tests/unit/test_live.py, or need a peer
    }
