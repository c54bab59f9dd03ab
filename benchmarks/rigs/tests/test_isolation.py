"""The generator is another code path: it imports nothing from the package; only the scorer opens the answers."""

from pathlib import Path

import pytest

from blind.tests.test_isolation import modules_of

HERE = Path(__file__).parents[1]


@pytest.mark.parametrize("path", sorted((HERE / "generator").glob("*.py")), ids=lambda path: path.name)
def test_the_generator_imports_nothing_from_the_package(path):
    foreign = {"netgen", "ngsolve", "numpy", "pypardiso", "scipy", "skfem"}
    standard = {"argparse", "collections", "contextlib", "dataclasses", "functools", "gzip", "hashlib", "json", "os"}
    standard |= {"pathlib", "secrets", "sys", "time", "types"}
    names = modules_of(path)
    assert {name.split(".")[0] for name in names if not name.startswith("rigs.generator")} <= foreign | standard
    assert "tissuereg" not in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", sorted(HERE.glob("*.py")), ids=lambda path: path.name)
def test_nothing_but_the_scorer_opens_the_answers(path):
    assert ("answers." + "json.gz" in path.read_text(encoding="utf-8")) == (path.name == "scored.py")


@pytest.mark.parametrize("name", ["run.py", "materialise.py"])
def test_what_writes_cases_and_predictions_knows_no_answers(name):
    assert not any(module.startswith(("rigs.score", "rigs.generator")) for module in modules_of(HERE / name))
