"""Exports of NDI trackers (Polaris, Vega, Aurora): poses of tools as quaternions, one tool a row or all in one row.

Tables of NDI Track (``Tools,Port 1,Frame,Face,State,Q0,...,Error,Port 2,...``, also with ``Time [sec]`` after Frame)
and of the Combined API's samples (``Frame#,ToolHandle,Face#,TransformStatus,Q0,...,Error,#Markers,...``, also after
``timespec_s,timespec_ns``). Older samples name the columns of one tool alone, and rows hold several.

The error of an optical tracker (Polaris, Vega) is an rms in mm; that of an electromagnetic one (Aurora) is an index of
quality from 0 to 9.9 that is no length. It counts as noise where the file tells that it was optical, nowhere else.
"""

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from tissuereg.errors import FormatError
from tissuereg.io.recordings.tracks import (
    HowRead,
    Tracks,
    check_room,
    number_in,
    offset_notes,
    rotations,
    rows_of,
    tool_places,
)

_POSE = ("q0", "qx", "qy", "qz", "tx", "ty", "tz")
_SEEN = ("", "ok", "valid", "enabled", "tracking")
_HINT = "a Polaris measures 60 a second or fewer, an Aurora 40"


#: Words that tell which of the two a file is of.
_OPTICAL, _MAGNETIC = re.compile(r"polaris|vega|spectra|vicra", re.IGNORECASE), re.compile(r"aurora", re.IGNORECASE)


class _Group(NamedTuple):
    """Columns of one tool: of its pose, error, count of markers, status, frame, time, and its name; -1 for none.

    `repeated`: rows begin with a count of tools, and these are the columns of the first of them.
    """

    pose: int
    error: int
    markers: int
    states: range
    frame: int
    seconds: int
    nanoseconds: int
    handle: int
    title: str
    repeated: bool = False


class _Sample(NamedTuple):
    """One pose: frame (or NaN), time in s (or NaN), tool, pose (7,), and error, NaN where there is none."""

    frame: float
    time_s: float
    tool: str
    pose: list[float]
    error: float


def is_ndi(head: str) -> bool:
    """Return whether a line at the beginning of a file names the columns of such poses."""
    return any(re.search(r"q0,\s*qx,\s*qy,\s*qz,\s*tx,\s*ty,\s*tz", line.lower()) for line in head.splitlines())


def read_ndi(file: Path, how: HowRead) -> Tracks:
    """Return the tools of an export as markers at their origins, or at their offsets; an optical error is the std."""
    samples, shown, optical = _samples(file)
    timed = all(np.isfinite(one.time_s) for one in samples)
    keys = [one.time_s if timed else one.frame for one in samples]
    if not np.isfinite(keys).all():
        message = f"{file} must number its frames (Frame) or give their times (timespec_s, timespec_ns)"
        raise FormatError(message, where=str(file))
    starts = [0, *(i for i in range(1, len(samples)) if shown[i] != shown[i - 1])]
    tools = list(dict.fromkeys(one.tool for one in samples))
    check_room(len(starts), 8 * len(tools), file)
    row = np.searchsorted(starts, np.arange(len(samples)), side="right") - 1
    poses = np.full((len(starts), len(tools), 7), np.nan)
    errors = np.full((len(starts), len(tools)), np.nan)
    for k, one in zip(row, samples, strict=True):
        poses[k, tools.index(one.tool)], errors[k, tools.index(one.tool)] = one.pose, one.error
    moments = np.array([keys[i] for i in starts])
    times = moments if timed else how.times_of(moments, file, _HINT)
    notes = offset_notes(tools, how.offsets)
    seen = np.isfinite(poses[..., 4:]).all(axis=2)
    places = [
        tool_places(rotations(poses[:, i, :4]), poses[:, i, 4:], how.offsets.get(name)) for i, name in enumerate(tools)
    ]
    std = np.where(seen & (errors > 0.0), errors, np.nan)
    if np.isfinite(std).any() and not optical:
        kind = "of an Aurora is" if optical is False else "is taken for what an Aurora's is,"
        notes.append(
            f"the column Error {kind} an index of quality and no length: it is not the noise, which --std says"
            + ("" if optical is False else "; nothing tells that the tracker was optical")
        )
        std = np.full_like(std, np.nan)
    lost = [
        f"{name} was missing or disabled in {int((~seen[:, i]).sum())} of {len(seen)} frames"
        for i, name in enumerate(tools)
        if not seen[:, i].all()
    ]
    return Tracks(
        "NDI CSV",
        times,
        tools,
        np.stack(places, axis=1),
        std if np.isfinite(std).any() else None,
        notes=[*notes, *lost],
    )


def _samples(file: Path) -> tuple[list[_Sample], list[object], bool | None]:
    """Return every pose of a file, and for each what tells the frames apart: the line, or the frame's number.

    And whether the tracker was optical, None if nothing tells: what stands before the poses or names a tool, or a tool
    with markers of its own.
    """
    groups: list[_Group] = []
    samples: list[_Sample] = []
    shown: list[object] = []
    optical: bool | None = None
    for line, cells in rows_of(file):
        if optical is not False:  # one word for an Aurora outweighs what else there is
            words = " ".join(cells)
            optical = False if _MAGNETIC.search(words) else True if _OPTICAL.search(words) else optical
        if not groups:
            groups = _groups(cells)
            continue
        tools = _repeated(cells, groups[0]) if groups[0].repeated else [(group, cells) for group in groups]
        for group, own in tools:
            if all(not cell for cell in own[group.states.start : group.error]):
                continue
            one = _sample(file, line, own, group)
            if optical is None and _n_markers(own, group):
                optical = True
            samples.append(one)
            shown.append(line if len(tools) > 1 else (one.frame, one.time_s))
    if not samples:
        message = f"{file} must hold at least one pose below a line with the columns {', '.join(_POSE)}"
        raise FormatError(message, where=str(file))
    return samples, shown, optical


def _n_markers(cells: list[str], group: _Group) -> int:
    """Return how many markers a line counts of a tool, which optical tools alone have."""
    count = cells[group.markers] if 0 <= group.markers < len(cells) else ""
    return int(count) if count.isascii() and count.isdigit() else 0


def _repeated(cells: list[str], group: _Group) -> list[tuple[_Group, list[str]]]:
    """Return the tools of a line that counts them, the cells of each where the columns of the first one are."""
    found: list[tuple[_Group, list[str]]] = []
    at = 1
    for _ in range(int(cells[0]) if cells[0].isascii() and cells[0].isdigit() else 1):
        own = [cells[0], *cells[at : at + group.markers]]
        lacks = re.search("[a-z]", "".join(own[group.states.start : group.states.start + 1]), re.IGNORECASE) is not None
        if lacks:
            own.insert(group.states.start, "")  # a missing tool may lack the cell of its face
        if len(own) > 1:
            found.append((group, own))
        at += group.markers - lacks + 4 * _n_markers(own, group)
        if at >= len(cells):
            break
    return found


def _groups(cells: list[str]) -> list[_Group]:
    """Return the tools of a line that names the columns; none if it does not."""
    # The samples of the Combined API put remarks before the first name: [alerts] [buttons] Frame#.
    names = [cell.lower().rsplit("] ", 1)[-1] for cell in cells]
    found: list[_Group] = []
    start = 0
    for i in range(len(names)):
        if tuple(names[i : i + 7]) != _POSE:
            continue
        part = names[start:i]
        at = {
            key: next((start + k for k, name in enumerate(part) if name.startswith(words)), -1)
            for key, words in (
                ("frame", ("frame",)),
                ("seconds", ("timespec_s", "time [s")),
                ("nanoseconds", ("timespec_ns",)),
                ("handle", ("toolhandle", "porthandle", "port ", "port")),
            )
        }
        titled = at["handle"] >= 0 and re.fullmatch(r"port \d+", names[at["handle"]])
        title = cells[at["handle"]] if titled else ""
        error = i + 7 if names[i + 7 : i + 8] == ["error"] else -1
        counted = i + 8 if error >= 0 and names[i + 8 : i + 9] in (["#markers"], ["markers"]) else -1
        # A missing tool may lack the cell of its face: its state is then one column earlier.
        first = max(start, at["handle"] + 1, at["frame"] + 1)
        clock = at["seconds"], at["nanoseconds"]
        found.append(_Group(i, error, counted, range(first, i), at["frame"], *clock, at["handle"], title))
        start = i + 8
    if len(found) == 1 and found[0].markers >= 0 and names[0] in ("#tools", "toolcount"):
        return [found[0]._replace(repeated=True)]
    return found


def _sample(file: Path, line: int, cells: list[str], group: _Group) -> _Sample:
    def cell(i: int) -> str:
        return cells[i] if 0 <= i < len(cells) else ""

    def number(i: int) -> float:
        return number_in(cell(i), file, line) if i >= 0 else np.nan

    time_s = number(group.seconds)
    if group.nanoseconds >= 0:
        time_s += 1e-9 * number(group.nanoseconds)
    states = [cell(i).lower() for i in group.states]
    words = [state for state in states if not re.fullmatch(r"[\d.+-]*", state)]
    tool = group.title or cell(group.handle) or "tool"
    if any(word not in _SEEN for word in words):
        return _Sample(number(group.frame), time_s, tool, [np.nan] * 7, np.nan)
    pose = [number(group.pose + i) for i in range(7)]
    pose = pose if np.isfinite(pose[4:]).all() else [np.nan] * 7
    return _Sample(number(group.frame), time_s, tool, pose, number(group.error))
