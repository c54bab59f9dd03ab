"""Is a law declared once? Who names its shape parameters; do all who list laws have all of them?"""

import re
from dataclasses import fields
from pathlib import Path

import pytest

import tissuereg
from support.scripts import REPOSITORY
from tissuereg.body.laws import DECLARED, main_key, shape_of
from tissuereg.body.material import LAWS, Material
from tissuereg.experiment.effects.elastic import OtherLaw

PACKAGE = Path(tissuereg.__file__).parent
CRATES = REPOSITORY / "crates"


def files_naming(word: str) -> set[str]:
    """Source files that name a word in code, comments of Rust and docstrings included."""
    named = set()
    for root, pattern in ((PACKAGE, "*.py"), (CRATES, "*.rs")):
        for path in root.rglob(pattern):
            parts = path.relative_to(root).parts
            if root == CRATES and parts[1] != "src":
                continue
            if re.search(rf"\b{word}\b", path.read_text(encoding="utf-8")):
                named.add(path.name)
    return named


def test_yeohs_parameters_are_named_where_they_are_declared_and_documented():
    # Its file, the catalogue, an example of the declaration, the keys of its effect, two docstrings.
    known = {"yeoh.rs", "kind.rs", "declaration.rs", "field.rs", "elastic.py", "material.py", "laws.py"}
    assert files_naming("c2_over_c1") <= known
    assert files_naming("c3_over_c1") <= known


def test_every_shape_parameter_is_a_key_of_the_effects_of_other_laws():
    keys = {key.name for law in DECLARED.values() for key in law.shape}
    assert keys == {field.name for field in fields(OtherLaw)} - {"law", "volumetric"}


@pytest.mark.parametrize(
    "place",
    [
        "python/tissuereg/body/material.py",
        "crates/fem/src/material/kind.rs",
        "crates/fem/README.md",
        "docs/theory/solver.md",
    ],
)
def test_every_law_is_documented(place):
    assert tuple(DECLARED) == LAWS
    text = (REPOSITORY / place).read_text(encoding="utf-8").lower().replace("\N{EN DASH}", "-").replace(". ", "-")
    # In the cell of a table, or in parentheses.
    assert set(LAWS) <= set(re.findall(r"(?:\| `?|\(|, )([\w-]+)(?=`? \||, |\))", text))


def test_every_shape_parameter_is_in_the_table_of_names():
    (row,) = re.findall(r"^\| law shape \|.*$", (REPOSITORY / "NOTATION.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert {key.name for law in DECLARED.values() for key in law.shape} <= set(re.findall(r"\w+", row))


@pytest.mark.parametrize("law", [law for law, said in DECLARED.items() if said.shape and not said.has_terms])
def test_a_law_takes_every_start_of_its_fit_and_is_plain_where_its_shape_vanishes(law):
    said = DECLARED[law]
    assert said.starts
    for start in said.starts:
        assert len(start) == len(said.shape)
        assert all(key.least <= value <= key.largest for key, value in zip(said.shape, start, strict=True))
        assert Material(3.0, 0.4, law=law, shape=shape_of(law, *start)).law == law
    assert shape_of(law)[main_key(law)] == 0.0
