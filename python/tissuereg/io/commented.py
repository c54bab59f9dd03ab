"""Experiment files with a comment for every key, made from the declarations that the reader uses."""

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from typing import Any

from tissuereg._base.fields import Field
from tissuereg.io.toml import Keys
from tissuereg.io.toml_text import toml_key, toml_value


def commented_toml(head: Sequence[str], tables: Sequence[tuple[type[Keys], Mapping[str, Any] | None]]) -> str:
    """Return an experiment file in which every declared key stands, with its meaning above it.

    Parameters
    ----------
    head : sequence of str
        Lines of the comment at the top.
    tables : sequence of pairs
        Declared keys, and values by key, in the order of the file; a list of tables has one pair per table. None: the
        table is left out, and shown behind ``#``. A mapping as a value becomes a table of its own.

    Returns
    -------
    str
        TOML. Keys without a value stand behind ``#``, without a space; all other comments have one.
    """
    lines = [f"# {line}" for line in head]
    for declaration, values in tables:
        lines += ["", *_table(declaration, values)]
    return "\n".join(lines) + "\n"


def _table(keys: type[Keys], values: Mapping[str, Any] | None) -> list[str]:
    off = "#" if values is None else ""
    given = {} if values is None else values
    lines = _wrapped(" ".join((keys.__doc__ or "").split()))
    if keys.heading:
        lines.append(f"{off}{keys.heading}")
    inner = [
        key for key in keys.declared() if isinstance(given.get(key.name), Mapping) and key.check.words[:5] == "table"
    ]
    for key in keys.declared():
        if key in inner:
            continue
        value = given.get(key.name)
        shown = value if value is not None else key.check.example if key.default in (None, MISSING) else key.default
        lines += [*_comment(key), f"{'#' if value is None else ''}{key.name} = {toml_value(shown)}"]
    for key in inner:
        lines += [*_comment(key), f"[{keys.heading.strip('[]')}.{key.name}]"]
        lines += [f"{toml_key(name)} = {toml_value(place)}" for name, place in given[key.name].items()]
    return lines


def _comment(key: Field) -> list[str]:
    holds = f"{key.check.words}, {key.unit}" if key.unit else key.check.words
    return _wrapped(f"{key.name}: {key.check.meaning}. Holds: {holds.replace('`', '')}.")


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 110, initial_indent="# ", subsequent_indent="#   ", break_on_hyphens=False)
