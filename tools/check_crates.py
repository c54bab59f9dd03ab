"""Package the published crates, try to publish them, and run their examples in a crate outside this repository.

    python tools/check_crates.py [--allow-dirty]

For each crate:

* ``cargo publish --dry-run``, without its build; it needs the network, since it updates the registry's index.
* Files and size of the package.
* The package, unpacked, is built as the only dependency of another crate, which holds copies of its examples; each of
  these runs.

Ends with code 1 at the first failed check.
"""

import argparse
import os
import re
import shutil
import subprocess
import tarfile
import tempfile
from pathlib import Path

from packages import CheckError, as_new, exit_code

ROOT = Path(__file__).resolve().parents[1]
CRATES = ("tissuereg-fem", "tissuereg-contacts", "tissuereg-esmda")
EXPECTED = re.compile(
    r"(Cargo\.(toml|toml\.orig|lock)|\.cargo_vcs_info\.json|README\.md|LICENSE-(MIT|APACHE)|(src|examples)/[\w/]+\.rs)"
)
NEEDED = {"Cargo.toml", "README.md", "LICENSE-MIT", "LICENSE-APACHE", "src/lib.rs"}
LARGEST = 300_000  # bytes, compressed
MANIFEST = """[package]
name = "stranger"
version = "0.0.0"
edition = "2024"

[dependencies]
{name} = {{ path = "{name}" }}

[workspace]
"""


def cargo(*arguments: str, cwd: Path = ROOT) -> str:
    """Run cargo with the build profile and the build folder of this workspace, and return what it prints."""
    shared = {
        "CARGO_TARGET_DIR": str(ROOT / "target"),
        "CARGO_PROFILE_DEV_OPT_LEVEL": "2",
        "CARGO_PROFILE_DEV_DEBUG": "line-tables-only",
    }
    command = [os.environ.get("CARGO", "cargo"), *arguments]
    done = subprocess.run(command, cwd=cwd, env={**os.environ, **shared}, stdout=subprocess.PIPE, text=True)
    if done.returncode != 0:
        message = f"`{' '.join(command)}` in {cwd} ended with code {done.returncode}"
        raise CheckError(message)
    return done.stdout


def package(name: str, options: list[str]) -> Path:
    """Try to publish a crate, and return the archive that would be uploaded."""
    cargo("publish", "--dry-run", "--no-verify", "--quiet", "--package", name, *options)
    # Where a dry run leaves its archive is not documented; `cargo package` writes the same files to a documented place.
    cargo("package", "--no-verify", "--quiet", "--package", name, *options)
    version = cargo("pkgid", "--package", name).strip().rsplit("#", 1)[1].rsplit("@", 1)[-1]
    return ROOT / "target" / "package" / f"{name}-{version}.crate"


def unpack(archive: Path, folder: Path) -> Path:
    """Check the files and the size of an archive, and unpack it into a folder."""
    with tarfile.open(archive) as files:
        names = {member.name.split("/", 1)[1] for member in files.getmembers() if member.isfile()}
        files.extractall(folder, filter=as_new)
    strange = sorted(name for name in names if not EXPECTED.fullmatch(name))
    missing = sorted(NEEDED - names)
    size = archive.stat().st_size
    if strange or missing or size > LARGEST:
        message = (
            f"{archive.name} must hold sources, examples, licences and its README in at most {LARGEST} bytes; "
            f"it has {size} bytes, lacks {missing} and holds {strange}"
        )
        raise CheckError(message)
    print(f"{archive.name}: {len(names)} files, {size} bytes")
    return folder / archive.name.removesuffix(".crate")


def run_examples(name: str, archive: Path, folder: Path) -> None:
    """Build a package, and run copies of its examples, in a crate that depends on it alone."""
    unpack(archive, folder).rename(folder / name)
    (folder / "Cargo.toml").write_text(MANIFEST.format(name=name), encoding="utf-8")
    # The same versions as in the workspace: nothing is built twice.
    shutil.copy(folder / name / "Cargo.lock", folder / "Cargo.lock")
    examples = sorted((folder / name / "examples").glob("*.rs"))
    if not examples:
        message = f"{name} has no examples"
        raise CheckError(message)
    (folder / "src" / "bin").mkdir(parents=True)
    for example in examples:
        shutil.copy(example, folder / "src" / "bin")
    for example in examples:
        printed = cargo("run", "--quiet", "--bin", example.stem, cwd=folder)
        if not printed.strip():
            message = f"{name}: {example.name} prints nothing"
            raise CheckError(message)
        print(f"{name}: {example.stem}: {printed.strip().splitlines()[0]}")


def main() -> int:
    """Check every crate."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--allow-dirty", action="store_true", help="package what is not committed too")
    options = ["--allow-dirty"] if parser.parse_args().allow_dirty else []

    def check() -> None:
        for name in CRATES:
            with tempfile.TemporaryDirectory(prefix="tissuereg-crate-") as folder:
                run_examples(name, package(name, options), Path(folder))

    return exit_code(check)


if __name__ == "__main__":
    raise SystemExit(main())
