"""An hour of frames through the sockets of ``tissuereg live``, and broken messages -> archive/, RESULTS-live.md.

    python -m tracking.soak [--minutes M] [--hz F]
    python -m tracking.soak --latency [--minutes M] [--hz F]
    python -m tracking.soak --fuzz [--messages N]
    python -m tracking.soak --page

``--latency`` sends the same frames for some minutes and keeps what they took, for a machine that does little else.

The server is a process of its own, as a user starts it, on the small phantom with the network of the tests; it records
what it gets. A tracker sends all markers in a POINT and reads every answer; viewers read too: a new one comes twice a
minute, and where eight peers are there the oldest gives way, since it sends nothing. Archive and page are written again
every minute, so that a run that is stopped leaves what it measured.
"""

import argparse
import contextlib
import json
import os
import re
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil

import tissuereg as tr
from common import REPOSITORY, commit, read_archive, write_archive
from tissuereg._base.arrays import FloatArray
from tissuereg._base.machine import machine, versions
from tissuereg.io.meshes import write_vtu
from tissuereg.live.protocol import (
    HEADER_BYTES,
    NamedPlace,
    crc64,
    header_of,
    message_of,
    packed,
    points_packed,
    surface_in,
    text_in,
    tools_packed,
    transform_packed,
)

HERE = Path(__file__).resolve().parent
SOAK, SOAK_TABLES = HERE / "archive" / "soak", ("minutes/#",)
LATENCY, FUZZ = HERE / "archive" / "latency", HERE / "archive" / "fuzz"
PAGE = HERE / "RESULTS-live.md"
MODEL = REPOSITORY / "tests" / "data" / "small-model"

#: Where the package lies that this module has imported: the process takes no other one.
_PACKAGE = str(Path(tr.__file__).parents[1])

#: Noise of the markers, mm; share of them that a frame lacks; seconds of a breath, and between two viewers.
STD_MM, LOST, BREATH_S, VISIT_S = 0.1, 0.02, 4.0, 30.0
#: Minutes that are left out of what is said of memory: caches fill, and what is imported late.
SETTLED = 5
#: Frames of the recording that are replayed at the end.
REPLAYED = 1000


class Live:
    """The command ``tissuereg live`` in a process of its own, on the small phantom."""

    def __init__(self, folder: Path, *more: Any) -> None:
        body = tr.phantom.phantom_mesh("small")
        held = np.setdiff1d(body.surface_nodes, body.fixed_nodes)[::40]
        self.places = body.nodes[held]
        self.names = [f"P{i + 1}" for i in range(len(held))]
        write_vtu(folder / "body.vtu", body)
        rows = [f"{name},{x},{y},{z}\n" for name, (x, y, z) in zip(self.names, self.places.tolist(), strict=True)]
        (folder / "sit.csv").write_text("marker,x_mm,y_mm,z_mm\n" + "".join(rows), "utf-8")
        (folder / "targets.csv").write_text("target,x_mm,y_mm,z_mm\nlesion,5,5,20\n", "utf-8")
        self._given = ["--reference", "sit.csv", "--targets", "targets.csv", "--model", MODEL, "--frame", "RAS"]
        words = ["live", "body.vtu", *self._given, "--listen", "127.0.0.1:0", "--json", "said.json", *more]
        self.folder = folder
        self._environment = os.environ | {"TISSUEREG_CACHE": str(folder / "cache"), "PYTHONPATH": _PACKAGE}
        self.process = subprocess.Popen(
            [sys.executable, "-m", "tissuereg", *map(str, words)],
            cwd=folder, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True, env=self._environment,
        )  # fmt: skip
        self.lines: list[str] = []
        self._listening = threading.Event()
        threading.Thread(target=self._read, daemon=True).start()
        if not self._listening.wait(180.0):
            raise RuntimeError("\n".join(self.lines))
        self._seen = psutil.Process(self.process.pid)

    def _read(self) -> None:
        assert self.process.stderr is not None
        for line in self.process.stderr:
            self.lines = [*self.lines[-50:], line.rstrip()]
            found = re.search(r"listening on (\S+):(\d+)", line)
            if found:
                self.address = found[1], int(found[2])
                self._listening.set()

    def used(self) -> dict[str, Any]:
        """Return the memory of the process, MB, its open files and sockets, its threads, and its processor seconds."""
        spent = self._seen.cpu_times()
        return {
            "rss_mb": self._seen.memory_info().rss / 1e6,
            "fds": self._seen.num_fds(),
            "threads": self._seen.num_threads(),
            "cpu_s": spent.user + spent.system,
        }

    def replayed(self, file: str) -> dict[str, Any]:
        """Return what ``track --replay`` says of the first frames of a recording: how many compared, and differ."""
        lines = (self.folder / file).read_text("utf-8").splitlines(keepends=True)
        (self.folder / "first.csv").write_text("".join(lines[: 1 + REPLAYED * len(self.names)]), "utf-8")
        words = ["track", "body.vtu", "--replay", "first.csv", *self._given, "--out", "again", "--quiet"]
        done = subprocess.run(
            [sys.executable, "-m", "tissuereg", *map(str, words)],
            cwd=self.folder, env=self._environment, capture_output=True, text=True, check=False,
        )  # fmt: skip
        if done.returncode not in (0, 4):
            raise RuntimeError(done.stderr)
        found: dict[str, Any] = json.loads((self.folder / "again" / "track.json").read_text("utf-8"))["replay"]
        return {"compared": found["compared"], "different": len(found["different_s"])}

    def __enter__(self) -> "Live":
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()

    def connect(self) -> socket.socket:
        """Return a connection to it."""
        made = socket.create_connection(self.address, timeout=60.0)
        made.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        return made

    def end(self) -> dict[str, Any]:
        """End it, as Ctrl-C does, and return what it says at the end."""
        self.process.terminate()  # a process in the background of a shell ignores interrupts
        code = self.process.wait(120.0)
        said: dict[str, Any] = json.loads((self.folder / "said.json").read_text("utf-8"))
        return {**said, "exit_code": code}


def frame_of(live: Live, places: FloatArray, time_s: float) -> bytes:
    """Return the POINT message of places, NaN where a marker is lost."""
    points = [NamedPlace(name, one, 0.0) for name, one in zip(live.names, places, strict=True) if np.isfinite(one[0])]
    return packed("POINT", "Markers", points_packed(points, "marker", (255, 0, 0, 255)), time_s)


def message_from(stream: Any) -> tuple[Any, bytes, float]:
    """Return header and body of the next message, and when it had come, s."""
    header = header_of(_exactly(stream, HEADER_BYTES))
    body = _exactly(stream, header.size)
    return header, body, time.perf_counter()


def _exactly(stream: Any, count: int) -> bytes:
    found = stream.read(count)
    if len(found) < count:
        raise EOFError
    return bytes(found)


class Ear:
    """Reads all that comes over a connection, and keeps of each answer when its targets came and what it says."""

    def __init__(self, made: socket.socket) -> None:
        self.answers: list[tuple[float, dict[str, Any]]] = []
        self.bytes = self.surfaces = 0
        self._stream = made.makefile("rb")
        threading.Thread(target=self._read, daemon=True).start()

    def _read(self) -> None:
        came = 0.0
        with contextlib.suppress(EOFError, OSError, ValueError):
            while True:
                header, body, now = message_from(self._stream)
                self.bytes += HEADER_BYTES + len(body)
                if header.type == "POINT":
                    came = now
                elif header.type == "POLYDATA":
                    self.surfaces += 1
                    if self.surfaces % 1000 == 1:  # now and then in full: it takes longer than a message
                        assert len(surface_in(message_of(header, body).content).points)
                elif header.type == "STRING":
                    said = json.loads(text_in(message_of(header, body).content))
                    if not said["stale"]:
                        self.answers.append((came if said["targets"] else now, said))


def soak(minutes: float, hz: float, folder: Path) -> dict[str, Any]:
    """Send frames for some minutes, write the archive every minute, and return it."""
    answer: dict[str, Any] = {
        "schema": "tissuereg.live-soak/1", "hz": hz, "asked_minutes": minutes, "std_mm": STD_MM, "lost": LOST,
        "load_before": os.getloadavg()[0], "machine": machine(), "versions": versions(), **commit(), "minutes": [],
    }  # fmt: skip
    rng = np.random.default_rng(0)
    with tempfile.TemporaryDirectory() as name, Live(Path(name), "--record", "kept.csv") as live:
        answer |= {"markers": len(live.names), "nodes": tr.phantom.phantom_mesh("small").n_nodes}
        tracker = live.connect()
        ear = Ear(tracker)
        begin, sent, done, visited = time.perf_counter(), list[float](), 0, -VISIT_S
        while (now := time.perf_counter() - begin) < 60.0 * minutes:
            if now - visited >= VISIT_S:
                visited = now
                Ear(live.connect())
            lean = 0.05 * np.sin(2.0 * np.pi * now / BREATH_S) * live.places[:, 2:] * np.array([1.0, 0.3, 0.0])
            places = live.places + lean + STD_MM * rng.standard_normal(live.places.shape)
            places[rng.random(len(places)) < LOST] = np.nan
            data = frame_of(live, places, 1000.0 + len(sent) / hz)
            sent.append(time.perf_counter())
            tracker.sendall(data)
            if now >= 60.0 * (done + 1):
                done += 1
                answer["minutes"].append(_minute(live, ear, sent, hz, now))
                write_archive(folder, answer, SOAK_TABLES)
            time.sleep(max(begin + len(sent) / hz - time.perf_counter(), 0.0))
        time.sleep(2.0)
        answer["minutes"].append(_minute(live, ear, sent, hz, time.perf_counter() - begin))
        answer |= {"sent": len(sent), "seconds": time.perf_counter() - begin, "load_after": os.getloadavg()[0]}
        said = live.end()
        answer["replay"] = live.replayed("kept.csv")
        kept = tr.read_recording(Path(name) / "kept.csv")
        answer["recorded"], answer["recorded_registered"] = len(kept), int(kept.registered.sum())
        answer["said"] = {key: said[key] for key in _SAID}
    write_archive(folder, answer, SOAK_TABLES)
    return answer


_SAID = ("received", "registered", "failed", "untrusted", "dropped", "late", "spoilt", "skipped", "unknown", "peers")
_SAID += ("refused", "displaced", "unsent", "exit_code")


def _minute(live: Live, ear: Ear, sent: list[float], hz: float, now: float) -> dict[str, Any]:
    """Return what a minute measured: latencies of its answers, ms, and what the process uses."""
    answers, ear.answers = ear.answers, []
    total, own, added = [], [], []
    before = 0.0
    for came, said in answers:
        # The server's clock for frames is the sender's, moved once by the first frame.
        if not hasattr(ear, "first_s"):
            ear.first_s = said["time_s"]
        k = round((said["time_s"] - ear.first_s) * hz)
        if 0 <= k < len(sent) and said["step_ms"] is not None:
            total.append(1e3 * (came - sent[k]))
            own.append(said["step_ms"])
            if sent[k] > before:  # it did not wait for the answer to another one
                added.append(total[-1] - own[-1])
        before = came
    row: dict[str, Any] = {"s": now, "sent": len(sent), "answered": len(answers), "matched": len(total)}
    for key, values in (("total", total), ("step", own), ("added", added)):
        row |= {f"{key}_{q}_ms": float(np.percentile(values, q)) if len(values) else None for q in (10, 50, 99)}
        row[f"{key}_max_ms"] = float(np.max(values)) if len(values) else None
    return {**row, **live.used(), "load": os.getloadavg()[0], "read_mb": ear.bytes / 1e6}


# --- broken messages ---


def broken(good: list[bytes], rng: np.random.Generator) -> tuple[str, bytes]:
    """Return a message that is broken in one of several ways, and the way's name."""
    data = bytearray(good[rng.integers(len(good))])
    how = ("bytes", "content", "length", "numbers", "half", "noise", "huge", "extended")[rng.integers(8)]
    if how == "bytes":  # anywhere, its check sum as before
        for at in rng.integers(len(data), size=rng.integers(1, 6)):
            data[at] = rng.integers(256)
    elif how in ("content", "numbers"):  # what it holds, with a check sum that is right
        step = 1 if how == "content" else 4
        for at in HEADER_BYTES + step * rng.integers((len(data) - HEADER_BYTES) // step, size=rng.integers(1, 20)):
            data[at : at + step] = rng.bytes(1) if step == 1 else _WORDS[rng.integers(len(_WORDS))]
    elif how == "length":
        data = data[: HEADER_BYTES + rng.integers(len(data) - HEADER_BYTES)]
    elif how == "half":
        return how, bytes(data[: rng.integers(1, len(data))])
    elif how == "noise":
        return how, rng.bytes(rng.integers(1, 400))
    elif how == "huge":
        data[42:50] = struct.pack(">Q", int(rng.integers(2**20, 2**62)))
        return how, bytes(data)
    else:  # version 2 with parts of any length
        body = struct.pack(">HHII", *rng.integers([20, 70, 70, 9])) + bytes(data[HEADER_BYTES:])
        data = bytearray(struct.pack(">H", 2) + data[2:HEADER_BYTES] + body)
    if how in ("content", "numbers", "length", "extended"):
        data[42:58] = struct.pack(">QQ", len(data) - HEADER_BYTES, crc64(bytes(data[HEADER_BYTES:])))
    return how, bytes(data)


#: NaN, infinity, the largest number, minus zero, the smallest, and words of letters that are no UTF-8.
_WORDS = [bytes.fromhex(word) for word in ("7fc00000", "7f800000", "7f7fffff", "80000000", "00000001", "fffefdfc")]


def fuzz(messages: int) -> dict[str, Any]:
    """Send broken messages, ask for the answer to a good frame after every hundred, and return what came of them."""
    rng, counts = np.random.default_rng(1), dict[str, int]()
    reconnected = answered = 0
    with tempfile.TemporaryDirectory() as name, Live(Path(name)) as live:
        poses = {one: np.eye(4) for one in live.names}
        good = [
            frame_of(live, live.places, 5.0),
            packed("TDATA", "Tracker", tools_packed(poses), 5.0),
            packed("TRANSFORM", "P1ToTracker", transform_packed(np.eye(4)), 5.0, {"TransformStatus": "OK"}),
            packed("STATUS", "x", bytes(30)),
            packed("IMAGE", "x", bytes(500)),
        ]
        friend, foe = live.connect(), live.connect()
        ear = Ear(friend)
        before = live.used()
        begin = time.perf_counter()
        for k in range(messages):
            how, data = broken(good, rng)
            counts[how] = counts.get(how, 0) + 1
            try:
                foe.sendall(data)
                if how in ("half", "noise", "huge", "bytes"):  # what follows would be taken for its rest
                    foe.shutdown(socket.SHUT_WR)
                    while foe.recv(65_536):  # until the other side has taken it in
                        pass
                    raise ConnectionError
            except OSError:
                reconnected += 1
                foe.close()
                foe = live.connect()
            if (k + 1) % 100 == 0:
                answered += _is_answered(live, friend, ear)
            if k + 1 == messages // 10:
                before = live.used()
        after = live.used()
        seconds = time.perf_counter() - begin
        said = live.end()
    return {
        "schema": "tissuereg.live-fuzz/1", "messages": messages, "ways": counts, "connections": reconnected + 2,
        "good_frames": messages // 100, "good_answered": answered, "before": before, "after": after,
        "seconds": seconds, "said": {key: said[key] for key in _SAID}, **commit(), "versions": versions(),
    }  # fmt: skip


def _is_answered(live: Live, friend: socket.socket, ear: Ear, within_s: float = 10.0) -> bool:
    """Return whether a good frame is registered in time.

    It is sent again and again, as a tracker does: a broken stamp may lie up to a second ahead, and frames until then
    come late.
    """
    end = time.perf_counter() + within_s
    while time.perf_counter() < end:
        friend.sendall(frame_of(live, live.places, 0.0))
        again = time.perf_counter() + 0.25
        while time.perf_counter() < again:
            if any(said["markers_used"] == len(live.names) for _, said in ear.answers):
                ear.answers = []
                return True
            time.sleep(0.002)
    return False


# --- the page ---

HEAD = """# Live: an hour through the sockets, and broken messages

Written by `make -C benchmarks/tracking soak latency fuzz` from `archive/`; edit none.
How it works: [live](../../docs/howto/live.md).
"""


SOAK_HEAD = """## Frames

{minutes:.1f} minutes of frames at {hz:g} Hz: {markers} markers with noise of {std_mm} mm in a POINT, {percent:.0f} % of
them lost, of the small phantom ({nodes} nodes, the network of the tests). The tracker and viewers read every answer:
the surface with its spread, the targets, STRING and STATUS. A new viewer comes every {visit:.0f} s; where eight peers
are there, the oldest gives way, since it sends nothing. Every frame is recorded.
"""


def _words(answer: dict[str, Any]) -> dict[str, Any]:
    return {key: answer[key] for key in ("hz", "markers", "std_mm", "nodes")}


def settled(rows: list[dict[str, Any]]) -> tuple[list[dict[str, Any]], float]:
    """Return the rows after the first minutes, and the slope of the memory in them, MB an hour."""
    kept = rows[SETTLED:] if len(rows) > SETTLED + 2 else rows
    hours = np.array([row["s"] for row in kept]) / 3600.0
    slope = float(np.polyfit(hours, [row["rss_mb"] for row in kept], 1)[0]) if len(kept) > 2 else 0.0
    return kept, slope


def soak_section(answer: dict[str, Any]) -> Iterator[str]:
    """Yield the part of the page on the frames."""
    rows = answer["minutes"]
    kept, slope = settled(rows)
    said = answer.get("said")
    yield SOAK_HEAD.format(
        minutes=rows[-1]["s"] / 60.0, percent=100.0 * answer["lost"], visit=VISIT_S, **_words(answer)
    )
    yield "| | |\n|---|---|"
    if said:
        found = [answer["sent"], said["registered"], said["dropped"], said["failed"]]
        yield f"| frames sent; registered; dropped; failed | {'; '.join(map(str, found))} |"
        found = [answer["recorded"], answer["recorded_registered"]]
        yield f"| frames in the recording; of these registered | {'; '.join(map(str, found))} |"
        found = [said["peers"], said["displaced"], said["exit_code"]]
        yield f"| connections; of these gave way; exit code | {'; '.join(map(str, found))} |"
    yield f"| answers read by the tracker | {rows[-1]['read_mb'] / 1e3:.2f} GB |"
    memory = [row["rss_mb"] for row in kept]
    yield (
        f"| memory after {SETTLED} minutes: first; last; least to most | {memory[0]:.1f}; {memory[-1]:.1f}; "
        f"{min(memory):.1f} to {max(memory):.1f} MB |"
    )
    yield f"| its slope | {slope:+.2f} MB an hour |"
    for key, words in (("fds", "open files and sockets"), ("threads", "threads")):
        found = [row[key] for row in kept]
        yield f"| {words}, least to most | {min(found)} to {max(found)} |"
    yield f"| share of a core | {100.0 * rows[-1]['cpu_s'] / rows[-1]['s']:.0f} % |"
    yield from _busy(answer, "frames were dropped for want of a core")


def latency_section(answer: dict[str, Any]) -> Iterator[str]:
    """Yield the part of the page on what frames took."""
    rows = [row for row in answer["minutes"] if row["matched"]]
    yield f"\n## Latency\n\n{rows[-1]['s'] / 60.0:.0f} minutes of the same frames; medians of minutes, ms.\n"
    yield "| | 10 % | median | 99 % |\n|---|---|---|---|"
    for key, words in (
        ("step", "the tracker's own time"),
        ("total", "marker in to target out, through both sockets"),
        ("added", "what the sockets add, of frames that waited for no other"),
    ):
        cells = [f"{np.median([row[f'{key}_{q}_ms'] for row in rows]):.1f}" for q in (10, 50, 99)]
        yield f"| {words} | {' | '.join(cells)} |"
    replay = answer["replay"]
    yield (
        f"\nOf the first {REPLAYED} frames of the recording `track --replay` answered {replay['compared']},\n"
        f"{replay['different']} of them otherwise than they were answered live."
    )
    yield from _busy(answer, "times are too long")


def _busy(answer: dict[str, Any], therefore: str) -> Iterator[str]:
    """Yield a remark where the machine had other work to do."""
    load = np.median([row["load"] for row in answer["minutes"]])
    if load > answer["machine"]["cores"] / 2.0:
        yield f"\nThe machine was busy with other work (load {load:.1f}): {therefore}."


def fuzz_section(answer: dict[str, Any]) -> Iterator[str]:
    """Yield the part of the page on broken messages."""
    said, ways = answer["said"], ", ".join(f"{count} {how}" for how, count in answer["ways"].items())
    yield (
        f"\n## Broken messages\n\n{answer['messages']} messages ({ways})\nover {answer['connections']} connections, in "
        f"{answer['seconds']:.0f} s, and a good frame after every hundred.\n"
    )
    yield "| | |\n|---|---|"
    yield f"| good frames answered | {answer['good_answered']} of {answer['good_frames']} |"
    yield f"| left out; passed over; refused connections | {said['spoilt']}; {said['skipped']}; {said['refused']} |"
    for key, words in (("rss_mb", "memory, MB"), ("fds", "open files and sockets"), ("threads", "threads")):
        yield f"| {words}: after a tenth; at the end | {answer['before'][key]:.0f}; {answer['after'][key]:.0f} |"
    yield f"| exit code | {said['exit_code']} |"


def page() -> str:
    """Return the page of the archives that are there."""
    lines = [HEAD]
    for folder, section in ((SOAK, soak_section), (LATENCY, latency_section), (FUZZ, fuzz_section)):
        if (folder / "run.json").exists():
            lines += section(read_archive(folder))
    return "\n".join(lines) + "\n"


def main() -> None:
    """Run the frames or the broken messages, or write the page again."""
    parser = argparse.ArgumentParser(description="An hour of frames through the sockets, and broken messages.")
    parser.add_argument("--minutes", type=float, help="default: 60, of latencies 5")
    parser.add_argument("--hz", type=float, default=20.0)
    parser.add_argument("--latency", action="store_true", help="what the frames took")
    parser.add_argument("--fuzz", action="store_true", help="broken messages in place of frames")
    parser.add_argument("--messages", type=int, default=10_000)
    parser.add_argument("--page", action="store_true", help="write the page again from the archives")
    given = parser.parse_args()
    if given.fuzz and not given.page:
        write_archive(FUZZ, fuzz(given.messages), ())
    elif given.latency and not given.page:
        soak(given.minutes or 5.0, given.hz, LATENCY)
    elif not given.page:
        soak(given.minutes or 60.0, given.hz, SOAK)
    PAGE.write_text(page(), "utf-8")


if __name__ == "__main__":
    main()
