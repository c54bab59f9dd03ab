"""Writing of TOML: plain tables, and experiment files with a comment for every key, made from the declared keys."""

import json
import os
import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import MISSING
from typing import Any

from tissuereg._base.fields import DeclaredField
from tissuereg.errors import ExperimentError
from tissuereg.io.atomic import atomic_file
from tissuereg.io.toml import Keys

_BARE = re.compile(r"[A-Za-z0-9_-]+")


def toml_text(content: Mapping[str, Any]) -> str:
    """Return a mapping as TOML text.

    `content`: texts, numbers, truth values, lists of these, mappings (tables) and lists of mappings (lists of tables),
    by key. Floats are written in the shortest form that reads back to the same bits. Raises `ExperimentError` if a
    value is of no TOML type.

    Examples
    --------
    >>> print(toml_text({"name": "rig", "mesh": {"file": "a.vtu"}, "effect": [{"id": "scale", "scale": 1.01}]}))
    name = "rig"
    <BLANKLINE>
    [mesh]
    file = "a.vtu"
    <BLANKLINE>
    [[effect]]
    id = "scale"
    scale = 1.01
    <BLANKLINE>
    """
    lines: list[str] = []
    _add_table(lines, (), content)
    return "\n".join(lines).lstrip("\n") + "\n"


def write_toml(path: str | os.PathLike[str], content: Mapping[str, Any]) -> None:
    """Write a mapping as a TOML file, whole or not at all.

    `content`: texts, numbers, truth values, lists of these, mappings (tables) and lists of mappings (lists of tables),
    by key. Raises `ExperimentError` if a value is of no TOML type; `OutputError` if the file cannot be written there.
    """
    text = toml_text(content)
    with atomic_file(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _add_table(lines: list[str], place: tuple[str, ...], content: Mapping[str, Any]) -> None:
    tables = {key: value for key, value in content.items() if isinstance(value, Mapping)}
    lists = {key: value for key, value in content.items() if _is_list_of_tables(value)}
    lines.extend(_line(key, value) for key, value in content.items() if key not in tables and key not in lists)
    for key, value in tables.items():
        lines.extend(["", f"[{'.'.join(map(toml_key, (*place, key)))}]"])
        _add_table(lines, (*place, key), value)
    for key, items in lists.items():
        for item in items:
            lines.extend(["", f"[[{'.'.join(map(toml_key, (*place, key)))}]]", *map(_line, item, item.values())])


def _line(key: str, value: Any) -> str:
    return f"{toml_key(key)} = {toml_value(value)}"


def _is_list_of_tables(value: Any) -> bool:
    return isinstance(value, list | tuple) and len(value) > 0 and all(isinstance(item, Mapping) for item in value)


def toml_key(key: str) -> str:
    """Return a key as TOML writes it, in quotes where they are needed."""
    return key if _BARE.fullmatch(key) else _text(key)


def toml_value(value: Any) -> str:
    """Return one value as TOML text on one line; a mapping becomes an inline table.

    `value`: a text, number, truth value, or a list or mapping of these. Raises `ExperimentError` if it is of no TOML
    type.
    """
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(toml_value, value))}]"
    if isinstance(value, Mapping):
        return f"{{ {', '.join(map(_line, value, value.values()))} }}"
    message = f"a value of a TOML file must be a text, number, truth value, list or table, got {type(value).__name__}"
    raise ExperimentError(message)


def _text(text: str) -> str:
    # JSON's escapes are TOML's; the one control character that JSON leaves alone is DEL.
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007F")


def commented_toml(head: Sequence[str], tables: Sequence[tuple[type[Keys], Mapping[str, Any] | None]]) -> str:
    """Return the text of an experiment file in which every declared key stands, with its meaning in a comment above it.

    `head`: lines of the comment at the top; `tables`: pairs of a table's declaration and its values by key, in the
    order of the file; a list of tables has one pair per table. For None in place of the values the table is left out,
    and shown as a comment behind ``#``. A mapping as a value becomes a table of its own. Keys without a value stand
    behind ``#`` without a space after it; all other comments have a space.
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


def _comment(key: DeclaredField) -> list[str]:
    holds = f"{key.check.words}, {key.unit}" if key.unit else key.check.words
    return _wrapped(f"{key.name}: {key.check.meaning}. Holds: {holds.replace('`', '')}.")


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 110, initial_indent="# ", subsequent_indent="#   ", break_on_hyphens=False)
