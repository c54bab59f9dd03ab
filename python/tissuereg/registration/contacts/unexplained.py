r"""Displacement that no load on the body explains: a random field, added to the equilibrium under the loads.

Real bodies do what no load on a believed body does: fibres pull, the stiffness differs from place to place, a support
gives, a cell pulls from inside. The field is Gaussian with independent components, an unknown size s, and the
covariance (Matern, smoothness 3/2)

    k(x, y) = s^2 (1 + q) exp(-q),      q = sqrt(3) |x - y| / l,

conditioned to be zero at held nodes. At nodes x it is expressed by its values at some places z, those of the markers:

    k(x, z) L^-T c + rest,      L L' = k(z, z),      c ~ N(0, s^2),

where the rest, of covariance k(x, x') - k(x, z) k(z, z)^-1 k(z, x'), is independent of c and seen by no marker.
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.mesh import Mesh
from tissuereg.registration.contacts.places import far_apart
from tissuereg.registration.contacts.settings import DISCRETISATION

Rows = list[tuple[IntArray, FloatArray]]


@dataclass(frozen=True, eq=False)
class Unexplained:
    """The random field of unit size, by its values at some places.

    `nodes` (n_nodes, 3): nodes, mm; `length`: l, mm; `held` (n_held, 3): places at which it is zero, mm; `places` (n,
    3): z, mm; `motion`: root mean square motion of what was measured, mm, the unit of the prior of s. Coefficients c
    are ordered by place, then by axis.
    """

    nodes: FloatArray
    length: float
    held: FloatArray
    places: FloatArray
    motion: float

    @classmethod
    def of(cls, mesh: Mesh, held: IntArray, places: FloatArray, motion: float) -> "Unexplained":
        """Return the field of a body with held nodes, int64 (n_held,), by its values at places (n, 3), mm.

        `motion`: root mean square motion of what was measured, mm. Cost: some 10 ms on 4,000 nodes, at the first use.
        """
        zero = held[far_apart(mesh.nodes[held], min(len(held), DISCRETISATION.held_places))] if len(held) else held
        length = DISCRETISATION.unexplained_length * mesh.extent
        return cls(mesh.nodes, length, mesh.nodes[zero], places, motion)

    def with_motion(self, motion: float) -> "Unexplained":
        """Return the same field for another motion, mm; what was computed of it is kept."""
        other = replace(self, motion=motion)
        other.__dict__.update({name: value for name, value in self.__dict__.items() if name in ("_parts", "rest")})
        return other

    @property
    def n_columns(self) -> int:
        """Number of coefficients, three for each place."""
        return 3 * len(self.places)

    def _kernel(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return the covariance (n, m) between places x (n, 3) and y (m, 3), of unit size, without held nodes."""
        squares = np.add.outer(np.sum(x**2, axis=1), np.sum(y**2, axis=1)) - 2.0 * x @ y.T
        q = np.sqrt(np.maximum(squares, 0.0)) * (np.sqrt(3.0) / self.length)
        return np.asarray((1.0 + q) * np.exp(-q))

    def _by(self, places: FloatArray) -> FloatArray:
        """Return L^-1 k(places, nodes) with k(places, places) = L L', (n, n_nodes); held nodes are not considered."""
        from scipy.linalg import solve_triangular

        factor = np.linalg.cholesky(self._kernel(places, places) + DISCRETISATION.jitter * np.eye(len(places)))
        return np.asarray(solve_triangular(factor, self._kernel(places, self.nodes), lower=True, check_finite=False))

    @cached_property
    def _parts(self) -> tuple[FloatArray, FloatArray]:
        """Fields of the coefficients, (n_nodes, n_places), and variance of the rest, (n_nodes,)."""
        every = self._by(np.concatenate([self.held, self.places]))
        fields = np.ascontiguousarray(every[len(self.held) :].T)
        return fields, np.maximum(1.0 - np.sum(every**2, axis=0), 0.0)

    @property
    def fields(self) -> FloatArray:
        """Fields of which c are the coefficients, (n_nodes, n_places), dimensionless."""
        return self._parts[0]

    @property
    def left(self) -> FloatArray:
        """Variance of the rest at every node, (n_nodes,), for a field of unit size."""
        return self._parts[1]

    @cached_property
    def rest(self) -> FloatArray:
        """Fields whose sum, with independent coefficients of unit variance, is nearly the rest, (n_nodes, n_rest)."""
        known = np.concatenate([self.held, self.places])
        between = self.nodes[far_apart(self.nodes, min(len(self.nodes), DISCRETISATION.rest_places))]
        return np.ascontiguousarray(self._by(np.concatenate([known, between]))[len(known) :].T)

    @property
    def missed(self) -> FloatArray:
        """Variance of the rest that these fields do not have, at every node, (n_nodes,), for a field of unit size."""
        return np.asarray(np.maximum(self.left - np.sum(self.rest**2, axis=1), 0.0))

    def responses(self, rows: Rows) -> FloatArray:
        """Return the change of observations by unit coefficients, (n_rows, n_columns).

        `rows`: nodes int64 (k,) and weights (k, 3) of the displacement in each observation.
        """
        found = [self.fields[nodes].T @ weights for nodes, weights in rows]
        return np.asarray(found).reshape(len(rows), self.n_columns)

    def displacement(self, coefficients: FloatArray) -> FloatArray:
        """Return the displacement of the nodes, (..., n_nodes, 3), mm, at coefficients (..., n_columns), mm."""
        return np.asarray(self.fields @ coefficients.reshape(*coefficients.shape[:-1], -1, 3))


__all__ = ["Rows", "Unexplained"]
