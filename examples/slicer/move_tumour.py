"""For the Python console of 3D Slicer: a segmentation and two point lists of the scene, and where all of it is now.

    exec(open("move_tumour.py").read())
    moved = move("segmentation", ["organ", "lesion"], "markers", "measured", fixed="plane 0 0 1 -18 2.5")

The words are names of nodes. The command ``tissuereg`` runs in a process of its own, with the environment that Slicer
was started from: Slicer's Python needs no package. What comes back is loaded into the scene: the segmentation as it is
now, the motion as a transform, moved models, and targets with their spread in their descriptions.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import slicer

#: Exit code of ``register`` for an answer that was written and is not to be trusted.
DOUBTFUL = 4


def tissuereg(*words: object) -> int:
    """Run the command and return its exit code; raise `RuntimeError` with its words if it made nothing.

    The command is that of the variable TISSUEREG, such as /home/me/venv/bin/tissuereg, or else the one on the path.
    """
    environment = slicer.util.startupEnvironment()
    command = os.environ.get("TISSUEREG") or shutil.which("tissuereg", path=environment.get("PATH", ""))
    if command is None:
        message = "tissuereg is not on the path: set os.environ['TISSUEREG'] to the command of its environment"
        raise RuntimeError(message)
    done = subprocess.run([command, *map(str, words)], env=environment, capture_output=True, text=True, check=False)
    print(done.stdout)
    if done.returncode not in (0, DOUBTFUL):
        message = f"tissuereg {words[0]} ended with {done.returncode}: {' '.join(done.stderr.split())}"
        raise RuntimeError(message)
    return done.returncode


def exported(name: str, file: Path) -> Path:
    """Write a node of the scene into a file, where it is in the world, and return the file."""
    slicer.util.exportNode(slicer.util.getNode(name), str(file), world=True)
    return file


def move(
    segmentation: str,
    labels: Sequence[str],
    before: str,
    after: str,
    *,
    fixed: str | None = None,
    size_mm: float = 7.0,
    targets: str | None = None,
    models: Sequence[str] = (),
    volume: str | None = None,
    folder: str | None = None,
) -> dict[str, Any]:
    """Register the body of some segments to its markers and load what has moved; return the new nodes by name.

    Parameters
    ----------
    segmentation : str
        Node of the undeformed organ; its segments must not overlap.
    labels : sequence of str
        Segments that together make the body.
    before, after : str
        Point lists: markers on the undeformed organ, and where they were seen, with the same labels.
    fixed : str, optional
        Rule for what is held, mm, LPS: ``"plane nx ny nz d tol"`` or ``"ball x y z r"``. Without it the body is free.
    size_mm : float
        Edges of the tetrahedra: a third of the thinnest part that bends is a good start.
    targets : str, optional
        Point list of places in the undeformed organ; it comes back where they are now.
    models : sequence of str
        Models of the undeformed organ that are moved, too.
    volume : str, optional
        The scan. The transform gets its grid, and the volume is put below it.
    folder : str, optional
        Where files are kept; a new temporary folder where none is named.
    """
    place = Path(folder or tempfile.mkdtemp(prefix="tissuereg-"))
    place.mkdir(parents=True, exist_ok=True)
    labelled = exported(segmentation, place / "segmentation.seg.nrrd")
    of_body = [word for label in labels for word in ("--label", label)] + (["--fixed", fixed] if fixed else [])
    tissuereg("mesh", labelled, "--size", size_mm, *of_body, "--out", place / "body.vtu")
    words = ["--measured", exported(after, place / "after.mrk.json"), *([] if fixed else ["--held", "free"])]
    if targets:
        words += ["--targets", exported(targets, place / "targets.mrk.json")]
    out = place / "registered"
    if tissuereg("register", place / "body.vtu", exported(before, place / "before.mrk.json"), *words, "--out", out):
        reasons = json.loads((out / "registration.json").read_text(encoding="utf-8"))["trust"]["reasons"]
        slicer.util.warningDisplay("Do not trust this registration: " + "; ".join(reasons))
    like = labelled if volume is None else exported(volume, place / "volume.nrrd")
    tissuereg("warp", out, "--labels", labelled, "--out", place / "moved.seg.nrrd")
    tissuereg("warp", out, "--grid", place / "field.h5", "--like", like)
    nodes = {
        "segmentation": slicer.util.loadSegmentation(str(place / "moved.seg.nrrd")),
        "transform": slicer.util.loadTransform(str(place / "field.h5")),
    }
    for number, model in enumerate(models):
        file = exported(model, place / f"model{number}.ply")
        tissuereg("warp", out, "--surface", file, "--out", place / f"moved{number}.ply")
        nodes[model] = slicer.util.loadModel(str(place / f"moved{number}.ply"))
    if targets:
        nodes["targets"] = slicer.util.loadMarkups(str(out / "targets.mrk.json"))
    if volume is not None:
        slicer.util.getNode(volume).SetAndObserveTransformNodeID(nodes["transform"].GetID())
    return nodes
