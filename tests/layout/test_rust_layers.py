"""What the files of a crate may use of each other: no circle, and lower layers alone, as `tools/layers.py` has them."""

import importlib.util
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
_SPEC = importlib.util.spec_from_file_location("layers", ROOT / "tools" / "layers.py")
layers = importlib.util.module_from_spec(_SPEC)
_SPEC.loader.exec_module(layers)

#: A module of a crate by the names that lead to it; the crate itself has none.
Module = tuple[str, ...]

CRATES = sorted(path.parent.parent for path in [*ROOT.glob("crates/*/src/lib.rs"), *ROOT.glob("paper/*/src/lib.rs")])


def module_of(path: Path, source: Path) -> Module:
    """Return the module that a file holds."""
    return tuple(name for name in path.relative_to(source).with_suffix("").parts if name not in ("mod", "lib"))


def code_of(text: str) -> str:
    """Return a source without comments and without its tests, which stand at its end."""
    text = re.sub(r"(?m)^\s*//.*$|(?<=[\s;{}),])// .*$", "", text)
    text = re.sub(r"#\[cfg\(test\)\]\s*(#\[[^\]]*\]\s*)*mod \w+;", "", text)
    return re.sub(r"(?s)#\[cfg\(test\)\].*", "", text)


def sources_of(crate: Path) -> dict[Module, str]:
    """Return the code of every module but those of tests."""
    source = crate / "src"
    paths = (path for path in source.rglob("*.rs") if path.stem != "tests")
    return {module_of(path, source): code_of(path.read_text(encoding="utf-8")) for path in paths}


def leaves(tree: str) -> Iterator[tuple[str, str]]:
    """Yield the single paths of a `use` tree, each with the name that it gets."""
    tree = re.sub(r"\s+", " ", tree).strip()
    head, brace, rest = tree.partition("{")
    if not brace:
        path, _, name = tree.partition(" as ")
        yield path, name or path.rsplit("::", 1)[-1]
        return
    body, depth, start = rest[: rest.rindex("}")], 0, 0
    for place, letter in enumerate(body + ","):
        depth += (letter == "{") - (letter == "}")
        if letter == "," and not depth:
            if part := body[start:place].strip():
                yield from leaves(head.strip() + part)
            start = place + 1


class Crate:
    """Modules of a crate, and what each uses of the others."""

    def __init__(self, sources: dict[Module, str]) -> None:
        self.sources = sources
        self.handed_on: dict[Module, dict[str, str]] = {}
        for module, text in sources.items():
            trees = re.findall(r"\bpub(?:\([\w ]+\))? use ([^;]+);", text)
            self.handed_on[module] = {name: path for tree in trees for path, name in leaves(tree)}

    def origin(self, module: Module, path: str) -> Module | None:
        """Return the module that a path leads to from a module, behind what others hand on; None outside the crate."""
        names = path.removeprefix("::").split("::")
        if names[0] == "crate":
            at, names = (), names[1:]
        elif names[0] in ("super", "self"):
            at = module
            while names and names[0] in ("super", "self"):
                at = at[:-1] if names[0] == "super" else at
                names = names[1:]
        elif (*module, names[0]) in self.sources:
            at = module
        else:
            return None
        while names and (*at, names[0]) in self.sources:
            at, names = (*at, names[0]), names[1:]
        if names and names[0] in self.handed_on[at]:
            return self.origin(at, "::".join([self.handed_on[at][names[0]], *names[1:]])) or at
        return at

    def uses(self, module: Module) -> set[Module]:
        """Return the other modules of which a module uses something; what it only hands on does not count."""
        text = re.sub(r"\bpub(?:\([\w ]+\))? use [^;]+;", "", self.sources[module])
        paths = {path for tree in re.findall(r"\buse ([^;]+);", text) for path, _ in leaves(tree)}
        rest = re.sub(r"\buse [^;]+;|pub\(in [\w:]+\)", "", text)
        own = [other[-1] for other in self.sources if other[:-1] == module and other]
        paths |= set(re.findall(rf"(?<![\w:])(?:{'|'.join(['crate', 'super', *own])})(?:::\w+)+", rest))
        return {found for path in paths if (found := self.origin(module, path)) is not None} - {module, ()}


def above(crate: str, uses: dict[Module, set[Module]]) -> list[str]:
    """Return what a crate's modules use of higher layers, or of modules that no layer has."""
    height = layers.rust_ranks(crate)
    wrong = []
    for module, others in uses.items():
        for other in others:
            pair = [height.get(one[0]) for one in (module or ("lib",), other)]
            if module and (None in pair or pair[0] < pair[1]):
                wrong.append(f"{'::'.join(module)} uses {'::'.join(other)}")
    return sorted(wrong)


@pytest.mark.parametrize("path", CRATES, ids=lambda path: path.name)
def test_files_of_a_crate_have_no_circle(path):
    crate = Crate(sources_of(path))
    try:
        TopologicalSorter({module: crate.uses(module) for module in crate.sources}).prepare()
    except CycleError as error:
        circle = " -> ".join("::".join(module) for module in reversed(error.args[1]))
        pytest.fail(f"{path.name}: {circle}")


@pytest.mark.parametrize("name", layers.RUST_LAYERS)
def test_a_file_uses_its_own_layer_and_lower_ones(name):
    crate = Crate(sources_of(ROOT / "crates" / name))
    assert above(name, {module: crate.uses(module) for module in crate.sources}) == []


@pytest.mark.parametrize("name", layers.RUST_LAYERS)
def test_every_module_is_in_a_layer(name):
    found = {module[0] for module in sources_of(ROOT / "crates" / name) if module}
    assert set(layers.rust_ranks(name)) == found


def test_what_is_found_of_a_crate():
    """The reading itself: nested trees, what is handed on, paths in the text, tests left out."""
    inner = "use super::super::b; // crate::c::no\n#[cfg(test)]\nmod tests { use crate::c::X; }"
    sources = {
        (): "mod a; mod b; pub use a::Known;",
        ("a",): "mod inner; pub(crate) use inner::{Known, other as renamed}; use crate::b::helper;",
        ("a", "inner"): code_of(inner),
        ("b",): "use std::fmt; use crate::{\n  a::renamed,\n c::{self, Deep}\n}; fn f() { crate::d::call(); }",
        ("c",): "",
        ("d",): "mod below; fn g() { below::call(); other::below(); }",
        ("d", "below"): "",
    }
    crate = Crate(sources)
    assert crate.uses(("a",)) == {("b",)}
    assert crate.uses(("a", "inner")) == {("b",)}
    assert crate.uses(("b",)) == {("a", "inner"), ("c",), ("d",)}
    assert crate.uses(("d",)) == {("d", "below")}
    with pytest.raises(CycleError):
        TopologicalSorter({module: crate.uses(module) for module in sources}).prepare()
