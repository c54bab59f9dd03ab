"""Places where the files of a data set lie: a folder of this machine, or a place that fsspec knows by its URL.

A file is written whole or not at all: in a folder by `tissuereg.io.atomic`; elsewhere under another name that is then
renamed, or, where a store can only put whole objects (S3, Google Cloud Storage, Azure), by one put.
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
from tissuereg.io.bounds import existing_file
from tissuereg.io.drafts import DRAFT_PREFIX, remove_stale_drafts

#: Protocols whose put makes the whole object visible at once, and that have no rename.
_WHOLE_OBJECTS = {"s3", "s3a", "gs", "gcs", "abfs", "abfss", "az", "adl", "oss", "oci", "memory"}


class Store(Protocol):
    """A place for files without subfolders, in which each file has a plain name.

    `url`: the place as it was given, for messages; `address`: text that names the place for other processes, which may
    run in another working folder.
    """

    url: str
    address: str

    def check(self) -> None:
        """Refuse, before a long run, a place where nothing can be written; remove drafts that killed writers left."""

    def names(self) -> set[str]:
        """Return the names of the files that are there; an empty set if the place does not exist."""

    def exists(self, name: str) -> bool:
        """Return whether a file of this name is there."""

    def write(self, name: str, content: bytes) -> None:
        """Write the bytes of a file, whole or not at all; an older file of this name is replaced."""

    def read(self, name: str) -> bytes:
        """Return the bytes of the file of this name; raise `FormatError` if there is none or it cannot be read."""

    def source(self, name: str) -> BinaryIO:
        """Return the file of this name, opened for reading with random access, for h5py; the caller closes it."""

    def where(self, name: str) -> str:
        """Return the full name of a file, a path or a URL, for messages."""


def store_of(given: str | os.PathLike[str] | Store, *, error: type[TissueRegError] = ArgumentError) -> Store:
    """Return the place for files, a `Store`, that a folder or a URL names; nothing is read or written yet.

    `given`: a folder of this machine, or a URL of fsspec such as ``s3://bucket/data``; fsspec takes keys and ports from
    its own configuration; a `Store` is returned as it is; `error`: class of the error where it is none of these. Raises
    `TissueRegError` of that class, if it is no path or fsspec does not know the protocol; `MissingPackageError` if
    fsspec, or the package behind the protocol, is not installed.
    """
    if isinstance(given, LocalStore | RemoteStore):
        return given
    if isinstance(given, str) and "://" in given:
        protocol, _, rest = given.partition("://")
        return LocalStore(place("path", rest, error=error)) if protocol == "file" else _remote(given, protocol, error)
    return LocalStore(place("path", given, error=error))


class LocalStore:
    """A place for files in a folder of this machine or of several; `folder` is made when the first file is written."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.url = str(folder)
        self.address = str(folder.absolute())

    def check(self) -> None:
        """Raise `OutputError` if nothing can be written in the folder, and remove drafts that killed writers left."""
        check_folder_target(self.folder)
        remove_stale_drafts(self.folder)

    def names(self) -> set[str]:
        """Return the names of the files in the folder, drafts left out; an empty set if it does not exist."""
        try:
            return {entry.name for entry in os.scandir(self.folder) if not entry.name.startswith(DRAFT_PREFIX)}
        except FileNotFoundError:
            return set()
        except OSError as error:
            message = f"{self.folder} must be a folder that can be read: {error.strerror or error}"
            raise FormatError(message, where=self.url) from error

    def exists(self, name: str) -> bool:
        """Return whether a file of this name is in the folder."""
        return (self.folder / name).is_file()

    def write(self, name: str, content: bytes) -> None:
        """Write the bytes of a file in the folder, whole or not at all; an older file of this name is replaced."""
        with atomic_file(self.folder / name) as temporary:
            temporary.write_bytes(content)

    def read(self, name: str) -> bytes:
        """Return the bytes of the file of this name; raise `FormatError` if there is none or it cannot be read."""
        with _as_format_error(self.where(name)):
            return existing_file(self.folder / name).read_bytes()

    def source(self, name: str) -> BinaryIO:
        """Return the file of this name, opened for reading without a buffer; the caller closes it."""
        with _as_format_error(self.where(name)):
            return existing_file(self.folder / name).open("rb", buffering=0)

    def where(self, name: str) -> str:
        """Return the path of a file of this name as text, for messages."""
        return str(self.folder / name)


class RemoteStore:
    """A place for files in a folder of a file system of fsspec.

    `url`: the place as it was given; `files`: the file system, an object of fsspec; `folder`: its name for the folder.
    """

    def __init__(self, url: str, files: Any, folder: str) -> None:
        self.url = self.address = url.rstrip("/")
        self._files = files
        self._folder = folder.rstrip("/")

    def check(self) -> None:
        """Make the folder, if the file system has folders; raise `OutputError` if it cannot be made."""
        with _as_output_error(self.url):
            self._files.makedirs(self._folder, exist_ok=True)

    def names(self) -> set[str]:
        """Return the names of the files in the folder, drafts left out; an empty set if it does not exist."""
        with _as_format_error(self.url):
            try:
                self._files.invalidate_cache(self._folder)
                found = self._files.ls(self._folder, detail=False)
            except FileNotFoundError:
                return set()
        names = {str(one).rstrip("/").rpartition("/")[2] for one in found}
        return {name for name in names if not name.startswith(DRAFT_PREFIX)}

    def exists(self, name: str) -> bool:
        """Return whether a file of this name is in the folder."""
        with _as_format_error(self.where(name)):
            self._files.invalidate_cache(self._folder)
            return bool(self._files.exists(f"{self._folder}/{name}"))

    def write(self, name: str, content: bytes) -> None:
        """Write the bytes of a file in the folder, whole or not at all; an older file of this name is replaced."""
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
        """Return the bytes of the file of this name; raise `FormatError` if there is none or it cannot be read."""
        with _as_format_error(self.where(name)):
            return bytes(self._files.cat_file(f"{self._folder}/{name}"))

    def source(self, name: str) -> BinaryIO:
        """Return the file of this name, opened for reading with random access; the caller closes it."""
        with _as_format_error(self.where(name)):
            opened: BinaryIO = self._files.open(f"{self._folder}/{name}", "rb")
            return opened

    def where(self, name: str) -> str:
        """Return the URL of a file of this name, for messages."""
        return f"{self.url}/{name}"

    def _renames(self) -> bool:
        """Return whether the file system moves a file in one step; fsspec's own `mv` copies and deletes."""
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
    except FormatError:
        raise
    except FileNotFoundError as error:
        message = f"no such file: {where}"
        raise FormatError(message, where=where) from error
    except Exception as error:
        message = f"{where} must be readable: {error or type(error).__name__}"
        raise FormatError(message, where=where) from error
