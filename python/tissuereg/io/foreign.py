"""Meshes and surfaces by the readers of other packages, without their output and with typed errors for failures."""

import contextlib
import io
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tissuereg.errors import FormatError, TissueRegError

#: Endings of meshes and surfaces that meshio reads, and its module for each.
MESHIO_MODULES: dict[str, str] = {".vtu": "vtu", ".vtk": "vtk", ".msh": "gmsh"}


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Silence prints and warnings of other packages."""
    silence = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def reading(file: Path, what: str) -> Iterator[None]:
    """Run a reader of another package silently; any error of it counts as an invalid file.

    `file`: the file that is read; `what`: what it must be: "a mesh", "a surface". Raises `FormatError` if the block
    raises anything but an error of this package.
    """
    try:
        with hushed():
            yield
    except TissueRegError:
        raise
    except (Exception, SystemExit) as error:  # a wrong size in the file may raise MemoryError
        reason = str(error).strip() or type(error).__name__
        message = f"{file} must be {what} of the kind that its name says ({file.suffix}); it cannot be read: {reason}"
        raise FormatError(message, where=str(file)) from error


def meshio_content(file: Path, what: str) -> Any:
    """Return a file as meshio reads it.

    `file`: with an ending of `MESHIO_MODULES`; `what`: as `reading` takes it. Result: as it stands. Raises
    `FormatError` if meshio cannot read it.
    """
    import meshio

    with reading(file, what):
        return getattr(meshio, MESHIO_MODULES[file.suffix.lower()]).read(str(file))
