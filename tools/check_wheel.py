"""Install a wheel as a user would, without a compiler, and build another one from the source archive.

    python tools/check_wheel.py WHEEL [--sdist ARCHIVE]

* The wheel serves every Python from 3.11 on, and holds its licences, one compiled module and no tests, in bounded
  size.
* pip installs it into a new environment, with a search path that holds the commands of that environment alone. There
  ``pip check``, ``import tissuereg``, ``tissuereg demo`` (the embedded phantom) and ``tissuereg register`` work.
* pip builds a wheel from the source archive in a folder outside this repository (needs cargo), with the same files.

Ends with code 1 at the first failed check.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tarfile
import tempfile
import venv
import zipfile
from pathlib import Path

from packages import CheckError, as_new, exit_code

ROOT = Path(__file__).resolve().parents[1]
LARGEST_WHEEL, LARGEST_SDIST = 12_000_000, 28_000_000  # bytes, compressed
MODULE = "tissuereg/_core.abi3.so"
NEEDED = {
    MODULE,
    "tissuereg/__init__.py",
    "tissuereg/_core.pyi",
    "tissuereg/licences.txt",
    "tissuereg/py.typed",
    "tissuereg/phantom/data/breast.toml",
    "tissuereg/phantom/data/full-truth.npz",
    "tissuereg/phantom/model/decoder.onnx",
}
LICENCES = ("LICENSE-MIT", "LICENSE-APACHE")
TOOLS_OF_A_BUILD = ("cargo", "rustc", "cc", "gcc", "clang", "maturin")


def must(holds: bool, message: str) -> None:
    """Raise unless something holds."""
    if not holds:
        raise CheckError(message)


def run(command: list[str], cwd: Path, environment: dict[str, str]) -> str:
    """Run a command and return what it prints, its errors included."""
    done = subprocess.run(
        command, cwd=cwd, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    )
    must(done.returncode == 0, f"`{' '.join(command)}` ended with code {done.returncode}:\n{done.stdout}")
    return done.stdout


def files_of(wheel: Path) -> set[str]:
    """Return the names of the package's files in a wheel, after a check of all that it holds."""
    with zipfile.ZipFile(wheel) as archive:
        names = {name for name in archive.namelist() if not name.endswith("/")}
    must("-cp311-abi3-" in wheel.name, f"a wheel must serve every Python from 3.11 on, got {wheel.name}")
    info = f"{wheel.name.split('-cp311', maxsplit=1)[0]}.dist-info"
    needed = NEEDED | {f"{info}/licenses/{name}" for name in LICENCES} | {f"{info}/entry_points.txt"}
    must(needed <= names, f"{wheel.name} lacks {sorted(needed - names)}")
    compiled = [name for name in names if re.search(r"\.(so|pyd|dylib)$", name)]
    must(compiled == [MODULE], f"{wheel.name} must hold one compiled module, {MODULE}; it holds {compiled}")
    package = {name for name in names if not name.startswith(f"{info}/")}
    strange = sorted(
        n for n in package if not n.startswith("tissuereg/") or re.search(r"\.(pyc|rs)$|/tests?/|/test_", n)
    )
    must(not strange, f"{wheel.name} holds what no user needs: {strange}")
    print(f"{wheel.name}: {len(names)} files, {wheel.stat().st_size} bytes")
    return package


def install(wheel: Path, folder: Path) -> tuple[Path, dict[str, str]]:
    """Install a wheel by pip without a compiler; return the folder of commands and their environment."""
    venv.create(folder / "venv", with_pip=True)
    commands = folder / "venv" / "bin"
    # The kept variables may configure pip's package source; those that locate tools are dropped.
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "CARGO", "RUST", "VIRTUAL_ENV"))}
    environment = {**kept, "PATH": str(commands), "CC": "/nonexistent", "PIP_DISABLE_PIP_VERSION_CHECK": "1"}
    found = [tool for tool in TOOLS_OF_A_BUILD if shutil.which(tool, path=str(commands))]
    must(not found, f"no tool to build with may be at hand, found {found}")
    run([str(commands / "python"), "-m", "pip", "install", "--quiet", str(wheel.resolve())], folder, environment)
    run([str(commands / "python"), "-m", "pip", "check"], folder, environment)
    return commands, environment


def use(commands: Path, folder: Path, environment: dict[str, str]) -> None:
    """Import what was installed, run the embedded phantom, and register its markers without its model."""
    code = "import tissuereg; print(tissuereg.__version__, tissuereg.__file__)"
    version, place = run([str(commands / "python"), "-c", code], folder, environment).split()
    must(Path(place).is_relative_to(folder), f"what is imported must be what was installed, got {place}")
    command = str(commands / "tissuereg")
    run([command, "demo", "--out", "demo"], folder, environment)
    given = folder / "demo" / "input"
    inputs = [str(given / "body.vtu"), str(given / "markers.csv"), "--targets", str(given / "targets.csv")]
    run([command, "register", *inputs, "--out", "registered"], folder, environment)
    answer = json.loads((folder / "registered" / "registration.json").read_text(encoding="utf-8"))
    must(answer["trust"]["ok"], f"the phantom must be registered with trust, got {answer['trust']}")
    print(f"tissuereg {version}: installed without a compiler, demo and register answer")


def rebuild(sdist: Path, folder: Path) -> Path:
    """Build a wheel from a source archive, outside this repository."""
    size = sdist.stat().st_size
    must(size <= LARGEST_SDIST, f"{sdist.name} must have at most {LARGEST_SDIST} bytes, it has {size}")
    with tarfile.open(sdist) as archive:
        names = {member.name.split("/", 1)[1] for member in archive.getmembers() if member.isfile()}
        archive.extractall(folder, filter=as_new)
    missing = sorted({"Cargo.lock", "pyproject.toml", "README.md", *LICENCES} - names)
    must(not missing, f"{sdist.name} lacks {missing}")
    strange = sorted(name for name in names if re.search(r"\.(so|pyc|whl)$|/target/", name))
    must(not strange, f"{sdist.name} holds what was built: {strange}")
    # Crates of other authors are built as in this repository, and not again.
    out = f"--out {shlex.quote(str(folder / 'built'))}"  # not among the wheels of this repository
    environment = {**os.environ, "CARGO_TARGET_DIR": str(ROOT / "target"), "MATURIN_PEP517_ARGS": out}
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", str(folder / "rebuilt")]
    run([*command, str(folder / sdist.name.removesuffix(".tar.gz"))], folder, environment)
    print(f"{sdist.name}: {len(names)} files, {size} bytes")
    return next((folder / "rebuilt").glob("tissuereg-*.whl"))


def main() -> int:
    """Check a wheel, and a source archive where one is given."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--sdist", type=Path)
    arguments = parser.parse_args()

    def check() -> None:
        with tempfile.TemporaryDirectory(prefix="tissuereg-wheel-") as name:
            folder = Path(name).resolve()
            files = files_of(arguments.wheel)
            # The wheel that is published is packed more tightly than one that is built from its source.
            size = arguments.wheel.stat().st_size
            must(
                size <= LARGEST_WHEEL, f"{arguments.wheel.name} must have at most {LARGEST_WHEEL} bytes, it has {size}"
            )
            commands, environment = install(arguments.wheel, folder)
            use(commands, folder, environment)
            if arguments.sdist:
                again = files_of(rebuild(arguments.sdist, folder))
                must(again == files, f"both wheels must hold the same files, they differ in {sorted(again ^ files)}")

    return exit_code(check)


if __name__ == "__main__":
    raise SystemExit(main())
