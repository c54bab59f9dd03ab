"""What ``[simulated]`` is about: a hash of mesh and tables, by which a statement copied to other data is recognised."""

import hashlib
from collections.abc import Iterator
from pathlib import Path

from tissuereg.io.bounds import FILES, existing_file
from tissuereg.io.experiment_keys import CSV_TABLES, TARGETS_CSV


def tables_sha256(folder: Path, mesh_file: Path) -> str:
    """Return the SHA-256 of what `diagnose` compares: the mesh, and the tables of a folder but that of targets.

    `folder`: folder of the comma-separated tables; those that are absent do not count; `mesh_file`: file of the mesh.
    Line ends of tables count alike. Raises `FormatError` if a file cannot be read or is too large.
    """
    whole = hashlib.sha256()
    for name, content in _contents(folder, mesh_file):
        whole.update(f"{name} {hashlib.sha256(content).hexdigest()}\n".encode())
    return whole.hexdigest()


def _contents(folder: Path, mesh_file: Path) -> Iterator[tuple[str, bytes]]:
    yield "mesh", existing_file(mesh_file, FILES.mesh_mb).read_bytes()
    for file in sorted(table.file for table in CSV_TABLES if table is not TARGETS_CSV):
        if (folder / file).exists():
            yield file, existing_file(folder / file, FILES.table_mb).read_bytes().replace(b"\r\n", b"\n")
