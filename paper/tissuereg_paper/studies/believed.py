"""What is believed of a rig: its simulation, driven as a user would drive it, and markers as a tracker gives them."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg import Load, Material, Mesh, Simulator
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.observe import TargetObservation
from tissuereg.errors import ConvergenceError, FormatError
from tissuereg.registration.learned.model import LatentModel
from tissuereg_paper.rivals import Setting
from tissuereg_paper.studies.rigs import Rig, inverted, on_spline
from tissuereg_paper.studies.variants import RigVariants

#: What everyone believes: the paper's modulus, kPa, and Poisson's ratio of the phantom's data.
BELIEVED = Material(10.0, 0.45)

#: Every so many frames one is scored, while the actuators have gone at least this share of their strokes.
EVERY, LEAST_SHARE = 8, 0.05

#: A believed body that is softer than the true one is pressed farther than that, up to this share of the strokes.
_MOST_SHARE = 2.0

#: A believed body without so many equilibria, rest among them, is none.
_LEAST_LEVELS = 3

#: Points of the curve of force by share that is inverted.
_FINE = 4001


@dataclass(frozen=True)
class Condition:
    """How markers are seen.

    Attributes
    ----------
    name, words : str
        For JSON, and for tables.
    noise_mm : float
        Standard deviation of the tracker in a coordinate, which the methods are told.
    dropped : float
        Share of the markers that are never seen.
    wrong_mm : float
        How far one marker is off in all frames, in a random direction; the methods are not told.
    drive : {"force", "motion"}
        What drives the believed simulation: the measured push of the actuators, or their motion.
    """

    name: str
    words: str
    noise_mm: float = 0.1
    dropped: float = 0.0
    wrong_mm: float = 0.0
    drive: str = "force"


PLAIN = Condition("plain", "all markers, noise 0.1 mm")
MOTION = Condition("motion", "simulation driven by the actuators' motion", drive="motion")
CONDITIONS = (
    PLAIN,
    MOTION,
    *(Condition(f"dropped-{p}", f"{p} % of the markers not seen", dropped=p / 100) for p in (20, 40, 60)),
    Condition("wrong", "one marker wrong by 5 mm", wrong_mm=5.0),
    *(Condition(f"noise-{n}", f"noise {n} mm", noise_mm=n) for n in (0.5, 1.0)),
)


@dataclass(frozen=True, eq=False)
class Path:
    """A body along growing shares of the pads' strokes, at rest first.

    Attributes
    ----------
    shares : ndarray of float64, shape (n,)
    fields_mm : ndarray of float64, shape (n, n_nodes, 3)
        Displacement of the nodes.
    pushes : ndarray of float64, shape (n,)
        How hard the pads push along their strokes together, mN.
    """

    shares: FloatArray
    fields_mm: FloatArray
    pushes: FloatArray

    def fields_at(self, shares: FloatArray) -> FloatArray:
        """Return the fields at shares (k,), on the spline, (k, n_nodes, 3) in mm; beyond the last share, its own."""
        return on_spline(self.shares, self.fields_mm, np.minimum(shares, self.shares[-1]))

    def shares_of(self, pushes: FloatArray) -> FloatArray:
        """Return the shares (k,) at which the body is pushed so hard (k,) in mN; the last one for harder pushes."""
        return inverted(self.shares, self.pushes, pushes, _FINE)[0]


def moved_by_pads(
    pressed: Sequence[IntArray], strokes_mm: FloatArray, fixed: IntArray
) -> tuple[IntArray, FloatArray, IntArray]:
    """Return the nodes whose displacement is given, that at whole strokes, and the pads that move them.

    Parameters
    ----------
    pressed : sequence of ndarray of int64
        Nodes under each pad; of a node under two, the last one's stroke counts.
    strokes_mm : ndarray of float64, shape (n_pads, 3)
        Their strokes.
    fixed : ndarray of int64, shape (n_fixed,)
        Nodes that do not move.

    Returns
    -------
    held : ndarray of int64, shape (n_held,)
        Ascending.
    displacement : ndarray of float64, shape (n_held, 3)
        mm.
    of_pad : ndarray of int64, shape (n_held,)
        Number of the pad, or -1.
    """
    held = np.unique(np.concatenate([fixed, *pressed]))
    displacement, of_pad = np.zeros((len(held), 3)), np.full(len(held), -1)
    for number, (nodes, stroke) in enumerate(zip(pressed, strokes_mm, strict=True)):
        rows = np.searchsorted(held, nodes)
        displacement[rows], of_pad[rows] = stroke, number
    return held, displacement, of_pad


def _further(shares: FloatArray) -> FloatArray:
    """Return shares beyond the last one, as far apart as the last two."""
    step = shares[-1] - shares[-2]
    return np.asarray(np.arange(shares[-1] + step, _MOST_SHARE + 0.5 * step, step))


class Believed:
    """What is believed of a rig: the simulation of its frames, and where the scored points lie in the mesh.

    Parameters
    ----------
    rig : Rig
    mesh : Mesh
        Of the user; its node set ``fixed`` is held.
    threads : int
        Of the solver.
    variants : RigVariants, optional
        Of the simulation; may be given later, as the attribute of this name.

    Notes
    -----
    The surface nodes under a pad, as far as the user knows it, move as one with it; nothing else moves the body. One
    equilibrium is solved at every stored share of the strokes, and at further ones as far as pushes need them and there
    is equilibrium;
    frames lie on the spline through them, and frames beyond the last one at the last one. Driven by motion, a frame is
    at the actuators' own share; driven by force, at the share at which the believed body pushes back as hard as was
    measured.
    """

    def __init__(self, rig: Rig, mesh: Mesh, threads: int = 0, variants: RigVariants | None = None) -> None:
        self.rig, self.mesh, self._threads, self.variants = rig, mesh, threads, variants
        self._simulated: dict[str, FloatArray] = {}
        points = {"sensor": rig.sensor_mm} | {str(k): place for k, place in enumerate(rig.inner_mm)}
        self._points = TargetObservation(mesh, points)

    def at_points(self, field: FloatArray) -> FloatArray:
        """Return a nodal field (n_nodes, 3) at the sensor and the inner points, (1 + n_inner, 3)."""
        return self._points.predict(field[self._points.nodes])

    @cached_property
    def truth_mm(self) -> FloatArray:
        """True displacement of the sensor and the inner points, shape (n_frames, 1 + n_inner, 3)."""
        both = np.concatenate([self.rig.sensor_levels_mm[:, None], self.rig.inner_levels_mm], axis=1)
        return self.rig.at_frames(both)

    @cached_property
    def _pressed(self) -> list[IntArray]:
        fixed, pressed = self.mesh.fixed_nodes, []
        for pad in self.rig.pads:
            nodes = np.setdiff1d(self.mesh.surface_nodes_within(pad.centre_mm, pad.radius_mm), fixed)
            if not len(nodes):
                message = f"{self.rig.name}: a pad must touch the mesh; none of its surface nodes lies under it"
                raise FormatError(message, where=self.rig.name)
            pressed.append(nodes)
        return pressed

    @cached_property
    def path(self) -> "Path":
        """The believed body along the strokes."""
        held, strokes, of_pad = moved_by_pads(self._pressed, self.rig.strokes_mm, self.mesh.fixed_nodes)
        simulator = Simulator(self.mesh, held_nodes=held)
        shares, fields, pushes = [0.0], [np.zeros_like(self.mesh.nodes)], [0.0]
        hardest = float(self.rig.push(self.rig.pad_forces).max())
        for share in (*self.rig.shares, *_further(self.rig.shares)):
            if share > self.rig.shares[-1] and len(pushes) > 1 and pushes[-2] > hardest:
                break  # with one equilibrium more than is needed, for the spline
            try:
                load = Load(prescribed=share * strokes)
                found = simulator.solve(load, BELIEVED, threads=self._threads, start=fields[-1])
            except ConvergenceError:
                if len(shares) < _LEAST_LEVELS:
                    raise
                break
            forces = np.array([found.reactions[of_pad == number].sum(axis=0) for number in range(len(self.rig.pads))])
            shares.append(float(share))
            fields.append(found.displacement)
            pushes.append(float(self.rig.push(forces[None])[0]))
        return Path(np.array(shares), np.array(fields), np.array(pushes))

    def simulation_mm(self, drive: str) -> FloatArray:
        """Return the believed displacement of the nodes, shape (n_frames, n_nodes, 3)."""
        if drive not in self._simulated:
            shares = self.rig.motion if drive == "motion" else self.path.shares_of(self._pushes)
            self._simulated[drive] = self.path.fields_at(shares)
        return self._simulated[drive]

    def variants_mm(self, frame: int) -> FloatArray | None:
        """Return variants of the simulation that the measured push of a frame drives, (n, n_nodes, 3) in mm."""
        return None if self.variants is None else self.variants.at(float(self._pushes[frame]))

    @cached_property
    def _pushes(self) -> FloatArray:
        return self.rig.at_frames(self.rig.push(self.rig.pad_forces))

    @cached_property
    def simulated(self) -> bool:
        """Whether the believed body has equilibria under the pads: without a simulation nothing starts."""
        try:
            _ = self.path
        except ConvergenceError:
            return False
        return True

    @property
    def scored(self) -> IntArray:
        """Frames that are scored."""
        frames = np.arange(0, len(self.rig.motion), EVERY)
        return frames[self.rig.motion[frames] >= LEAST_SHARE]

    def setting(self, condition: Condition, model: LatentModel | None, fields: Any, seed: int) -> Setting:
        """Return what every method is given."""
        return Setting(
            mesh=self.mesh,
            reference_mm=self.rig.reference_mm,
            std_mm=np.full(len(self.rig.reference_mm), condition.noise_mm),
            material=BELIEVED,
            model=model,
            fields=fields,
            driven=np.unique(np.concatenate(self._pressed)),
            frame_s=self.rig.frame_s,
            seed=seed,
            threads=self._threads,
        )


def measured(rig: Rig, condition: Condition, seed: int) -> FloatArray:
    """Return the markers as the tracker gives them (n_frames, n_markers, 3), mm; NaN = not seen."""
    rng = np.random.default_rng([seed, rig.scenario, rig.seed])
    places = rig.reference_mm + rig.at_frames(rig.marker_levels_mm)
    order = rng.permutation(len(rig.reference_mm))
    direction = rng.standard_normal(3)
    noisy = places + condition.noise_mm * rng.standard_normal(places.shape)
    noisy[:, order[-1]] += condition.wrong_mm * direction / np.linalg.norm(direction)
    noisy[:, order[: round(condition.dropped * len(order))]] = np.nan
    return np.asarray(noisy)
