"""Whether what a model leaves is noise: a battery of statistics, judged together against effect-free data."""

import numpy as np
from scipy.stats import gumbel_r

from tissuereg._arrays import FloatArray
from tissuereg.diagnose.signals import Layout


def p_misfit(residual: FloatArray, nulls: FloatArray, layout: Layout) -> float:
    """Return the probability that effect-free data misfit as much.

    Parameters
    ----------
    residual : ndarray of float64, shape (size,)
        Whitened and reduced.
    nulls : ndarray of float64, shape (n, size)
        Those of effect-free data.
    layout : Layout
        Order of the data.

    Returns
    -------
    float
        Of the largest of all statistics, each standardised on the nulls; Gumbel's tail takes over where nulls end.
    """
    found, drawn = _statistics(residual[None], layout)[0], _statistics(nulls, layout)
    centre, spread = drawn.mean(axis=0), np.maximum(drawn.std(axis=0), 1e-9)
    largest = float(((found - centre) / spread).max())
    of_nulls = ((drawn - centre) / spread).max(axis=1)
    share = float((of_nulls >= largest).mean())
    # Largest values follow Gumbel's law, fitted by its moments where the draws end.
    width = float(of_nulls.std()) * np.sqrt(6.0) / np.pi
    tail = float(gumbel_r.sf(largest, of_nulls.mean() - np.euler_gamma * width, width))
    return max(share, tail) if share > 0.0 else min(tail, 1.0 / len(nulls))


def _statistics(residuals: FloatArray, layout: Layout) -> FloatArray:
    """Return logarithms of sums of squares, largest ones among them, shape (n, n_statistics)."""
    rows = []
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
    rows.append((residuals**2).sum(axis=1))
    return np.asarray(np.log(np.maximum(np.stack(rows, axis=1), 1e-12)))
