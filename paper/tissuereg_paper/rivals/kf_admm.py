"""KF-ADMM: projective dynamics by ADMM, corrected by a Kalman filter; our reconstruction."""

from typing import Any, ClassVar

import numpy as np

from tissuereg import Simulator
from tissuereg._base.arguments import check_choice, real, whole
from tissuereg._base.arrays import FloatArray
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ArgumentError, LoadError
from tissuereg_paper import _core
from tissuereg_paper.rivals.modal_filter import ModalFilter
from tissuereg_paper.rivals.modes import admm_modes, vibration_modes
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting

#: Modes by name.
_MODES = {"admm": admm_modes, "elastic": vibration_modes}


class KfAdmm(Rival):
    """A body that is stepped by ADMM with inertia, and a Kalman filter over its places and velocities.

    Prediction: one step of implicit Euler of the neo-Hookean body by ADMM (`_core.AdmmBody`), on the same elements and
    with the same moduli as the simulation. Correction: gain of a filter whose random nodal forces act through
    elasticity (`ModalFilter`), with the markers' feet on the surface as observation; afterwards the local variables
    of ADMM start from the corrected shape.

    The method has a simulation of its own, which is to feel the actuators as the simulation does that all methods are
    given. Nodes that they move (`Setting.driven`) follow that simulation, and so do held nodes. All others feel the
    nodal forces that hold its field in equilibrium. Without a correction, ADMM comes to rest in that field. If the
    simulation turns a tet inside out, the forces of the moment before act.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    modes : {"admm", "elastic"}
        Whether the filter's body is linear as ADMM's global step has it, ``M + dt^2 D' W^2 D``, or by the stiffness at
        rest.
    n_modes : int
        Vibration modes that hold the covariance.
    noise_mm : float
        Process noise: root mean square displacement of the nodes by the random forces of one moment.
    density_g_cm3 : float
        Density; it sets the time scale on which the body follows its forces.
    n_iterations : int
        Iterations of ADMM a moment.
    carried : float
        Share of what the filter corrected at the driven nodes that is carried on to the next moment: with 0 they follow
        the simulation until the next correction, with 1 errors of one push are there in the next.

    Raises
    ------
    SupportError
        If the body can move freely.
    ArgumentError
        If a constant is out of its range.

    References
    ----------
    .. [1] M. Afshar et al., "Accurate tissue deformation modeling using a Kalman filter and ADMM-based projective
       dynamics", IEEE/ASME Transactions on Mechatronics, 2022. The coupling is reconstructed from its description.
    .. [2] M. Overby et al., "ADMM ⊇ Projective Dynamics", IEEE Trans. Vis. Comput. Graph. 23, 2222-2234, 2017.
    """

    name: ClassVar[str] = "KF-ADMM, our reconstruction"
    needs: ClassVar[frozenset[str]] = frozenset({"simulation"})
    remembers: ClassVar[bool] = True

    def __init__(
        self,
        setting: Setting,
        *,
        modes: str = "admm",
        n_modes: int = 150,
        noise_mm: float = 0.3,
        density_g_cm3: float = 1.0,
        n_iterations: int = 5,
        carried: float = 0.0,
    ) -> None:
        super().__init__(setting)
        check_choice("modes", modes, tuple(_MODES), ArgumentError)
        whole("n_modes", n_modes, least=1)
        real("noise_mm", noise_mm, above=0.0, unit="mm")
        real("density_g_cm3", density_g_cm3, above=0.0, unit="g/cm^3")
        self._n_iterations = whole("n_iterations", n_iterations, least=1)
        self._carried = real("carried", carried, least=0.0)
        if self._carried > 1.0:
            message = f"`carried` must be a share from 0 to 1, got {carried}"
            raise ArgumentError(message, where="carried")
        mesh, dt = setting.mesh, setting.frame_s
        self._simulator = Simulator(mesh)
        self._moduli = self._simulator.moduli(setting.material)
        held = mesh.fixed_nodes
        self._held = setting.held
        self._body = _core.AdmmBody(mesh.nodes, mesh.tets, self._held, *self._moduli, density=float(density_g_cm3))
        slowest = _MODES[modes](mesh, setting.material, self._body.masses, n_modes, setting.threads)
        self._shapes: FloatArray = slowest.shapes.reshape(len(slowest.shapes), -1)
        reach = dt * dt / (1.0 + dt * dt * slowest.squares)
        # Mean square displacement of a node for forces of one.
        square = float(np.sum((reach[:, None] * self._shapes) ** 2)) / (mesh.n_nodes - len(held))
        self._filter = ModalFilter(slowest.squares, dt, noise_mm / np.sqrt(square))
        names = tuple(str(k) for k in range(setting.n_markers))
        self._observation = MarkerObservation(mesh, setting.reference_mm, names)
        weights = self._observation.points(mesh.n_nodes)[: setting.n_markers]
        by_node = slowest.shapes.transpose(1, 2, 0).reshape(mesh.n_nodes, -1)
        #: Displacement of the markers' feet by amplitudes, (n_markers, 3, n_modes).
        self._sensitivity: FloatArray = (weights @ by_node).reshape(setting.n_markers, 3, -1)
        self._begun = False
        self._forces: FloatArray | None = None
        self._last: FloatArray | None = None

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the corrected state of one moment; see `Rival.register`.

        Raises
        ------
        LoadError
            If the simulation turns a tet inside out, so that no forces hold it.
        """
        moment = self.moment(measured_mm, simulation_mm)
        simulation, mesh = moment.start_mm, self.setting.mesh
        if not self._begun:
            self._body.set_state(simulation, np.zeros_like(simulation))
            self._begun = True
        gap = self._predict(simulation)
        moved, velocity = self._body.displacement, self._body.velocity
        predicted = self._observation.predict(moved[self._observation.nodes])[moment.seen]
        innovation = (moment.displacement_mm - predicted).ravel()
        sensitivity = self._sensitivity[moment.seen].reshape(len(innovation), -1)
        variance = np.repeat(self.setting.std_mm[moment.seen] ** 2, 3)
        amplitudes, rates = self._filter.update(sensitivity, variance, innovation)
        moved = moved + (amplitudes @ self._shapes).reshape(mesh.nodes.shape)
        velocity = velocity + (rates @ self._shapes).reshape(mesh.nodes.shape)
        self._body.set_state(moved, velocity)
        of_places = self._filter.covariance[: self._filter.n_modes, : self._filter.n_modes]
        spread = np.sqrt(np.maximum(np.einsum("kn,kn->n", self._shapes, of_places @ self._shapes), 0.0))
        kept = {"gap": gap, "innovation_mm": float(np.sqrt(np.mean(innovation**2)))}
        return Estimate(moved, spread.reshape(mesh.nodes.shape), kept)

    def _predict(self, simulation: FloatArray) -> float:
        """Let one moment pass under what moves the simulation; return the gap of ADMM."""
        try:
            forces = self._simulator.body.internal_forces(simulation, *self._moduli)
        except LoadError:
            if self._forces is None:
                raise
            forces = self._forces
        forces[self._held] = 0.0
        before = simulation if self._last is None else self._last
        prescribed = (simulation + self._carried * (self._body.displacement - before))[self._held]
        gap, _ = self._body.step(
            self.setting.frame_s, self._n_iterations, forces=forces, prescribed=prescribed, threads=self.setting.threads
        )
        self._forces, self._last = forces, simulation
        self._filter.predict()
        return gap
