"""Frames of markers from messages: points come all at once, tools one a message; times are this machine's."""

import math
import re
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import Match
from tissuereg.errors import FormatError, MarkerError
from tissuereg.io.matching import Labels, finder, partners
from tissuereg.io.points import turned
from tissuereg.io.recordings.plus import tool_of
from tissuereg.live.protocol import Message, NamedPlace, points_in, tools_in, transform_in
from tissuereg.live.settings import LiveSettings
from tissuereg.tracking.align import Alignment, rigid_alignment

#: Types of messages that hold markers.
TAKEN = ("POINT", "TRANSFORM", "TDATA")


#: What a status calls a place that was measured; anything else is one that was not.
_MEASURED = ("OK", "VALID", "1", "TRUE")
_STATUS_KEY = re.compile(r"(.*?)[_. ]?(?:transform)?status", re.IGNORECASE)


class LiveFrame(NamedTuple):
    """Markers of one moment: `places` (n_markers, 3), mm, in the body's frame, NaN where not seen; times in s.

    `time_s` ascends from frame to frame, whatever the sender's clock does; `received_s` is when its last message came.
    `sent_as`: what the sender calls each marker, empty where it was not sent; `ready`: whether it can be registered,
    which no frame can before the tracker's frame is aligned.
    """

    time_s: float
    places: FloatArray
    received_s: float
    sent_as: tuple[str, ...] = ()
    ready: bool = True


class FirstFrame(NamedTuple):
    """What the first whole frame is aligned to: `reference` (n_markers, 3), the markers on the undeformed body, mm.

    `std`: standard deviation of a coordinate, mm.
    """

    reference: FloatArray
    std: float = 0.1


class Intake(NamedTuple):
    """How what comes in becomes places of the body's frame.

    `names`: of the markers; `match`: how senders' names are theirs, as of `read_markers`; `offsets`: place of the
    marker on each tool, mm; `frame`: patient frame of the body, None if its numbers are those of the messages, which
    are RAS; `alignment`: of the tracker's frame to the body's, in place of a patient frame, or what the first whole
    frame gives it by; `tools_in`: the one frame into which transforms of tools are taken (``Tracker`` of
    ``P1ToTracker``), None for the one into which all are.
    """

    names: Sequence[str]
    match: Match = "label"
    offsets: Mapping[str, FloatArray] = {}
    frame: str | None = None
    alignment: Alignment | FirstFrame | None = None
    tools_in: str | None = None


class LiveEvent(NamedTuple):
    """What happened that peers should be told: a `name` of a status, and a `text`."""

    name: str
    text: str


class Gathering:
    """Makes frames of messages: one a POINT, and one of tools until all were there, one comes again, or time is up.

    `alignment`: of the tracker's frame, once it is known; `events`: what peers should be told, until it is taken out.
    """

    def __init__(self, intake: Intake, settings: LiveSettings) -> None:
        self.unknown: dict[str, None] = {}
        self.events: list[LiveEvent] = []
        self.late = self.resets = 0
        self.alignment = intake.alignment if isinstance(intake.alignment, Alignment) else None
        self._intake, self._settings = intake, settings
        self._first = intake.alignment if isinstance(intake.alignment, FirstFrame) else None
        self._row = finder(Labels("the reference", intake.names), "label" if intake.match == "order" else intake.match)
        self._into: dict[str, tuple[str, float]] = {}
        self._pending: dict[int, tuple[str, FloatArray]] = {}
        self._sent_s, self._since, self._received_s = 0.0, 0.0, 0.0
        self._offset, self._last = math.nan, -math.inf
        self._told: set[tuple[str, str]] = set()

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
        hidden = _hidden(message.metadata)
        found: list[LiveFrame] = []
        for device, pose in tools.items():
            row = self._tool(device, now)
            if row is None:
                continue
            if row in self._pending:
                found += self.flush(now, always=True)
            if not self._pending:
                self._since, self._sent_s = now, sent_s
            offset = self._intake.offsets.get(self._intake.names[row], np.zeros(3))
            seen = not hidden & {"", device.lower(), tool_of(device).lower()}
            with np.errstate(invalid="ignore", over="ignore"):
                turn = pose[:3, :3]
                rigid = np.abs(turn @ turn.T - np.eye(3)).max() < self._settings.skew and np.linalg.det(turn) > 0.0
                place = turn @ offset + pose[:3, 3] if seen and rigid else np.full(3, np.nan)
            self._pending[row] = device, place
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

    def _framed(self, rows: Mapping[int, tuple[str, FloatArray]], sent_s: float, now: float) -> list[LiveFrame]:
        time_s = self._time(sent_s, now)
        if time_s is None:
            return []
        names = [""] * len(self._intake.names)
        sent = np.full((len(names), 3), np.nan)
        for row, (names[row], place) in rows.items():
            sent[row] = place
        with np.errstate(invalid="ignore", over="ignore"):
            if self._first is not None and self.alignment is None:
                self._align(self._first, sent)
            ready = self._first is None or self.alignment is not None
            found = self._on_body(sent) if ready else np.full_like(sent, np.nan)
            seen = np.asarray((np.abs(found) < self._settings.farthest_mm).all(axis=1))
        return [LiveFrame(time_s, np.where(seen[:, None], found, np.nan), now, tuple(names), ready)]

    def _on_body(self, sent: FloatArray) -> FloatArray:
        """Return places (n, 3), mm, in the body's frame."""
        return turned(sent, "RAS", self._intake.frame) if self.alignment is None else self.alignment.apply(sent)

    def _align(self, first: FirstFrame, sent: FloatArray) -> None:
        """Align the tracker's frame by a frame in which all markers were seen; tell what came of it, once."""
        lost = [name for name, place in zip(self._intake.names, sent, strict=True) if not np.isfinite(place).all()]
        if lost:
            few = ", ".join(lost[:3])
            self._tell("NOT_ALIGNED", f"all markers must be seen once to align the tracker's frame: {few} was not")
            return
        try:
            found = rigid_alignment(sent, first.reference, list(self._intake.names), std=first.std)
        except MarkerError as error:
            self._tell("NOT_ALIGNED", str(error))
            return
        self.alignment = found
        worst = max(found.residual_mm, key=lambda name: found.residual_mm[name])
        self._tell(
            "ALIGNED",
            f"the tracker's frame was aligned to the body's by the first frame in which all {len(sent)} markers were "
            f"seen, and stays so: rms residual {found.rms_mm:.3g} mm, the farthest '{worst}' with "
            f"{found.residual_mm[worst]:.3g} mm",
        )

    def _tell(self, name: str, text: str) -> None:
        """Note what peers should be told, each kind once."""
        kind = name, text.partition(":")[0]
        if kind not in self._told and len(self._told) < self._settings.most_names:
            self._told.add(kind)
            self.events.append(LiveEvent(name, text))

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

    def _of_points(self, points: Sequence[NamedPlace]) -> dict[int, tuple[str, FloatArray]]:
        """Return the places of markers by their numbers; raise `FormatError` where it is not clear which they are."""
        names = self._intake.names
        if self._intake.match == "order" and len(points) != len(names):
            message = f"points that are joined by order must be as many as the markers, {len(names)}; got {len(points)}"
            raise FormatError(message, where="POINT")
        rows: dict[int, tuple[str, FloatArray]] = {}
        for i, one in enumerate(points):
            row = i if self._intake.match == "order" else self._row(one.name)
            if row in rows:
                message = f"each marker must stand once in a message, got '{names[row]}' again by '{one.name}'"
                raise FormatError(message, where="POINT")
            if row is None:
                self._note_stranger(one.name)
            else:
                rows[row] = one.name, one.place
        return rows

    def _tool(self, device: str, now: float) -> int | None:
        """Return the number of the marker on a tool by the name of its transform; None if it is not taken.

        Transforms into several frames are not mixed: while some come that end in another one than others, none of them
        is taken unless it is the frame that the user named, since no message tells which is the body's.
        """
        tool = tool_of(device)
        row, into = self._row(tool), device[len(tool) + len("To") :]
        if row is None or device in self._intake.names:
            row, into = self._row(device), ""
        if row is None:
            self._note_stranger(device)
        if row is None or not into or into == self._intake.tools_in:
            return row
        if self._intake.tools_in is not None:
            self._tell("SEVERAL_FRAMES", f"'{device}' does not end in To{self._intake.tools_in}: it is left out")
            return None
        self._into.pop(into, None)  # the last one heard of stands last
        self._into[into] = device, now
        recent = [one for one in self._into.items() if now - one[1][1] <= self._settings.idle_s]
        self._into = dict(recent[-self._settings.most_names :])
        others = [name for frame, (name, _) in self._into.items() if frame != into]
        if not others:
            return row
        choice = "none is taken until one of them stops, or --tools-in names one"
        self._tell("SEVERAL_FRAMES", f"'{device}' is in another frame than '{others[0]}': {choice}")
        return None

    def _note_stranger(self, name: str) -> None:
        if len(self.unknown) < self._settings.most_names:
            self.unknown[name] = None


def _hidden(metadata: Mapping[str, str]) -> set[str]:
    """Return the tools that a message's statuses say were not measured, in lower case; empty text: all of them.

    ``P1ToTrackerTransformStatus``, ``P1Status`` are of P1 alone, ``TransformStatus`` and ``Status`` of all.
    """
    found = set()
    for key, value in metadata.items():
        of = _STATUS_KEY.fullmatch(key)
        if of and value.strip().upper() not in _MEASURED:
            found |= {of[1].lower(), tool_of(of[1]).lower()}
    return found


def check_intake(intake: Intake) -> None:
    """Raise `FormatError` where the names of markers cannot be joined as `intake.match` says."""
    partners(
        Labels("the reference", intake.names), Labels("", []), "label" if intake.match == "order" else intake.match
    )
    strangers = [name for name in intake.offsets if name not in intake.names]
    if strangers:
        message = f"an offset must be of a marker ({', '.join(intake.names[:8])} ...), got '{strangers[0]}'"
        raise FormatError(message, where="offsets")
