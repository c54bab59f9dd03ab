"""The truth is made by another code path: its generator imports nothing from the package."""

from pathlib import Path

import pytest

from blind.tests.test_isolation import modules_of

GENERATOR = Path(__file__).parents[1] / "generator"
STANDARD = {"argparse", "dataclasses", "functools", "json", "pathlib", "sys", "tempfile", "time"}
ALLOWED = {"blind", "loadfree", "numpy", "pytetwild", "scipy", "skfem"}


@pytest.mark.parametrize("path", sorted(GENERATOR.glob("*.py")), ids=lambda path: path.name)
def test_the_generator_imports_nothing_from_the_package(path):
    modules = modules_of(path)
    assert {name.split(".")[0] for name in modules} <= ALLOWED | STANDARD
    for name in modules:
        if name.startswith(("blind", "loadfree")):
            assert name.startswith(("blind.generator", "loadfree.generator")), name
