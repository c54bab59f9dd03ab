"""Words of which an argument takes one: an editor completes those that are accepted, and no others are."""

import argparse
import inspect
from typing import Any, get_args, get_type_hints

import pytest

import tissuereg as tr
from tissuereg._base import choices
from tissuereg.cli import COMMANDS, build_parser
from tissuereg.io.surfaces import read_triangles
from tissuereg.tracking import FemPhysics

#: Callables with an argument that takes one of the words.
TAKERS = [
    (tr.Body.__init__, "held", choices.HELD),
    (tr.Body.__init__, "stiffness", choices.STIFFNESS),
    (tr.Body.__init__, "element", choices.BODY_ELEMENTS),
    (tr.RegisterSettings.__init__, "tracker", choices.TRACKERS),
    (tr.RegisterSettings.__init__, "readings", choices.READINGS),
    (tr.Mesh.__init__, "frame", choices.FRAMES),
    (tr.read_mesh, "coincident", choices.COINCIDENT),
    (tr.read_markers, "match", choices.MATCHES),
    (tr.read_markers, "table_frame", choices.FRAMES),
    (tr.Registration.transform, "direction", choices.DIRECTIONS),
    (tr.Tracker.__init__, "restart", choices.RESTARTS),
    (tr.simulate, "element", choices.ELEMENTS),
    (FemPhysics.__init__, "element", choices.ELEMENTS),
    (tr.tetrahedralize, "unit", choices.UNITS),
    (read_triangles, "unit", choices.UNITS),
    (tr.phantom.phantom_mesh, "size", choices.SIZES),
]


def words_of(hint: Any) -> set[str]:
    """Return the words of a hint, through unions with None."""
    return {word for one in get_args(hint) or (hint,) for word in (words_of(one) if get_args(one) else {one})}


@pytest.mark.parametrize(("call", "name", "words"), TAKERS, ids=lambda x: getattr(x, "__qualname__", None))
def test_an_argument_is_typed_by_what_it_takes(call, name, words):
    assert words_of(get_type_hints(call)[name]) - {type(None)} == set(words)
    default = inspect.signature(call).parameters[name].default
    assert default in (None, inspect.Parameter.empty) or default in words


def test_a_word_that_is_not_listed_is_refused_with_the_list():
    mesh = tr.phantom.phantom_mesh("small")
    for name, words in (("held", choices.HELD), ("stiffness", choices.STIFFNESS), ("element", choices.BODY_ELEMENTS)):
        for word in words:
            assert getattr(tr.Body(mesh, **{name: word}), name) == word
        with pytest.raises(tr.TissueRegError, match=", ".join(words)):
            tr.Body(mesh, **{name: "other"})
    with pytest.raises(tr.TissueRegError, match=", ".join(choices.RESTARTS)):
        tr.Tracker(mesh, mesh.nodes[mesh.surface_nodes[:3]], restart="other")


def test_options_of_commands_take_the_same_words():
    (commands,) = [one for one in build_parser()._actions if isinstance(one, argparse._SubParsersAction)]
    expected = {
        "--held": choices.HELD,
        "--tracker": choices.TRACKERS,
        "--frame": choices.FRAMES,
        "--tables-frame": choices.FRAMES,
        "--coincident": choices.COINCIDENT,
        "--match": choices.MATCHES,
        "--direction": choices.DIRECTIONS,
        "--unit": choices.UNITS,
    }
    seen = set()
    for name in COMMANDS:
        for option in commands.choices[name]._actions:
            for flag in set(option.option_strings) & expected.keys():
                if flag == "--unit" and name not in ("mesh", "warp"):
                    continue  # of a tracker, whose files know more units
                seen.add(flag)
                assert tuple(option.choices) == expected[flag], (name, flag)
    assert seen == expected.keys()
