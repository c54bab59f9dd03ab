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
from tissuereg.registration.contacts.sensed import Row
from tissuereg.registration.contacts.settings import DISCRETISATION
from tissuereg.registration.contacts.state import RigidMotion


@dataclass(frozen=True, eq=False)
class Cells:
    """Small parts of a surface on springs, each of which moves nearly as one.

    `weights` (n_cells, n_nodes): share of each node in the mean motion of a cell, rows add up to one; `areas`
    (n_cells,): area, mm^2; `centres` (n_cells, 3): centroid, mm; `of_set` int64 (n_cells,): number of the set of
    springs that each cell belongs to.
    """

    weights: FloatArray
    areas: FloatArray
    centres: FloatArray
    of_set: IntArray

    @classmethod
    def of(cls, nodes: FloatArray, sets: Sequence[IntArray]) -> "Cells":
        """Return the cells into which sets of surface triangles are divided, about `DISCRETISATION.cells` in all.

        `nodes` (n_nodes, 3): places of the nodes, mm; `sets`: for each set of springs its triangles, int64 (n, 3).
        """
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
        """Nodes int64 (k,) and weights (k, 3) of the mean motion of every cell, three entries per cell: x, y and z."""
        found = []
        for own in self.weights:
            nodes = np.flatnonzero(own)
            found += [(nodes, np.outer(own[nodes], axis)) for axis in np.eye(3)]
        return found


@dataclass(frozen=True, eq=False)
class Condensed:
    """Responses of the observations and of small parts of the supports to all causes, on springs of one stiffness.

    `columns`: possible causes of motion, on these springs; `cells`: small parts of the surface on springs, each of
    which moves nearly as one; `known`: stiffness of these springs, in Young's modulus over extent; `stiffness`
    (n_cells,): force on each cell per mm of its motion on springs of one modulus over extent, mN/mm; `innovation`
    (n_obs,): measured displacement minus that predicted at zero coefficients, mm; `variances` (n_obs,): variances of
    the observations' noise, mm^2; `responses` (n_obs + 3 n_cells, n_columns): motion of observations, then of cells,
    under a unit coefficient of each cause, mm; `rest` (3 n_cells,): motions of the cells at zero coefficients, mm;
    `by_cells` (n_obs, 3 n_cells): motion of the observations under unit forces on the cells, mm/mN; `among` (3 n_cells,
    3 n_cells): motion of the cells under unit forces on the cells, mm/mN.
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
        """Return the responses of a body before its first registration step, with springs of a known stiffness.

        `passes`: holds the body, its material, causes and data, and counts the right-hand sides; `frame`: initial rigid
        motion from the body's frame to the tracker's; `known`: stiffness of the springs, in Young's modulus over
        extent. Cost: a factorisation, one right-hand side for each observation and three for each cell.
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
        sensed, more = tangent.sensed(cells.rows)
        whole = sensed.compliance
        passes.counters["right_hand_sides"] += solved + more
        n_nodes = body.mesh.n_nodes
        still = np.zeros((3 * len(cells.areas), 6))
        by_cell = [
            np.einsum("onx,qn->oqx", one.forces[:, :n_nodes], cells.weights, optimize=True).reshape(len(one.forces), -1)
            for one in (own, whole)
        ]
        by_causes = columns.responses(sensed, np.empty((0, 3)), still)
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
        """Return the observations on springs of other stiffness: one number per set, in Young's modulus over extent."""
        more = np.array(stiffness)[self.cells.of_set] - self.known
        return OnSprings(self, np.repeat(more * self.stiffness, 3))


@dataclass(frozen=True, eq=False)
class OnSprings:
    """The observations of a body on springs of another stiffness than the one for which responses were computed.

    `condensed`: responses on the springs of known stiffness K0; `pull` (3 n_cells,): stiffness of every cell along each
    axis in excess of K0, mN/mm, negative on softer springs.
    """

    condensed: Condensed
    pull: FloatArray

    @cached_property
    def _kept(self) -> FloatArray:
        """Matrix I + C K, (3 n_cells, 3 n_cells): C, motion of cells per force on cells; K, the excess stiffness."""
        return np.asarray(np.eye(len(self.pull)) + self.condensed.among * self.pull)

    @cached_property
    def by_motion(self) -> FloatArray:
        """Change of the observations by unit motions that the cells have on the known springs, (n_obs, 3 n_cells)."""
        return np.asarray(-np.linalg.solve(self._kept.T, (self.condensed.by_cells * self.pull).T).T)

    @cached_property
    def innovation(self) -> FloatArray:
        """Measured displacement minus that predicted at zero coefficients on these springs, (n_obs,), in mm."""
        return self.condensed.innovation - self.by_motion @ self.condensed.rest

    def observed(self, covariance: FloatArray) -> FloatArray:
        """Return the covariance (n_obs, n_obs) of the observations on these springs, in mm^2.

        `covariance` (n_obs + 3 n_cells, n_obs + 3 n_cells): joint covariance of observations and cells on the springs
        of known stiffness, mm^2.
        """
        n_obs = len(self.condensed.innovation)
        mixed = self.by_motion @ covariance[n_obs:, :n_obs]
        inner = self.by_motion @ covariance[n_obs:, n_obs:] @ self.by_motion.T
        found = covariance[:n_obs, :n_obs] + mixed + mixed.T + inner
        return np.asarray(0.5 * (found + found.T))
