"""Sequences of the PLUS toolkit (.igs.mha, .seq.mha, .igs.nrrd): poses of tools in the header of an image file.

A transform ``ToolToTracker`` takes the tool's coordinates to the tracker's. Its status does not tell whether it was
measured anew: trackers repeat the last pose and call it OK, so a pose that repeats the one before to the last digit
counts as not seen.
"""

import re
from pathlib import Path

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.bounds import FILES, bounded_stream
from tissuereg.io.recordings.tracks import (
    HowRead,
    Tracks,
    check_room,
    is_place,
    offset_notes,
    tool_places,
    without_repeats,
)

_ENTRY = re.compile(rb"Seq_Frame(\d{1,12})_(\w+?)\s*:?=\s*(.*)")
_TRANSFORM = "Transform"


def is_plus(head: bytes) -> bool:
    """Return whether a file begins as a MetaImage or NRRD header."""
    return head.startswith((b"ObjectType", b"NDims", b"NRRD000"))


def read_plus(file: Path, how: HowRead) -> Tracks:
    """Return the tools of a sequence as markers at their origins, or at their offsets."""
    entries = _entries(file)
    frames = sorted({frame for frame, _ in entries})
    transforms = sorted({key.removesuffix(_TRANSFORM) for _, key in entries if key.endswith(_TRANSFORM)})
    if not transforms:
        message = f"{file} must hold transforms of tools (Seq_Frame0000_ToolToTrackerTransform), it has none"
        raise FormatError(message, where=str(file))
    if any(key == "Timestamp" for _, key in entries):
        times = np.array([_numbers(file, frame, "Timestamp", entries, 1)[0] for frame in frames])
    else:
        times = how.times_of(np.array(frames, float), file, "its rate")
    check_room(len(frames), 16 * len(transforms), file)
    names = _tools(transforms)
    notes = offset_notes(names, how.offsets)
    if len({one.removeprefix(tool_of(one)) for one in transforms}) > 1:
        notes.append(f"places are in the frames that the transforms end in, which differ: {', '.join(transforms)}")
    places = []
    for name, transform in zip(names, transforms, strict=True):
        found, told = _track(file, frames, transform, entries)
        places.append(tool_places(found[:, :3, :3], found[:, :3, 3], how.offsets.get(name)))
        notes += [f"{name}: {words}" for words in told]
    return Tracks("PLUS sequence", times, names, np.stack(places, axis=1), notes=notes)


def tool_of(transform: str) -> str:
    """Return the tool of a transform's name: ``Stylus`` of ``StylusToTracker``; the whole name if it is no such one."""
    found = re.fullmatch(r"(.+)To[A-Z]\w*", transform)
    return found[1] if found else transform


def _tools(transforms: list[str]) -> list[str]:
    """Return a name for each transform: its tool's, or its own where a tool has several."""
    tools = [tool_of(one) for one in transforms]
    return [tool if tools.count(tool) == 1 else whole for tool, whole in zip(tools, transforms, strict=True)]


def _entries(file: Path) -> dict[tuple[int, str], str]:
    """Return the entries of all frames in the header, by the frame's number and the key."""
    found: dict[tuple[int, str], str] = {}
    with bounded_stream(file, FILES.recording_mb) as stream:
        for line in stream:
            if line.startswith(b"ElementDataFile") or not line.strip():
                break
            entry = _ENTRY.match(line)
            if entry:
                found[int(entry[1]), entry[2].decode()] = entry[3].decode("utf-8", "replace").strip()
    return found


def _track(
    file: Path, frames: list[int], transform: str, entries: dict[tuple[int, str], str]
) -> tuple[FloatArray, list[str]]:
    """Return the poses of a tool (n_frames, 4, 4), NaN where it was not seen, and what a user should know of it."""
    poses = np.full((len(frames), 16), np.nan)
    invalid = 0
    for k, frame in enumerate(frames):
        status = entries.get((frame, f"{transform}{_TRANSFORM}Status"), "OK")
        if status.upper() != "OK":
            invalid += 1
        elif (frame, transform + _TRANSFORM) in entries:
            poses[k] = _numbers(file, frame, transform + _TRANSFORM, entries, 16)
    poses, repeated = without_repeats(poses)
    told = [f"{invalid} frames have another status than OK"] if invalid else []
    if repeated:
        told.append(f"{repeated} poses repeat the one before to the last digit and count as not seen")
    return poses.reshape(-1, 4, 4), told


def _numbers(file: Path, frame: int, key: str, entries: dict[tuple[int, str], str], count: int) -> list[float]:
    text = entries.get((frame, key), "")
    try:
        found = [float(word) for word in text.split()]
    except ValueError:
        found = []
    if len(found) != count or not is_place(np.array(found)).all():
        message = f"Seq_Frame{frame:04d}_{key} of {file} must be {count} finite numbers, got '{text[:60]}'"
        raise FormatError(message, where=f"{file}: Seq_Frame{frame:04d}_{key}")
    return found
