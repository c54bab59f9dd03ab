"""Is what we say true? README blocks, docstring examples, links."""

import doctest
import importlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import tissuereg
from tissuereg.demo import run_demo

REPOSITORY = Path(__file__).resolve().parents[2]
PACKAGE = Path(tissuereg.__file__).parent
MODULES = sorted(
    ".".join(("tissuereg", *path.relative_to(PACKAGE).with_suffix("").parts)).removesuffix(".__init__")
    for path in PACKAGE.rglob("*.py")
    if path.name != "__main__.py"
)


@pytest.fixture(scope="module")
def demo_folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("readme")
    run_demo(folder / "demo", seed=0)
    return folder


def readme_block(language: str) -> list[str]:
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```(\w*)\n(.*?)```", text, flags=re.DOTALL)
    return [content for named, content in blocks if named == language]


def test_the_readme_block_runs_and_finds_the_lesion(demo_folder, monkeypatch):
    monkeypatch.chdir(demo_folder)
    monkeypatch.setenv("TISSUEREG_CACHE", str(demo_folder / "cache"))
    (block,) = readme_block("python")
    names: dict[str, object] = {}
    exec(compile(block, "README.md", "exec"), names)
    result = names["result"]
    told = json.loads((demo_folder / "demo" / "registration.json").read_text(encoding="utf-8"))
    true = told["truth"]["targets"]["lesion"]["true_mm"]
    off = ((result.target("lesion").mean - true) ** 2).sum() ** 0.5
    rest = ((result.target("lesion").reference - true) ** 2).sum() ** 0.5
    assert off < 0.2 * rest
    assert (demo_folder / "report.html").is_file()


def test_the_readme_command_runs(demo_folder):
    command = next(block for block in readme_block("") if "tissuereg register" in block)
    words = command.split()
    given = {
        "body.vtu": "demo/input/body.vtu",
        "markers.csv": "demo/input/markers.csv",
        "targets.csv": "demo/input/targets.csv",
    }
    words = [given.get(word, word) for word in words]
    environment = {**os.environ, "TISSUEREG_CACHE": str(demo_folder / "cache")}
    done = subprocess.run(
        [sys.executable, "-m", *words], cwd=demo_folder, capture_output=True, text=True, env=environment, check=False
    )
    assert done.returncode == 0, done.stderr
    assert (demo_folder / "registered" / "registered.vtu").is_file()


@pytest.mark.parametrize("name", MODULES)
def test_docstring_examples_hold(name):
    failures, _ = doctest.testmod(importlib.import_module(name), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert failures == 0


@pytest.mark.parametrize("document", sorted(REPOSITORY.glob("*.md")) + sorted((REPOSITORY / "docs").rglob("*.md")))
def test_links_to_files_lead_somewhere(document):
    text = document.read_text(encoding="utf-8")
    for target in re.findall(r"\]\(([^)#]+)\)", text):
        if "://" not in target:
            assert (document.parent / target).exists(), f"{document.name}: {target}"
