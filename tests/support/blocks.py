"""Code blocks of pages, run in order as a reader would: needs nothing but the standard library.

What the fence of a block says decides what is done with it:

* ``python``: run; the blocks of a page share their names.
* none, ``bash`` or ``console``: lines that begin with ``tissuereg`` are run; ``# exit code 4`` at the end of a line is
  the code that must come, 0 where nothing is said. Other lines may not stand between them.
* ``toml``, ``csv`` or ``json``: must be readable; with ``title="FILE"`` it becomes FILE for the blocks that follow.
* ``rust``: ``title="crates/.../examples/NAME.rs"`` or ``title="crates/.../README.md"`` says which example, or whose
  doctest, it is: cargo runs them.
* ``text``: shown, not run.

``<!-- not run: reason -->`` on the line before excludes a block.
"""

import csv
import json
import os
import re
import shlex
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]

FENCE = re.compile(r"^(?P<indent> *)(?P<marks>`{3,})(?P<language>\w*)(?P<rest>.*)$")
NOT_RUN = re.compile(r"^\s*<!-- not run: (.+) -->\s*$")
EXIT = re.compile(r"#\s*exit code (\d+)\s*$")

SHELLS = ("", "bash", "console")
SHOWN = ("text",)


@dataclass(frozen=True)
class Block:
    """One fenced block of a page."""

    page: Path
    line: int
    language: str
    title: str | None
    text: str
    not_run: str | None

    @property
    def place(self) -> str:
        """Page and line, for messages."""
        return f"{self.page.name}:{self.line}"

    @property
    def commands(self) -> list[tuple[list[str], int]]:
        """Words of every ``tissuereg`` line of a shell block, and the exit code that it must give."""
        lines = [line.strip().removeprefix("$ ") for line in re.sub(r"\\\n", " ", self.text).splitlines()]
        lines = [line for line in lines if line and not line.startswith("#")]
        own = [line for line in lines if line.startswith("tissuereg ")]
        others = [line for line in lines if line not in own]
        if (own or self.language) and others:
            message = f"{self.place}: no test runs {others}; a block of their own must say why it is not run"
            raise AssertionError(message)
        return [(shlex.split(line, comments=True), int(code[1]) if (code := EXIT.search(line)) else 0) for line in own]


def blocks(page: Path) -> list[Block]:
    """Return the fenced blocks of a page, in order."""
    found: list[Block] = []
    inside: list[str] | None = None
    before, opened, start = "", None, 0
    for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
        fence = FENCE.match(line)
        if inside is None:
            if fence:
                opened, inside, start = fence, [], number
            elif line.strip():
                before = line
        elif fence and fence["marks"] == opened["marks"] and not fence["language"]:
            why = NOT_RUN.match(before)
            title = re.search(r'title="([^"]+)"', opened["rest"])
            indent = len(opened["indent"])
            text = "".join(row[indent:] + "\n" for row in inside)
            found.append(Block(page, start, opened["language"], title and title[1], text, why and why[1]))
            inside, before = None, ""
        else:
            inside.append(line)
    assert inside is None, f"{page.name}:{start}: a block is not closed"
    return found


def run_page(page: Path, folder: Path, environment: dict[str, str]) -> dict[str, object]:
    """Run the blocks of a page in a folder, which is the current one; return the names that its Python made."""
    names: dict[str, object] = {"__name__": "page"}
    for block in blocks(page):
        if block.not_run is None:
            run_block(block, folder, names, environment)
    return names


def run_block(block: Block, folder: Path, names: dict[str, object], environment: dict[str, str]) -> None:
    """Run or check one block."""
    if block.language == "python":
        # Empty lines before it, so that a traceback names the line of the page.
        exec(compile("\n" * block.line + block.text, str(block.page), "exec"), names)
    elif block.language in SHELLS:
        for words, wanted in block.commands:
            run_command(block, words, wanted, folder, environment)
    elif block.language == "rust":
        check_example(block)
    elif block.language in READERS:
        READERS[block.language](block.text)
        if block.title is not None:
            file = folder / block.title
            assert file.resolve().is_relative_to(folder.resolve()), block.place
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(block.text, encoding="utf-8")
    else:
        assert block.language in SHOWN, f"{block.place}: nobody knows how to check a block of {block.language!r}"


def run_command(block: Block, words: list[str], wanted: int, folder: Path, environment: dict[str, str]) -> None:
    """Run one command line and compare its exit code."""
    done = subprocess.run(
        [sys.executable, "-m", *words],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, **environment},
        check=False,
    )
    message = f"{block.place}: {shlex.join(words)} gave {done.returncode}\n{done.stdout}\n{done.stderr}"
    assert done.returncode == wanted, message


def check_example(block: Block) -> None:
    """Compare a block of Rust with what cargo runs: an example, or a block of a crate's README (a doctest)."""
    assert block.title is not None, f"{block.place}: a block of Rust must name the file that it is"
    file = REPOSITORY / block.title
    if file.name == "README.md":
        assert 'include_str!("../README.md")' in (file.parent / "src" / "lib.rs").read_text(encoding="utf-8")
        known = [other.text for other in blocks(file) if other.language == "rust"]
    else:
        manifest = tomllib.loads((file.parents[1] / "Cargo.toml").read_text(encoding="utf-8"))
        assert {"name": file.stem, "test": True} in manifest["example"], f"{block.place}: cargo test must run {file}"
        known = [file.read_text(encoding="utf-8")]
    assert block.text in known, f"{block.place} is not in {block.title}"


def read_csv(text: str) -> None:
    """Fail unless every row has as many cells as the first."""
    rows = list(csv.reader(text.splitlines()))
    assert len({len(row) for row in rows}) == 1, rows


READERS = {"toml": tomllib.loads, "json": json.loads, "csv": read_csv}
