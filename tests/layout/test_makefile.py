"""What `make` says before it builds: how long it takes, and what is missing."""

import shutil
import subprocess

import pytest

from support.scripts import REPOSITORY

pytestmark = pytest.mark.skipif(shutil.which("make") is None, reason="make is absent")


def make(*words):
    return subprocess.run(["make", *words], cwd=REPOSITORY, capture_output=True, text=True)


@pytest.mark.parametrize(
    ("variable", "said"), [("CARGO=absent", "https://rustup.rs"), ("PYTHON=false", "Python 3.11 or later")]
)
def test_a_build_without_its_tools_says_what_is_missing_and_where_it_is(variable, said):
    done = make("wheel", variable, "VENV=absent")
    assert done.returncode != 0
    assert said in done.stderr
    planned = make("--dry-run", "demo", variable, "VENV=absent").stdout
    assert planned.index("rustup.rs") < planned.index("-m venv")


def test_the_demo_says_beforehand_how_long_it_takes():
    planned = make("--dry-run", "demo", "VENV=absent").stdout
    assert planned.index("about 3 minutes") < planned.index("maturin build") < planned.index("a minute or less")
    assert planned.index("some seconds") < planned.index("tissuereg demo")
    assert "--quiet --interpreter" not in planned
