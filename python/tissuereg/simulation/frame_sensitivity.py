"""Derivatives of the frames of a history by causes, and of observations by the stiffness of every point.

The derivatives are exact, with one factorisation per step for all causes and all observations; the material's memory is
differentiated too. At a switch (first loading of a softening material, slack fibres) the derivative is one-sided.
Frames are recorded by ``FrameSettings(record=True)``.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, IntArray, float_array
from tissuereg.body.load import Load
from tissuereg.errors import LoadError
from tissuereg.simulation.frames import Frames, Record
from tissuereg.simulation.sensitivity import Cause, Observation, core_cause, core_observation
from tissuereg.simulation.solve import stacked_parts


@dataclass(frozen=True, eq=False)
class Loads:
    """Directional changes of the loads, one per frame.

    Parameters
    ----------
    rates : sequence of Load
        Changes of the loads per unit of the cause.
    """

    rates: Sequence[Load]


@dataclass(frozen=True, eq=False)
class Motion:
    """A directional change of the motion of a pad.

    Parameters
    ----------
    pad : str
        Its name.
    rates : array_like of float, shape (n_frames, 3)
        Changes of its translation, mm per unit of the cause; frames in which it is absent are ignored.
    """

    pad: str
    rates: Any


#: Causes by which frames can be differentiated.
FrameCause = Cause | Loads | Motion


@dataclass(frozen=True, eq=False)
class FrameObservation:
    """A scalar observation of one frame.

    Parameters
    ----------
    frame : int
        Its number.
    observation : Observation
        Weights of displacements and reactions.
    pad_weights : mapping of str to array_like of float, shape (3,)
        Weights of the forces of pads, by their names.
    """

    frame: int
    observation: Observation = field(default_factory=Observation)
    pad_weights: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class FrameDerivatives:
    """Derivatives of frames by each cause, per unit of the cause; NaN for frames that failed.

    Attributes
    ----------
    displacement : ndarray of float64, shape (n_causes, n_frames, n_nodes, 3)
        Of the mesh's nodes, mm.
    reactions : ndarray of float64, shape (n_causes, n_frames, n_held, 3)
        Of the force on the body at every held node, mN.
    pad_forces : dict of str to ndarray of float64, shape (n_causes, n_frames, 3)
        Of the force of every pad on the body, mN; NaN where it is absent.
    """

    displacement: FloatArray
    reactions: FloatArray
    pad_forces: dict[str, FloatArray]


@dataclass(frozen=True, eq=False)
class FrameAdjoints:
    """Derivatives of observations by the stiffness of every point, through all earlier frames.

    Attributes
    ----------
    young : ndarray of float64, shape (n_obs, n_tets, n_points)
        Derivative by Young's modulus of every quadrature point, per kPa.
    poisson : ndarray of float64, shape (n_obs, n_tets, n_points)
        By Poisson's ratio of every quadrature point.
    """

    young: FloatArray
    poisson: FloatArray


def frame_derivatives(frames: Frames, causes: Sequence[FrameCause]) -> FrameDerivatives:
    """Return the derivatives of all frames by each cause.

    Parameters
    ----------
    frames : Frames
        Found by ``FrameSettings(record=True)``.
    causes : sequence of Parameter, Field, Load, Loads or Motion
        Causes; the cost is one solution each per step.

    Returns
    -------
    FrameDerivatives
        One entry per cause, in their order. The shape that pads are bonded to moves with the body; the unloaded shape
        of a mesh that was imaged under its weight is kept fixed.

    Raises
    ------
    LoadError
        If frames were not recorded, or a pad is unknown.
    MaterialError
        If the law, the behaviour or the surface does not have a parameter.
    ConvergenceError
        If a frame is no stable equilibrium.
    LoadError, ShapeError
        If rates do not fit body and frames.

    Examples
    --------
    >>> from tissuereg import Material, Mesh
    >>> from tissuereg.simulation.behaviour import Behaviour, Relaxation
    >>> from tissuereg.simulation.frames import Acting, FrameSettings, Pad, solve_frames
    >>> from tissuereg.simulation.sensitivity import Parameter
    >>> block = Mesh([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1, 2, 3]], {"fixed": [0, 1, 2]})
    >>> push, slow = Pad("tip", [3], [[0, 0, -1.0]] * 2), Behaviour(relaxation=Relaxation([0.3], [2.0]))
    >>> acting, settings = Acting(pads=[push]), FrameSettings(record=True)
    >>> found = solve_frames(block, Material(), [0.0, 50.0], acting, behaviour=slow, settings=settings)
    >>> by_share = frame_derivatives(found, [Parameter("relaxation.g")]).pad_forces["tip"][0, :, 2]
    >>> bool(abs(by_share[0]) < 1e-12), bool(abs(by_share[1] + found.pad_forces["tip"][0, 2]) < 1e-6)
    (True, True)
    """
    record, good = _recorded(frames)
    displacement, reactions, pads = record.rig.derivatives(
        [_frame_cause(frames, record, good, cause) for cause in causes]
    )
    n_nodes = frames.displacement.shape[1]
    forces = {name: _all_frames(frames, good, pads[:, :, k]) for k, name in enumerate(record.pads)}
    return FrameDerivatives(
        _all_frames(frames, good, displacement[:, :, :n_nodes]), _all_frames(frames, good, reactions), forces
    )


def frame_adjoints(frames: Frames, observations: Sequence[FrameObservation]) -> FrameAdjoints:
    """Return the derivatives of observations of frames by the stiffness of every point.

    Parameters
    ----------
    frames : Frames
        Found by ``FrameSettings(record=True)``.
    observations : sequence of FrameObservation
        Observations; the cost is one solution each per step.

    Returns
    -------
    FrameAdjoints
        One entry per observation, in their order.

    Raises
    ------
    LoadError
        If frames were not recorded, a frame was not found, or a node or pad does not exist or is not held.
    ShapeError
        If there is not one row of weights per node.
    """
    record, good = _recorded(frames)
    numbers = {int(frame): number for number, frame in enumerate(good)}
    seen = []
    for one in observations:
        if one.frame not in numbers:
            message = f"an observation must be of a frame that was found, got frame {one.frame} of {len(frames.times)}"
            raise LoadError(message, where=f"frame {one.frame}")
        nodes, weights, held, held_weights = core_observation(one.observation)
        pads = np.array([_pad(record, name) for name in one.pad_weights], dtype=np.int64)
        rows = [float_array(f"weights of pad '{name}'", row, (3,)) for name, row in one.pad_weights.items()]
        pad_weights = np.reshape(rows, (-1, 3)).astype(np.float64)
        seen.append((numbers[one.frame], (nodes, weights), (held, held_weights), (pads, pad_weights)))
    return FrameAdjoints(*record.rig.adjoints(seen))


def _recorded(frames: Frames) -> tuple[Record, IntArray]:
    """Return the record of frames, and the indices of those that were found."""
    if frames.record is None:
        message = "frames must be recorded for derivatives: `FrameSettings(record=True)`"
        raise LoadError(message, where="frames")
    lost = {frame for frame, _ in frames.failed}
    return frames.record, np.array([k for k in range(len(frames.times)) if k not in lost], dtype=np.int64)


def _all_frames(frames: Frames, good: IntArray, found: FloatArray) -> FloatArray:
    """Return rows of all frames, NaN for those that were not found."""
    rows = np.full((found.shape[0], len(frames.times), *found.shape[2:]), np.nan)
    rows[:, good] = found
    return rows


def _pad(record: Record, name: str) -> int:
    if name not in record.pads:
        message = f"there is no pad '{name}'; there are {', '.join(record.pads) or 'none'}"
        raise LoadError(message, where=f"pad '{name}'")
    return record.pads.index(name)


def _frame_cause(frames: Frames, record: Record, good: IntArray, cause: FrameCause) -> _core.Cause:
    """Return a cause of frames as the compiled solver takes it: rates of the frames that were found."""
    n_frames = len(frames.times)
    if isinstance(cause, Motion):
        number = _pad(record, cause.pad)
        rates = float_array(f"rates of pad '{cause.pad}'", cause.rates, (n_frames, 3))[good]
        absent = np.isnan(frames.pad_forces[cause.pad][good])
        return _core.Cause.motion(number, np.where(absent, 0.0, rates))
    if isinstance(cause, Loads):
        if len(cause.rates) != n_frames:
            message = f"there must be one rate of the load per frame, got {len(cause.rates)} for {n_frames}"
            raise LoadError(message, where="loads")
        parts = [record.spreader.load_parts(cause.rates[frame], record.n_held) for frame in good]
        return _core.Cause.loads(len(good), **stacked_parts(parts))
    if isinstance(cause, Load):
        return _core.Cause.load(**record.spreader.load_parts(cause, record.n_held))
    return core_cause(record.spreader, cause)
