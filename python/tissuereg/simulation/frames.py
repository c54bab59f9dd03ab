"""A body through time frames: history, pads that attach and release, springs, a mesh that was imaged under gravity."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissuereg import _core
from tissuereg._base.arrays import FloatArray, IntArray, float_array, index_array
from tissuereg._base.choices import Element
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ConvergenceError, LoadError
from tissuereg.simulation.behaviour import Behaviour, Springs
from tissuereg.simulation.settings import SIZE
from tissuereg.simulation.solve import Simulator


@dataclass(frozen=True, eq=False)
class Pad:
    """A patch of nodes that an actuator holds in some of the frames.

    `name`: key of its forces in the answer; `nodes` (n,): numbers of the nodes of the patch; nodes that are held anyway
    stay where they are; `motion` (n_frames, 3): translation in mm in every frame, relative to the shape of the body
    when the pad attaches. Rows of NaN are frames in which the pad is absent and its nodes are free.
    """

    name: str
    nodes: Any
    motion: Any


@dataclass(frozen=True, eq=False)
class Frames:
    """Equilibria of a body in all time frames; frames without equilibrium are rows of NaN.

    `times` (n_frames,): time of every frame in s; `displacement` (n_frames, n_nodes, 3): displacement of the mesh's
    nodes from the mesh as given, mm; `reactions` (n_frames, n_held, 3): force on the body at every held node, mN;
    `pad_forces` (n_frames, 3): force of every pad on the body by its name, mN; NaN where it is absent; `pad_moments`
    (n_frames, 3): moment of every pad on the body about the mean place of its nodes, mN mm; NaN where it is absent;
    `spring_forces` (n_frames, n_springs, 3): force of every set of springs on the body, mN; `all_displacement`
    (n_frames, n_element_nodes, 3): displacement of all nodes, mm: those of the mesh, then the mid-edge nodes of
    ten-node elements; `rest_nodes` (n_nodes, 3): places of the nodes of the unloaded body, mm: those of the mesh unless
    it was given in its shape under its weight; `failed`: frames without equilibrium, with the reason; the history
    continues from the previous frame; `reports`: record of the work, one per frame; empty for a frame that failed.
    """

    times: FloatArray
    displacement: FloatArray
    reactions: FloatArray
    pad_forces: dict[str, FloatArray]
    pad_moments: dict[str, FloatArray]
    spring_forces: FloatArray
    all_displacement: FloatArray
    rest_nodes: FloatArray
    failed: list[tuple[int, str]]
    reports: list[dict[str, Any]]


@dataclass(frozen=True, eq=False)
class KeptRig:
    """A cached rig (an analysed body with pads, in some state of its history) from which others are made.

    `mesh`: mesh of the body; `spreader`: simulator of the same mesh that turns tractions into nodal forces and never
    solves; `rig`: the compiled rig, in the frame in which it was last used.
    """

    mesh: Mesh
    spreader: Simulator
    rig: _core.Rig


#: Rigs by all but material, behaviour and loads.
Rigs = dict[tuple[object, ...], KeptRig]


@dataclass(frozen=True, eq=False)
class Acting:
    """Loads, pads and supports that act on a body through its frames.

    `loads`: one load for all frames, or one per frame; None is no load. Its prescribed displacements are those of the
    held nodes, mm; `pads`: patches that are held in some frames; `springs`: springs under the surface; they can support
    the body without held nodes; `weight` (3,): body force in all frames, mN/mm^3, added to that of the loads, or None;
    `Material.weight` gives gravity's; `in_reference`: whether the mesh is given in its shape under `weight`, so that
    the unloaded shape is found first; `held_nodes` (n_held,): numbers of the nodes whose displacement is given by the
    loads (zero where absent), by default the node set ``fixed``. Raises `LoadError` if `in_reference` is set without
    `weight`.
    """

    loads: Load | Sequence[Load] | None = None
    pads: Sequence[Pad] = ()
    springs: Sequence[Springs] = ()
    weight: Any = None
    in_reference: bool = False
    held_nodes: Any = None

    def __post_init__(self) -> None:
        if self.in_reference and self.weight is None:
            message = "a mesh can hang in its weight only where `weight` is given"
            raise LoadError(message, where="weight")


@dataclass(frozen=True)
class FrameSettings:
    """Numerical settings of a solve through time frames.

    Parameters
    ----------
    element : {"tet4", "tet4-averaged", "tet10"}
        Four-node tets; four-node tets with volume ratios averaged at the nodes; or ten-node tets on the same edges.
    tolerance : float
        Norm of the residual over the norm of the load at which a frame counts as solved.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    """

    element: Element = "tet4"
    tolerance: float = 1e-9
    threads: int = 0


@dataclass(frozen=True, eq=False)
class Similar:
    """Solutions of similar bodies that save work; they change no answer beyond the tolerance.

    `near`: displacement of all nodes of a similar body, mm, NaN where unknown: (n_frames, n_element_nodes, 3), or a
    dict of such arrays by the name of the case. The initial guess of a frame is the last frame plus the change of that
    body between the two frames. It serves bodies that are solved through time; `rigs`: cache of analysed bodies with
    pads, whose analyses and factors are reused for the same mesh, and to which new ones are added. It serves many
    histories that differ in material and behaviour; bodies with springs or with `Acting.in_reference` are not cached;
    `simulators`: cache of simulators of elastic models, by element and the bytes of the held nodes' numbers. None:
    nothing is reused.
    """

    near: Any = None
    rigs: Rigs | None = None
    simulators: dict[tuple[str, bytes], Simulator] | None = None


def solve_frames(
    mesh: Mesh,
    material: Material,
    times: Any,
    acting: Acting | None = None,
    *,
    behaviour: Behaviour | None = None,
    settings: FrameSettings | None = None,
    similar: Similar | None = None,
    progress: Callable[[int], object] | None = None,
) -> Frames:
    """Return the equilibria of a body in successive time frames.

    The first frame is reached instantaneously (the elastic solution). Between frames, forces and motions change
    linearly; the step to a frame without equilibrium is subdivided. `mesh`: reference shape; its node set ``fixed`` is
    held unless other nodes are; `material`: the elastic law; instantaneous moduli where the stress relaxes; `times`
    (n_frames,): s, never decreasing; `acting`: loads, pads and supports, none by default; `behaviour`: inelastic
    behaviour of the material, none by default; `settings`: elements, tolerance, threads; `similar`: solutions of
    similar bodies to begin from; `progress`: called with the number of frames done. Result: displacements in mm and
    forces in mN, one row per frame, and the frames that failed. Raises `LoadError` if loads, pads and times do not fit
    together; `ConvergenceError` if no frame finds equilibrium, or the mesh has no unloaded shape; `MaterialError`,
    `ShapeError` or `SupportError` if the input does not fit the body.

    Warns
    -----
    LockingWarning
        If Poisson's ratio is above 0.475 somewhere and the elements are ``"tet4"``.

    Examples
    --------
    >>> block = Mesh([[0, 0, 0], [9, 0, 0], [0, 9, 0], [0, 0, 9]], [[0, 1, 2, 3]], {"fixed": [0, 1, 2]})
    >>> push = Pad("tip", [3], [[0, 0, -1.0], [0, 0, -1.0], [np.nan] * 3])
    >>> frames = solve_frames(block, Material(young=10.0), [0.0, 1.0, 2.0], Acting(pads=[push]))
    >>> bool(frames.pad_forces["tip"][1, 2] < 0), bool(abs(frames.displacement[2]).max() < 1e-6)
    (True, True)
    """
    times = float_array("times", times, (None,))
    acting, settings, similar = acting or Acting(), settings or FrameSettings(), similar or Similar()
    n, pads, springs = len(times), acting.pads, tuple(acting.springs)
    each = _one_a_frame(acting.loads, n)
    motions = _motions(pads, n)
    held = mesh.fixed_nodes if acting.held_nodes is None else index_array("held_nodes", acting.held_nodes, (None,))
    body_force = None if acting.weight is None else float_array("weight", acting.weight, (3,))
    plan = _Plan(mesh, held, pads, springs, settings)
    rigs = None if acting.in_reference or springs else similar.rigs
    kept = None if rigs is None else rigs.get(plan.key)
    if kept is None or kept.mesh is not mesh:
        # Distributes tractions over nodes and holds the moduli; it never solves.
        spreader = Simulator(mesh, element=settings.element, held_nodes=np.arange(mesh.n_nodes))
        built = plan.build(spreader, material, behaviour, body_force if acting.in_reference else None)
        kept = KeptRig(mesh, spreader, built)
    spreader, rig = kept.spreader, kept.rig
    if rigs is not None:
        # What is kept is never advanced: nobody waits for it, and it remembers no frames.
        young, poisson = spreader.moduli(material)
        rig = rig.again(young, poisson, law=material.core_law(), behaviour=_core_behaviour(behaviour))
        rigs.pop(plan.key, None)
        rigs[plan.key] = kept
        for oldest in list(rigs)[: -SIZE.rigs_kept]:
            rigs.pop(oldest, None)
    guides = None if similar.near is None else float_array("near", similar.near, (n, spreader.body.n_nodes, 3))
    last = -1
    answer = _empty(times, mesh.n_nodes, spreader.body.n_nodes, len(held), [pad.name for pad in pads], len(springs))
    for frame, (time, load) in enumerate(zip(times, each, strict=True)):
        parts = spreader.load_parts(load, len(held))
        both = [force for force in (parts["body_force"], body_force) if force is not None]
        parts["body_force"] = np.sum(both, axis=0) if both else None
        change = None if guides is None or last < 0 else guides[frame] - guides[last]
        if change is not None and not np.isfinite(change).all():
            change = None
        try:
            found = rig.advance(float(time), motions[frame], change=change, **parts)
        except ConvergenceError as error:
            answer.failed.append((frame, str(error)))
            answer.reports.append({})
        else:
            _keep(answer, frame, found)
            last = frame
        if progress is not None:
            progress(frame + 1)
    if len(answer.failed) == n > 0:
        message = f"some frame must find equilibrium; none does: {answer.failed[0][1]}"
        raise ConvergenceError(message, where="frame 0")
    return replace(answer, rest_nodes=rig.rest_nodes[: mesh.n_nodes].copy())


@dataclass(frozen=True, eq=False)
class _Plan:
    """Everything that defines a rig (an analysed body with pads) except its material.

    `mesh`: reference shape; `held` (n_held,): numbers of the held nodes; `pads`: patches that are held in some frames;
    `springs`: sets of springs under the surface; `settings`: elements, tolerance, threads.
    """

    mesh: Mesh
    held: IntArray
    pads: Sequence[Pad]
    springs: tuple[Springs, ...]
    settings: FrameSettings

    @property
    def key(self) -> tuple[object, ...]:
        """Cache key of a rig without springs on one mesh: bytes of the held nodes, pads and settings."""
        patches = tuple((pad.name, np.asarray(pad.nodes).tobytes()) for pad in self.pads)
        return (self.held.tobytes(), patches, self.settings)

    def build(
        self, spreader: Simulator, material: Material, behaviour: Behaviour | None, hangs_in: FloatArray | None
    ) -> _core.Rig:
        """Return a new compiled rig (body with pads, springs and behaviour) in its state before the first frame.

        `spreader`: simulator of the same mesh that checks the moduli; `material`: the elastic law; `behaviour`:
        inelastic behaviour, if any; `hangs_in` (3,) or None: body force in mN/mm^3 under which the mesh was imaged.
        """
        young, poisson = spreader.moduli(material)
        body = _core.Body(
            self.mesh.nodes,
            self.mesh.tets,
            self.held,
            element=self.settings.element,
            springs=[one.as_tuple() for one in self.springs],
            rests=len(self.springs) > 0,
        )
        return _core.Rig(
            body,
            young,
            poisson,
            law=material.core_law(),
            pads=[index_array(f"nodes of pad '{pad.name}'", pad.nodes, (None,)) for pad in self.pads],
            behaviour=_core_behaviour(behaviour),
            hangs_in=hangs_in,
            tolerance=self.settings.tolerance,
            threads=self.settings.threads,
        )


def _core_behaviour(behaviour: Behaviour | None) -> _core.Behaviour | None:
    return None if behaviour is None else behaviour.core()


def _one_a_frame(loads: Load | Sequence[Load] | None, n_frames: int) -> list[Load]:
    if loads is None or isinstance(loads, Load):
        return [loads or Load()] * n_frames
    if len(loads) != n_frames:
        message = f"there must be one load per frame, got {len(loads)} for {n_frames}"
        raise LoadError(message, where="loads")
    return list(loads)


def _motions(pads: Sequence[Pad], n_frames: int) -> FloatArray:
    names = [pad.name for pad in pads]
    if len(set(names)) < len(names):
        message = f"pads must have different names, got {', '.join(names)}"
        raise LoadError(message, where="pads")
    motions = np.empty((n_frames, len(pads), 3))
    for k, pad in enumerate(pads):
        motions[:, k] = float_array(f"motion of pad '{pad.name}'", pad.motion, (n_frames, 3))
        missing = np.isnan(motions[:, k])
        if (missing.any(axis=1) != missing.all(axis=1)).any():
            frame = int(np.flatnonzero(missing.any(axis=1) != missing.all(axis=1))[0])
            message = f"the motion of pad '{pad.name}' must be known along all axes or none, not so in frame {frame}"
            raise LoadError(message, where=f"pad '{pad.name}'")
    return motions


def _empty(
    times: FloatArray, n_nodes: int, n_element_nodes: int, n_held: int, pads: list[str], n_springs: int
) -> Frames:
    n = len(times)
    everything = np.full((n, n_element_nodes, 3), np.nan)
    return Frames(
        times,
        everything[:, :n_nodes],
        np.full((n, n_held, 3), np.nan),
        {name: np.full((n, 3), np.nan) for name in pads},
        {name: np.full((n, 3), np.nan) for name in pads},
        np.full((n, n_springs, 3), np.nan),
        everything,
        np.empty((0, 3)),
        [],
        [],
    )


def _keep(answer: Frames, frame: int, found: _core.RigFrame) -> None:
    # The displacement of the mesh's nodes is a view of this.
    answer.all_displacement[frame] = found.displacement
    answer.reactions[frame] = found.reactions
    answer.spring_forces[frame] = found.spring_forces
    for k, name in enumerate(answer.pad_forces):
        answer.pad_forces[name][frame] = found.pad_forces[k]
        answer.pad_moments[name][frame] = found.pad_moments[k]
    answer.reports.append(found.report)
