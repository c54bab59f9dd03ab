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
    """Return the bytes of an HDF5 file with the given arrays; they are the same for the same content.

    `arrays`: arrays by name, in which a slash makes a group; text is written as UTF-8; `attributes`: attributes of the
    whole file, by name; `by_row`: names of arrays that are stored row by row, so that one row can be read alone; each
    other array is stored as one piece.
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
    """Return an array of texts as UTF-8 bytes of one length, with the dtype that h5py uses for such text."""
    import h5py

    encoded = np.char.encode(texts, "utf-8")
    return encoded.astype(h5py.string_dtype("utf-8", max(encoded.dtype.itemsize, 1)))


@contextmanager
def opened(store: Store, name: str, content: bytes | None = None) -> Iterator[Any]:
    """Open an HDF5 file for reading and yield the open file; errors of h5py become a `FormatError` that names the file.

    `store`: place of the file; `name`: its name there; `content`: its bytes, if they have been read already. Raises
    `FormatError` if it is missing or spoilt, also if that shows only while it is read in the block.
    """
    with spoilt_is_said(store, name):
        whole = OpenFile(store, name, content)
        try:
            yield whole.file
        finally:
            whole.close()


class OpenFile:
    """An open HDF5 file that its owner must close; errors of h5py pass unchanged.

    `store`: place of the file; `name`: its name there; `content`: its bytes, if they have been read already. The
    attribute `file` is the open h5py file.
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
        """Close the HDF5 file, and the file or the bytes from which it is read."""
        self.file.close()
        self._source.close()


@contextmanager
def spoilt_is_said(store: Store, name: str) -> Iterator[None]:
    """Turn the errors that h5py raises in the block on a spoilt file of this name into a `FormatError`."""
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
    """Return an array of an open HDF5 file, as stored, after checking its dtype and shape.

    `file`: the open file; `where`: its name, for messages; `name`: name of the array; `kinds`: letters of the numpy
    kinds of dtype that it may have, such as "iu"; `shape`: wanted shape, in which None stands for any length. Raises
    `FormatError` if it is missing, or of another dtype or shape.
    """
    data = checked(file, where, name, kinds, shape)
    content: npt.NDArray[Any] = data[()]
    return content


def checked(file: Any, where: str, name: str, kinds: str, shape: tuple[int | None, ...]) -> Any:
    """Return an array of an open HDF5 file as an h5py data set, not read yet, after checking its dtype and shape.

    `file`: the open file; `where`: its name, for messages; `name`: name of the array; `kinds`: letters of the numpy
    kinds of dtype that it may have, such as "iu"; `shape`: wanted shape, in which None stands for any length. Raises
    `FormatError` if it is missing, or of another dtype or shape.
    """
    data = own_dataset(file, where, name)
    if data is None:
        message = f"{where} must hold an array '{name}'; it holds: {', '.join(file) or 'nothing'}"
        raise FormatError(message, where=f"{where}:{name}")
    fits = len(data.shape) == len(shape) and all(w is None or w == g for w, g in zip(shape, data.shape, strict=True))
    if data.dtype.kind not in kinds or not fits:
        wanted = ", ".join("any" if one is None else str(one) for one in shape)
        message = f"array '{name}' in {where} must have shape ({wanted}), got {data.dtype} {data.shape}"
        raise FormatError(message, where=f"{where}:{name}")
    return data


def own_dataset(file: Any, where: str, name: str) -> Any:
    """Return the array `name` of an open HDF5 file as an h5py data set, or None if the file holds no such array.

    `where`: the file's name, for messages; `name`: steps parted by slashes. Raises `FormatError` if the array lies in
    another file, which is not opened (a pipe would wait for ever), or would take far more memory than it is stored in.
    """
    import h5py

    found = file
    for step in filter(None, name.split("/")):
        if not isinstance(found, h5py.Group):
            return None
        link = found.get(step, getlink=True)
        if isinstance(link, h5py.ExternalLink | h5py.SoftLink):
            raise _elsewhere(where, name)
        found = found.get(step)
    if not isinstance(found, h5py.Dataset):
        return None
    if found.external or found.is_virtual:
        raise _elsewhere(where, name)
    size = int(np.prod(np.array(found.shape, object))) * found.dtype.itemsize
    most_ratio = 1100  # the most that the packing of HDF5 can do
    if size > most_ratio * found.id.get_storage_size():
        message = f"array '{name}' in {where} must be stored; most of its {size / 1e6:.0f} MB are not"
        raise FormatError(message, where=f"{where}:{name}")
    return found


def _elsewhere(where: str, name: str) -> FormatError:
    message = f"array '{name}' must lie in {where} itself; it is a link, or lies in another file"
    return FormatError(message, where=f"{where}:{name}")
