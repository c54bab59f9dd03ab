"""Checks of a file before it is read: it exists, is not too large for its format, and begins as its format requires.

The largest sizes bound memory and time; ``docs/files.md`` lists them. While it is read, a table takes up to forty times
its size in memory, a mesh up to ten times.
"""

import io
import os
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from tissuereg._base.arguments import place
from tissuereg._base.provenance import note_file
from tissuereg.errors import FormatError


@dataclass(frozen=True)
class FileLimits:
    """Largest sizes of files, tolerances of comparisons between files, and defaults of the readers; MB are 1e6 bytes.

    Attributes
    ----------
    table_mb : int
        Largest size of a comma-separated table, MB.
    text_mb : int
        Largest size of a list of points, a TOML file or a model's description, MB.
    recording_mb : int
        Largest size of a tracker's recording, or of the text at the head of one with images, MB.
    mesh_mb : int
        Largest size of a mesh, a surface or a numpy archive, MB.
    unpacked_mb : int
        Largest size to which the arrays of a mesh or surface unpack, MB.
    head_bytes : int
        Number of bytes at a file's beginning by which its format is recognised.
    toml_depth : int
        Most parts of a dotted key, and most brackets in each other, of a TOML file: its reader takes time and memory
        with the square of them.
    toml_word : int
        Most characters of a key of a TOML file.
    table_points : int
        Largest number of markers or targets of one state that a table may hold; more points must be given as a surface.
    header_rows : int
        Most lines above the numbers of a tracker's table.
    farthest : float
        Numbers as large are no coordinates in any unit and no times in s: trackers write such ones for none.
    farthest_mm : float
        Nor are coordinates in mm as large as this, a kilometre.
    std_mm : float
        Standard deviation of a measured coordinate where none is given, mm: that of an optical tracker.
    same_time : float
        Largest difference between a row's time and a frame's for the row to belong to it, as a share of the frame step.
    same_place : float
        Largest distance between a file's point and the mesh's node that it must be, as a share of the mesh's extent.
    held_out_share : float
        Share of a data set's members in the test split, and in the validation split.
    open_chunks : int
        Number of chunk files of a data set that are kept open.
    stale_draft_s : float
        Age in s above which the draft (temporary folder) of another machine is removed: writing takes seconds.
    draft_tries : int
        Number of names that are tried for a draft: another writer may remove a new draft before it is locked.
    least_extent_mm, most_extent_mm : float
        Smallest and largest extent of a mesh or surface that may be a body, mm; outside, the unit must be wrong.
    usual_least_mm, usual_most_mm : float
        Smallest and largest extent of nearly all bodies, mm; outside, the unit may be wrong.
    typical_extent_mm : float
        Typical extent of a body, mm. Where both cm and m are possible units, the likelier one brings the extent closer
        to this, by ratio.
    """

    table_mb: int = 64
    text_mb: int = 16
    recording_mb: int = 256
    mesh_mb: int = 256
    unpacked_mb: int = 2048
    head_bytes: int = 4096
    toml_depth: int = 32
    toml_word: int = 1000
    table_points: int = 10_000
    header_rows: int = 12
    farthest: float = 1e15
    farthest_mm: float = 1e6
    std_mm: float = 0.1
    same_time: float = 0.01
    same_place: float = 1e-4
    held_out_share: float = 0.1
    open_chunks: int = 16
    stale_draft_s: float = 86_400.0
    draft_tries: int = 100
    least_extent_mm: float = 5.0
    most_extent_mm: float = 2000.0
    usual_least_mm: float = 20.0
    usual_most_mm: float = 600.0
    typical_extent_mm: float = 150.0


FILES = FileLimits()


#: How a file of each suffix begins, after any white space.
_HEADS = {
    ".vtu": (b"<?xml", b"<VTKFile", b"<!--"),
    ".vtp": (b"<?xml", b"<VTKFile", b"<!--"),
    ".vtk": (b"# vtk DataFile",),
    ".msh": (b"$MeshFormat", b"$Comments"),
    ".xdmf": (b"<?xml", b"<Xdmf", b"<!DOCTYPE Xdmf", b"<!--"),
    ".ply": (b"ply",),
}
_TEXT = (".obj", ".off")
_BINARY_STL_HEAD, _BINARY_STL_ROW = 84, 50


def existing_file(path: str | os.PathLike[str], most_mb: int | None = None) -> Path:
    """Return `path` as `regular_file` does; the file counts as read from now on."""
    file = regular_file(path, most_mb)
    note_file(file)
    return file


def regular_file(path: str | os.PathLike[str], most_mb: int | None = None) -> Path:
    """Return `path` as a `Path` after checking that it is a regular file that can be read.

    `most_mb`: largest size, MB; None for no limit. Raises `FormatError` if it does not exist, is a folder, a pipe or a
    device (opening one may wait for ever, and its size is not known), may not be read or is larger.
    """
    file = place("path", path, error=FormatError)
    if file.is_dir():
        message = f"a file is needed, got the folder {file}"
        raise FormatError(message, where=str(file))
    if not file.exists():
        message = f"no such file: {file}"
        raise FormatError(message, where=str(file))
    if not file.is_file():
        message = f"{file} must be a regular file; it is a pipe, a socket or a device: save its content in a file first"
        raise FormatError(message, where=str(file))
    if not os.access(file, os.R_OK):
        message = f"{file} must be readable; permission was denied"
        raise FormatError(message, where=str(file))
    if most_mb is not None and file.stat().st_size > most_mb * 1_000_000:
        raise too_large(file, most_mb, f"it has {file.stat().st_size / 1e6:.0f} MB")
    return file


def mesh_file(path: str | os.PathLike[str], what: str) -> Path:
    """Return `path` after checking that it is a mesh or surface file that begins as its suffix requires.

    `what`: word for its content in messages, ``"mesh"`` or ``"surface"``. Raises `FormatError` if it is no file, has
    more than `FILES.mesh_mb` MB, or begins otherwise. Only the head of the file is read.
    """
    file = existing_file(path, FILES.mesh_mb)
    suffix = file.suffix.lower()
    with file.open("rb") as stream:
        head = stream.read(FILES.head_bytes)
    begin = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    rule = None
    if suffix in _HEADS and not begin.startswith(_HEADS[suffix]):
        rule = "begin with " + " or ".join(f"'{one.decode()}'" for one in _HEADS[suffix])
    elif suffix == ".stl" and begin[:5].lower() != b"solid":
        rule = _rule_of_binary_stl(head, file.stat().st_size)
    elif suffix in _TEXT and not _is_text(head):
        rule = "be text"
    if rule is not None:
        message = f"{file} must be a {what} of the kind that its name says ({suffix}) and {rule}, got {begin[:24]!r}"
        raise FormatError(message, where=str(file))
    return file


def bounded_stream(file: Path, most_mb: int) -> BinaryIO:
    """Open a file for reading up to a bound, for it may grow after its size was checked.

    `file`: path of a file that exists; `most_mb`: largest size, MB. Result: a binary stream that raises `FormatError`
    when more than this is read.
    """
    return io.BufferedReader(_Bounded(file, most_mb))


def read_text(file: Path, most_mb: int = FILES.text_mb) -> str:
    """Return the whole text of a file in UTF-8, with its line ends unchanged.

    `file`: path of a file in UTF-8, with or without byte order mark; `most_mb`: largest size, MB. Raises `FormatError`
    if it is larger; `UnicodeDecodeError` or `OSError` if it is no such text, or cannot be read.
    """
    with bounded_stream(file, most_mb) as stream:
        return stream.read().decode("utf-8-sig")


def text_lines(file: Path) -> list[str]:
    """Return the lines of a text file in UTF-8, without their ends.

    A line ends at a line feed; carriage returns before it, or alone within the line, are left out. Only where there is
    no line feed at all do lines end at carriage returns. Raises as `read_text` does.
    """
    text = read_text(file)
    return [line.replace("\r", "") for line in text.split("\n" if "\n" in text else "\r")]


def too_large(file: Path | str, most_mb: int, found: str) -> FormatError:
    """Return the error for a file that is larger than files of its format may be.

    `most_mb`: largest size, MB; `found`: clause that states the size found, such as ``it has 300 MB``.
    """
    message = f"{file} must have at most {most_mb} MB, {found}; docs/files.md states the sizes"
    return FormatError(message, where=str(file))


class _Bounded(io.RawIOBase):
    def __init__(self, file: Path, most_mb: int) -> None:
        super().__init__()
        self._file, self._most_mb, self._left = file, most_mb, most_mb * 1_000_000
        self._raw = io.FileIO(file)

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: "memoryview") -> int:  # type: ignore[override]
        read = self._raw.readinto(buffer) or 0
        self._left -= read
        if self._left < 0:
            raise too_large(self._file, self._most_mb, "it has more")
        return read

    def close(self) -> None:
        self._raw.close()
        super().close()


def _rule_of_binary_stl(head: bytes, size: int) -> str | None:
    """Return the rule that a binary .stl file breaks, in words, or None if it breaks none.

    The file's length must follow from its number of triangles. `head`: first bytes of the file; `size`: its size in
    bytes.
    """
    n_triangles = int.from_bytes(head[_BINARY_STL_HEAD - 4 : _BINARY_STL_HEAD], "little")
    whole = _BINARY_STL_HEAD + _BINARY_STL_ROW * n_triangles
    if len(head) >= _BINARY_STL_HEAD and size == whole:
        return None
    return f"begin with 'solid', or be as long as its number of triangles requires ({whole} bytes, it has {size})"


def _is_text(head: bytes) -> bool:
    return not any(byte < 32 and byte not in b"\t\n\r\f\v" for byte in head) and 127 not in head
