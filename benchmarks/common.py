"""What the benches share: an archive on disk, and the commit of a run.

An archive is a folder: ``run.json`` holds what is true of the whole run, and each table a CSV file, one row a case,
compressed where it is large. A table is named by a path into the answer, as ``rows/<rig>`` (a dictionary of rows whose
keys become the column `rig`), ``rows/<method>/#`` (lists of rows by method) or ``trials/#``. Nested values of a row
have columns like ``register/trusted``; a cell holds a plain word or JSON; an empty one stands for a value that the row
does not have.
"""

import csv
import io
import json
import lzma
import subprocess
from pathlib import Path
from typing import Any

REPOSITORY = Path(__file__).resolve().parents[1]
BENCHES = REPOSITORY / "benchmarks"
SHARED = REPOSITORY.parent / "shared"

#: Tables of more bytes are compressed.
_LARGE = 150_000


def write_archive(folder: Path, answer: dict[str, Any], tables: tuple[str, ...]) -> None:
    """Write an answer as an archive, each file at once; tables that it does not have are left out.

    Parameters
    ----------
    folder : Path
    answer : dict
        Values that JSON can hold.
    tables : tuple of str
        Paths of the tables.
    """
    folder.mkdir(parents=True, exist_ok=True)
    rest = json.loads(json.dumps(answer))
    for path in tables:
        rows = _taken(rest, path.split("/"), {})
        _write_table(folder / f"{_name(path)}.csv", rows)
    lines = [f" {json.dumps(key)}: {json.dumps(value)}" for key, value in rest.items()]
    _replace(folder / "run.json", ("{\n" + ",\n".join([*lines, f' "tables": {json.dumps(tables)}']) + "\n}\n").encode())


def read_archive(folder: Path) -> dict[str, Any]:
    """Return the answer of an archive."""
    answer = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    for path in answer.pop("tables"):
        for row in _read_table(folder / f"{_name(path)}.csv"):
            _put(answer, path.split("/"), row)
    return answer


def commit() -> dict[str, Any]:
    """Return the commit under which something is made, and whether files that bear on it were changed since."""
    changed = _git("status", "--porcelain", "--untracked-files=no", "--", "python", "crates", "benchmarks", "tests")
    return {"commit": _git("rev-parse", "--short=12", "HEAD"), "changed_files": bool(changed)}


def _git(*words: str) -> str:
    done = subprocess.run(["git", *words], cwd=REPOSITORY, capture_output=True, text=True, check=False)
    return done.stdout.strip()


def _name(path: str) -> str:
    """Return the file name of a table's path: its words alone."""
    return "-".join(part.replace("_", "-") for part in path.split("/") if part != "#" and not part.startswith("<"))


def _taken(node: Any, path: list[str], keys: dict[str, Any]) -> list[dict[str, Any]]:
    """Return the rows below a path, with the keys on the way, and take them out of what is above."""
    part, *after = path
    if part == "#" or part.startswith("<"):
        named = enumerate(node) if part == "#" else node.items()
        rows = []
        for key, value in named:
            # Where a row's number in a list is no more than its place in the file, it needs no column.
            on_the_way = keys if part == "#" and not after else {**keys, part: key}
            rows += _taken(value, after, on_the_way) if after else [{**on_the_way, **value}]
        if not after:
            node.clear()
        return rows
    if part not in node:
        return []
    words = any(part != "#" and not part.startswith("<") for part in after)
    return _taken(node[part] if words else node.pop(part), after, keys)


def _put(node: Any, path: list[str], row: dict[str, Any]) -> None:
    """Put a row back below its path."""
    part, *after = path
    if part == "#":
        if not after:
            node.append(row)
            return
        number = row.pop(part)
        node.extend({} for _ in range(number + 1 - len(node)))
        _put(node[number], after, row)
        return
    key = row.pop(part) if part.startswith("<") else part
    if not after:
        node[key] = row
        return
    _put(node.setdefault(key, [] if after[0] == "#" else {}), after, row)


def _flat(row: dict[str, Any], before: str = "") -> dict[str, str]:
    cells: dict[str, str] = {}
    for key, value in row.items():
        if isinstance(value, dict) and value:
            cells |= _flat(value, f"{before}{key}/")
        else:
            cells[before + key] = _cell(value)
    return cells


def _cell(value: Any) -> str:
    """Return a word as it is where it cannot be taken for JSON, and JSON of everything else."""
    if isinstance(value, str) and value == value.strip() and value:
        try:
            json.loads(value)
        except json.JSONDecodeError:
            return value
    return json.dumps(value, separators=(",", ":"))


def _value(cell: str) -> Any:
    try:
        return json.loads(cell)
    except json.JSONDecodeError:
        return cell


def _write_table(path: Path, rows: list[dict[str, Any]]) -> None:
    flat = [_flat(row) for row in rows]
    out = io.StringIO()
    table = csv.DictWriter(out, list(dict.fromkeys(name for row in flat for name in row)), "", lineterminator="\n")
    table.writeheader()
    table.writerows(flat)
    content, packed = out.getvalue().encode(), path.with_suffix(".csv.xz")
    (path if len(content) > _LARGE else packed).unlink(missing_ok=True)
    if len(content) > _LARGE:
        _replace(packed, lzma.compress(content, preset=9 | lzma.PRESET_EXTREME))
    else:
        _replace(path, content)


def _read_table(path: Path) -> list[dict[str, Any]]:
    packed = path.with_suffix(".csv.xz")
    content = lzma.decompress(packed.read_bytes()) if packed.exists() else path.read_bytes()
    csv.field_size_limit(10**7)
    rows = []
    for flat in csv.DictReader(io.StringIO(content.decode())):
        row: dict[str, Any] = {}
        for name, cell in flat.items():
            if cell:
                *above, last = name.split("/")
                inner = row
                for part in above:
                    inner = inner.setdefault(part, {})
                inner[last] = _value(cell)
        rows.append(row)
    return rows


def _replace(path: Path, content: bytes) -> None:
    partial = path.with_name(f".{path.name}.part")
    partial.write_bytes(content)
    partial.replace(path)
