"""Whether what a model leaves is noise: a battery of statistics, judged together against effect-free data.

Sums of squares over cases, sensors, markers and frames see what is large somewhere. A wrong cause leaves something
small and smooth that goes with the load: sums over a few smooth patterns, in which noise has little, see that.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import gumbel_r

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.generic import histories
from tissuereg.diagnose.noise import Noise
from tissuereg.diagnose.patterns import force_columns, marker_columns, smooth_patterns
from tissuereg.diagnose.signals import Layout

#: Patterns over the markers of a smooth subspace: the smoothest.
SMOOTH = 3

#: Directions of a subspace shorter than this, over its longest, are none.
_LEAST = 1e-6


@dataclass(frozen=True)
class Misfit:
    """How unlike noise a residual is.

    Attributes
    ----------
    p : float
        Probability that effect-free data misfit as much.
    explained, explained_there : float
        Share of what the believed model leaves beyond noise that is gone: of all, and in the statistic that stands out
        most.
    """

    p: float
    explained: float
    explained_there: float


class Battery:
    """Statistics of residuals, each a sum of squares or the largest of some.

    Parameters
    ----------
    layout : Layout
        Order of the data.
    subspaces : sequence of ndarray of float64, shapes (k, size)
        Orthonormal rows; see `smooth_subspaces`.
    """

    def __init__(self, layout: Layout, subspaces: Sequence[FloatArray]) -> None:
        self.layout = layout
        self.subspaces = subspaces

    def judge(self, before: FloatArray, after: FloatArray, nulls: FloatArray) -> Misfit:
        """Return how unlike noise the residual of a model is.

        Parameters
        ----------
        before, after : ndarray of float64, shape (size,)
            Whitened and reduced: of the believed model, and of the one that is judged.
        nulls : ndarray of float64, shape (n, size)
            Those of effect-free data.

        Returns
        -------
        Misfit
            The probability is that of the largest of all statistics, each standardised on the nulls; Gumbel's tail
            takes over where nulls end.
        """
        sums, drawn = self.sums(np.stack([before, after])), self.sums(nulls)
        logs = np.log(drawn)
        centre, spread = logs.mean(axis=0), np.maximum(logs.std(axis=0), 1e-9)
        excess = (np.log(sums[1]) - centre) / spread
        worst = int(excess.argmax())
        largest = float(excess[worst])
        of_nulls = ((logs - centre) / spread).max(axis=1)
        share = float((of_nulls >= largest).mean())
        # Largest values follow Gumbel's law, fitted by its moments where the draws end.
        width = float(of_nulls.std()) * np.sqrt(6.0) / np.pi
        tail = float(gumbel_r.sf(largest, of_nulls.mean() - np.euler_gamma * width, width))
        return Misfit(
            p=max(share, tail) if share > 0.0 else min(tail, 1.0 / len(nulls)),
            explained=_gone(sums[:, 0], drawn[:, 0], nothing=1.0),
            explained_there=_gone(sums[:, worst], drawn[:, worst], nothing=0.0),
        )

    def sums(self, residuals: FloatArray) -> FloatArray:
        """Return all statistics, shape (n, n_statistics), positive; that of everything first."""
        layout, rows = self.layout, [(residuals**2).sum(axis=1)]
        per_marker = np.zeros((len(residuals), len(layout.marker_names)))
        per_frame = []
        for part in layout.parts:
            markers = part.markers(residuals) ** 2
            rows.append(markers.sum(axis=(1, 2, 3)))
            per_marker += markers.sum(axis=(1, 3))
            per_frame.append(markers.sum(axis=(2, 3)))
            for i in range(len(part.pads)):
                forces = part.forces(residuals)[:, :, i] ** 2
                rows.append(forces.sum(axis=(1, 2)))
                per_frame.append(forces.sum(axis=2))
        rows.append(per_marker.max(axis=1))
        rows.append(np.concatenate(per_frame, axis=1).max(axis=1))
        rows += [((residuals @ basis.T) ** 2).sum(axis=1) for basis in self.subspaces]
        return np.asarray(np.maximum(np.stack(rows, axis=1), 1e-12))


def smooth_subspaces(layout: Layout, base: FloatArray, extent: float, noise: Noise) -> list[FloatArray]:
    """Return what smooth changes of markers and forces span, with every history of a case, and with all of them.

    Parameters
    ----------
    layout : Layout
        Order of the data.
    base : ndarray of float64, shape (size,)
        What the believed model says, mm and mN.
    extent : float
        Of the body, mm.
    noise : Noise
        Of the measurement.

    Returns
    -------
    list of ndarray of float64, shapes (k, size)
        Orthonormal rows over whitened data.
    """
    patterns = smooth_patterns(layout.reference, extent)[:SMOOTH]
    found = []
    for part in layout.parts:
        of_case = []
        for history in histories(part, base):
            markers = marker_columns(layout, part, history, patterns).reshape(-1, layout.size)
            forces = [force_columns(layout, part, pad, history) for pad in range(len(part.pads))]
            of_case.append(noise.whitened(np.concatenate([markers, *forces]), layout))
        found += [_basis(columns) for columns in (*of_case, np.concatenate(of_case))]
    return [basis for basis in found if len(basis)]


def _gone(sums: FloatArray, drawn: FloatArray, nothing: float) -> float:
    """Return the share of a statistic, before and after, beyond what is drawn, that is gone; `nothing` of none."""
    (before, after), expected = sums.tolist(), float(drawn.mean())
    return float((before - after) / (before - expected)) if before > expected else nothing


def _basis(columns: FloatArray) -> FloatArray:
    """Return orthonormal rows that span some columns (k, size)."""
    lengths = np.linalg.norm(columns, axis=1)
    columns = columns[lengths > 0.0] / lengths[lengths > 0.0, None]
    if not len(columns):
        return columns
    _, sizes, rows = np.linalg.svd(columns, full_matrices=False)
    return np.asarray(rows[sizes > _LEAST * sizes[0]])
