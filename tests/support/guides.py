"""Guides of docs/guides: their blocks of code, and a copy of the sources in which they are followed."""

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from support.scripts import REPOSITORY

GUIDES = REPOSITORY / "docs" / "guides"

#: A block follows a paragraph whose last line states what is done with it.
_STEP = re.compile(
    r"^\*\*(?P<verb>New file|After|In place of|Run)\*\*[^\n`]*"
    r"(?:`(?P<line>[^`\n]+)`, in )?(?:`(?P<path>[^`\n]+)`)?:\n\n"
    r"```(?P<language>\w+)\n(?P<code>.*?)^```$",
    flags=re.MULTILINE | re.DOTALL,
)


@dataclass(frozen=True)
class Step:
    """One block of a guide: a new file, lines after or in place of a line, or a command."""

    verb: str
    path: str | None
    line: str | None
    code: str


def steps(guide: str) -> list[Step]:
    """Steps of a guide, in order; every block of code must be one."""
    text = (GUIDES / f"{guide}.md").read_text(encoding="utf-8")
    found = [Step(m["verb"], m["path"], m["line"], m["code"]) for m in _STEP.finditer(text)]
    assert len(found) == text.count("\n```") // 2, "every block must follow a line that states what is done with it"
    return found


def follow(guide: str, root: Path) -> list[list[str]]:
    """Follow a guide in a copy of the repository, and return its commands, which are not run."""
    commands = []
    for step in steps(guide):
        if step.verb == "Run":
            commands += [line.split() for line in step.code.splitlines()]
            continue
        assert step.path is not None
        file = root / step.path
        if step.verb == "New file":
            assert not file.exists(), f"{step.path} is no new file"
            file.write_text(step.code, encoding="utf-8")
        else:
            _edit(file, step)
    return commands


def _edit(file: Path, step: Step) -> None:
    lines = file.read_text(encoding="utf-8").splitlines(keepends=True)
    places = [i for i, line in enumerate(lines) if line.strip() == step.line]
    assert len(places) == 1, f"`{step.line}` must stand in {step.path} once, found {len(places)} times"
    first = places[0] + (step.verb == "After")
    lines[first : places[0] + 1] = [step.code]
    # A linked file belongs to the repository: it is replaced, not written to.
    file.unlink()
    file.write_text("".join(lines), encoding="utf-8")


def copy_of_package(root: Path) -> Path:
    """Put the Python package and the tests' support below `root`: sources copied, the compiled core linked."""
    import tissuereg

    installed = Path(tissuereg.__file__).parent
    ours = root / "python" / "tissuereg"
    shutil.copytree(installed, ours, ignore=shutil.ignore_patterns("__pycache__", "*.so", "*.pyd", "*.npz", "*.onnx"))
    for file in installed.rglob("*"):
        if file.suffix in (".so", ".pyd", ".npz", ".onnx"):
            (ours / file.relative_to(installed)).symlink_to(file)
    (root / "pyproject.toml").symlink_to(REPOSITORY / "pyproject.toml")
    (root / "tests" / "unit").mkdir(parents=True)
    (root / "tests" / "support").symlink_to(REPOSITORY / "tests" / "support")
    return root


def copy_of_crates(root: Path) -> Path:
    """Put the crates below `root` with their times of change: unchanged files are not compiled again."""
    for name in ("Cargo.toml", "Cargo.lock", "rustfmt.toml", "clippy.toml", "README.md"):
        shutil.copy2(REPOSITORY / name, root / name)
    shutil.copytree(REPOSITORY / "crates", root / "crates", ignore=shutil.ignore_patterns("target"))
    # A member of the workspace.
    shutil.copytree(REPOSITORY / "paper" / "crate", root / "paper" / "crate")
    return root


def cargo(root: Path, *words: str) -> str:
    """Run cargo in a copy, with the repository's folder of builds, and return what it prints."""
    environment = {**os.environ, "CARGO_TARGET_DIR": str(REPOSITORY / "target")}
    done = subprocess.run(["cargo", *words], cwd=root, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def build_core(root: Path) -> None:
    """Build the compiled core of a copy and put it in the place of the linked one."""
    cargo(root, "build", "-p", "tissuereg-bindings", "--features", "pyo3/extension-module")
    for linked in (root / "python" / "tissuereg").glob("_core*.so"):
        linked.unlink()
    shutil.copy2(REPOSITORY / "target" / "debug" / "lib_core.so", root / "python" / "tissuereg" / "_core.abi3.so")


def lint(guide: str, root: Path) -> None:
    """Check the Python files of a guide in a copy as those of the repository are checked."""
    files = sorted({str(step.path) for step in steps(guide) if str(step.path).endswith(".py")})
    for check in (["check"], ["format", "--check"]):
        run(root, ["python", "-m", "ruff", *check, "--no-cache", *files])


def run(root: Path, command: list[str]) -> str:
    """Run a guide's command in a copy, and return what it prints."""
    assert command[0] == "python"
    environment = {
        "PYTHONPATH": f"{root / 'python'}:{root / 'tests'}",
        "PATH": "",
        "TISSUEREG_CACHE": str(root / "cache"),
    }
    done = subprocess.run(
        [sys.executable, *command[1:]], cwd=root, env=environment, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout
