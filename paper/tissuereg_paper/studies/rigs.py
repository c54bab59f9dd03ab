"""Recordings of phantom rigs (the paper's Fig. 9): what the actuators did, what the markers did, and the truth inside.

``bench/twin`` makes such files with another solver. A file holds the displacements at a few shares of the
actuators' strokes; a body without memory moves along them, so that every frame lies on the spline through them.
"""

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._base.arguments import place
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import FormatError
from tissuereg.io.fields import Archive, open_npz


@dataclass(frozen=True, eq=False)
class Pad:
    """Pad of a linear actuator that sticks to the skin, as a user knows it.

    Attributes
    ----------
    centre_mm : ndarray of float64, shape (3,)
        Where it touches the undeformed skin.
    stroke_mm : ndarray of float64, shape (3,)
        Its largest motion.
    radius_mm : float
    """

    centre_mm: FloatArray
    stroke_mm: FloatArray
    radius_mm: float


@dataclass(frozen=True, eq=False)
class Rig:
    """One rig with its recording.

    Attributes
    ----------
    name : str
        Of its file.
    scenario, seed : int
        1: one actuator, along x; 2: two, along x and y.
    pads : tuple of Pad
    frame_s : float
        Time between frames, s.
    motion : ndarray of float64, shape (n_frames,)
        Share of the strokes at every frame.
    reference_mm, sensor_mm, inner_mm : ndarray of float64, shapes (n_markers, 3), (3,), (n_inner, 3)
        Places on and in the undeformed body.
    shares : ndarray of float64, shape (n_levels,)
        Shares of the strokes with a stored equilibrium, growing from above 0.
    marker_levels_mm, sensor_levels_mm, inner_levels_mm : ndarray of float64, shapes (n_levels, ..., 3)
        True displacements there.
    pad_forces : ndarray of float64, shape (n_levels, n_pads, 3)
        Force of each pad on the body there in mN, as its actuator measures it.
    truth : mapping of str to object
        What is true of the rig and not known to any method.
    """

    name: str
    scenario: int
    seed: int
    pads: tuple[Pad, ...]
    frame_s: float
    motion: FloatArray
    reference_mm: FloatArray
    sensor_mm: FloatArray
    inner_mm: FloatArray
    shares: FloatArray
    marker_levels_mm: FloatArray
    sensor_levels_mm: FloatArray
    inner_levels_mm: FloatArray
    pad_forces: FloatArray
    truth: Mapping[str, Any]

    def at_frames(self, levels: FloatArray) -> FloatArray:
        """Return displacements at every frame (n_frames, ...) from those at the shares (n_levels, ...), mm."""
        known = np.concatenate([np.zeros_like(levels[:1]), levels])
        return on_spline(np.concatenate([[0.0], self.shares]), known, self.motion)

    @property
    def strokes_mm(self) -> FloatArray:
        """Strokes of the pads, shape (n_pads, 3)."""
        return np.array([pad.stroke_mm for pad in self.pads])

    def push(self, forces: FloatArray) -> FloatArray:
        """Return how hard the pads push along their strokes together (n,), from their forces (n, n_pads, 3), mN."""
        along = self.strokes_mm / np.linalg.norm(self.strokes_mm, axis=1, keepdims=True)
        return np.asarray(np.einsum("lpx,px->l", forces, along))


def on_spline(places: FloatArray, values: FloatArray, wanted: FloatArray) -> FloatArray:
    """Return values (k, ...) at wanted places (k,), on the cubic spline through values (n, ...) at places (n,)."""
    from scipy.interpolate import CubicSpline

    return np.asarray(CubicSpline(places, values)(wanted))


def inverted(places: FloatArray, values: FloatArray, wanted: FloatArray, n_fine: int) -> tuple[FloatArray, float]:
    """Return places (k,) from 0 on where the spline through growing values (n,) has wanted ones, and the largest value.

    Parameters
    ----------
    places, values : ndarray of float64, shape (n,)
        The first place is 0.
    wanted : ndarray of float64, shape (k,)
        Beyond the largest value: the last place.
    n_fine : int
        Points of the curve between which it is linear.
    """
    fine = np.linspace(0.0, places[-1], n_fine)
    # Rounding, or a body that gives way, must not turn the curve around.
    along = np.maximum.accumulate(on_spline(places, values, fine))
    return np.asarray(np.interp(wanted, along, fine)), float(along[-1])


def read_rig(path: str | os.PathLike[str]) -> Rig:
    """Read one rig.

    Parameters
    ----------
    path : path-like
        An .npz file of ``bench/twin``; `pages/phantom-experiment.md` lists its arrays.

    Returns
    -------
    Rig

    Raises
    ------
    FormatError
        If the file is missing or spoilt, or an array of it is not as stated.
    """
    with open_npz(path) as file:
        centres = file.floats("pad_centre_mm", None, 3)
        directions, n = file.floats("pad_direction", len(centres), 3), len(centres)
        radii, strokes = file.floats("pad_radius_mm", n), file.floats("pad_stroke_mm", n)
        reference, inner = file.floats("markers_mm", None, 3), file.floats("inner_mm", None, 3)
        shares, motion = file.floats("shares", None), file.floats("motion", None)
        if not (len(shares) > 1 and shares[0] > 0.0 and (np.diff(shares) > 0.0).all()):
            message = f"array 'shares' in {path} must be two or more growing numbers above 0, got {shares.tolist()}"
            raise FormatError(message, where=f"{path}:shares")
        if not (len(motion) and motion.min() >= 0.0 and motion.max() <= shares[-1]):
            message = f"array 'motion' in {path} must be shares from 0 to {shares[-1]:g}, the last of 'shares'"
            raise FormatError(message, where=f"{path}:motion")
        truth = _truth(file)
        return Rig(
            name=Path(path).stem,
            scenario=int(truth["scenario"]),
            seed=int(truth["seed"]),
            pads=tuple(
                Pad(centre, stroke * direction, float(radius))
                for centre, stroke, direction, radius in zip(centres, strokes, directions, radii, strict=True)
            ),
            frame_s=float(file.floats("frame_s")),
            motion=motion,
            reference_mm=reference,
            sensor_mm=file.floats("sensor_mm", 3),
            inner_mm=inner,
            shares=shares,
            marker_levels_mm=file.floats("marker_displacement_mm", len(shares), len(reference), 3),
            sensor_levels_mm=file.floats("sensor_displacement_mm", len(shares), 3),
            inner_levels_mm=file.floats("inner_displacement_mm", len(shares), len(inner), 3),
            pad_forces=file.floats("pad_force_mN", len(shares), n, 3),
            truth=truth,
        )


def read_rigs(folder: str | os.PathLike[str]) -> list[Rig]:
    """Read all rigs of a folder.

    Parameters
    ----------
    folder : path-like
        Holds ``*.npz``.

    Returns
    -------
    list of Rig
        By name.

    Raises
    ------
    FormatError
        If it holds none, or one cannot be read.
    """
    files = sorted(place("data", folder, error=FormatError).glob("*.npz"))
    if not files:
        message = f"{folder} must hold rigs (*.npz); `make -C paper twin` makes those of paper/bench/twin/rigs"
        raise FormatError(message, where=str(folder))
    return [read_rig(file) for file in files]


def _truth(file: Archive) -> dict[str, Any]:
    try:
        truth = json.loads(str(file.raw("truth")[()]))
        whole = {name: int(truth[name]) for name in ("scenario", "seed")}
    except (ValueError, TypeError, KeyError, IndexError) as error:
        message = f"array 'truth' in {file.path} must be JSON with `scenario` and `seed`"
        raise FormatError(message, where=f"{file.path}:truth") from error
    return {**truth, **whole}
