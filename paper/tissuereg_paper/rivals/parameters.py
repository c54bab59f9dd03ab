"""Inference of the simulation's own parameters: ES-MDA over the finite-element solver."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from tissuereg import Body, Load, Material, Simulator
from tissuereg._base.arguments import flag, real, whole
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ArgumentError
from tissuereg.registration.contacts.body import ContactBody
from tissuereg.registration.contacts.supports import Supports
from tissuereg.registration.learned.model import Gaussian
from tissuereg_paper.rivals.assimilation import AssimilationSettings, StepOptions, assimilate
from tissuereg_paper.rivals.rival import Estimate, Moment, Rival, Setting

#: Residual over load at which an equilibrium is good enough for markers with noise.
_TOLERANCE = 1e-6

#: Upper limit of a standard deviation of a logarithm, and of the drift: beyond lie no bodies.
_MOST_STD = 10.0


class ParameterInference(Rival):
    r"""The equilibrium whose stiffness and load, as factors on the believed ones, explain the markers.

    The logarithms of both factors have a Gaussian prior; ES-MDA updates an ensemble of them, each member a solve with
    the full law. The load is what holds the simulation in equilibrium, or without one the load of the setting; its
    weight (`Load.body_force`), known from the density, keeps its size. Without weight only the quotient of the factors
    matters, and the prior says how it is shared out. Of nodes that actuators move (`Setting.driven`) the load's factor
    is one on their displacement: a body of another stiffness under the same push is pressed deeper or less deep, and
    forces that do not follow it would let a soft one buckle. From moment to moment the parameters stay the same but for
    a small drift: the posterior is the next prior.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    stiffness_std, load_std : float
        Standard deviations of the logarithms before the first moment. By default 0.6 and 0.3: the paper's training data
        span 10 to 60 kPa, a factor of 2.4 either side of their middle at one and a half deviations; loads are measured.
    drift : float
        Standard deviation of the change from one moment to the next, over that before the first moment.
    n_members : int
        Ensemble size. The update is a deterministic transform of an ensemble whose moments are exact, so that few
        members more than parameters suffice where the markers are nearly linear in the logarithms.
    n_steps, later_steps : int
        Steps at the first moment, and at later ones, which begin near the answer.
    spread : bool
        Whether the members are solved once more for the spread of the nodes.

    Notes
    -----
    Cost of a moment: ``n_members`` solves a step, and one for the answer. The idea is that of R. Antonova et al., "A
    Bayesian treatment of real-to-sim for deformable object manipulation", IEEE Robotics and Automation Letters 7,
    5819-5826, 2022, and P. Sundaresan et al., "DiffCloud", arXiv:2204.03139, 2022; both have other inference.
    """

    name: ClassVar[str] = "parameter inference"

    def __init__(
        self,
        setting: Setting,
        *,
        stiffness_std: float = 0.6,
        load_std: float = 0.3,
        drift: float = 0.1,
        n_members: int = 8,
        n_steps: int = 4,
        later_steps: int = 1,
        spread: bool = False,
    ) -> None:
        super().__init__(setting)
        given = (("stiffness_std", stiffness_std), ("load_std", load_std))
        stds = [real(name, std, above=0.0, below=_MOST_STD) for name, std in given]
        self._first = Gaussian(np.zeros(2), np.diag(np.square(stds)))
        self._drift = real("drift", drift, least=0.0, below=_MOST_STD) ** 2 * self._first.covariance
        self._n_members = whole("n_members", n_members, least=4)
        self._n_steps = (whole("n_steps", n_steps, least=1), whole("later_steps", later_steps, least=1))
        self._spread = flag("spread", spread)
        element = Body(setting.mesh, setting.material).fitting_element
        self._body = ContactBody.of(setting.mesh, Supports.of(setting.mesh, "sure"), element)
        self._simulator = self._body.simulator
        if len(setting.driven):
            self._simulator = Simulator(setting.mesh, element=element, held_nodes=setting.held)
        markers = setting.markers(np.full_like(setting.reference_mm, np.nan))
        self._observed = MarkerObservation.of(setting.mesh, markers)
        self._known: Gaussian | None = None
        self._n_moments = 0

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the equilibrium at the posterior mean; see `Rival.register`.

        Raises
        ------
        ArgumentError
            If there is neither a simulation nor a load.
        EnsembleError
            If half of the members find no equilibrium.
        ConvergenceError
            If there is none at the mean.

        Notes
        -----
        Kept: ``stiffness`` and ``load``, the factors; ``log_covariance`` of their logarithms.
        """
        moment = self.moment(measured_mm, simulation_mm)
        of = self._load_of(moment)
        start = np.zeros_like(self.setting.mesh.nodes) if moment.simulation_mm is None else moment.simulation_mm
        rows = (3 * moment.seen[:, None] + np.arange(3)).ravel()

        def fields(logs: FloatArray) -> FloatArray:
            loads = [of(float(np.exp(member[1]))) for member in logs.T]
            materials = [self._material(float(np.exp(member[0]))) for member in logs.T]
            how = {"start": start, "tolerance": _TOLERANCE, "threads": self.setting.threads}
            return self._simulator.solve_many(loads, materials, **how).displacement

        def predict(logs: FloatArray) -> FloatArray:
            moved = self._observed.predict(fields(logs)[:, self._observed.nodes])
            return np.ascontiguousarray(moved.reshape(len(moved), -1)[:, rows].T)

        first = self._known is None
        found = assimilate(
            predict,
            moment.displacement_mm.ravel(),
            np.diag(np.repeat(self.setting.std_mm[moment.seen] ** 2, 3)),
            self._prior(),
            rng=np.random.default_rng([self.setting.seed, 11, self._n_moments]),
            settings=AssimilationSettings(
                self._n_members,
                self._n_steps[0 if first else 1],
                options=StepOptions(form="square_root"),
                min_members=max(3, self._n_members // 2),
                threads=self.setting.threads,
            ),
        )
        self._n_moments += 1
        self._known = Gaussian(found.mean, np.cov(found.latents))
        spread = np.nanstd(fields(found.latents), axis=0, ddof=1) if self._spread else None
        stiffness, load = np.exp(found.mean)
        answer = self._simulator.solve(
            of(float(load)), self._material(float(stiffness)), start=start, threads=self.setting.threads
        )
        kept = {"stiffness": float(stiffness), "load": float(load), "log_covariance": self._known.covariance}
        return Estimate(answer.displacement, spread, kept)

    def _prior(self) -> Gaussian:
        if self._known is None:
            return self._first
        return Gaussian(self._known.mean, self._known.covariance + self._drift)

    def _material(self, factor: float) -> Material:
        return replace(self.setting.material, young=factor * self.setting.material.young_array)

    def _load_of(self, moment: Moment) -> Callable[[float], Load]:
        """Return the load as a function of its factor."""
        believed, simulator = self.setting.load, self._simulator
        weight = None if believed is None or believed.body_force is None else believed.body_force
        if moment.simulation_mm is not None:
            forces = simulator.internal_forces(moment.simulation_mm, self.setting.material)
            if weight is not None:
                forces -= self._body.node_volumes[:, None] * float_array("body_force", weight, (3,))
            forces[simulator.held_nodes] = 0.0
            held = moment.simulation_mm[simulator.held_nodes]
        elif believed is not None:
            given = simulator.forces(believed)
            forces = np.zeros_like(self.setting.mesh.nodes) if given is None else given
            held = np.zeros((len(simulator.held_nodes), 3))
            if believed.prescribed is not None:
                held = float_array("prescribed", believed.prescribed, held.shape)
        else:
            message = f"the method '{self.name}' must have a simulation or a load, `simulation_mm` and `setting.load` "
            raise ArgumentError(message + "are both None", where="simulation_mm")
        return lambda factor: Load(forces=factor * forces, body_force=weight, prescribed=factor * held)
