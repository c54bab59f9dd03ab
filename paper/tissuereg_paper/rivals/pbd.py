"""Position-based dynamics with observed places as constraints (Liu et al. 2021)."""

from typing import Any, ClassVar

import numpy as np

from tissuereg import Mesh, Simulator
from tissuereg._base.arguments import real, whole
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.observe import MarkerObservation
from tissuereg_paper import _core
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting

#: kg/mm^3 in one g/cm^3.
_KG_PER_MM3 = 1e-6


class PositionBasedDynamics(Rival):
    """XPBD with the edges' lengths, the tets' volumes and the markers' places as constraints.

    The simulated shape of the moment is the one at rest: edges and tets keep its lengths and volumes, so that known
    loads need no counterpart in this model and markers that agree with the simulation change nothing. Nodes start
    from the simulation plus the correction of the moment before, go on by a share of its last change, as bodies with
    mass do, and constraints are met in turn (`_core.Pbd`).

    Compliances follow from the material: ``L^2 / (E V_e)`` for an edge of length ``L`` with the volume ``V_e`` (a
    sixth of each tet around it), and ``V / K`` for a tet with the bulk modulus ``K``. A marker's is its variance over
    an energy, ``std^2 / energy``: the energy up to which the body is strained for one standard deviation.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    energy_uj : float
        The energy above, uJ (mN mm).
    n_iterations : int
        Rounds over all constraints a moment.
    density_g_cm3 : float
        Density that gives nodes their masses. It is a number of the method, not of the tissue: constraints of heavier
        nodes are met in fewer rounds, but hold them back more from where the markers are.
    momentum : float
        Share of the correction's last change by which nodes go on, below 1.

    References
    ----------
    .. [1] F. Liu et al., "Real-to-sim registration of deformable soft tissue with position-based dynamics for surgical
       robot autonomy", IEEE ICRA, 2021.
    .. [2] M. Macklin, M. Müller and N. Chentanez, "XPBD: position-based simulation of compliant constrained dynamics",
       Motion in Games, 2016.
    """

    name: ClassVar[str] = "PBD with observations"
    needs: ClassVar[frozenset[str]] = frozenset({"simulation"})
    remembers: ClassVar[bool] = True

    def __init__(
        self,
        setting: Setting,
        *,
        energy_uj: float = 30.0,
        n_iterations: int = 100,
        density_g_cm3: float = 30.0,
        momentum: float = 0.9,
    ) -> None:
        super().__init__(setting)
        real("energy_uj", energy_uj, above=0.0, unit="uJ")
        real("density_g_cm3", density_g_cm3, above=0.0, unit="g/cm^3")
        self._n_iterations = whole("n_iterations", n_iterations, least=1)
        self._momentum = real("momentum", momentum, least=0.0, below=1.0)
        mesh = setting.mesh
        young, poisson = (np.broadcast_to(v, mesh.n_tets) for v in Simulator(mesh).moduli(setting.material))
        inverse = 1.0 / (_KG_PER_MM3 * density_g_cm3 * _node_volumes(mesh))
        inverse[mesh.fixed_nodes] = 0.0
        bulk = young / (3.0 * (1.0 - 2.0 * poisson))

        self._pbd = _core.Pbd(
            inverse, mesh.nodes, mesh.edges, _edge_compliances(mesh, young), mesh.tets, mesh.volumes / bulk
        )
        names = tuple(str(k) for k in range(setting.n_markers))
        self._observation = MarkerObservation(mesh, setting.reference_mm, names)
        feet = self._observation.points(mesh.n_nodes)[: setting.n_markers]
        self._feet = feet
        self._particles: IntArray = feet.indices.reshape(setting.n_markers, -1).astype(np.int64)
        self._weights: FloatArray = feet.data.reshape(setting.n_markers, -1)
        self._compliance: FloatArray = setting.std_mm**2 / energy_uj
        self._correction: FloatArray = np.zeros_like(self.setting.mesh.nodes)
        self._change: FloatArray = np.zeros_like(self._correction)

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the places that meet the constraints of one moment; see `Rival.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        simulation, mesh, seen = moment.start_mm, self.setting.mesh, moment.seen
        start = simulation + self._correction + self._momentum * self._change
        # What a marker off the surface moves by besides its foot.
        besides = self._observation.predict(start[self._observation.nodes]) - self._feet @ start
        feet = (self._feet @ mesh.nodes)[seen] + moment.displacement_mm - besides[seen]
        self._pbd.set_rest(mesh.nodes + simulation)
        places = self._pbd.project(
            mesh.nodes + start,
            self._particles[seen],
            self._weights[seen],
            np.ascontiguousarray(feet),
            self._compliance[seen],
            self.setting.frame_s,
            self._n_iterations,
        )
        correction = places - mesh.nodes - simulation
        self._change, self._correction = correction - self._correction, correction
        return Estimate(places - mesh.nodes)


def _node_volumes(mesh: Mesh) -> FloatArray:
    """Return the volume that counts for every node, mm^3."""
    return np.asarray(np.bincount(mesh.tets.ravel(), np.repeat(mesh.volumes / 4.0, 4), mesh.n_nodes), np.float64)


def _edge_compliances(mesh: Mesh, young: FloatArray) -> FloatArray:
    """Return ``L^2 / (E V_e)`` of every edge, mm/mN."""
    corners = np.sort(mesh.tets[:, [[0, 1], [0, 2], [0, 3], [1, 2], [1, 3], [2, 3]]].reshape(-1, 2), axis=1)
    keys = mesh.edges[:, 0] * mesh.n_nodes + mesh.edges[:, 1]
    edge = np.searchsorted(keys, corners[:, 0] * mesh.n_nodes + corners[:, 1])
    stiffness = np.bincount(edge, np.repeat(young * mesh.volumes / 6.0, 6), len(keys))
    lengths = np.linalg.norm(mesh.nodes[mesh.edges[:, 1]] - mesh.nodes[mesh.edges[:, 0]], axis=1)
    return np.asarray(lengths**2 / stiffness)
