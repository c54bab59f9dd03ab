"""A place in the bytes of a file that mixes lines of text with numbers, which are text too or binary."""

import re
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg.errors import FormatError

_IS_BLANK = np.isin(np.arange(256), np.frombuffer(b" \t\r\n\f\v", np.uint8))
_WORD = re.compile(rb"\s*(\S*)")


class Cursor:
    """Reader of lines, words and numbers, one after another.

    `data`: the bytes; `binary`: whether `numbers` reads binary ones; `order`: byte order of those, ``<`` or ``>``.
    Reading beyond the end raises `FormatError`, before any memory is taken for what the file claims to hold.
    """

    def __init__(self, data: bytes, binary: bool = False, order: str = "<") -> None:
        bare = data.removeprefix(b"\xef\xbb\xbf")
        # Without any line feed, which no binary file lacks, lines end at carriage returns.
        self.data = bare if b"\n" in bare else bare.replace(b"\r", b"\n")
        self.binary, self.order, self.at = binary, order, 0
        self._starts: npt.NDArray[np.int64] | None = None

    def line(self) -> str:
        """Return the rest of the line, without white space at its ends, and go to the next one."""
        end = self.data.find(b"\n", self.at)
        end = len(self.data) if end < 0 else end
        found = self.data[self.at : end]
        self.at = min(end + 1, len(self.data))
        return found.decode("utf-8", "replace").strip()

    def words(self) -> list[str]:
        """Return the words of the next line that is not empty, and go behind it; an empty list at the end."""
        while self.at < len(self.data):
            found = self.line().split()
            if found:
                return found
        return []

    def next_word(self) -> str:
        """Return the next word without going on; empty at the end."""
        found = _WORD.match(self.data, self.at)
        return found[1][:64].decode("latin-1") if found else ""

    def numbers(self, dtype: str, count: int) -> npt.NDArray[Any]:
        """Return the next `count` numbers; as text, whole ones are int64 and others float64, whatever `dtype` is."""
        if count < 0:
            message = f"a count must not be negative, got {count}"
            raise FormatError(message)
        return self._binary(np.dtype(self.order + dtype), count) if self.binary else self._text(dtype, count)

    def one(self, dtype: str) -> int:
        """Return the next whole number."""
        return int(self.numbers(dtype, 1)[0])

    def skip(self, n_bytes: int) -> None:
        """Go on by a number of bytes."""
        self._need(n_bytes)
        self.at += n_bytes

    def _need(self, n_bytes: int) -> None:
        if not 0 <= n_bytes <= len(self.data) - self.at:
            message = f"the file ends too early: {n_bytes} more bytes must follow, {len(self.data) - self.at} do"
            raise FormatError(message)

    def _binary(self, dtype: np.dtype[Any], count: int) -> npt.NDArray[Any]:
        self._need(count * dtype.itemsize)
        found = np.frombuffer(self.data, dtype, count, self.at)
        self.at += count * dtype.itemsize
        return found.astype(dtype.newbyteorder("="))

    def _text(self, dtype: str, count: int) -> npt.NDArray[Any]:
        if self._starts is None:  # of every word, once
            blank = _IS_BLANK[np.frombuffer(b" " + self.data, np.uint8)]
            self._starts = np.flatnonzero(blank[:-1] & ~blank[1:])
        first = int(np.searchsorted(self._starts, self.at))
        left = len(self._starts) - first
        if count > left:
            message = f"the file ends too early: {count} more numbers must follow, {left} words do"
            raise FormatError(message)
        end = int(self._starts[first + count]) if count < left else len(self.data)
        found = text_numbers(self.data[self.at : end], dtype)
        if len(found) != count:
            message = f"{count} numbers must follow, got {self.data[self.at : end][:40]!r}..."
            raise FormatError(message)
        # The line's end is left: a line may follow that is empty on purpose.
        self.at = self.at + len(self.data[self.at : end].rstrip()) if count else self.at
        return found


def text_numbers(text: bytes | str, dtype: str) -> npt.NDArray[Any]:
    """Return the numbers in a text, int64 where `dtype` is one of whole numbers and float64 otherwise."""
    if not text or text.isspace():
        return np.empty(0, np.int64 if dtype[0] in "iu" else np.float64)
    try:
        found: npt.NDArray[Any] = np.fromstring(text, np.int64 if dtype[0] in "iu" else np.float64, sep=" ")
    except (DeprecationWarning, ValueError) as error:  # a warning is an error while a file is read
        message = f"numbers must stand, got {text[:60]!r}"
        raise FormatError(message) from error
    return found
