"""One method after another on the recordings of rigs: errors at the buried sensor and at inner points, and times.

Every method is given the same: markers, the believed simulation, the believed material (E = 10 kPa, neo-Hookean, as in
the paper's section IV), and no other truth.
"""

import hashlib
import os
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from inspect import signature
from typing import Any

import numpy as np

from tissuereg import Mesh
from tissuereg._base.arrays import FloatArray
from tissuereg.errors import TissueRegError
from tissuereg.registration.learned.model import LatentModel
from tissuereg_paper.rivals import (
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
    Spline,
    SplineAbout,
    Varied,
    VariedNetwork,
)
from tissuereg_paper.studies.believed import MOTION, PLAIN, Believed, Condition, measured
from tissuereg_paper.studies.rigs import Rig
from tissuereg_paper.studies.runs import KeptRuns, Run
from tissuereg_paper.studies.variants import digest, read_variants

#: 95 % quantile of the normal distribution: a component lies within it of its mean in 90 % of cases.
_QUANTILE90 = 1.6448536269514722


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
    variants : path-like, optional
        Folder of variants of the rigs' simulations.
    methods : mapping of str to type of Rival
        Those that lack what they need are left out.
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
        variants: str | os.PathLike[str] | None = None,
        *,
        methods: Mapping[str, type[Rival]] = METHODS,
        seed: int = 0,
        threads: int = 0,
        keep: str | os.PathLike[str] | None = None,
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
