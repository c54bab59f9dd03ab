"""The generator is another code path: it imports nothing from the package; only the scorer opens the answers."""

import ast
from pathlib import Path

import pytest

HERE = Path(__file__).parents[1]


def modules_of(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            found.add(node.module or "")
    return found


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
