"""Reading of meshes and surfaces by other packages, without their printed output; failures become `FormatError`."""

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
    """Silence what other packages print to standard output and error, and their warnings, during the block."""
    silence = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
        warnings.simplefilter("ignore")
        yield


@contextlib.contextmanager
def reading(file: Path, what: str) -> Iterator[None]:
    """Run a block that reads a file by another package silently, and turn any error in it into `FormatError`.

    `file`: the file that is read; `what`: what it must be, for the message: "a mesh", "a surface". Errors of this
    package pass unchanged.
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
    """Return the content of a mesh file as the object `meshio.Mesh`.

    `file`: a file whose ending `MESHIO_MODULES` lists; `what`: what it must be, for messages: "a mesh", "a surface".
    Raises `FormatError` if meshio cannot read it.
    """
    import meshio

    with reading(file, what):
        return getattr(meshio, MESHIO_MODULES[file.suffix.lower()]).read(str(file))
