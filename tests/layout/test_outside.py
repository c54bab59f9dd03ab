"""Whatever benches, the paper, training, examples and tools take from the package exists there."""

import ast
import importlib
import importlib.util
from pathlib import Path

import pytest

import tissuereg as tr

TOP = Path(__file__).resolve().parents[2]
PLACES = ("benchmarks", "paper", "training", "examples", "tools")
FILES = sorted(path for place in PLACES for path in (TOP / place).rglob("*.py") if ".venv" not in path.parts)


def taken(tree):
    """Yield every (module, name) that a file takes from `tissuereg`, by import or as an attribute of it."""
    aliases = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            aliases |= {one.asname or one.name for one in node.names if one.name == "tissuereg"}
            yield from ((one.name, None) for one in node.names if one.name.split(".")[0] == "tissuereg")
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "tissuereg":
            yield from ((node.module, one.name) for one in node.names)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id in aliases:
            yield "tissuereg", node.attr


def exists(module, name):
    """Whether a module has a name, as its attribute or as a module in it."""
    found = importlib.import_module(module)
    if name is None or hasattr(found, name):
        return True
    return hasattr(found, "__path__") and importlib.util.find_spec(f"{module}.{name}") is not None


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.relative_to(TOP).as_posix())
def test_every_name_taken_from_the_package_exists(path):
    missing = [pair for pair in taken(ast.parse(path.read_text(encoding="utf-8"))) if not exists(*pair)]
    assert not missing


def test_a_name_that_is_gone_is_noticed():
    tree = ast.parse("import tissuereg as tr\nfrom tissuereg.body.mesh import Mesh, Gone\ntr.NoSuchName\ntr.register\n")
    assert [pair for pair in taken(tree) if not exists(*pair)] == [
        ("tissuereg.body.mesh", "Gone"),
        ("tissuereg", "NoSuchName"),
    ]
    assert tr.register
