"""The command ``tissuereg track``: registers a body frame after frame, from mesh and a recording of its markers."""

import argparse
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from tissuereg.cli.body_input import (
    add_belief_options,
    add_body_options,
    add_match_option,
    add_method_options,
    beliefs_of,
    believed_body,
    method_of,
    read_tracked_body,
)
from tissuereg.cli.common import UNTRUSTED, Outcome, Stopwatch, ended_by_signals, note, seconds_line
from tissuereg.cli.options import Help, Parser, refuse, refuse_overwriting
from tissuereg.cli.progress import progress_bar
from tissuereg.cli.recording_input import add_recording_options, read_recorded, read_replayed, warm_up
from tissuereg.report.words import at_time, counted, target_line

if TYPE_CHECKING:
    from tissuereg._base.arrays import FloatArray
    from tissuereg.body.mesh import Mesh
    from tissuereg.errors import TissueRegError
    from tissuereg.io.recordings import Recording
    from tissuereg.report.tracked import Film
    from tissuereg.tracking import Alignment, TablePhysics, TrackedFrame, Tracker

HELP = Help(
    "Registers a body frame after frame: each frame starts from the registered state of the last one. Input: "
    "MESH, as of 'register'; MARKERS (csv: time_s,marker,x_mm,y_mm,z_mm, in the order of time; a marker without a "
    "row, or with empty cells, was not seen; or what a tracker exports: Motive, NDI, PLUS, .c3d, .trc, any table with "
    "--columns); and --reference, where the markers sit on the undeformed body (csv: "
    "marker,x_mm,y_mm,z_mm[,std_mm], or points of 3D Slicer). Every frame is registered, as fast as possible; with "
    "--live the recording is replayed at its own rate, and frames that come too fast are dropped for the newest one. "
    "A frame in which no marker was seen is left out. In place of MARKERS, --replay registers what 'live' recorded, "
    "and tells whether every answer is the one that was given then. DIR gets targets.csv and track.json, with --fields "
    "fields.npz, with --report report.html, all or none. Ctrl-C ends it after the frame in hand, and what was "
    "registered is written. Exit code 0: nothing speaks against any frame; 4: written, but some frames are not to be "
    "trusted, could not be registered, or differ from those replayed; 130: written, up to an interrupt; 2: bad usage "
    "or input; 3: no frame could be registered.",
    example=(
        "tissuereg track breast.vtu recording.csv --reference markers.csv --out tracked\n"
        "tissuereg track breast.vtu motive.csv --reference sit.csv --align first --live --out tracked"
    ),
    seed="seed of all random numbers (default: 0)",
)

_TARGETS, _ANSWER, _FIELDS, _PAGE = "targets.csv", "track.json", "fields.npz", "report.html"


def options(parser: Parser) -> None:
    """Add the arguments of ``tissuereg track`` to its parser."""
    parser.add_argument("path", metavar="MESH", help="mesh file")
    parser.add_argument("recording", metavar="MARKERS", nargs="?", help="recording of the markers, frame after frame")
    parser.add_argument(
        "--reference", required=True, metavar="FILE", help="where the markers sit on the undeformed body"
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder for the results")
    parser.add_argument("--live", action="store_true", help="replay at the recorded rate (default: every frame)")
    text = "recording of 'live', in place of MARKERS: the frames that it registered, and are the answers the same?"
    parser.add_argument("--replay", metavar="FILE", help=text)
    text = "write fields.npz too: times_s (k,), displacement_mm (k, n, 3) of the frames, and the mesh"
    parser.add_argument("--fields", action="store_true", help=text)
    text = "write report.html too: targets over time, markers used and lost, the body to turn at any moment"
    parser.add_argument("--report", action="store_true", help=text)
    more = parser.add_argument_group("more input")
    text = "times_s (k,), displacement_mm (k, n, 3), predicted by any simulator; linear in time between them"
    more.add_argument("--simulations", metavar="U.npz", help=text)
    add_match_option(more, "--reference and MARKERS")
    add_recording_options(parser.add_argument_group("recordings of trackers"))
    add_body_options(more, "MARKERS, --reference and --targets")
    add_belief_options(parser.add_argument_group("what is believed"))
    add_method_options(parser.add_argument_group("method"))


def run(args: argparse.Namespace) -> Outcome:
    """Run ``tissuereg track`` and write the result; JSON schema ``tissuereg.track/1``.

    The exit code is 4 if a frame is not trusted or not registered. If no frame can be registered, the error of the
    first one is raised.
    """
    from tissuereg.io.atomic import check_folder_target
    from tissuereg.report.tracked import Film, events_of

    if (args.recording is None) == (args.replay is None):
        refuse("MARKERS or --replay must be given: one of them", "--replay")
    pairs = None if args.align in (None, "first") else args.align
    inputs = [args.path, args.recording, args.replay, args.reference, args.simulations, args.targets, pairs]
    refuse_overwriting([Path(args.out) / name for name in (_TARGETS, _ANSWER, _FIELDS, _PAGE)], inputs)
    check_folder_target(args.out)
    clock = Stopwatch()
    tracker, recording, simulations, alignment = _read(args)
    clock.lap("read")
    if args.replay is not None:
        warm_up(tracker)  # as 'live' does
    elif args.live:
        _warm_up(tracker, recording, simulations)
    clock.lap("prepare")
    tracked = _Tracked(
        keeps_fields=args.fields, film=Film() if args.report else None, digests=None if args.replay is None else {}
    )
    with progress_bar("frames", quiet=args.quiet) as progress, ended_by_signals() as ended:
        for frame in _answers(tracker, _recorded(recording, simulations, ended), args, tracked.failed, ended):
            tracked.add(frame)
            if progress is not None:
                progress(len(tracked.frames) + len(tracked.failures) + tracker.dropped, len(recording))
    spent = clock.lap("track")
    if not tracked.frames and (ended() or not tracked.errors):
        raise KeyboardInterrupt
    if not tracked.frames:
        raise tracked.errors[0]
    content = {
        "schema": "tissuereg.track/1",
        "seed": args.seed or 0,
        "live": args.live,
        "frames": tracked.frames,
        "failed": tracked.failures,
        "interrupted": ended(),
        "events": events_of(tracked.frames, tracked.failures),
        "recording": _described(recording),
        "replay": tracked.compared(recording),
        "alignment": None if alignment is None else alignment.to_json(),
        "hz": len(tracked.frames) / spent,
        "dropped_frames": tracker.dropped,
        "provenance": tracked.provenance,
    }
    seconds = clock.seconds
    _write(Path(args.out), {**content, "seconds": seconds}, tracked, tracker.registrar.mesh)
    clock.lap("write")
    content["seconds"] = clock.seconds
    same = content["replay"] is None or not content["replay"]["different_s"]
    code = 130 if content["interrupted"] else 0 if tracked.all_trusted and same else UNTRUSTED
    return Outcome(content, _summary(content, args.out, verbose=args.verbose), args.threads, code)


def _read(args: argparse.Namespace) -> "tuple[Tracker, Recording, TablePhysics | None, Alignment | None]":
    from tissuereg.io.tables import read_reference, read_targets
    from tissuereg.registration.registrar import Registrar
    from tissuereg.tracking import Tracker
    from tissuereg.tracking.align import another_frame

    material, load = beliefs_of(args, "--simulations")
    mesh, frames = read_tracked_body(args)
    markers = read_reference(args.reference, args.std, **frames)
    alignment = None
    if args.replay is not None:
        recording = read_replayed(args, markers)
    else:
        recording, markers, alignment = read_recorded(args, markers, frames)
    if args.replay is None and (why := another_frame(recording.places, markers.reference, mesh.extent)):
        refuse(f"{why}; say --align first, --align PAIRS.csv, or --unit", "--align")
    targets = None if args.targets is None else read_targets(args.targets, **frames)
    simulations = None if args.simulations is None else _simulations(args, mesh.n_nodes, recording)
    body = believed_body(args, mesh, material)
    registrar = Registrar(body, markers, targets=targets, load=load, **method_of(args))
    return Tracker(registrar, simulator=simulations), recording, simulations, alignment


def _described(recording: "Recording") -> dict[str, Any]:
    """Return what is told of how a recording was read; its notes go to standard error too."""
    for text in recording.notes:
        note(text)
    clock = [{"frame": one.frame, "time_s": one.time_s, "kind": one.kind} for one in recording.clock]
    return {"format": recording.format, "up": recording.up, "clock": clock, "notes": list(recording.notes)}


def _simulations(args: argparse.Namespace, n_nodes: int, recording: "Recording") -> "TablePhysics":
    from tissuereg.errors import FormatError
    from tissuereg.io.problems import read_simulations
    from tissuereg.tracking import TablePhysics

    times, fields = read_simulations(args.simulations, n_nodes)
    first, last = recording.times[0], recording.times[-1]
    if not times[0] <= first <= last <= times[-1]:
        message = (
            f"the times of {args.simulations} must cover the recording, from {first:g} to {last:g} s; they go from "
            f"{times[0]:g} to {times[-1]:g} s"
        )
        raise FormatError(message, where=args.simulations)
    return TablePhysics(times, fields)


def _recorded(
    recording: "Recording", simulations: "TablePhysics | None", ended: Callable[[], bool] = lambda: False
) -> "Iterator[tuple[float, FloatArray, float | None]]":
    """Yield time, s, marker places (n_markers, 3), mm, and actuator state (the time; None without simulations).

    `ended`: says whether the user asked for the end.
    """
    for time_s, measured in recording:
        if ended():
            return
        yield time_s, measured, None if simulations is None else time_s


def _warm_up(tracker: "Tracker", recording: "Recording", simulations: "TablePhysics | None") -> None:
    """Register one frame and reset the tracker, so that one-time preparations do not delay a replay."""
    from tissuereg.tracking.tracker import CANNOT_BE_REGISTERED

    time_s, measured, actuator = next(_recorded(recording, simulations))
    with suppress(*CANNOT_BE_REGISTERED):
        tracker.step(measured, time_s, actuator=actuator)
    tracker.reset()


def _answers(
    tracker: "Tracker",
    recorded: Any,
    args: argparse.Namespace,
    failed: "Callable[[float, TissueRegError], None]",
    ended: Callable[[], bool],
) -> "Iterator[TrackedFrame]":
    from tissuereg.errors import TissueRegError
    from tissuereg.tracking.tracker import CANNOT_BE_REGISTERED

    def wait(seconds: float) -> None:
        end = time.perf_counter() + seconds
        while not ended() and (left := end - time.perf_counter()) > 0.0:
            time.sleep(min(left, 0.1))

    if args.live:
        yield from tracker.run(recorded, failed=failed, wait=wait)
        return
    # A live registration goes on after every error.
    caught = CANNOT_BE_REGISTERED if args.replay is None else (TissueRegError,)
    for time_s, measured, actuator in recorded:
        try:
            tracker.step(measured, time_s, actuator=actuator)
        except caught as error:
            failed(time_s, error)
        else:
            if tracker.last is not None:
                yield tracker.last


@dataclass
class _Tracked:
    """Results of all frames in the form in which they are written: answers, failures, errors, displacement fields.

    `frames`, `failures`: JSON content per registered and per failed frame; `errors`: exceptions of failed frames;
    `provenance`: that of the last frame, which knows all files and warnings so far;
    `fields`: displacement (n_nodes, 3) in mm per registered frame, only if `keeps_fields`; `film`: for the page, if one
    is wanted; `digests`: of the answers, by the frame's time, ``failed`` where there is none; None if nobody compares.
    """

    keeps_fields: bool
    film: "Film | None" = None
    digests: "dict[float, str] | None" = None
    frames: list[dict[str, Any]] = field(default_factory=list)
    failures: list[dict[str, Any]] = field(default_factory=list)
    errors: "list[TissueRegError]" = field(default_factory=list)
    provenance: dict[str, Any] = field(default_factory=dict)
    fields: "list[FloatArray]" = field(default_factory=list)

    def add(self, frame: "TrackedFrame") -> None:
        result = frame.registration
        trust = result.trust
        self.provenance = result.provenance.to_json(result.given)
        self.frames.append(
            {
                "time_s": frame.time_s,
                "targets": {name: target.to_json() for name, target in result.targets.items()},
                "markers_rms_mm": result.markers.after_rms_mm,
                "markers_used": len(result.markers.used),
                "dropped": [{"marker": name, "reason": reason} for name, reason in result.markers.dropped],
                "trust": {"ok": trust.ok, "p_value": trust.p_value, "reasons": list(trust.reasons)},
                "latency_ms": 1e3 * frame.latency_s,
                "skipped": frame.skipped,
            }
        )
        if self.keeps_fields:
            self.fields.append(result.displacement)
        if self.film is not None:
            self.film.add(frame)
        if self.digests is not None:
            from tissuereg.live.answers import answer_digest

            self.digests[frame.time_s] = answer_digest(result, frame.time_s)

    def compared(self, recording: "Recording") -> dict[str, Any] | None:
        """Return how many answers there are to compare with those of a live run, and the times of those that differ."""
        if self.digests is None:
            return None
        answers = recording.answers or ("",) * len(recording)
        given = {time_s: one for time_s, one in zip(recording.times.tolist(), answers, strict=True) if one}
        pairs = [(time_s, one == given[time_s]) for time_s, one in self.digests.items() if time_s in given]
        return {"compared": len(pairs), "different_s": [time_s for time_s, same in pairs if not same]}

    def failed(self, time_s: float, error: "TissueRegError") -> None:
        if self.digests is not None:
            self.digests[time_s] = "failed"
        self.failures.append({"time_s": time_s, "reason": str(error)})
        self.errors.append(error)

    @property
    def all_trusted(self) -> bool:
        return not self.failures and all(frame["trust"]["ok"] for frame in self.frames)


def _write(out: Path, content: dict[str, Any], tracked: _Tracked, mesh: "Mesh") -> None:
    """Write the files ``track.json`` and ``targets.csv``, on request ``fields.npz`` and a page, all or none."""
    from tissuereg.io.atomic import atomic_folder
    from tissuereg.io.json import write_json
    from tissuereg.io.problems import write_simulations
    from tissuereg.io.tables import write_tracked_targets
    from tissuereg.report.tracked import tracked_page

    with atomic_folder(out) as draft:
        write_json(draft / _ANSWER, content)
        write_tracked_targets(draft / _TARGETS, [(frame["time_s"], frame["targets"]) for frame in tracked.frames])
        if tracked.keeps_fields:
            write_simulations(draft / _FIELDS, [one["time_s"] for one in tracked.frames], tracked.fields, mesh)
        if tracked.film is not None:
            (draft / _PAGE).write_text(tracked_page(tracked.film, content), encoding="utf-8")


def _summary(content: dict[str, Any], out: str, *, verbose: bool) -> str:
    """Return the content of ``track.json`` as text; the last line states whether a frame is not to be trusted."""
    import numpy as np

    from tissuereg.report.tracked import KEPT, event_line

    frames, failed = content["frames"], content["failed"]
    told = [event for event in content["events"] if event["what"] == "not used"]
    latency = [frame["latency_ms"] for frame in frames]
    rms = np.median([frame["markers_rms_mm"] for frame in frames])
    last = frames[-1]
    return "\n".join(
        [
            f"{counted(len(frames), 'frame')} registered, {content['dropped_frames']} dropped, {len(failed)} failed, "
            f"{content['hz']:.1f} a second",
            f"latency: median {np.median(latency):.0f} ms, 99 % {np.percentile(latency, 99):.0f} ms",
            f"rms distance to the markers: median {rms:.3f} mm",
            *(
                target_line(name, target, f" at {at_time(last['time_s'])} s")
                for name, target in last["targets"].items()
            ),
            seconds_line(content["seconds"], verbose=verbose),
            f"written: {out}",
            *_replay_lines(content["replay"]),
            *(["Interrupted: the frames after the last one are not registered."] if content["interrupted"] else []),
            *(event_line(event) for event in told[: KEPT.lines]),
            *([f"and {len(told) - KEPT.lines} more, see track.json"] if len(told) > KEPT.lines else []),
            *([f"not registered at {at_time(failed[0]['time_s'])} s: {failed[0]['reason']}"] if failed else []),
            *_frames_verdict(frames),
        ]
    )


def _replay_lines(replay: dict[str, Any] | None) -> list[str]:
    if replay is None:
        return []
    count, different = replay["compared"], replay["different_s"]
    if not count:
        return ["replayed: the recording holds no answer to compare with"]
    if not different:
        return [f"replayed: {count} answers compared, each the one that was given live, to the last bit"]
    return [
        f"replayed: {len(different)} of {count} answers are not those that were given live, the first at "
        f"{at_time(different[0])} s: is it the same mesh, reference, options, version and machine?"
    ]


def _frames_verdict(frames: list[dict[str, Any]]) -> list[str]:
    doubted = [frame for frame in frames if not frame["trust"]["ok"]]
    if not doubted:
        return ["Nothing speaks against any frame."]
    first = doubted[0]
    return [
        f"at {at_time(first['time_s'])} s: {first['trust']['reasons'][0]}",
        f"Not to be trusted: {len(doubted)} of {len(frames)} frames.",
    ]
