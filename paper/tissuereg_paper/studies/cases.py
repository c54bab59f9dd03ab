"""The cases of the studies: pairs of a start mesh and a target mesh, markers on the surface, inner points.

The paper's, section III: ten random meshes of the test set as starts, and for each of them ten other random ones as
targets. Its phantom has 15 markers; the simulation studies do not state their number, and take as many here. A marker
is a node of the skin, and is read off the target without noise: the paper perturbs it inside ES-MDA alone.
"""

from dataclasses import dataclass

import numpy as np

from tissuereg import Mesh
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.errors import EnsembleError
from tissuereg_paper.studies.shapes import Fields, HeldOut

#: Start meshes, targets of each, markers, and inner points at which regions are tried.
N_STARTS, N_TARGETS, N_MARKERS, N_INNER = 10, 10, 15, 25

#: Random nodes of the skin out of which the markers are spread.
_CANDIDATES = 400


@dataclass(frozen=True, eq=False)
class Cases:
    """Pairs of shapes, with the nodes that are observed.

    Attributes
    ----------
    fields : ndarray of float32, shape (n_shapes, n_nodes, 3)
        Displacements of the shapes, mm.
    starts, targets : ndarray of int64, shape (n_pairs,)
        The shapes of each pair.
    markers : ndarray of int64, shape (n_markers,)
        Nodes of the skin.
    inner : ndarray of int64, shape (n_inner,)
        Nodes inside the body.
    """

    fields: Fields
    starts: IntArray
    targets: IntArray
    markers: IntArray
    inner: IntArray

    @property
    def n_pairs(self) -> int:
        """Number of pairs."""
        return len(self.starts)

    @property
    def start_errors(self) -> FloatArray:
        """Mean distance of the nodes of start and target, mm, (n_pairs,)."""
        pairs = zip(self.starts, self.targets, strict=True)
        return np.array([_distance(self.fields[a], self.fields[b]) for a, b in pairs])

    def far(self, start_mm: float, within_mm: float, most: int, rng: np.random.Generator) -> "Cases":
        """Return pairs of the same shapes that lie about so far apart.

        Parameters
        ----------
        start_mm, within_mm : float
            Wanted mean distance of the nodes, and by how much a pair's may differ from it.
        most : int
            Most pairs; chosen at random where there are more.
        rng : numpy.random.Generator
            Source of random numbers.

        Returns
        -------
        Cases
            No two shapes are paired twice.

        Raises
        ------
        EnsembleError
            If there is no such pair.
        """
        first, second = np.triu_indices(len(self.fields), 1)
        apart = np.array([_distance(self.fields[a], self.fields[b]) for a, b in zip(first, second, strict=True)])
        near = np.flatnonzero(np.abs(apart - start_mm) <= within_mm)
        if not len(near):
            message = f"two shapes must lie {start_mm} mm apart, within {within_mm} mm; none of {len(apart)} pairs do"
            raise EnsembleError(message, where="start_mm")
        chosen = np.sort(rng.permutation(near)[:most])
        swapped = rng.random(len(chosen)) < 0.5
        starts = np.where(swapped, second[chosen], first[chosen])
        targets = np.where(swapped, first[chosen], second[chosen])
        return Cases(self.fields, starts, targets, self.markers, self.inner)


def draw_cases(
    held_out: HeldOut, seed: int, threads: int = 0, *, n_starts: int = N_STARTS, n_targets: int = N_TARGETS
) -> Cases:
    """Return random pairs of held-out shapes, which are solved now.

    Parameters
    ----------
    held_out : HeldOut
        Where the shapes come from.
    seed : int
        Of the choice of shapes, markers and inner points.
    threads : int
        Threads to use; 0 takes all cores. The result does not depend on it.
    n_starts, n_targets : int
        Start meshes, and targets of each.

    Returns
    -------
    Cases
        ``n_starts * n_targets`` pairs, those of a start in a row.

    Raises
    ------
    EnsembleError
        If there are too few shapes for that, or one has no equilibrium.
    """
    numbers = held_out.numbers
    if len(numbers) < max(n_starts, n_targets + 1):
        message = (
            f"there must be at least {max(n_starts, n_targets + 1)} held-out shapes for {n_starts} starts with "
            f"{n_targets} targets each, there are {len(numbers)}"
        )
        raise EnsembleError(message, where="held_out")
    rng = np.random.default_rng([seed, 20])
    starts = rng.choice(len(numbers), n_starts, replace=False)
    targets = np.array([rng.choice(np.setdiff1d(np.arange(len(numbers)), a), n_targets, replace=False) for a in starts])
    shapes = np.unique(np.concatenate([starts, targets.ravel()]))
    fields = held_out.fields(numbers[shapes], threads)
    markers, inner = _skin_nodes(held_out.mesh, rng), _inner_nodes(held_out.mesh, rng)
    begin = np.searchsorted(shapes, np.repeat(starts, n_targets))
    return Cases(fields, begin, np.searchsorted(shapes, targets.ravel()), markers, inner)


def _distance(one: Fields, other: Fields) -> float:
    difference = np.subtract(one, other, dtype=np.float64)
    return float(np.sqrt(np.einsum("ni,ni->n", difference, difference)).mean())


def _skin_nodes(mesh: Mesh, rng: np.random.Generator) -> IntArray:
    """Return nodes spread over the free surface: each the farthest of random ones from those before it."""
    free = np.setdiff1d(np.unique(mesh.surface), mesh.fixed_nodes)
    rest = rng.permutation(free)[:_CANDIDATES]
    found, rest = [int(rest[0])], rest[1:]
    while len(found) < N_MARKERS and len(rest):
        gap = np.linalg.norm(mesh.nodes[rest][:, None] - mesh.nodes[found][None], axis=2).min(axis=1)
        found.append(int(rest[np.argmax(gap)]))
        rest = np.delete(rest, np.argmax(gap))
    return np.array(found, np.int64)


def _inner_nodes(mesh: Mesh, rng: np.random.Generator) -> IntArray:
    inside = np.setdiff1d(np.arange(mesh.n_nodes), np.concatenate([np.unique(mesh.surface), mesh.fixed_nodes]))
    return np.asarray(np.sort(rng.permutation(inside)[:N_INNER]), np.int64)
