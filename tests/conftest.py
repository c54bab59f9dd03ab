"""Fixtures that all tests share."""

import os
import sys
from pathlib import Path

import pytest

# Read when numpy is loaded, also by processes that tests start: some sums depend on it.
os.environ.update(OMP_NUM_THREADS="1", OPENBLAS_NUM_THREADS="1")

# Benches by their folders' names: tests draw from the data behind published figures.
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmarks"))
sys.path.insert(0, str(Path(__file__).parent))
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "tools"))

import own_sources  # noqa: F401 (before the package)

import tissuereg as tr
from support.meshes import block

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def block_mesh() -> tr.Mesh:
    """A block of 30 x 20 x 40 mm, 360 tets; the face z = 0 is the node set ``fixed``."""
    return block()


@pytest.fixture(scope="session")
def of_two():
    """The target of fits to a small experiment with two hidden effects."""
    from support.targets import target_of
    from tissuereg.experiment.effects import Latency, Poisson

    return target_of(Poisson(poisson=0.3), Latency(latency_s=0.1))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Measured data and reference solutions next to the repository; tests that need them are skipped without it."""
    folder = REPOSITORY.parent / "shared"
    if not folder.is_dir():
        pytest.skip("the folder `shared` next to the repository is absent: measured data and references")
    return folder


@pytest.fixture
def no_home(monkeypatch) -> None:
    """Neither a home nor a folder for what is kept."""
    for name in ("TISSUEREG_CACHE", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)

    def home() -> Path:
        message = "could not determine home directory"
        raise RuntimeError(message)

    monkeypatch.setattr("pathlib.Path.home", home)
