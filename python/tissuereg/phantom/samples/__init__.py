"""Sample files to try tissuereg on, made by ``tools/samples.py``: a surface, a segmentation, an experiment."""

import os
import shutil
from pathlib import Path

from tissuereg._base.arguments import place
from tissuereg.io.atomic import OutputError, atomic_folder

_DATA = Path(__file__).resolve().parent / "data"

#: Folders that `write_samples` writes.
SAMPLES = ("surface", "scan", "rig")


def write_samples(out: str | os.PathLike[str]) -> list[str]:
    """Write the sample files, all or none; return their paths relative to the folder `out`, with forward slashes.

    The folder ``surface`` gets ``organ.stl``, ``markers.csv``, ``targets.csv`` and ``truth.csv`` (the true places of
    the targets), the folder ``scan`` the same organ as ``segmentation.seg.nrrd`` with ``markers.mrk.json`` and
    ``measured.mrk.json`` (points of 3D Slicer), the folder ``rig`` an experiment and ``truth.json`` (the physical
    effect that is in its data and not in its model). Files of other names stay. Raises OutputError if `out` is a file,
    a file of one of these names stands there with other content, or the operating system refuses.
    """
    files = sorted(path.relative_to(_DATA) for name in SAMPLES for path in (_DATA / name).rglob("*") if path.is_file())
    for file in files:
        standing = place("out", out, error=OutputError) / file
        if standing.exists() and not (standing.is_file() and standing.read_bytes() == (_DATA / file).read_bytes()):
            message = f"{standing} must be absent: it has another content than the sample of that name"
            raise OutputError(message, where=str(standing))
    with atomic_folder(out) as draft:
        for file in files:
            (draft / file).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(_DATA / file, draft / file)
    return [file.as_posix() for file in files]
