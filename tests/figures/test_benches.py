"""Every bench runs once, with its smallest case, in a copy: archives and pages stay as they are."""

import os
import re
import shutil
import subprocess
import sys

import pytest

from common import BENCHES, REPOSITORY, SHARED, read_archive

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def copy(tmp_path_factory):
    """The benches in a folder of their own, as a repository would have them."""
    top = tmp_path_factory.mktemp("copy") / "main"
    kept_out = shutil.ignore_patterns("twin", "results", "__pycache__", "*.tar.xz")
    shutil.copytree(BENCHES, top / "benchmarks", ignore=kept_out)
    for name in ("tests/support", "tests/data", "examples", "training/recipes", "python/tissuereg/phantom/data"):
        shutil.copytree(REPOSITORY / name, top / name)
    if SHARED.is_dir():
        (top.parent / "shared").symlink_to(SHARED)
    return top


def run(top, *words):
    """Run a module of a bench in the copy; return what it printed."""
    paths = [str(top / "benchmarks"), str(top / "tests"), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(paths), "OMP_NUM_THREADS": "1"}
    done = subprocess.run(
        [sys.executable, "-m", *map(str, words)], cwd=top, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr[-2000:]
    return done.stdout


def test_blind(copy):
    (copy / "one.txt").write_text(sorted((BENCHES / "blind" / "data" / "cases").glob("*.npz"))[0].stem + "\n", "utf-8")
    run(copy, "blind.run", "--cases", "one.txt", "--predictions", "out")
    assert "1 of 538 sealed cases scored" in run(copy, "blind.score", "out")


@pytest.mark.parametrize("words", [("beam",), ("hole", "--bench", "supports")], ids=" ".join)
def test_loadfree(copy, words):
    body, *bench = words
    run(
        copy, "loadfree", *bench, "--half", "dev", "--bodies", body, "--limit", 1, "--methods", *METHODS[len(bench) > 0]
    )
    half = "supports-dev" if bench else "dev"
    assert read_archive(copy / "benchmarks" / "loadfree" / "archive" / half)["rows"]
    run(copy, "loadfree.table")


METHODS = (("contacts", "none", "rigid", "spline", "gaussian"), ("perhaps", "sure"))


def test_misuse(copy):
    assert "200" in run(copy, "misuse", "--quick")


def test_diagnosis(copy):
    shutil.rmtree(copy / "benchmarks" / "diagnosis" / "archive" / "simulated-here")
    run(copy, "diagnosis.simulated_here", "--rigs", 1)
    assert "| all | 1 |" in (copy / "benchmarks/diagnosis/RESULTS-simulated-here.md").read_text(encoding="utf-8")
    run(copy, "diagnosis.material", "--seeds", 1, "--null-seeds", 1, "--only", "three modes")


def test_tracking(copy):
    run(copy, "tracking.tracking", "--seeds", 1, "--contacts-seeds", 1)


def test_live(copy):
    run(copy, "tracking.soak", "--minutes", 0.1, "--hz", 5)
    run(copy, "tracking.soak", "--fuzz", "--messages", 300)
    answer = read_archive(copy / "benchmarks" / "tracking" / "archive" / "soak")
    assert answer["said"]["received"] == answer["sent"] == answer["recorded"]
    assert answer["said"]["registered"] == answer["recorded_registered"] > 0
    assert answer["replay"] == {"compared": answer["recorded_registered"], "different": 0}
    assert "| good frames answered | 3 of 3 |" in (copy / "benchmarks/tracking/RESULTS-live.md").read_text("utf-8")


def test_speed(copy):
    run(copy, "speed.cluster", "--chunks", 1, "--repeats", 1, "--tasks", 20)
    run(copy, "speed.large_bodies", "--sizes", 2000, "--out", "large")
    assert read_archive(copy / "large")["rows"][0]["measured"]["solve"]["wall_s"] > 0.0


@pytest.fixture(scope="module")
def few_shapes(copy):
    """A data set of the phantom as the shipped model's, of 120 members: its folder."""
    recipe = re.sub(
        r"(?m)^(members|chunk) = \d{2,}", r"\1 = 120", (copy / "training/recipes/breast.toml").read_text("utf-8")
    )
    (copy / "few.toml").write_text(recipe, "utf-8")
    run(copy, "tissuereg", "simulate", "few.toml", "--out", "few")
    return copy / "few"


def test_advise(copy, few_shapes):
    run(copy, "advise.advise", "--data", few_shapes, "--train", 80, "--test", 5)
    assert "80 members choose, 5 held-out members" in (copy / "benchmarks/advise/RESULTS.md").read_text("utf-8")


def test_learned(copy, few_shapes):
    recipe = copy / "benchmarks" / "learned" / "foreign.toml"
    recipe.write_text(recipe.read_text("utf-8").replace("members = 10 ", "members = 1 "), "utf-8")
    (copy / "docs").mkdir()
    for page in ("docs/results.md", "README.md"):
        shutil.copy(REPOSITORY / page, copy / page)
    run(copy, "learned", "--foreign", "foreign", "--make", "1:6:2")
    run(copy, "learned", "--data", few_shapes, "--foreign", "foreign", "--share", 0.004)
    rows = read_archive(copy / "benchmarks" / "learned" / "archive")["rows"]
    assert {row["method"] for row in rows} >= {"shipped", "graph", "not calibrated", "without ES-MDA"}
    assert "| demo, its lesion | 1.13 |" in (copy / "README.md").read_text("utf-8")


@pytest.mark.skipif(not SHARED.is_dir(), reason="the folder `shared` next to the repository is absent")
def test_with_shared_data(copy):
    run(copy, "loadfree", "--bench", "reference", "--limit", 1, "--bodies", "dome_4k_pull", "--methods", "contacts")
    run(copy, "speed.solver", "--quick", "--peers", "none", "--out", "solver")
    assert read_archive(copy / "solver")["solves"]


def test_regions(copy):
    run(copy, "regions.regions", "--quick")
    rows = read_archive(copy / "benchmarks" / "regions" / "archive")["rows"]
    own = {row["family"]: row for row in rows if row["method"] == "register"}
    assert {"five bodies, markers spread", "five bodies, markers far"} <= own.keys()
    assert sum(row["crps_mm"] for row in own.values()) < sum(
        row["crps_mm"] for row in rows if row["method"] == "spline"
    )


@pytest.mark.skipif(not (SHARED / "data").is_dir(), reason="the recordings next to the repository are absent")
def test_real(copy):
    run(copy, "real", "--quick", "--data", SHARED / "data")
    found = read_archive(copy / "benchmarks" / "real" / "archive")
    assert [len(found[body]) for body in ("beam", "hydrogel")] == [1, 2]
    assert all(row["registered"] < 0.6 * row["none"] for row in found["hydrogel"])
