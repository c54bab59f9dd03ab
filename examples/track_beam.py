"""A real silicone beam that is released and vibrates: tracked by two motion-capture markers, tested at a third.

    python examples/track_beam.py --data DIR [--from-s T] [--to-s T] [--every N] [--seed N] [--no-replay] [--json FILE]

DIR holds ``beam.stl`` and recordings ``own_weight_*.csv``, ``load_52g_*.csv`` at 100 Hz (as for ``beam.py``). The beam
is held level until t = 0, then released. Nothing is told of its weight, of the load or of its motion: contacts that
explain Tip-1 and Tip-2 are found frame after frame, and Tip-3 is predicted. The beam vibrates and a registration knows
no inertia: each frame is an equilibrium that fits the markers. Every frame is registered on its own too, and the
recording is then replayed at its rate. Needs the extra ``mesh``.
"""

import argparse
import csv
import json
import sys
from pathlib import Path

import numpy as np
from beam import DENSITY_G_PER_CM3, FITTED, HELD_OUT, MARKER_STD_MM, POISSON, beam_mesh
from simple import copied

import tissuereg as tr

#: E in kPa that the beam's makers identified; with an unknown load it scales forces alone.
YOUNG_KPA = 263.8

#: The beam is level before this, s, and at rest for so long at the end, s.
LEVEL_S, REST_S = -0.05, 1.0

NAMES = (*FITTED, HELD_OUT)


def read_recording(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return times (n_frames,) in s and places (n_frames, 3, 3) of Tip-1, Tip-2, Tip-3 in mm; NaN = not seen."""
    with path.open(newline="", encoding="utf-8") as stream:
        rows = list(csv.DictReader(stream))
    times = np.array([float(row["t_s"]) for row in rows])
    cells = [[[row[f"{name}_{axis}_mm"] for axis in "xyz"] for name in NAMES] for row in rows]
    return times, np.array([[[float(cell or "nan") for cell in place] for place in frame] for frame in cells])


def track(mesh: tr.Mesh, path: Path, begin_s: float, end_s: float, every: int, *, seed: int, replay: bool) -> dict:
    """Return the errors at Tip-3 of one recording, frame after frame, by method, and how a replay went."""
    times, places = read_recording(path)
    reference = np.nanmedian(places[times < LEVEL_S], axis=0)
    whole = np.flatnonzero((times >= begin_s) & (times <= end_s))
    chosen = whole[::every]
    seen = places.copy()
    seen[:, NAMES.index(HELD_OUT)] = np.nan
    registrar = tr.Registrar(
        tr.Body(mesh, tr.Material(YOUNG_KPA, POISSON, density=DENSITY_G_PER_CM3)),
        tr.Markers(reference, std=MARKER_STD_MM, names=NAMES),
        seed=seed,
    )
    tracker = tr.Tracker(registrar)
    frames = []
    for k in chosen:
        results = {"tracked": tracker.step(seen[k], times[k]), "alone": registrar.register(seen[k])}
        at = {name: result.unseen[HELD_OUT].mean for name, result in results.items()}
        moved = seen[k, : len(FITTED)]
        at["copied"] = reference[-1] + copied(reference[: len(FITTED)], moved, reference[-1])
        errors = {name: float(np.linalg.norm(place - places[k, -1])) for name, place in at.items()}
        size = float(np.linalg.norm(places[k, -1] - reference[-1]))
        frames.append({"time_s": float(times[k]), "moved_mm": size, "gain": tracker.last.gain, "error_mm": errors})
        tell(path.stem, len(frames), len(chosen))
    rest = [frame for frame in frames if frame["time_s"] > times[-1] - REST_S]
    moving = [frame for frame in frames if frame["time_s"] >= 0.0 and frame not in rest]
    answer = {
        "trial": path.stem,
        "frames": frames,
        "moving_mm": mean_errors(moving),
        "rest_mm": mean_errors(rest),
        "hz": float(1.0 / np.median(np.diff(times))),
        "replay": None,
    }
    if replay:
        answer["replay"] = replayed(tracker, times[whole], seen[whole], places[whole, -1])
    return answer


def mean_errors(frames: list[dict]) -> dict | None:
    """Return the mean error by method, mm; None without frames."""
    if not frames:
        return None
    return {name: float(np.nanmean([frame["error_mm"][name] for frame in frames])) for name in frames[0]["error_mm"]}


def replayed(tracker: tr.Tracker, times: np.ndarray, seen: np.ndarray, truth: np.ndarray) -> dict:
    """Return latencies and drops at the recorded rate, and the mean error at Tip-3 of the frames that were registered.

    The tracker has registered frames before, so that what a first frame makes for all is not part of the replay.
    """
    tracker.reset()
    dropped = tracker.dropped
    found = list(tracker.run(zip(times.tolist(), seen, strict=True)))
    latency = 1e3 * np.array([frame.latency_s for frame in found])
    index = np.searchsorted(times, [frame.time_s for frame in found])
    places = np.array([frame.registration.unseen[HELD_OUT].mean for frame in found])
    return {
        "registered": len(found),
        "dropped": tracker.dropped - dropped,
        "latency_median_ms": float(np.median(latency)),
        "latency_p99_ms": float(np.percentile(latency, 99)),
        "error_mm": float(np.nanmean(np.linalg.norm(places - truth[index], axis=1))),
    }


def tell(trial: str, done: int, in_all: int) -> None:
    """Say now and then how far it is."""
    if done % 50 == 0:
        print(f"{trial}: {done} of {in_all} frames", file=sys.stderr, flush=True)


def main() -> int:
    """Track every recording found, print a table, write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--data", type=Path, required=True, help="folder with beam.stl and the recordings")
    parser.add_argument("--trial", help="name of one recording (default: all)")
    parser.add_argument("--from-s", type=float, default=-0.1, help="first time in s (default -0.1)")
    parser.add_argument("--to-s", type=float, default=np.inf, help="last time in s (default: the end)")
    parser.add_argument("--every", type=int, default=1, help="take each Nth frame only, but for the replay (default 1)")
    parser.add_argument("--seed", type=int, default=0, help="of the search for contacts (default 0)")
    parser.add_argument("--no-replay", action="store_true", help="leave the replay at the recorded rate out")
    parser.add_argument("--json", type=Path, help="file for the answer")
    options = parser.parse_args()
    mesh = beam_mesh(options.data / "beam.stl")
    print(f"{mesh}; mean errors at {HELD_OUT} in mm", file=sys.stderr)
    pattern = options.trial or "*"
    trials = []
    for path in sorted(options.data.glob(f"{pattern}.csv")):
        row = track(
            mesh, path, options.from_s, options.to_s, options.every, seed=options.seed, replay=not options.no_replay
        )
        trials.append(row)
        for part in ("moving_mm", "rest_mm"):
            if row[part] is not None:
                cells = ", ".join(f"{name} {value:.2f}" for name, value in row[part].items())
                print(f"{row['trial']:14s} {part.removesuffix('_mm'):7s} {cells}")
        if row["replay"] is not None:
            told = row["replay"]
            print(
                f"{row['trial']:14s} at {row['hz']:.0f} Hz: {told['registered']} registered, "
                f"{told['dropped']} dropped, latency {told['latency_median_ms']:.0f} ms, error {told['error_mm']:.2f}"
            )
    if options.json:
        answer = {"schema": "tissuereg.track-beam/1", "held_out": HELD_OUT, "n_nodes": mesh.n_nodes, "trials": trials}
        options.json.write_text(json.dumps(answer, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
