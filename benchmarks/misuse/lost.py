"""Markers that are lost to a value of the tracker, and exchanged ones -> archive-lost/, RESULTS-lost.md.

    python -m misuse.lost [--events N] [--data DATA]
    python -m misuse.lost --page

One marker of an event (in every other event one in five) gets a value that trackers write for a marker which they do
not see, and one good marker is held out; then two measured places are exchanged instead. Without a model: good events
of 8 to 30 markers on every body; with the shipped one: shapes of the test split of its data set, 15 markers.
"""

import argparse
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

import tissuereg as tr
from common import commit, read_archive, write_archive
from learned.cases import STD, known
from misuse.events import BODIES, misusable
from tissuereg._base.machine import machine
from tissuereg.phantom import phantom_mesh

HERE = Path(__file__).resolve().parent
ARCHIVE, PAGE, TABLES = HERE / "archive-lost", HERE / "RESULTS-lost.md", ("rows/#", "swaps/#")

VALUES = {
    "nothing lost": None,
    "left blank": (np.nan,) * 3,
    "0, 0, 0": (0.0, 0.0, 0.0),
    "-9999.99": (-9999.99,) * 3,
    "bad float": (-3.697314e28,) * 3,
    "one constant place": (-212.417, 80.293, -931.88),
}

#: What frames show besides: the pose of the frame before, and a marker that jumps by some mm.
OF_FRAMES, JUMP_MM = ("the pose of the frame before", "a jump of 150 mm"), 150.0

#: Shares of the motion in a recording's frames, 0.1 s apart; in the last `LATE` frames markers are lost.
FRAMES, LATE, STEP_S = (0.3, 0.6, 0.9, 1.0), 2, 0.1

#: How an answer is made, and its model.
PATHS = {
    "register": None,
    "register, trained model": "phantom",
    "track": None,
    "track, trained model": "phantom",
}


@dataclass(frozen=True, eq=False)
class Case:
    """An event with what is lost: `body` and `number` say which; `measured` (n_markers, 3) in mm; rows of markers."""

    body: str
    number: int
    mesh: tr.Mesh
    reference: np.ndarray
    measured: np.ndarray
    std: float
    held_out: int
    lost: np.ndarray

    def frames(self) -> Iterator[np.ndarray]:
        """Yield the measured places (n_markers, 3) of each frame, mm, of one noise; nothing is lost yet."""
        rng = np.random.default_rng([22, 6, self.number])
        for share in FRAMES:
            noise = self.std * np.sqrt(1.0 - share**2) * rng.standard_normal(self.measured.shape)
            places = self.reference + share * (self.measured - self.reference) + noise
            places[self.held_out] = np.nan
            yield places


def cases(model: "str | None", n_events: int, data: Path) -> Iterator[Case]:
    """Yield the events of answers with a model or without."""
    if model is not None:
        for i, event in enumerate(known(data, n_events * len(BODIES))):
            mesh, rng = phantom_mesh(), np.random.default_rng([22, 7, i])
            yield Case("known", i, mesh, event.reference, event.measured, STD, *_chosen(event, 2 * i + 1, rng))
        return
    for body, number in _asked(n_events):
        event, rng = misusable(body, number), np.random.default_rng([22, 4, BODIES.index(body), number])
        mesh = event.mesh()
        yield Case(body, number, mesh, event.reference, event.measured, event.std, *_chosen(event, number, rng))


def _asked(n_events: int) -> list[tuple[str, int]]:
    return [(body, number) for body in BODIES for number in range(1, 2 * n_events, 2)]


def _chosen(event, number: int, rng: np.random.Generator) -> tuple[int, np.ndarray]:
    n = len(event.measured)
    held_out, *rows = rng.permutation(n)[: 1 + (1 if number % 4 == 1 else max(1, n // 5))]
    return int(held_out), np.array(rows)


def answers(path: str, case: Case, value: str) -> dict[str, object]:
    """Return whether all answers with lost markers are trusted, in how many of these the marker is outside, how far."""
    model = PATHS[path]
    settings = tr.RegisterSettings(threads=1)
    frames = list(case.frames())
    before = frames[-LATE - 1].copy()
    for places in frames[-LATE:]:
        if value == OF_FRAMES[0]:
            places[case.lost] = before[case.lost]
        elif value == OF_FRAMES[1]:
            places[case.lost] += JUMP_MM / np.sqrt(3.0)
        elif VALUES[value] is not None:
            places[case.lost] = VALUES[value]
    if path.startswith("register"):
        markers = tr.Markers(case.reference, frames[-1], case.std)
        results = [tr.register(case.mesh, markers, model=model, settings=settings)]
    else:
        markers = tr.Markers(case.reference, None, case.std)
        tracker = tr.Tracker(tr.Registrar(case.mesh, markers, model, settings=settings))
        results = [tracker.step(places, STEP_S * k) for k, places in enumerate(frames)][-LATE:]
    trusted, outside, off = 0, 0, 0.0
    for result, truth in zip(reversed(results), _held_out(case), strict=False):
        target = result.unseen[result.all_markers.names[case.held_out]]
        trusted += result.trust.ok
        if result.trust.ok and not target.region(0.999).contains(truth):
            outside += 1
            off = max(off, float(np.linalg.norm(target.mean - truth)))
    return {"answers": len(results), "trusted": trusted, "outside": outside, "off_mm": off}


def _held_out(case: Case) -> list[np.ndarray]:
    """Return the true places of the marker that is held out, in the last frames, the last one first, mm."""
    motion = case.measured[case.held_out] - case.reference[case.held_out]
    return [case.reference[case.held_out] + share * motion for share in FRAMES[::-1]]


def swapped(body: str, number: int) -> tuple[bool, bool]:
    """Return whether two exchanged markers are named, and whether they are used again where they were put back."""
    event = misusable(body, number)
    rng = np.random.default_rng([22, 5, BODIES.index(body), number])
    pair = rng.permutation(len(event.measured))[:2]
    measured = event.measured.copy()
    measured[pair] = measured[pair[::-1]]
    result = tr.register(event.mesh(), event.but(measured=measured).markers(), settings=tr.RegisterSettings(threads=1))
    named = sum(reason.startswith("swapped: ") for reason in result.trust.reasons) == 1
    right = np.allclose(result.all_markers.measured, event.measured)
    return named, right and not {event.markers().names[i] for i in pair} - set(result.markers.used)


def page(content: dict) -> str:
    """Return the page of an archive."""
    lines = [
        "# Markers that are no measurements",
        "",
        f"`{content['command']}`, load unknown: {content['events']} events on five bodies, with the trained model as "
        f"many shapes of its data set's test split. A recording has {len(FRAMES)} frames, {STEP_S:g} s apart; in the "
        f"last {LATE} markers are lost. *Outside*: trusted answers in which a held-out marker lies outside the region "
        "that holds it with 99.9 %.",
        "",
        "| asked by | measured place | answers | trusted | outside | farthest off in those (mm) |",
        "|---|---|---|---|---|---|",
    ]
    for path in PATHS:
        for name in (*VALUES, *OF_FRAMES):
            rows = [row for row in content["rows"] if row["value"] == name and row["path"] == path]
            if rows:
                n, trusted, bad = (sum(row[key] for row in rows) for key in ("answers", "trusted", "outside"))
                off = f"{max(row['off_mm'] for row in rows):.1f}" if bad else ""
                lines.append(f"| {path} | {name} | {n} | {trusted} | {bad} | {off} |")
    swaps = content["swaps"]
    named, back = (sum(row[key] for row in swaps) for key in ("named", "back"))
    lines += [
        "",
        f"Two exchanged, `register`: {len(swaps)} events, named once in {named}, put back and used in {back}.",
    ]
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run and write; `--page` writes the page alone."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--events", type=int, default=2, help="events of each body")
    parser.add_argument("--data", type=Path, help="data set of the shipped model")
    parser.add_argument("--page", action="store_true")
    options = parser.parse_args()
    if not options.page:
        rows, swaps = [], []
        with threadpool_limits(limits=1), warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            for path, model in PATHS.items():
                for case in cases(model, options.events, options.data):
                    for value in (*VALUES, *(OF_FRAMES if path.startswith("track") else ())):
                        which = {"path": path, "value": value, "body": case.body, "event": case.number}
                        rows.append({**which, **answers(path, case, value)})
                print(f"{path}: {len(rows)} rows", flush=True)
            for body, number in _asked(options.events):
                named, back = swapped(body, number)
                swaps.append({"body": body, "event": number, "named": named, "back": back})
        made = {"command": f"python -m misuse.lost --events {options.events} --data DATA", "machine": machine()}
        content = {**made, "events": len(BODIES) * options.events, **commit()}
        write_archive(ARCHIVE, {**content, "rows": rows, "swaps": swaps}, TABLES)
    PAGE.write_text(page(read_archive(ARCHIVE)), encoding="utf-8")


if __name__ == "__main__":
    main()
