"""One method after another on the recordings of rigs: errors at the buried sensor and at inner points, and times.

Every method is given the same: markers, the believed simulation, the believed material (E = 10 kPa, neo-Hookean, as in
the paper's section IV), and no other truth.
"""

import hashlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from inspect import signature
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.baselines import (
    RIVALS,
    EnsembleOfSimulations,
    Estimate,
    KfAdmm,
    LatentFilter,
    Libr,
    LinearElastic,
    LinearResidual,
    MeanAbout,
    MeanOfMarkers,
    Network,
    OneStepSmoother,
    ParameterInference,
    PcaEsMda,
    PhysicsPrior,
    PositionBasedDynamics,
    Rigid,
    RigidAbout,
    Rival,
    Setting,
    Spline,
    SplineAbout,
    Varied,
    VariedNetwork,
)
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.body.observe import TargetObservation
from tissuereg.errors import ConvergenceError, FormatError, TissueRegError
from tissuereg.phantom.event import PHANTOM
from tissuereg.registration.learned.model import LatentModel
from tissuereg.simulation.solve import Simulator
from tissuereg.studies.rigs import Rig, inverted, on_spline
from tissuereg.studies.runs import KeptRuns, Run
from tissuereg.studies.variants import RigVariants, digest, read_variants

#: What everyone believes: the paper's modulus.
BELIEVED = Material(10.0, PHANTOM.poisson)

#: Every so many frames one is scored, while the actuators have gone at least this share of their strokes.
EVERY, LEAST_SHARE = 8, 0.05

#: A believed body that is softer than the true one is pressed farther than that, up to this share of the strokes.
_MOST_SHARE = 2.0

#: A believed body without so many equilibria, rest among them, is none.
_LEAST_LEVELS = 3

#: Points of the curve of force by share that is inverted.
_FINE = 4001

#: 95 % quantile of the normal distribution: a component lies within it of its mean in 90 % of cases.
_QUANTILE90 = 1.6448536269514722


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


class Simulated(Rival):
    """The believed simulation as it is: what every method starts from."""

    name = "simulation"
    needs = frozenset({"simulation"})

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the simulation."""
        return Estimate(self.moment(measured_mm, simulation_mm).start_mm)


class NetworkAlone(Network):
    """The registration by the model without a simulation."""

    name = "tissuereg, network without simulation"

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the registered body."""
        return super().register(measured_mm, None)


#: Every method by its name, the simulation and ours first.
METHODS: dict[str, type[Rival]] = {
    method.name: method for method in (Simulated, VariedNetwork, Network, NetworkAlone)
} | RIVALS

#: Short names of the methods, for JSON and the command line.
KEYS: dict[str, str] = {
    Simulated.name: "simulation",
    VariedNetwork.name: "tissuereg-variants",
    Network.name: "tissuereg",
    NetworkAlone.name: "tissuereg-without-simulation",
    PhysicsPrior.name: "tissuereg-contacts",
    EnsembleOfSimulations.name: "ensemble",
    KfAdmm.name: "kf-admm",
    PositionBasedDynamics.name: "pbd",
    ParameterInference.name: "parameters",
    LinearResidual.name: "linear-residual",
    Rigid.name: "rigid",
    Spline.name: "spline",
    MeanOfMarkers.name: "copy",
    RigidAbout.name: "simulation-rigid",
    SplineAbout.name: "simulation-spline",
    MeanAbout.name: "simulation-copy",
    LinearElastic.name: "compliance",
    PcaEsMda.name: "pca-esmda",
    OneStepSmoother.name: "one-step-es",
    LatentFilter.name: "enkf",
    Libr.name: "libr",
}


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


def run_method(
    rival: Rival, believed: Believed, markers: FloatArray, condition: Condition, *, scored_alone: bool | None = None
) -> Run:
    """Return what a method does on the frames of a rig, in their order.

    Parameters
    ----------
    rival : Rival
        Made for the setting.
    believed : Believed
        Of the rig.
    markers : ndarray of float64, shape (n_frames, n_markers, 3)
        As measured, mm.
    condition : Condition
        Under which they were measured.
    scored_alone : bool, optional
        Whether it is given the scored frames alone; by default if it remembers none.
    """
    scored, rig = believed.scored, believed.rig
    is_scored = np.isin(np.arange(len(markers)), scored)
    alone = not rival.remembers if scored_alone is None else scored_alone
    distances, inside, seconds, failed = [], [], [], 0
    for frame, (seen, simulation) in enumerate(zip(markers, believed.simulation_mm(condition.drive), strict=True)):
        if alone and not is_scored[frame]:
            continue
        given = [believed.variants_mm(frame)] if isinstance(rival, Varied) else []
        begun = time.process_time()
        try:
            found = rival.register(seen, simulation, *given)
        except TissueRegError:
            failed += 1
            found = Estimate(simulation)
        seconds.append(time.process_time() - begun)
        if not is_scored[frame]:
            continue
        off = believed.at_points(found.displacement_mm) - believed.truth_mm[frame]
        distances.append(np.linalg.norm(off, axis=1))
        if found.spread_mm is not None:
            inside.append((np.abs(off) <= _QUANTILE90 * believed.at_points(found.spread_mm))[1:].mean())
    away = np.array(distances)
    return Run(
        method=rival.name,
        condition=condition.name,
        rig=rig.name,
        scenario=rig.scenario,
        times_s=np.asarray((scored + 1) * rig.frame_s, np.float64),
        sensor_mm=away[:, 0],
        inner_mm=away[:, 1:],
        coverage90=float(np.mean(inside)) if inside else None,
        ms=1e3 * float(np.median(seconds)),
        frames=len(seconds),
        failed=failed,
    )


def _mark(model: LatentModel | None) -> str:
    """Return what tells one trained model from another: the digest of its card, which has those of its files."""
    folder = getattr(model, "folder", None)
    return "" if folder is None else hashlib.sha256((folder / "model.json").read_bytes()).hexdigest()


class Contest:
    """Methods on rigs under conditions; nothing is run twice.

    Parameters
    ----------
    rigs : sequence of Rig
    mesh : Mesh
        Of the user.
    model : LatentModel, optional
        Trained model of the mesh.
    fields : ndarray of float64, shape (n_fields, n_nodes, 3), optional
        Training fields, mm.
    methods : mapping of str to type of Rival
        Those that lack what they need are left out.
    variants : path-like, optional
        Folder of variants of the rigs' simulations.
    seed, threads : int
        Of the noise and the methods; of the solver and the methods.
    keep : path-like, optional
        Folder where runs are kept, and taken from where they were made with the same seed, model and fields.
    """

    def __init__(
        self,
        rigs: Sequence[Rig],
        mesh: Mesh,
        model: LatentModel | None = None,
        fields: Any = None,
        methods: Mapping[str, type[Rival]] = METHODS,
        seed: int = 0,
        threads: int = 0,
        keep: str | os.PathLike[str] | None = None,
        variants: str | os.PathLike[str] | None = None,
    ) -> None:
        self.rigs, self._mesh, self._model, self._fields = tuple(rigs), mesh, model, fields
        self._seed, self._threads = seed, threads
        given = {"simulation"}
        parts = {"model": model, "fields": fields, "variants": variants}
        given |= {name for name, value in parts.items() if value is not None}
        self.methods = {name: method for name, method in methods.items() if method.needs <= given}
        self.left_out = tuple(name for name in methods if name not in self.methods)
        self._variants = variants
        self._kept = KeptRuns(keep, self._key_of)
        self._believed: dict[str, Believed] = {}
        self._has_simulation: dict[str, bool] = {}
        self._runs: dict[tuple[str, str], list[Run]] = {}

    @property
    def facts(self) -> dict[str, Any]:
        """The model for the studies' JSON: ``kind``, ``source``, ``n_nodes``, ``n_latent``."""
        card = {} if self._model is None else self._model.card
        latents = 0 if self._model is None else self._model.n_latent
        facts = {name: card.get(name, "none") for name in ("kind", "source")}
        return {**facts, "n_nodes": self._mesh.n_nodes, "n_latent": latents}

    def simulated(self, rig: Rig) -> bool:
        """Return whether the believed body has equilibria under the rig's pads; found once for each rig."""
        if rig.name not in self._has_simulation:
            self._has_simulation[rig.name] = self._believed_of(rig).simulated
        return self._has_simulation[rig.name]

    def _believed_of(self, rig: Rig) -> Believed:
        if rig.name not in self._believed:
            self._believed = {rig.name: Believed(rig, self._mesh, self._threads)}  # one rig's fields at a time
        return self._believed[rig.name]

    def _key_of(self, rig: Rig, name: str) -> dict[str, Any]:
        """Return what the run of a method on a rig depends on besides rig and condition."""
        needs = self.methods[name].needs
        key: dict[str, Any] = {"seed": self._seed, "n_nodes": self._mesh.n_nodes}
        if "model" in needs:
            key["model"] = _mark(self._model)
        if "fields" in needs:
            key["training_fields"] = len(self._fields)
        if "variants" in needs and self._variants is not None:
            key["variants"] = digest(self._variants, rig)
        return key

    def runs(self, rig: Rig, condition: Condition) -> list[Run]:
        """Return what every method did on a rig under a condition."""
        key = rig.name, condition.name
        if key not in self._runs:
            self._runs[key] = self._run(rig, condition)
        return self._runs[key]

    def _run(self, rig: Rig, condition: Condition) -> list[Run]:
        runs = {name: self._kept.read(rig, condition.name, name) for name in self.methods}
        for name, known in runs.items():
            if known is None:
                runs[name] = self._run_anew(rig, condition, name)
        return [run for run in runs.values() if run is not None]

    def _run_anew(self, rig: Rig, condition: Condition, name: str) -> Run:
        believed, method = self._believed_of(rig), self.methods[name]
        if "variants" in method.needs and believed.variants is None and self._variants is not None:
            believed.variants = read_variants(self._variants, rig, self._mesh.n_nodes)
        setting = believed.setting(condition, self._model, self._fields, self._seed)
        markers = measured(rig, condition, self._seed)
        run = replace(run_method(method(setting), believed, markers, condition), method=name)
        if run.coverage90 is None and condition in (PLAIN, MOTION) and "spread" in signature(method).parameters:
            # Its spread costs time that its answer does not need: other runs are timed.
            wide: Callable[..., Rival] = method
            covered = run_method(wide(setting, spread=True), believed, markers, condition)
            run = replace(run, coverage90=covered.coverage90)
        self._kept.write(rig, run)
        return run
