"""Does the package use what is public of `tissuereg`, and besides that what it declares?"""

import ast
import importlib
from pathlib import Path

import pytest

import tissuereg_paper
from tissuereg_paper.private import PRIVATE

SOURCES = sorted(path for folder in tissuereg_paper.__path__ for path in Path(folder).rglob("*.py"))
DECLARED = {f"tissuereg.{module}" for _, modules in PRIVATE.values() for module in modules}

#: Modules whose `__all__` is public.
PUBLIC = ("tissuereg", "tissuereg.errors", "tissuereg.phantom")


def private(tree):
    """Return the private modules that a source imports, or takes a private name of."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {one.name for one in node.names if one.name.startswith("tissuereg.")}
        elif isinstance(node, ast.ImportFrom) and (node.module or "").split(".")[0] == "tissuereg":
            names = [one.name for one in node.names]
            if node.module in PUBLIC:
                module = importlib.import_module(node.module)
                public = getattr(module, "__all__", None) or [name for name in vars(module) if name[0] != "_"]
                found |= {f"{node.module}.{name}" for name in names if name not in public}
            else:
                found.add(node.module)
    return found


def test_every_private_module_is_declared_and_every_declared_one_used():
    used = {module for path in SOURCES for module in private(ast.parse(path.read_text(encoding="utf-8")))}
    assert used == DECLARED


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("from tissuereg import Mesh", set()),
        ("from tissuereg.errors import ModelError", set()),
        ("from tissuereg import _core", {"tissuereg._core"}),
        ("from tissuereg.phantom import _FOLDER", {"tissuereg.phantom._FOLDER"}),
        ("import tissuereg.io.fields", {"tissuereg.io.fields"}),
        ("def f():\n    from tissuereg.io.fields import open_npz", {"tissuereg.io.fields"}),
        ("from tissuereg_paper.studies import reproduce", set()),
    ],
)
def test_a_private_import_is_found(line, found):
    assert private(ast.parse(line)) == found


def test_a_declared_module_is_there():
    for module in DECLARED:
        importlib.import_module(module)
