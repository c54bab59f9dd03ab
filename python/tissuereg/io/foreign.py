"""Reading of the mesh files of other programs, silently; failures become `FormatError`."""

import contextlib
import io
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

from tissuereg.errors import FormatError, TissueRegError
from tissuereg.io.bounds import mesh_file
from tissuereg.io.gmsh import read_gmsh
from tissuereg.io.grid import Grid
from tissuereg.io.vtk_legacy import read_vtk_legacy
from tissuereg.io.vtk_xml import read_vtk_xml
from tissuereg.io.xdmf import read_xdmf

#: Readers of bodies and surfaces by the ending of a file's name: its content, in its own unit.
GRID_READERS: dict[str, Callable[[Path], Grid]] = {
    ".vtu": read_vtk_xml,
    ".vtk": read_vtk_legacy,
    ".msh": read_gmsh,
    ".xdmf": read_xdmf,
}


@contextlib.contextmanager
def hushed() -> Iterator[None]:
    """Silence what other packages print to standard output and error, and their warnings, during the block."""
    silence = io.StringIO()
    with warnings.catch_warnings(), contextlib.redirect_stdout(silence), contextlib.redirect_stderr(silence):
        warnings.simplefilter("ignore")
        # numpy's word for a text that is no number.
        warnings.filterwarnings("error", message=".*could not be read to its end", category=DeprecationWarning)
        yield


@contextlib.contextmanager
def reading(file: Path, what: str) -> Iterator[None]:
    """Run a block that reads a file silently, and turn any error in it into `FormatError`.

    `file`: the file that is read; `what`: what it must be, for the message: "a mesh", "a surface". Other errors of this
    package pass unchanged.
    """
    try:
        with hushed():
            yield
    except TissueRegError as error:
        if error.where is not None:
            raise
        raise _unreadable(file, what, str(error)) from error
    except (Exception, SystemExit) as error:  # a wrong size in the file may raise MemoryError
        raise _unreadable(file, what, str(error).strip() or type(error).__name__) from error


def _unreadable(file: Path, what: str, reason: str) -> FormatError:
    message = f"{file} must be {what} of the kind that its name says ({file.suffix}); it cannot be read: {reason}"
    return FormatError(message, where=str(file))


def read_grid(file: Path, what: str) -> Grid:
    """Return the content of a file that one of `GRID_READERS` reads, or of a .vtp.

    `what`: what it must be, for messages: "mesh", "surface". Raises `FormatError` if it cannot be read.
    """
    reader = GRID_READERS.get(file.suffix.lower(), read_vtk_xml)
    checked = mesh_file(file, what)
    with reading(checked, f"a {what}"):
        return reader(checked)
