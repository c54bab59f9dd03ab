"""A place for one frame between a camera and a tracker: a newer frame takes the place of one that waits."""

import threading
from typing import Any


class Inbox:
    """Keeps the newest frame, and counts those that were never taken."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._frame: Any = None
        self._skipped = 0
        self.dropped = 0

    def push(self, frame: Any) -> None:
        """Put a frame in; one that waits is dropped."""
        with self._lock:
            if self._frame is not None:
                self.dropped += 1
                self._skipped += 1
            self._frame = frame

    def take(self) -> tuple[Any, int] | None:
        """Return the frame that waits, and how many were dropped since the last one; None if none waits."""
        with self._lock:
            if self._frame is None:
                return None
            taken = self._frame, self._skipped
            self._frame, self._skipped = None, 0
            return taken
