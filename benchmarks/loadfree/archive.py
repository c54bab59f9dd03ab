"""Results on disk: rows of single registrations as they come, and one archive a half for the repository."""

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np

from common import REPOSITORY, read_archive, write_archive
from loadfree.bench import LOADFREE, Bench
from tissuereg._base.machine import machine, versions

RESULTS = Path(__file__).resolve().parent / "archive"
SCRATCH = REPOSITORY / "build" / "loadfree"

SCHEMA = "tissuereg.loadfree/1"
TABLES = ("methods/<method>", "events/#", "rows/<method>/#")


def result_path(half: str, bench: Bench = LOADFREE) -> Path:
    """Return where a half's results lie."""
    return RESULTS / f"{bench.mark}{half}"


def scratch_path(half: str, method: str, bench: Bench = LOADFREE) -> Path:
    """Return where rows of a method are kept while it runs."""
    return SCRATCH / f"{bench.mark}{half}-{method}.jsonl"


def key_of(row: dict) -> tuple[str, int, str]:
    """Return what makes a row of a method unique."""
    return row["body"], row["event"], row["layout"]


def read_rows(path: Path) -> list[dict]:
    """Return the rows of a scratch file; a last line that was cut off is left out."""
    if not path.exists():
        return []
    whole, _, _ = path.read_text(encoding="utf-8").rpartition("\n")
    return [json.loads(line) for line in whole.splitlines()]


def read_results(path: Path) -> dict:
    """Return a half's results, empty where there are none."""
    if not path.exists():
        return {"schema": SCHEMA, "methods": {}, "events": [], "rows": {}}
    return read_archive(path)


def write_results(bench: Bench, half: str, method: str, rows: list[dict], run: dict) -> None:
    """Put a method's rows into a half's results; other methods' rows stay.

    Parameters
    ----------
    bench : Bench
    half, method : str
    rows : list of dict
    run : dict
        Commit, command and settings under which they were made.
    """
    path = result_path(half, bench)
    answer = read_results(path)
    answer["half"] = half
    answer["methods"][method] = run | {
        "date": datetime.now(UTC).date().isoformat(),
        "machine": machine(),
        "versions": versions(),
        "n": len(rows),
    }
    answer["rows"][method] = sorted(rows, key=key_of)
    answer["events"] = _events(bench, answer["rows"])
    write_archive(path, answer, TABLES)


def _events(bench: Bench, rows: dict[str, list[dict]]) -> list[dict]:
    """Return what is true of every event that has a row."""
    used = sorted({(row["body"], row["event"]) for some in rows.values() for row in some})
    found = []
    for name, number in used:
        event = next(event for event in bench.read(name).events if event.number == number)
        support = {"support": event.description["support"]["kind"]} if "support" in event.description else {}
        found.append(
            {
                "body": name,
                "event": number,
                "kind": event.kind,
                **support,
                "difference": event.description["difference"],
                "largest_mm": round(event.description["largest_mm"], 3),
                "body_moved_mm": round(float(np.linalg.norm(event.nodes, axis=1).mean()), 5),
                "moved_um": [int(v) for v in np.rint(1e3 * np.linalg.norm(event.targets, axis=1))],
            }
        )
    return found
