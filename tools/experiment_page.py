"""Write the tables of ``docs/experiment.md`` from the declarations that the readers use, and the drawing on that page.

    python tools/experiment_page.py           # the tables
    python tools/experiment_page.py --check   # exit code 1 if the page holds others
    python tools/experiment_page.py --draw    # docs/rig.png, of the rig that `tissuereg demo --files` writes

A block between ``<!-- made by tools/experiment_page.py: NAME -->`` and ``<!-- end -->`` is rewritten; the rest stays.
"""

import argparse
import ast
import re
import sys
from collections.abc import Callable, Iterable
from dataclasses import MISSING
from pathlib import Path
from typing import Any

import own_sources  # noqa: F401 (before the package)

from tissuereg._base.fields import DeclaredField, unit_of
from tissuereg.body.material import SHAPE_KEYS, Material
from tissuereg.experiment.effects import EFFECTS, ChainEffect
from tissuereg.experiment.effects.base import Effect
from tissuereg.experiment.effects.elastic import OtherLaw
from tissuereg.io import experiment_keys as keys
from tissuereg.io.toml import Keys
from tissuereg.simulation.recipe import DataRecipe, MaterialRecipe, MeshRecipe, PairsRecipe

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "experiment.md"
TRAIN_SETTINGS = ROOT / "training" / "tissuereg_training" / "settings.py"
#: Its classes, and headings: the text stands between backticks, and so do its two parts.
TRAIN = (
    ("TrainSettings", "[train]"),
    ("GraphSettings", '[train]`, `kind = "graph"'),
    ("ClosureSettings", '[train]`, `kind = "closure"'),
)
_BLOCK = re.compile(r"(<!-- made by tools/experiment_page\.py: (.+?) -->\n).*?(<!-- end -->)", re.DOTALL)


def table(head: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """Return a Markdown table."""
    head = list(head)
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in line)} |\n" for line in lines)


def keys_of(keys: type[Keys]) -> str:
    """Return the keys of one table of the file."""
    rows = [(f"`{key.name}`", key.check.words, key.unit, default_of(key), key.check.meaning) for key in keys.declared()]
    must = " The table must be there." if keys.needed else ""
    said = " ".join((keys.__doc__ or "").split())
    return f"{said}{must}\n\n" + table(("key", "holds", "unit", "where absent", "meaning"), rows)


def default_of(key: DeclaredField) -> str:
    """Return what applies where a key is absent."""
    if key.default is MISSING:
        return "must be given"
    return key.check.otherwise or shown(key.default)


def shown(value: Any) -> str:
    """Return a default as the file would hold it."""
    if isinstance(value, bool):
        return f"`{str(value).lower()}`"
    if isinstance(value, str):
        return f'`"{value}"`'
    if isinstance(value, tuple | list):
        return f"`[{', '.join(f'{x:g}' for x in value)}]`"
    return f"`{value:g}`"


def node_forms() -> str:
    """Return the forms of a rule for nodes."""
    rows = [(f"`{text}`", f"`{form}`" if form else "none", meaning) for text, form, meaning in keys.NODE_FORMS]
    return table(("as text", "as a table", "nodes"), rows)


def laws() -> str:
    """Return the laws with their energies, out of the docstring of `Material`."""
    rows = re.findall(r"^ +\| ([\w-]+) \| ([^|]+) \| [^|]*\|$", Material.__doc__ or "", flags=re.MULTILINE)
    energy = {law: words for law, words in rows if law not in ("law", "---")}
    if set(energy) != set(SHAPE_KEYS):
        message = f"the table of laws must name {sorted(SHAPE_KEYS)}, got {sorted(energy)}"
        raise ValueError(message)
    rows = [
        (f"`{law}`", ", ".join(f"`{key}`" for key in shape) or "none", energy[law]) for law, shape in SHAPE_KEYS.items()
    ]
    return table(("law", "shape parameters (further keys of the table)", "energy density"), rows)


def csv_tables() -> str:
    """Return the comma-separated tables of a rig's folder."""
    rows = [(f"`{each.file}`", f"`{','.join(each.columns)}`", each.presence, each.meaning) for each in keys.CSV_TABLES]
    return table(("file", "columns", "needed", "a row holds"), rows)


def test_columns() -> str:
    """Return the columns of ``test.csv``."""
    return table(("column", "holds"), ((f"`{name}`", meaning) for name, meaning in keys.TEST_COLUMNS.items()))


def effects() -> str:
    """Return every effect with its keys."""
    rows = []
    for effect in EFFECTS.values():
        of_law = [key for keys_ in SHAPE_KEYS.values() for key in keys_] if issubclass(effect, OtherLaw) else []
        own = [key for key in effect.declared() if key.name not in of_law]
        seen = "yes" if effect.of_specimen else ""
        several = " *" if effect.repeatable else ""
        listed = "<br>".join(effect_key(key) for key in own)
        if of_law:
            listed += "<br>the shape parameters of the law"
        what = first_sentence(effect)
        if issubclass(effect, ChainEffect):
            what += " (tracker alone)"
        rows.append((f"`{effect.id}`{several}", listed, what, seen))
    return table(("id", "keys", "what it does", "in material tests"), rows)


def effect_key(key: DeclaredField) -> str:
    """Return one key of an effect, with unit, default and meaning."""
    stated = [key.check.words, *([key.unit] if key.unit else [])]
    if key.default is None:
        stated.append("may be left out")
    elif key.default is not MISSING:
        stated.append(f"{shown(key.default)} where absent")
    return f"`{key.name}` ({', '.join(stated)}): {key.check.meaning}"


def first_sentence(effect: type[Effect]) -> str:
    """Return the first line of an effect's docstring, in Markdown."""
    return (effect.__doc__ or "").splitlines()[0].rstrip(".").replace("``", "`")


def recipes() -> str:
    """Return the tables of a recipe; that of the training package out of its file, without importing it."""
    parts = [
        f"### `{kind.heading}`\n\n{keys_of(kind)}" for kind in (MeshRecipe, MaterialRecipe, DataRecipe, PairsRecipe)
    ]
    for name, heading in TRAIN:
        rows = [
            (f"`{key}`", kind, unit_of(key), f"`{default}`", meaning)
            for key, kind, default, meaning in recipe_keys(TRAIN_SETTINGS, name)
        ]
        parts.append(f"### `{heading}`\n\n" + table(("key", "holds", "unit", "where absent", "meaning"), rows))
    return "\n".join(parts)


def recipe_keys(path: Path, name: str) -> list[tuple[str, str, str, str]]:
    """Return key, kind, default and meaning of every field of a class, read without importing it."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    classes = {node.name: node for node in tree.body if isinstance(node, ast.ClassDef)}
    found = classes[name]
    bases = [classes[base.id] for base in found.bases if isinstance(base, ast.Name) and base.id in classes]
    documented: dict[str, tuple[str, str]] = {}
    for each in (*bases, found):
        documented |= described(ast.get_docstring(each) or "")
    rows = []
    for node in found.body:
        if isinstance(node, ast.AnnAssign) and node.value is not None and isinstance(node.target, ast.Name):
            if "ClassVar" in ast.unparse(node.annotation):
                continue
            kind, meaning = documented[node.target.id]
            default = ast.unparse(node.value).replace("(", "[").replace(")", "]").replace("'", '"').replace(",]", "]")
            rows.append((node.target.id, kind, default, meaning))
    return rows


def described(docstring: str) -> dict[str, tuple[str, str]]:
    """Return kind and meaning by name, out of the section ``Parameters`` of a docstring."""
    section = docstring.split("Parameters\n----------\n")[1]
    entries = re.findall(r"^(\w+) : (.+)\n((?:    .+\n?)+)", section, flags=re.MULTILINE)
    words = {"int": "whole number", "float": "number", "str": "text"}
    words["tuple of int"] = "list of whole numbers"
    return {name: (words.get(kind, kind), " ".join(meaning.split())) for name, kind, meaning in entries}


BLOCKS: dict[str, Callable[[], str]] = {
    **{(kind.heading or "top"): (lambda kind=kind: keys_of(kind)) for kind in (*keys.RIG, keys.MaterialTestKeys)},
    "nodes": node_forms,
    "laws": laws,
    "tables": csv_tables,
    "test.csv": test_columns,
    "effects": effects,
    "recipes": recipes,
}


def made(text: str) -> str:
    """Return a page with its blocks made anew.

    Parameters
    ----------
    text : str
        The page.

    Returns
    -------
    str
        With every block once.

    Raises
    ------
    ValueError
        If a block is missing, unknown or there twice.
    """
    named = [name for _, name, _ in _BLOCK.findall(text)]
    if sorted(named) != sorted(BLOCKS):
        message = f"the page must hold each block once: {sorted(BLOCKS)}, got {sorted(named)}"
        raise ValueError(message)
    return _BLOCK.sub(lambda found: f"{found[1]}\n{BLOCKS[found[2]]()}\n{found[3]}", text)


def draw() -> None:
    """Draw the rig of `tissuereg demo --files`."""
    import tempfile

    from tissuereg.phantom.samples import write_samples

    sys.path.insert(0, str(ROOT / "tools"))
    from rig_drawing import draw_rig

    with tempfile.TemporaryDirectory() as folder:
        write_samples(folder)
        draw_rig(Path(folder) / "rig", ROOT / "docs" / "rig.png")


def main() -> int:
    """Run the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--check", action="store_true", help="write nothing")
    parser.add_argument("--draw", action="store_true", help="draw docs/rig.png")
    args = parser.parse_args()
    if args.draw:
        draw()
        return 0
    text = PAGE.read_text(encoding="utf-8")
    new = made(text)
    if args.check:
        return int(new != text)
    PAGE.write_text(new, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
