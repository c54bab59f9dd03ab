"""The licences of the crates that a wheel holds are those of Cargo.lock."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

import tissuereg
from support.scripts import REPOSITORY

TEXT = (Path(tissuereg.__file__).parent / "licences.txt").read_text(encoding="utf-8")


def test_every_crate_of_the_file_is_in_the_lock_and_has_a_text():
    lock = (REPOSITORY / "Cargo.lock").read_text(encoding="utf-8")
    locked = set(re.findall(r'name = "(.+)"\nversion = "(.+)"\nsource', lock))
    named = set(re.findall(r"^  ([\w-]+) (\d\S+) \(", TEXT, re.MULTILINE))
    assert {"faer", "rayon", "pyo3", "numpy"} <= {name for name, _ in named}
    assert named <= locked
    for part in TEXT.split("\n" + 80 * "=" + "\n")[1:]:
        assert len(part.split("\n\n", 1)[1]) > 500


@pytest.mark.skipif(shutil.which("cargo") is None, reason="cargo is absent, which says what is linked")
def test_the_file_is_what_the_tool_writes():
    done = subprocess.run([sys.executable, "tools/licences.py"], cwd=REPOSITORY, capture_output=True, text=True)
    if "but --offline was specified" in done.stderr:
        pytest.skip("cargo has not all sources of the crates")
    assert done.returncode == 0, done.stderr
