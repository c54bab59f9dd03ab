"""Where the files of a data set lie: a folder of this machine, or a place that fsspec knows by its URL.

A file is written whole or not at all: in a folder by `tissuereg.io.atomic`; elsewhere under another name that is then
renamed, or, where a store puts whole objects only (S3, Google Cloud Storage, Azure), by one put.
"""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO, Protocol

from tissuereg._base.arguments import place
from tissuereg.errors import ArgumentError, FormatError, MissingPackageError, TissueRegError
from tissuereg.io.atomic import OutputError, atomic_file, check_folder_target
from tissuereg.io.drafts import DRAFT_PREFIX, remove_stale_drafts

#: Protocols whose put makes the whole object visible at once, and that have no rename.
_WHOLE_OBJECTS = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "oci", "memory"}


class Store(Protocol):
    """A flat place for files, by plain names.

    `url`: the place as it was given, for messages; `address`: the place for other processes, which may run in another
    folder.
    """

    url: str
    address: str

    def check(self) -> None:
        """Refuse early what could not be written at the end of a long run, and remove what killed writers left."""

    def names(self) -> set[str]:
        """Return the names that are there; none if the place does not exist."""

    def exists(self, name: str) -> bool:
        """Return whether a file is there."""

    def write(self, name: str, content: bytes) -> None:
        """Write a file, whole or not at all; an older one is replaced."""

    def read(self, name: str) -> bytes:
        """Return the content of a file."""

    def source(self, name: str) -> BinaryIO:
        """Return an open file with random access, for h5py; its reader closes it."""

    def where(self, name: str) -> str:
        """Return the full name of a file, for messages."""


def store_of(given: str | os.PathLike[str] | Store, *, error: type[TissueRegError] = ArgumentError) -> Store:
    """Return the store of a folder or a URL.

    `given`: a folder of this machine, or a URL of fsspec such as ``s3://bucket/data``; what the file system needs
    (keys, ports) comes from fsspec's own configuration; `error`: class of the error where it is neither. Result:
    nothing is touched yet. Raises `TissueRegError` of that class, if it is no path or fsspec does not know the
    protocol; `MissingPackageError` if fsspec, or the package behind the protocol, is not installed.
    """
    if isinstance(given, LocalStore | RemoteStore):
        return given
    if isinstance(given, str) and "://" in given:
        protocol, _, rest = given.partition("://")
        return LocalStore(place("path", rest, error=error)) if protocol == "file" else _remote(given, protocol, error)
    return LocalStore(place("path", given, error=error))


class LocalStore:
    """A folder of this machine, or one that several machines share. `folder`: made when the first file is written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.url = str(folder)
        self.address = str(folder.absolute())

    def check(self) -> None:
        """Refuse a folder in which nothing can be written, and remove drafts of killed writers."""
        check_folder_target(self.folder)
        remove_stale_drafts(self.folder)

    def names(self) -> set[str]:
        """Return the names that are there."""
        try:
            return {entry.name for entry in os.scandir(self.folder) if not entry.name.startswith(DRAFT_PREFIX)}
        except FileNotFoundError:
            return set()
        except OSError as error:
            message = f"{self.folder} must be a folder that can be read: {error.strerror or error}"
            raise FormatError(message, where=self.url) from error

    def exists(self, name: str) -> bool:
        """Return whether a file is there."""
        return (self.folder / name).is_file()

    def write(self, name: str, content: bytes) -> None:
        """Write a file, whole or not at all."""
        with atomic_file(self.folder / name) as temporary:
            temporary.write_bytes(content)

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        with _as_format_error(self.where(name)):
            return (self.folder / name).read_bytes()

    def source(self, name: str) -> BinaryIO:
        """Return an open file."""
        with _as_format_error(self.where(name)):
            return (self.folder / name).open("rb", buffering=0)

    def where(self, name: str) -> str:
        """Return the path of a file as text."""
        return str(self.folder / name)


class RemoteStore:
    """A folder of a file system of fsspec. `files`: the file system; `folder`: its name for the folder."""

    def __init__(self, url: str, files: Any, folder: str) -> None:
        self.url = self.address = url.rstrip("/")
        self._files = files
        self._folder = folder.rstrip("/")

    def check(self) -> None:
        """Make the folder, where the file system has any."""
        with _as_output_error(self.url):
            self._files.makedirs(self._folder, exist_ok=True)

    def names(self) -> set[str]:
        """Return the names that are there."""
        with _as_format_error(self.url):
            try:
                self._files.invalidate_cache(self._folder)
                found = self._files.ls(self._folder, detail=False)
            except FileNotFoundError:
                return set()
        names = {str(one).rstrip("/").rpartition("/")[2] for one in found}
        return {name for name in names if not name.startswith(DRAFT_PREFIX)}

    def exists(self, name: str) -> bool:
        """Return whether a file is there."""
        with _as_format_error(self.where(name)):
            self._files.invalidate_cache(self._folder)
            return bool(self._files.exists(f"{self._folder}/{name}"))

    def write(self, name: str, content: bytes) -> None:
        """Write a file, whole or not at all."""
        final = f"{self._folder}/{name}"
        with _as_output_error(self.where(name)):
            if not self._renames():
                self._files.pipe_file(final, content)
                return
            draft = f"{self._folder}/{DRAFT_PREFIX}{secrets.token_hex(8)}"
            try:
                self._files.pipe_file(draft, content)
                self._files.mv(draft, final)
            except BaseException:
                if self._files.exists(draft):
                    self._files.rm_file(draft)
                raise

    def read(self, name: str) -> bytes:
        """Return the content of a file."""
        with _as_format_error(self.where(name)):
            return bytes(self._files.cat_file(f"{self._folder}/{name}"))

    def source(self, name: str) -> BinaryIO:
        """Return an open file."""
        with _as_format_error(self.where(name)):
            opened: BinaryIO = self._files.open(f"{self._folder}/{name}", "rb")
            return opened

    def where(self, name: str) -> str:
        """Return the URL of a file."""
        return f"{self.url}/{name}"

    def _renames(self) -> bool:
        """Whether the file system moves a file in one step; fsspec's own `mv` copies and deletes."""
        from fsspec import AbstractFileSystem

        protocol = self._files.protocol
        known = {protocol} if isinstance(protocol, str) else set(protocol)
        return not known & _WHOLE_OBJECTS and type(self._files).mv is not AbstractFileSystem.mv


def _remote(url: str, protocol: str, wrong: type[TissueRegError]) -> RemoteStore:
    try:
        from fsspec.core import url_to_fs
    except ImportError as error:
        message = (
            f"{url}: places beyond this machine's folders need fsspec, which is not installed; "
            "`pip install fsspec`, or name a folder"
        )
        raise MissingPackageError(message, where=url) from error
    try:
        files, folder = url_to_fs(url)
    except ImportError as error:
        message = f"{url}: fsspec needs another package for {protocol}://, which is not installed: {error}"
        raise MissingPackageError(message, where=url) from error
    except ValueError as error:
        message = f"{url} must be a folder, or a URL that fsspec knows: {error}"
        raise wrong(message, where=url) from error
    return RemoteStore(url, files, folder)


@contextmanager
def _as_output_error(where: str) -> Iterator[None]:
    # What a file system raises is its own affair; fsspec promises no class.
    try:
        yield
    except Exception as error:
        message = f"{where} must be writable: {error or type(error).__name__}"
        raise OutputError(message, where=where) from error


@contextmanager
def _as_format_error(where: str) -> Iterator[None]:
    try:
        yield
    except FileNotFoundError as error:
        message = f"no such file: {where}"
        raise FormatError(message, where=where) from error
    except Exception as error:
        message = f"{where} must be readable: {error or type(error).__name__}"
        raise FormatError(message, where=where) from error
