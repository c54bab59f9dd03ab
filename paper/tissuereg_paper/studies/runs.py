"""What a method did on a rig, and files that keep it, so that a contest of hours goes on where it was stopped."""

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg import __version__
from tissuereg._base.arguments import place
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.fields import open_npz, write_npz
from tissuereg_paper.studies.rigs import Rig


@dataclass(frozen=True, eq=False)
class Run:
    """What a method did on one rig under one condition.

    Attributes
    ----------
    method, condition, rig : str
        Names.
    scenario : int
    times_s : ndarray of float64, shape (n_scored,)
        Of the scored frames.
    sensor_mm, inner_mm : ndarray of float64, shapes (n_scored,), (n_scored, n_inner)
        Distance of the sensor and the inner points from where they are.
    coverage90 : float or None
        Share of the components of inner points whose 90 % interval holds the truth, where the method gives a spread.
    ms : float
        Median processor time of a frame.
    frames, failed : int
        Frames that it was given, and those among them that it could not register: the simulation counts there.
    """

    method: str
    condition: str
    rig: str
    scenario: int
    times_s: FloatArray
    sensor_mm: FloatArray
    inner_mm: FloatArray
    coverage90: float | None
    ms: float
    frames: int
    failed: int


#: The parts of a run that are no arrays.
_FACTS = ("method", "condition", "rig", "scenario", "coverage90", "ms", "frames", "failed")


class KeptRuns:
    """Runs in a folder, one file each, written whole.

    Parameters
    ----------
    folder : path-like, optional
        Made where it is missing; without one nothing is kept.
    key_of : callable of (Rig, str) -> mapping of str to object
        What the run of a method on a rig depends on besides the recording and the condition; a file of another key, or
        of other software, is not taken.
    """

    def __init__(self, folder: str | os.PathLike[str] | None, key_of: Callable[[Rig, str], Mapping[str, Any]]) -> None:
        self._folder = None if folder is None else place("keep", folder)
        self._key_of_run = key_of

    def read(self, rig: Rig, condition: str, method: str) -> Run | None:
        """Return a run that is kept, or None."""
        path = self._path(rig, condition, method)
        if path is None or not path.exists():
            return None
        try:
            with open_npz(path) as file:
                kept = json.loads(str(file.raw("facts")[()]))
                if kept.pop("key") != self._key_of(rig, method):
                    return None
                away = file.floats("inner_mm", None, None)
                return Run(
                    times_s=file.floats("times_s", len(away)),
                    sensor_mm=file.floats("sensor_mm", len(away)),
                    inner_mm=away,
                    **{name: kept[name] for name in _FACTS},
                )
        except (FormatError, ValueError, KeyError, AttributeError):
            return None  # spoilt: it is made anew

    def write(self, rig: Rig, run: Run) -> None:
        """Keep a run."""
        path = self._path(rig, run.condition, run.method)
        if path is None:
            return
        path.parent.mkdir(parents=True, exist_ok=True)
        facts = {name: getattr(run, name) for name in _FACTS} | {"key": self._key_of(rig, run.method)}
        arrays = {name: getattr(run, name) for name in ("times_s", "sensor_mm", "inner_mm")}
        write_npz(path, {**arrays, "facts": json.dumps(facts)})

    def _path(self, rig: Rig, condition: str, method: str) -> Path | None:
        words = "".join(c if c.isalnum() else "-" for c in method)
        return None if self._folder is None else self._folder / f"{rig.name}--{condition}--{words}.npz"

    def _key_of(self, rig: Rig, method: str) -> dict[str, Any]:
        parts = (rig.reference_mm, rig.motion, rig.marker_levels_mm, rig.sensor_levels_mm, rig.inner_levels_mm)
        data = b"".join(np.ascontiguousarray(part).tobytes() for part in (*parts, rig.pad_forces, rig.strokes_mm))
        digest = hashlib.sha256(data).hexdigest()[:16]
        return {**self._key_of_run(rig, method), "version": __version__, "rig_digest": digest}
