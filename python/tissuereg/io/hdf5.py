"""HDF5 files: arrays packed into bytes that are the same for the same content, and checked reading.

Every array is protected by checksums (fletcher32), so that damage is noticed when it is read.
"""

import io
import weakref
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any

import numpy as np
import numpy.typing as npt

from tissuereg.errors import FormatError
from tissuereg.io.stores import Store

#: What h5py raises on spoilt files.
_SPOILT = (OSError, RuntimeError, ValueError, TypeError, KeyError, MemoryError, UnicodeDecodeError)


def packed(arrays: Mapping[str, npt.NDArray[Any]], attributes: Mapping[str, Any], by_row: frozenset[str]) -> bytes:
    """Return an HDF5 file of arrays.

    `arrays`: by name; a slash makes a group. Text is written as UTF-8; `attributes`: attributes of the whole file;
    `by_row`: names of arrays that are chunked by rows, so that one row can be read alone; the others are one chunk.
    Result: the same bytes for the same content.
    """
    import h5py

    whole = io.BytesIO()
    with h5py.File(whole, "w", track_order=False) as file:
        for name, value in attributes.items():
            file.attrs[name] = value
        for name, array in arrays.items():
            content = _utf8(array) if array.dtype.kind == "U" else array
            if content.size:
                chunks = (1, *content.shape[1:]) if name in by_row else content.shape
                made = file.create_dataset(name, data=content, chunks=chunks, fletcher32=True, track_times=False)
                # Closing would place it too, but a debugger or Dask's profiler may keep it open until others are there.
                made.flush()
            else:
                file.create_dataset(name, shape=content.shape, dtype=content.dtype, track_times=False)
    return whole.getvalue()


def _utf8(texts: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """Return texts as bytes of one length, marked as UTF-8."""
    import h5py

    encoded = np.char.encode(texts, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", max(encoded.dtype.itemsize, 1)))


@contextmanager
def opened(store: Store, name: str, content: bytes | None = None) -> Iterator[Any]:
    """Open an HDF5 file for reading; errors of h5py become a `FormatError` that names the file.

    `name`: its name there; `content`: the file's content, where it has been read already. Gives: the open file. Raises
    `FormatError` if it is missing or spoilt, also if that shows only while it is read.
    """
    with spoilt_is_said(store, name):
        whole = OpenFile(store, name, content)
        try:
            yield whole.file
        finally:
            whole.close()


class OpenFile:
    """An open HDF5 file, to be closed by its owner; without the messages of `opened`.

    `store`, `name`, `content`: as `opened`.
    """

    def __init__(self, store: Store, name: str, content: bytes | None = None) -> None:
        import h5py

        # Not by its path: HDF5 would lock it, which some shared folders cannot, and refuse it where another part of the
        # program has it open with another kind of lock. A file that is there is whole and never changes.
        self._source = store.source(name) if content is None else io.BytesIO(content)
        try:
            self.file = h5py.File(self._source, "r")
        except BaseException:
            self._source.close()
            raise
        weakref.finalize(self, self._source.close)  # for owners that go away without a word

    def close(self) -> None:
        """Close the file, and the one under it."""
        self.file.close()
        self._source.close()


@contextmanager
def spoilt_is_said(store: Store, name: str) -> Iterator[None]:
    """Turn what h5py raises on spoilt files into `FormatError`."""
    try:
        yield
    except FormatError:
        raise
    except _SPOILT as error:
        message = (
            f"{store.where(name)} must be a whole HDF5 file of the data set: {error}. Delete it, and the same command "
            "makes it anew"
        )
        raise FormatError(message, where=store.where(name)) from error


def array_of(file: Any, where: str, name: str, kinds: str, shape: tuple[int | None, ...]) -> npt.NDArray[Any]:
    """Return an array of an open file, checked.

    `file`: the open file; `where`: its name, for messages; `name`: the array's; `kinds`: kinds of dtype that it may
    have; `shape`: its shape; None means any length. Result: as stored. Raises `FormatError` if it is missing, or of
    another kind or shape.
    """
    data = checked(file, where, name, kinds, shape)
    content: npt.NDArray[Any] = data[()]
    return content


def checked(file: Any, where: str, name: str, kinds: str, shape: tuple[int | None, ...]) -> Any:
    """Return a data set of an open file, unread, whose kind and shape were checked as by `array_of`."""
    import h5py

    data = file.get(name)
    if not isinstance(data, h5py.Dataset):
        message = f"{where} must hold an array '{name}'; it holds: {', '.join(file) or 'nothing'}"
        raise FormatError(message, where=f"{where}:{name}")
    fits = len(data.shape) == len(shape) and all(w is None or w == g for w, g in zip(shape, data.shape, strict=True))
    if data.dtype.kind not in kinds or not fits:
        wanted = ", ".join("any" if one is None else str(one) for one in shape)
        message = f"array '{name}' in {where} must have shape ({wanted}), got {data.dtype} {data.shape}"
        raise FormatError(message, where=f"{where}:{name}")
    return data
