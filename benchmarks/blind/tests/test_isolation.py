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
    allowed = {"blind", "numpy", "scipy", "skfem", "pypardiso"}
    standard = {
        "argparse",
        "collections",
        "dataclasses",
        "functools",
        "gzip",
        "hashlib",
        "json",
        "logging",
        "os",
        "pathlib",
        "secrets",
        "sys",
        "tempfile",
        "time",
        "traceback",
    }
    assert {name.split(".")[0] for name in modules_of(path)} <= allowed | standard
    assert "tissuereg" not in path.read_text(encoding="utf-8")


@pytest.mark.parametrize("path", sorted(HERE.glob("*.py")), ids=lambda path: path.name)
def test_nothing_but_the_scorer_opens_the_answers(path):
    opens = "answers." + "json.gz" in path.read_text(encoding="utf-8")
    # The data's own test sums the file up, and opens it through the scorer.
    assert opens == (path.name in ("scored.py", "test_data.py"))


@pytest.mark.parametrize("name", ["run.py", "materialise.py", "variants.py", "rivals.py", "heldout.py"])
def test_what_writes_cases_and_predictions_knows_no_answers(name):
    assert not any(module.startswith(("blind.score", "blind.generator")) for module in modules_of(HERE / name))
