r"""A linearised body on springs of any stiffness, from one factorisation at a medium stiffness.

The springs are divided into cells. Raising the stiffness of cell q by k_q (or lowering it, k_q < 0) adds a restoring
force of k_q times the mean motion of the cell. With the compliance C of cells to forces on cells, that of observations
to forces on cells D, and K = diag(k), the motions m of observations and u of cells become

    u' = (I + C K)^-1 u,    m' = m + W u,    W = -D K (I + C K)^-1,

so that if m and u are jointly normal, m' is normal too, with a covariance from products of small matrices.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.fit import Passes, start_of
from tissuereg.registration.contacts.places import gathered
from tissuereg.registration.contacts.settings import DISCRETISATION
from tissuereg.registration.contacts.state import RigidMotion
from tissuereg.registration.contacts.tangent import Row


@dataclass(frozen=True, eq=False)
class Cells:
    """Small parts of a surface on springs, each of which moves nearly as one.

    `weights` (n_cells, n_nodes): share of each node in the mean motion of a cell; rows add up to one; `areas`
    (n_cells,): mm^2; `centres` (n_cells, 3): mm; `of_set` int64 (n_cells,): set of springs of each cell.
    """

    weights: FloatArray
    areas: FloatArray
    centres: FloatArray
    of_set: IntArray

    @classmethod
    def of(cls, nodes: FloatArray, sets: Sequence[IntArray]) -> "Cells":
        """Return the cells of sets of triangles (n, 3) between nodes (n_nodes, 3)."""
        triangles, of_set = list[IntArray](), list[int]()
        for index, whole in enumerate(sets):
            corners = nodes[whole]
            across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            cell = gathered(corners.mean(axis=1), np.linalg.norm(across, axis=1), DISCRETISATION.cells // len(sets))
            triangles += [whole[cell == one] for one in range(int(cell.max()) + 1)]
            of_set += [index] * (int(cell.max()) + 1)
        weights = np.zeros((len(triangles), len(nodes)))
        for own, some in zip(weights, triangles, strict=True):
            corners = nodes[some]
            across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
            np.add.at(own, some, np.linalg.norm(across, axis=1)[:, None] / 6.0)
        areas = weights.sum(axis=1)
        weights /= areas[:, None]
        return cls(weights, areas, weights @ nodes, np.asarray(of_set, np.int64))

    @property
    def rows(self) -> list[Row]:
        """Nodes and weights of the mean motion of every cell along each axis, three a cell."""
        found = []
        for own in self.weights:
            nodes = np.flatnonzero(own)
            found += [(nodes, np.outer(own[nodes], axis)) for axis in np.eye(3)]
        return found


@dataclass(frozen=True, eq=False)
class Condensed:
    """Responses of the observations and of small parts of the supports to all causes, on springs of one stiffness.

    Attributes
    ----------
    columns : Columns
        Causes, on these springs.
    cells : Cells
        Small parts of the surface on springs, each of which moves nearly as one.
    known : float
        Stiffness of these springs, in Young's modulus over extent.
    stiffness : ndarray of float64, shape (n_cells,)
        Force per mm of each cell at stiffness one, mN/mm.
    innovation : ndarray of float64, shape (n_obs,)
        Measured displacement minus that predicted at zero coefficients, mm.
    variances : ndarray of float64, shape (n_obs,)
        Variances of the observations' noise, mm^2.
    responses : ndarray of float64, shape (n_obs + 3 n_cells, n_columns)
        Motion of observations, then of cells, under a unit coefficient of each cause, mm.
    rest : ndarray of float64, shape (3 n_cells,)
        Motions of the cells at zero coefficients, mm.
    by_cells : ndarray of float64, shape (n_obs, 3 n_cells)
        Motion of the observations under unit forces on the cells, mm/mN.
    among : ndarray of float64, shape (3 n_cells, 3 n_cells)
        Motion of the cells under unit forces on the cells, mm/mN.
    """

    columns: Columns
    cells: Cells
    known: float
    stiffness: FloatArray
    innovation: FloatArray
    variances: FloatArray
    responses: FloatArray
    rest: FloatArray
    by_cells: FloatArray
    among: FloatArray

    @classmethod
    def of(cls, passes: Passes, frame: RigidMotion, known: float) -> "Condensed":
        """Return the condensed problem of a body before its first registration step.

        `passes`: body, material and data; the work is counted there; `frame`: rigid motion of the tracker to begin
        with; `known`: stiffness of the springs, in Young's modulus over extent. Cost: a factorisation, one right-hand
        side for each observation and three for each cell.
        """
        body = passes.columns.body
        columns = passes.columns.on_springs([known] * len(body.springs))
        passes = replace(passes, columns=columns)
        start = start_of(columns, passes.material, None, frame, passes.threads)
        tangent = passes.linear.tangent(start)
        reading = passes.observed.read(start)
        observations = passes.linear.observations(tangent, reading, start.coefficients, passes.observed)
        cells = Cells.of(body.mesh.nodes, [triangles for triangles, _ in body.springs])
        own, solved = tangent.compliance(observations.rows)
        whole, more = tangent.compliance(cells.rows)
        passes.counters["right_hand_sides"] += solved + more
        n_nodes = body.mesh.n_nodes
        still = np.zeros((3 * len(cells.areas), 6))
        by_cell = [
            np.einsum("onx,qn->oqx", one.forces[:, :n_nodes], cells.weights, optimize=True).reshape(len(one.forces), -1)
            for one in (own, whole)
        ]
        by_causes = columns.responses(whole, np.empty((0, 3)), still)
        unit = columns.base_young / body.mesh.extent
        return cls(
            columns,
            cells,
            known,
            unit * cells.areas,
            observations.innovation,
            observations.variances,
            np.concatenate([observations.responses, by_causes]),
            (cells.weights @ start.displacement[:n_nodes]).ravel(),
            by_cell[0],
            0.5 * (by_cell[1] + by_cell[1].T),
        )

    def on(self, stiffness: Sequence[float]) -> "OnSprings":
        """Return the observations on springs of other stiffness: one value a set, modulus over extent."""
        more = np.array(stiffness)[self.cells.of_set] - self.known
        return OnSprings(self, np.repeat(more * self.stiffness, 3))


@dataclass(frozen=True, eq=False)
class OnSprings:
    """The observations of a body on springs of another stiffness than the one for which responses were computed.

    `condensed`: responses on the springs of known stiffness K0; `pull` (3 n_cells,): stiffness of every cell in excess
    of K0, mN/mm.
    """

    condensed: Condensed
    pull: FloatArray

    @cached_property
    def _kept(self) -> FloatArray:
        """Matrix I + C K, (3 n_cells, 3 n_cells): C are motions of cells by forces on cells, K the excess stiffness."""
        return np.asarray(np.eye(len(self.pull)) + self.condensed.among * self.pull)

    @cached_property
    def by_motion(self) -> FloatArray:
        """Change of the observations by unit motions of the cells on the known springs, (n_obs, 3 n_cells)."""
        return np.asarray(-np.linalg.solve(self._kept.T, (self.condensed.by_cells * self.pull).T).T)

    @cached_property
    def innovation(self) -> FloatArray:
        """Measured displacement minus that predicted at zero coefficients on these springs, (n_obs,), in mm."""
        return self.condensed.innovation - self.by_motion @ self.condensed.rest

    def observed(self, covariance: FloatArray) -> FloatArray:
        """Return the covariance (n_obs, n_obs) of the observations on these springs, in mm^2.

        `covariance` (n_obs + 3 n_cells, n_obs + 3 n_cells): of observations and cells on the springs of known
        stiffness, mm^2.
        """
        n_obs = len(self.condensed.innovation)
        mixed = self.by_motion @ covariance[n_obs:, :n_obs]
        inner = self.by_motion @ covariance[n_obs:, n_obs:] @ self.by_motion.T
        found = covariance[:n_obs, :n_obs] + mixed + mixed.T + inner
        return np.asarray(0.5 * (found + found.T))
