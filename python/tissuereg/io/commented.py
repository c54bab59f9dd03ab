"""Experiment files with a comment for every key, made from the declarations that the reader uses."""

import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

from tissuereg.io.declared import Declaration, Key
from tissuereg.io.experiment_keys import ACTUATOR, BOUNDARY, FORCES, GRAVITY, MARKERS, MATERIAL, MESH, TOP
from tissuereg.io.toml_text import toml_key, toml_value

#: Values shown for keys that are left out.
_EXAMPLES: dict[tuple[str, str], Any] = {
    (TOP.heading, "kind"): "rig",
    (TOP.heading, "name"): "my rig",
    (TOP.heading, "tables"): ".",
    (MESH.heading, "surface_std_mm"): 0.5,
    (MESH.heading, "surface_length_mm"): 10.0,
    (MATERIAL.heading, "law"): "neo-hookean",
    (MATERIAL.heading, "density_g_per_cm3"): 1.0,
    (MATERIAL.heading, "volumetric"): "log",
    (GRAVITY.heading, "direction"): [0.0, 0.0, -1.0],
    (GRAVITY.heading, "in_reference"): True,
    (GRAVITY.heading, "g_mm_per_s2"): 9810.0,
    (BOUNDARY.heading, "kind"): "fixed",
    (BOUNDARY.heading, "edge_std_mm"): 1.0,
    (ACTUATOR.heading, "contact"): "bonded",
    (ACTUATOR.heading, "edge_std_mm"): 1.0,
    (MARKERS.heading, "reference_time_s"): 0.0,
    (MARKERS.heading, "rest_case"): "rest",
    (MARKERS.heading, "trial_share"): 0.02,
    (FORCES.heading, "std_mN"): 5.0,
}


def commented_toml(head: Sequence[str], tables: Sequence[tuple[Declaration, Mapping[str, Any] | None]]) -> str:
    """Return an experiment file in which every declared key stands, with its meaning above it.

    Parameters
    ----------
    head : sequence of str
        Lines of the comment at the top.
    tables : sequence of pairs
        Declaration and values by key, in the order of the file; a list of tables has one pair per table. None: the
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


def _table(declaration: Declaration, values: Mapping[str, Any] | None) -> list[str]:
    off = "#" if values is None else ""
    given = {} if values is None else values
    lines = _wrapped(declaration.meaning)
    if declaration.heading:
        lines.append(f"{off}{declaration.heading}")
    for key in declaration.keys:
        value = given.get(key.name)
        if isinstance(value, Mapping) and key.words.startswith("table"):
            continue
        lines += _comment(key)
        if value is None:
            lines.append(f"#{key.name} = {toml_value(_EXAMPLES[declaration.heading, key.name])}")
        else:
            lines.append(f"{key.name} = {toml_value(value)}")
    for key in declaration.keys:
        value = given.get(key.name)
        if isinstance(value, Mapping) and key.words.startswith("table"):
            lines += [*_comment(key), f"[{declaration.name}.{key.name}]"]
            lines += [f"{toml_key(name)} = {toml_value(place)}" for name, place in value.items()]
    return lines


def _comment(key: Key) -> list[str]:
    holds = f"{key.words}, {key.unit}" if key.unit else key.words
    return _wrapped(f"{key.name}: {key.meaning}. Holds: {holds.replace('`', '')}.")


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(text, 110, initial_indent="# ", subsequent_indent="#   ", break_on_hyphens=False)
