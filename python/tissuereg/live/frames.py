"""Frames of markers from messages: points come all at once, tools one a message; times are this machine's."""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Match
from tissuereg.errors import FormatError
from tissuereg.io.matching import Labels, finder, partners
from tissuereg.io.points import turned
from tissuereg.io.recordings.plus import tool_of
from tissuereg.live.protocol import Message, NamedPlace, points_in, tools_in, transform_in
from tissuereg.live.settings import LiveSettings
from tissuereg.tracking.align import Alignment

#: Types of messages that hold markers.
TAKEN = ("POINT", "TRANSFORM", "TDATA")


class LiveFrame(NamedTuple):
    """Markers of one moment: `places` (n_markers, 3), mm, in the body's frame, NaN where not seen; times in s.

    `time_s` ascends from frame to frame, whatever the sender's clock does; `received_s` is when its last message came.
    """

    time_s: float
    places: FloatArray
    received_s: float


class Intake(NamedTuple):
    """How what comes in becomes places of the body's frame.

    `names`: of the markers; `match`: how senders' names are theirs, as of `read_markers`; `offsets`: place of the
    marker on each tool, mm; `frame`: patient frame of the body, None if its numbers are those of the messages, which
    are RAS; `alignment`: of the tracker's frame to the body's, in place of a patient frame.
    """

    names: Sequence[str]
    match: Match = "label"
    offsets: Mapping[str, FloatArray] = {}
    frame: str | None = None
    alignment: Alignment | None = None

    def places(self, sent: FloatArray) -> FloatArray:
        """Return places (n, 3), mm, in the body's frame."""
        return turned(sent, "RAS", self.frame) if self.alignment is None else self.alignment.apply(sent)


class Gathering:
    """Makes frames of messages: one a POINT, and one of tools until all were there, one comes again, or time is up."""

    def __init__(self, intake: Intake, settings: LiveSettings) -> None:
        self.unknown: dict[str, None] = {}
        self.late = self.resets = 0
        self._intake, self._settings = intake, settings
        self._row = finder(Labels("the reference", intake.names), "label" if intake.match == "order" else intake.match)
        self._device: dict[int, str] = {}
        self._pending: dict[int, FloatArray] = {}
        self._sent_s, self._since, self._received_s = 0.0, 0.0, 0.0
        self._offset, self._last = math.nan, -math.inf

    def take(self, message: Message, now: float) -> list[LiveFrame]:
        """Return the frames that a message completes, none or more; `now`: this machine's clock, s.

        Raises `FormatError` if its content is none of its type.
        """
        sent_s, type_ = message.header.time_s, message.header.type
        if type_ == "POINT":
            rows = self._of_points(points_in(message.content))
            return [*self.flush(now, always=True), *self._framed(rows, sent_s, now)] if rows else []
        tools = (
            tools_in(message.content) if type_ == "TDATA" else {message.header.device: transform_in(message.content)}
        )
        seen = all(
            value.upper() in ("OK", "VALID", "1", "TRUE")
            for key, value in message.metadata.items()
            if key.lower() == "status" or key.lower().endswith("transformstatus")
        )
        found: list[LiveFrame] = []
        for device, pose in tools.items():
            row = self._tool(device)
            if row is None:
                self._note_stranger(device)
                continue
            if row in self._pending:
                found += self.flush(now, always=True)
            if not self._pending:
                self._since, self._sent_s = now, sent_s
            offset = self._intake.offsets.get(self._intake.names[row], np.zeros(3))
            with np.errstate(invalid="ignore", over="ignore"):
                turn = pose[:3, :3]
                rigid = np.abs(turn @ turn.T - np.eye(3)).max() < self._settings.skew and np.linalg.det(turn) > 0.0
                self._pending[row] = turn @ offset + pose[:3, 3] if seen and rigid else np.full(3, np.nan)
            self._received_s = now
        if len(self._pending) == len(self._intake.names):
            found += self.flush(now, always=True)
        return found

    def flush(self, now: float, *, always: bool = False) -> list[LiveFrame]:
        """Return the frame of the tools that wait, if they have waited long enough, or `always`."""
        if not self._pending or not (always or now - self._since >= self._settings.gather_s):
            return []
        rows, self._pending = self._pending, {}
        return self._framed(rows, self._sent_s, self._received_s)

    @property
    def waits(self) -> bool:
        """Whether tools wait for the rest of their frame."""
        return bool(self._pending)

    def _framed(self, rows: Mapping[int, FloatArray], sent_s: float, now: float) -> list[LiveFrame]:
        time_s = self._time(sent_s, now)
        if time_s is None:
            return []
        places = np.full((len(self._intake.names), 3), np.nan)
        for row, place in rows.items():
            places[row] = place
        with np.errstate(invalid="ignore", over="ignore"):
            found = self._intake.places(places)
            seen = np.asarray((np.abs(found) < self._settings.farthest_mm).all(axis=1))
        return [LiveFrame(time_s, np.where(seen[:, None], found, np.nan), now)]

    def _time(self, sent_s: float, now: float) -> float | None:
        """Return a frame's time on this machine's clock, s, later than the last one's; None if it is not later.

        A sender's clock gives the time between frames. It is set by the first frame, and anew where it is off by more
        than `jump_s`; where none is stated, the time of arrival counts.
        """
        if sent_s > 0.0:
            if math.isnan(self._offset) or abs(sent_s + self._offset - now) > self._settings.jump_s:
                self.resets += not math.isnan(self._offset)
                self._offset = now - sent_s
            time_s = sent_s + self._offset
        else:
            time_s = now
        if time_s <= self._last:
            time_s = now if now > self._last else math.nan
        if math.isnan(time_s):
            self.late += 1
            return None
        self._last = time_s
        return time_s

    def _of_points(self, points: Sequence[NamedPlace]) -> dict[int, FloatArray]:
        """Return the places of markers by their numbers; raise `FormatError` where it is not clear which they are."""
        names = self._intake.names
        if self._intake.match == "order" and len(points) != len(names):
            message = f"points that are joined by order must be as many as the markers, {len(names)}; got {len(points)}"
            raise FormatError(message, where="POINT")
        rows: dict[int, FloatArray] = {}
        for i, one in enumerate(points):
            row = i if self._intake.match == "order" else self._row(one.name)
            if row in rows:
                message = f"each marker must stand once in a message, got '{names[row]}' again by '{one.name}'"
                raise FormatError(message, where="POINT")
            if row is None:
                self._note_stranger(one.name)
            else:
                rows[row] = one.place
        return rows

    def _tool(self, device: str) -> int | None:
        """Return the number of the marker on a tool by the name of its transform; None if it is none."""
        row = self._row(tool_of(device))
        if row is None:
            return self._row(device)
        if self._device.setdefault(row, device) != device:
            self._device[row] = ""  # several transforms of a tool are in several frames: none of them is taken
            return self._intake.names.index(device) if device in self._intake.names else None
        return row

    def _note_stranger(self, name: str) -> None:
        if len(self.unknown) < self._settings.most_names:
            self.unknown[name] = None


def check_intake(intake: Intake) -> None:
    """Raise `FormatError` where the names of markers cannot be joined as `intake.match` says."""
    partners(
        Labels("the reference", intake.names), Labels("", []), "label" if intake.match == "order" else intake.match
    )
    strangers = [name for name in intake.offsets if name not in intake.names]
    if strangers:
        message = f"an offset must be of a marker ({', '.join(intake.names[:8])} ...), got '{strangers[0]}'"
        raise FormatError(message, where="offsets")
