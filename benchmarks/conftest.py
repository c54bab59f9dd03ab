"""Benches are imported by their folders' names; helpers of the package's tests by `support`."""

import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
sys.path.insert(0, str(Path(__file__).parent))

from common import SHARED


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Measured data and reference solutions next to the repository; tests that need them are skipped without it."""
    if not SHARED.is_dir():
        pytest.skip("the folder `shared` next to the repository is absent: measured data and references")
    return SHARED
