"""A field is declared once: a record, a table of a file and an option of the command line obey the same check."""

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from tissuereg._base import fields
from tissuereg._base.fields import CheckedRecord
from tissuereg.cli.options import Parser, UsageError, add_option
from tissuereg.errors import ArgumentError, ExperimentError
from tissuereg.io.toml import Keys, Table


@dataclass(frozen=True)
class Inner(CheckedRecord):
    """A record within another one."""

    n: int = fields.whole("how many", least=1, default=3)


@dataclass(frozen=True, kw_only=True)
class Every(CheckedRecord):
    """A field of every kind."""

    std_mm: float = fields.number("noise", above=0.0, below=9.0, default=0.5)
    share: float | None = fields.number("share", least=0.0, most=1.0, default=None)
    speed: float = fields.number("speed", unit="mm/s", least=0.0, default=0.0)
    members: int = fields.whole("members", least=2, most=50, default=10)
    centre: tuple[float, ...] = fields.numbers("a place", 3, default=(0.0, 0.0, 0.0))
    towards: tuple[float, ...] = fields.numbers("a direction", 3, directed=True, default=(0.0, 0.0, 1.0))
    young_kpa: tuple[float, float | None] = fields.belief("stiffness", default=(1.0, None))
    radius_mm: tuple[float, float] = fields.span("range", above=0.0, default=(1.0, 2.0))
    patches: tuple[int, int] = fields.span("range", counted=1, default=(1, 2))
    name: str = fields.text("a name", default="a")
    pair: tuple[str, ...] = fields.texts("two names", length=2, default=("a", "b"))
    update: str = fields.choice(("one", "two"), "which", default="one")
    closed: bool = fields.flag("whether", default=False)
    folder: Path | None = fields.path("where", default=None)
    inner: Inner = fields.nested(Inner)


WRONG = {
    "zero": ({"std_mm": 0.0}, "`std_mm` must be a finite number greater than 0 and less than 9, got 0.0"),
    "a text": ({"std_mm": "1"}, "`std_mm` must be a finite number .* got '1'"),
    "true": ({"std_mm": True}, "got True"),
    "NaN": ({"std_mm": float("nan")}, "got nan"),
    "None without a default of None": ({"std_mm": None}, "got None"),
    "above the most": ({"share": 1.5}, "`share` must be a finite number at least 0 and at most 1, got 1.5"),
    "a unit that the name does not state": ({"speed": -1}, "at least 0, in mm/s, got -1"),
    "too few": ({"members": 1}, "`members` must be a whole number of at least 2, got 1"),
    "too many": ({"members": 51}, "`members` must be a whole number of at most 50, got 51"),
    "no whole number": ({"members": 3.0}, "`members` must be a whole number of at least 2, got 3.0"),
    "two of three": ({"centre": [1.0, 2.0]}, r"`centre` must be a list of 3 finite numbers, got \[1.0, 2.0\]"),
    "no direction": ({"towards": (0.0, 0.0, 0.0)}, "`towards` must have a length"),
    "a spread of zero": ({"young_kpa": [1.0, 0.0]}, r"`young_kpa` must be a number or \[mean, standard deviation > 0"),
    "a range downwards": ({"radius_mm": [2.0, 1.0]}, r"`radius_mm` must be a range \[low, high\], got \[2.0, 1.0\]"),
    "a range from zero": ({"radius_mm": [0.0, 1.0]}, "`radius_mm` must be a finite number greater than 0, got 0.0"),
    "half a patch": ({"patches": [1, 1.5]}, "`patches` must be a whole number of at least 1, got 1.5"),
    "an empty name": ({"name": " "}, "`name` must be a text, got ' '"),
    "one name twice": ({"pair": ["a", "a"]}, "`pair` must be a list of 2 different texts"),
    "an unknown word": ({"update": "three"}, "`update` must be one of one, two, got 'three'"),
    "one for true": ({"closed": 1}, "`closed` must be true or false, got 1"),
    "no path": ({"folder": 3}, "`folder` must be a path"),
    "another kind of record": ({"inner": 3}, "`inner` must be of the kind Inner, got 3"),
}


@pytest.mark.parametrize(("given", "message"), WRONG.values(), ids=WRONG)
def test_a_record_refuses_what_a_field_does_not_allow(given, message):
    with pytest.raises(ArgumentError, match=message) as caught:
        Every(**given)
    assert caught.value.where == next(iter(given))


def test_a_record_holds_values_of_one_type():
    made = Every(std_mm=np.float32(2), centre=np.arange(3), young_kpa=4, folder="a/b", share=None)
    assert (made.std_mm, made.centre, made.young_kpa) == (2.0, (0.0, 1.0, 2.0), (4.0, None))
    assert (type(made.std_mm), made.folder, made.share, made.inner.n) == (float, Path("a/b"), None, 3)
    assert [field.unit for field in made.declared()[:4]] == ["mm", "", "mm/s", ""]


@dataclass(frozen=True, kw_only=True)
class Chair(Keys):
    """A table of a file."""

    heading: ClassVar[str] = "[chair]"
    height_mm: float = fields.number("height", above=0.0)
    legs: int = fields.whole("legs", least=1, default=4)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"legs": 3}, r"`height_mm` must be given; the table holds legs in \[chair\] of f\.toml"),
        ({"height_mm": -1}, r"`height_mm` must be a finite number greater than 0, got -1 in \[chair\] of f\.toml"),
        ({"height_mm": 1, "arms": 2}, r"only the keys height_mm, legs are known, got 'arms' in \[chair\] of f\.toml"),
    ],
)
def test_a_table_is_refused_with_its_place(content, message):
    with pytest.raises(ExperimentError, match=message):
        Chair.alone(Table(Path("f.toml"), "", {"chair": content}))


def test_an_option_has_type_range_help_and_default_of_a_field():
    parser = Parser(prog="p")
    for name in ("std_mm", "members", "share"):
        add_option(parser, f"--{name}", Every.__dataclass_fields__[name], "X")
    assert vars(parser.parse_args(["--members", "7"])) == {"std_mm": 0.5, "members": 7, "share": None}
    assert "members (default: 10)" in parser.format_help()
    for words, message in (
        (["--std_mm", "0"], "--std_mm: must be a finite number greater than 0 and less than 9, got 0.0"),
        (["--members", "2.5"], "--members: must be a whole number of at least 2, got '2.5'"),
        (["--share", "much"], "--share: must be a finite number at least 0 and at most 1, got 'much'"),
    ):
        with pytest.raises(UsageError, match=message):
            parser.parse_args(words)
