"""A released beam, tracked by two markers and tested at a third -> archive/beam, RESULTS-beam.md.

    python -m tracking.tracked_beam [--data DIR] [--every N] [--seeds N] [--page]

Runs ``examples/track_beam.py`` on every recording in DIR (``../shared/data/beam``); ``--page`` writes the page again
from the archive.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from common import REPOSITORY, SHARED, read_archive, write_archive
from tissuereg._base.machine import machine, n_cores, versions

EXAMPLE = REPOSITORY / "examples" / "track_beam.py"
HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive" / "beam", HERE / "RESULTS-beam.md", ("trials/#",)

#: Parts of a recording, as the example names their errors.
PARTS = ("moving_mm", "rest_mm")

HEAD = """# A released beam, frame after frame

Written by `make -C benchmarks/tracking beam` from `archive/beam`; edit neither. The
recordings are public and not part of this repository; the command finds them in `../shared/data`.

A silicone beam, clamped at one end and held level, is released and swings until it hangs at rest. Two markers near its
tip are seen by motion capture at {hz:.0f} Hz; `examples/track_beam.py` tracks the beam with a `tr.Tracker` that knows
neither weight nor load nor simulation, and predicts a third marker, {held_out}, which is compared with where it was
seen. It is quasi-static: it follows the markers through the vibration and takes inertia for contacts. {taken}
from 0.1 s before the release.

Mean distance at {held_out} in mm, from the release to the last second, and in the last second, at rest. *Alone*: each
frame registered on its own. *Copied*: mean displacement of the two markers. Contacts are found by sampling: means over
{seeds} seeds, the least and the largest in brackets.

| recording | | moved, at most | tracked | alone | copied |
|---|---|---|---|---|---|
"""

REPLAY = """
## Replayed at {hz:.0f} Hz

All frames, by `Tracker.run`; distances over the frames that were registered. *Latency*: from a frame's time to its
answer.

| recording | registered | dropped | latency, median | latency, 99 % | {held_out} |
|---|---|---|---|---|---|
"""


def tracked(data: Path, every: int, seed: int, *, replay: bool = False) -> dict[str, Any]:
    """Return what the example finds."""
    with tempfile.TemporaryDirectory() as folder:
        told = Path(folder) / "told.json"
        words = ["--data", str(data), "--every", str(every), "--seed", str(seed), "--json", str(told)]
        subprocess.run([sys.executable, str(EXAMPLE), *words, *([] if replay else ["--no-replay"])], check=True)
        return dict(json.loads(told.read_text(encoding="utf-8")))


def page(answer: dict[str, Any]) -> str:
    """Return the page of an archive."""
    hz = answer["trials"][0]["hz"]
    text = HEAD.format(
        hz=hz, held_out=answer["held_out"], taken=_taken(answer["every"]), seeds=len(answer["trials"][0]["by_seed"])
    )
    for trial in answer["trials"]:
        for part, name in zip(PARTS, ("moving", "at rest"), strict=True):
            by_seed = [one[part] for one in trial["by_seed"]]
            cells = " | ".join(_cell([one[method] for one in by_seed]) for method in ("tracked", "alone", "copied"))
            text += f"| `{trial['trial']}` | {name} | {trial['most_moved_mm']:.1f} | {cells} |\n"
    text += REPLAY.format(hz=hz, held_out=answer["held_out"])
    for trial in answer["trials"]:
        told = trial["replay"]
        text += (
            f"| `{trial['trial']}` | {told['registered']} | {told['dropped']} | {told['latency_median_ms']:.0f} ms "
            f"| {told['latency_p99_ms']:.0f} ms | {told['error_mm']:.2f} mm |\n"
        )
    busy = " The machine was busy with other work: times are too long." if answer["load_before"] > 0.5 else ""
    return f"{text}\n{answer['n_nodes']} nodes, {answer['threads']} threads.{busy}\n"


def _cell(values: list[float]) -> str:
    """Return a mean over seeds and, where they differ, the least and the largest."""
    mean = f"{sum(values) / len(values):.3f}"
    return mean if max(values) == min(values) else f"{mean} ({min(values):.3f} to {max(values):.3f})"


def _taken(every: int) -> str:
    return "Every frame" if every == 1 else f"One of {every} frames"


def main() -> None:
    """Track the recordings, or write the page again."""
    parser = argparse.ArgumentParser(description="A released beam, tracked by two markers and tested at a third.")
    parser.add_argument("--data", type=Path, default=SHARED / "data" / "beam")
    parser.add_argument("--every", type=int, default=8, help="take each Nth frame only, but for the replay (default 8)")
    parser.add_argument("--seeds", type=int, default=4, help="searches for contacts that are averaged (default 4)")
    parser.add_argument("--page", action="store_true", help="write the page again from the archive")
    given = parser.parse_args()
    if not given.page:
        load = os.getloadavg()[0]
        answer = tracked(given.data, given.every, 0, replay=True)
        for trial in answer["trials"]:
            trial["most_moved_mm"] = max(frame["moved_mm"] for frame in trial.pop("frames"))
            trial["by_seed"] = [{part: trial.pop(part) for part in PARTS}]
        for seed in range(1, given.seeds):
            for trial, again in zip(answer["trials"], tracked(given.data, given.every, seed)["trials"], strict=True):
                trial["by_seed"].append({part: again[part] for part in PARTS})
        answer |= {
            "schema": "tissuereg.tracked-beam/1",
            "every": given.every,
            "threads": n_cores(),
            "load_before": load,
        }
        answer |= {"machine": machine(), "versions": versions()}
        write_archive(ARCHIVE, answer, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")


if __name__ == "__main__":
    main()
