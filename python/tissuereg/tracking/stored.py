"""A track on disk: its reader, and the transform with time that it makes."""

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tissuereg._base.arguments import place
from tissuereg._base.arrays import FloatArray
from tissuereg._base.provenance import reads
from tissuereg.body.mesh import Mesh
from tissuereg.body.surroundings import SpaceMap
from tissuereg.errors import FormatError
from tissuereg.imaging.sequences import write_sequence
from tissuereg.imaging.transforms import Written
from tissuereg.io.bounds import existing_file
from tissuereg.io.fields import open_npz
from tissuereg.io.meshes import mesh_from_archive
from tissuereg.io.problems import times_and_fields

#: File of a track's folder that holds its fields.
FIELDS = "fields.npz"


@dataclass(frozen=True, eq=False)
class StoredTrack:
    """The fields of a track that was read from its folder.

    Attributes
    ----------
    mesh : Mesh
        The undeformed body.
    times : ndarray of float64, shape (n_frames,)
        Of the frames, s.
    displacement : ndarray of float64, shape (n_frames, n_nodes, 3)
        Of the nodes, mm.
    """

    mesh: Mesh
    times: FloatArray
    displacement: FloatArray

    def transform(
        self, path: str | os.PathLike[str], *, like: Any = None, spacing: Any = None, threads: int = 0
    ) -> Written:
        """Write the fields as one grid transform with time, which 3D Slicer reads.

        Parameters
        ----------
        path : path-like
            A file ``.seq.nrrd``. Displacements lead from places before the deformation to those after it.
        like : path-like, optional
            Image whose grid is taken.
        spacing : float, optional
            Spacing in mm of a grid over the body and around it, in place of `like`.
        threads : int
            Threads to use; 0 takes all cores.

        Returns
        -------
        Written
            The file, and how far voxels moved.

        Raises
        ------
        ArgumentError
            If not one of `like` and `spacing` is given, or all grids together have too many voxels.
        FormatError
            If `path` ends otherwise, or the image cannot be read.
        """
        spaces = (SpaceMap(self.mesh, field) for field in self.displacement)
        return write_sequence(path, self.times.tolist(), spaces, like=like, spacing=spacing, threads=threads)

    def __repr__(self) -> str:
        first, last = self.times[0], self.times[-1]
        return f"StoredTrack({self.mesh.n_nodes} nodes, {len(self.times)} frames from {first:g} to {last:g} s)"


@reads
def read_track(folder: str | os.PathLike[str]) -> StoredTrack:
    """Read the fields that ``tissuereg track --fields`` wrote.

    Parameters
    ----------
    folder : path-like
        Folder with ``fields.npz``.

    Returns
    -------
    StoredTrack
        Body, times and displacements.

    Raises
    ------
    FormatError
        If the file is missing, spoilt, or holds no mesh.
    """
    file = place("folder", folder, error=FormatError) / FIELDS
    if not file.is_file() and Path(folder).is_dir():
        message = f"{file} must be there: track with --fields"
        raise FormatError(message, where=str(file))
    with open_npz(existing_file(file)) as archive:
        mesh = mesh_from_archive(archive)
        return StoredTrack(mesh, *times_and_fields(archive, mesh.n_nodes, least=1))


__all__ = ["FIELDS", "StoredTrack", "read_track"]
