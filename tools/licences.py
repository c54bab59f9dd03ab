"""Write the licences of the Rust crates that are linked into the compiled module, or check that they are written.

    python tools/licences.py            # check python/tissuereg/licences.txt
    python tools/licences.py --write    # write it anew, after a change of Cargo.lock

Needs cargo, and the sources of the crates as cargo keeps them after a build. Of a crate with a choice of licences that
of MIT is taken. Texts that differ in their copyright lines alone are written once.
"""

import argparse
import json
import os
import re
import subprocess
from pathlib import Path
from typing import Any

from packages import CheckError, exit_code

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "python" / "tissuereg" / "licences.txt"

#: Platforms for which wheels are made.
TARGETS = (
    "x86_64-unknown-linux-gnu",
    "aarch64-unknown-linux-gnu",
    "x86_64-apple-darwin",
    "aarch64-apple-darwin",
    "x86_64-pc-windows-msvc",
)
LARGEST = 120_000  # bytes

MIT = """Permission is hereby granted, free of charge, to any person obtaining a copy of this software and associated
documentation files (the "Software"), to deal in the Software without restriction, including without limitation the
rights to use, copy, modify, merge, publish, distribute, sublicense, and/or sell copies of the Software, and to permit
persons to whom the Software is furnished to do so, subject to the following conditions:

The above copyright notice and this permission notice shall be included in all copies or substantial portions of the
Software.

THE SOFTWARE IS PROVIDED "AS IS", WITHOUT WARRANTY OF ANY KIND, EXPRESS OR IMPLIED, INCLUDING BUT NOT LIMITED TO THE
WARRANTIES OF MERCHANTABILITY, FITNESS FOR A PARTICULAR PURPOSE AND NONINFRINGEMENT. IN NO EVENT SHALL THE AUTHORS OR
COPYRIGHT HOLDERS BE LIABLE FOR ANY CLAIM, DAMAGES OR OTHER LIABILITY, WHETHER IN AN ACTION OF CONTRACT, TORT OR
OTHERWISE, ARISING FROM, OUT OF OR IN CONNECTION WITH THE SOFTWARE OR THE USE OR OTHER DEALINGS IN THE SOFTWARE."""

#: Linked into everything that Rust compiles, and no crate of the registry.
STANDARD = ("the Rust standard library", "MIT", f"Copyright (c) The Rust Project Contributors\n\n{MIT}")

_LICENCE = re.compile(r"(licen[cs]e|copying|notice|unlicense)", re.IGNORECASE)
_ALTERNATIVE = re.compile(r"(apache|zlib|unlicense|bsd)", re.IGNORECASE)
_COPYRIGHT = re.compile(r"^\W*(©|copyright\b(?! (notice|holder|owner|license|and related))).*", re.IGNORECASE)


def cargo(*arguments: str) -> str:
    """Run cargo on this workspace, without the network, and return what it prints."""
    command = [os.environ.get("CARGO", "cargo"), *arguments, "--offline", "--locked"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    if done.returncode != 0:
        message = f"`{' '.join(command)}` ended with code {done.returncode}: {done.stderr}"
        raise CheckError(message)
    return done.stdout


def linked() -> list[tuple[str, str]]:
    """Return name and version of the crates of others that are linked into the module on any platform, sorted."""
    targets = [word for target in TARGETS for word in ("--target", target)]
    tree = cargo("tree", "-p", "tissuereg-bindings", "-e", "normal,no-proc-macro", "--prefix", "none", *targets)
    names = {(words[0], words[1].removeprefix("v")) for words in map(str.split, tree.splitlines()) if words}
    return sorted(name for name in names if not name[0].startswith("tissuereg-"))


def texts_of(crate: dict[str, Any]) -> list[str]:
    """Return the texts of the licences of a crate: those of its files, or else that of MIT with its authors."""
    folder = Path(crate["manifest_path"]).parent
    files = sorted(file for file in folder.iterdir() if _LICENCE.match(file.name) and file.is_file())
    if "MIT" in crate["license"]:
        chosen = [file for file in files if "mit" in file.name.lower()]
        others = [file for file in files if file not in chosen and not _ALTERNATIVE.search(file.name)]
        # Third parties' notices, and ported algorithms, go with any of them.
        kept = [file for file in files if re.search(r"third|notice|copying\.", file.name, re.IGNORECASE)]
        files = list(dict.fromkeys((chosen or others) + kept))
        own = [file for file in files if file not in kept]
        if not own:
            authors = ", ".join(name.split(" <")[0] for name in crate["authors"]) or "its authors"
            notices = [file.read_text(encoding="utf-8") for file in files]
            return [f"Copyright (c) {authors}\n\n{MIT}", *notices]
    if not files:
        message = f"{crate['name']} {crate['version']} ({crate['license']}) must have a file with its licence"
        raise CheckError(message)
    return [file.read_text(encoding="utf-8") for file in files]


def divided(text: str) -> tuple[list[str], str]:
    """Return the copyright lines of a licence of MIT, of which there are many, and the rest as it is."""
    lines = text.replace("\r", "").splitlines()
    alike = "Permission is hereby granted, free of charge" in text and len(lines) < 60
    held = [line.strip() for line in lines if alike and _COPYRIGHT.match(line)]
    rest = "\n".join(line.rstrip() for line in lines if line.strip() not in held)
    return held, re.sub(r"\n{3,}", "\n\n", rest).strip()


def content() -> str:
    """Return the whole file."""
    crates = {
        (one["name"], one["version"]): one for one in json.loads(cargo("metadata", "--format-version", "1"))["packages"]
    }
    every = [STANDARD]
    for key in linked():
        crate = crates[key]
        every += [(" ".join(key), crate["license"], text) for text in texts_of(crate)]
    rests: dict[str, str] = {}
    holders: dict[str, list[str]] = {}
    for name, licence, text in every:
        held, rest = divided(text)
        # Titles and line breaks differ among copies of one licence.
        words = re.sub(r"[\W_]+", " ", re.sub(r"(?i)^(the )?mit license( \(mit\))?", "", rest)).strip().lower()
        rests.setdefault(words, rest)
        holders.setdefault(words, []).append(f"  {name} ({licence})" + "".join(f"\n      {line}" for line in held))
    rule = "=" * 80
    parts = [
        "The compiled module of tissuereg holds the Rust crates below, each under its licence.\n"
        "Written by tools/licences.py from cargo metadata and the crates' own files."
    ]
    for words, rest in rests.items():
        parts.append(f"{rule}\n" + "\n".join(holders[words]) + f"\n\n{rest}")
    return "\n\n".join(parts) + "\n"


def main() -> int:
    """Write the file, or check that it is what would be written."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--write", action="store_true")
    writes = parser.parse_args().write

    def check() -> None:
        text = content()
        if len(text.encode()) > LARGEST:
            message = f"{FILE.name} must have at most {LARGEST} bytes, it would have {len(text.encode())}"
            raise CheckError(message)
        if writes:
            FILE.write_text(text, encoding="utf-8")
        elif not FILE.exists() or FILE.read_text(encoding="utf-8") != text:
            message = f"{FILE.relative_to(ROOT)} must be that of Cargo.lock: run tools/licences.py --write"
            raise CheckError(message)

    return exit_code(check)


if __name__ == "__main__":
    raise SystemExit(main())
