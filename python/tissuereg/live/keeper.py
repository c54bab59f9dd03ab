"""Frames on their way into a recording: each with whether it was registered, and what was answered."""

from collections.abc import Callable
from typing import Protocol

from tissuereg.io.recordings.table import LiveRow
from tissuereg.live.frames import LiveFrame
from tissuereg.live.settings import LiveSettings


class Recorder(Protocol):
    """What keeps the frames that came in; `full` says that it takes no more."""

    full: bool

    def add(self, row: LiveRow) -> None:
        """Keep a frame, whether it was registered, or came too fast, and what was answered."""


class Keeper:
    """Hands frames to a recorder in the order of time; those that come while one is registered wait for its answer.

    `lost`: is told, once, that nothing is recorded any more, and why.
    """

    def __init__(self, recorder: Recorder | None, settings: LiveSettings, lost: Callable[[str], None]) -> None:
        self._recorder, self._settings, self._lost = recorder, settings, lost
        self._wanted = recorder is not None
        self._waiting: list[LiveRow] = []

    @property
    def recording(self) -> bool | None:
        """Whether frames are recorded; None if nobody wants that."""
        return self._recorder is not None if self._wanted else None

    def dropped(self, frame: LiveFrame) -> None:
        """Keep a frame that is not registered."""
        self._waiting.append(_row(frame))
        # An answer that does not come holds no memory.
        if not self._waiting[0].registered or len(self._waiting) > self._settings.most_waiting:
            self._write()

    def taken(self, frame: LiveFrame) -> None:
        """Keep a frame that is registered now; its answer follows."""
        self._write()
        self._waiting = [_row(frame)._replace(registered=True)]

    def answered(self, digest: str) -> None:
        """Keep the digest of the answer to the frame that was taken last."""
        if self._waiting and self._waiting[0].registered:
            self._waiting[0] = self._waiting[0]._replace(answer=digest)
        self._write()

    def close(self) -> None:
        """Write what waits; a frame whose answer did not come any more counts as not registered."""
        if self._waiting and not self._waiting[0].answer:
            self._waiting[0] = self._waiting[0]._replace(registered=False)
        self._write()

    def _write(self) -> None:
        rows, self._waiting = self._waiting, []
        for row in rows:
            if self._recorder is None:
                return
            try:
                self._recorder.add(row)
                ended = "it has its largest size: frames from now on are not in it" if self._recorder.full else ""
            except OSError as error:  # a full disk is no reason to end, and no peer's fault
                ended = f"it cannot be written: {error}"
            if ended:
                self._recorder = None
                self._lost(f"the recording ends here, since {ended}")


def _row(frame: LiveFrame) -> LiveRow:
    return LiveRow(frame.time_s, frame.places, frame.received_s, frame.sent_as)
