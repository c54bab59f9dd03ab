"""What the three published crates hold: licences, metadata, examples that stand alone, settings that can be set."""

import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
CRATES = ("fem", "contacts", "esmda")
FIRST = {"fem": "first_solve", "contacts": "first_contact", "esmda": "first_update"}
EXAMPLES = [path for crate in CRATES for path in sorted((ROOT / "crates" / crate / "examples").glob("*.rs"))]


def manifest(crate: str) -> dict:
    return tomllib.loads((ROOT / "crates" / crate / "Cargo.toml").read_text(encoding="utf-8"))


def readme(crate: str) -> str:
    return (ROOT / "crates" / crate / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("crate", CRATES)
@pytest.mark.parametrize("licence", ["LICENSE-MIT", "LICENSE-APACHE"])
def test_a_crate_carries_the_licences_of_the_repository(crate, licence):
    assert (ROOT / "crates" / crate / licence).read_bytes() == (ROOT / licence).read_bytes()


@pytest.mark.parametrize("crate", CRATES)
def test_the_metadata_of_a_crate_is_complete(crate):
    package = manifest(crate)["package"]
    assert {"name", "version", "edition", "rust-version", "license", "authors", "description"} <= set(package)
    assert package["readme"] == "README.md"
    # At most five of each, as a registry demands.
    assert 3 <= len(package["keywords"]) <= 5
    assert all(re.fullmatch(r"[a-z][a-z0-9-]{0,19}", word) for word in package["keywords"])
    assert 1 <= len(package["categories"]) <= 5
    assert package.get("publish", True)


@pytest.mark.parametrize("key", ["repository", "homepage"])
def test_a_link_that_the_workspace_has_stands_in_every_crate(key):
    workspace = tomllib.loads((ROOT / "Cargo.toml").read_text(encoding="utf-8"))["workspace"]["package"]
    for crate in CRATES:
        assert (manifest(crate)["package"].get(key) == {"workspace": True}) == (key in workspace)


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_needs_its_own_crate_alone(path):
    text = path.read_text(encoding="utf-8")
    assert not re.search(r"#\[path|include(_str|_bytes)?!|^\s*mod \w+;", text, re.MULTILINE)
    crate = f"tissuereg_{path.parents[1].name}"
    used = re.findall(r"^use (\w+)", text, re.MULTILINE)
    assert crate in used
    assert set(used) <= {crate, "std"}


@pytest.mark.parametrize("crate", CRATES)
def test_the_first_code_of_a_readme_is_an_example(crate):
    text = (ROOT / "crates" / crate / "examples" / f"{FIRST[crate]}.rs").read_text(encoding="utf-8")
    code = re.sub(r"\A(//!.*\n)+\n", "", text)
    assert re.search(r"```rust\n(.*?)```", readme(crate), re.DOTALL).group(1) == code
    assert f"cargo add tissuereg-{crate}\n" in readme(crate)


@pytest.mark.parametrize(
    ("crate", "path", "name"),
    [
        ("fem", "solve/settings.rs", "SolveSettings"),
        ("contacts", "settings.rs", "ChainSettings"),
        ("esmda", "step/settings.rs", "StepSettings"),
        ("esmda", "gauss_newton/mod.rs", "SearchSettings"),
    ],
)
def test_every_setting_can_be_set_outside_its_crate(crate, path, name):
    source = (ROOT / "crates" / crate / "src" / path).read_text(encoding="utf-8")
    body = re.search(rf"#\[non_exhaustive\]\npub struct {name} \{{\n(.*?)\n\}}\n", source, re.DOTALL).group(1)
    fields = re.findall(r"^    pub (\w+):", body, re.MULTILINE)
    assert fields
    assert [field for field in fields if f"pub fn with_{field}(" not in source] == []
