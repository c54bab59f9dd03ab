"""Held-out proof: what a model, fitted without a block of the data, says of that block.

Models are linear at their fit (`Fit.jacobian`), so leaving a block out is exact linear algebra: the posterior of knobs
and nuisances given all other data, and the predictive density of the block. A cause must beat the believed model and
the generic rival there: a patch interpolates, a cause extrapolates (Brynjarsdottir and O'Hagan 2014).
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import BoolArray, FloatArray
from tissuereg.diagnose.fit import Fit, Target
from tissuereg.diagnose.noise import Noise
from tissuereg.diagnose.signals import CasePart, Layout

#: A cause is proved on a case only where the others tell its knobs: to this share of their prior variance.
TOLD = 0.5

#: Figures are given of a case only where the others tell what the cause does there: all but this share, in squares.
LEFT_OPEN = 0.75

#: Rows of a cause's proof: the model before it, that with it, the generic rival beside the former, the believed one.
BEFORE, NAMED, GENERIC, BELIEVED = range(4)

#: Blocks in time, where one case alone shows a cause.
TIME_BLOCKS = 4


@dataclass(frozen=True, eq=False)
class Linear:
    """A model, linear in its coordinates: measured = columns . x + what is left.

    Attributes
    ----------
    residual : ndarray of float64, shape (size,)
        Measured less predicted at x = 0, whitened.
    columns : ndarray of float64, shape (p, size)
        Whitened, over prior deviations.
    """

    residual: FloatArray
    columns: FloatArray


@dataclass(frozen=True, eq=False)
class HeldOut:
    """How models predict blocks that they were not fitted to.

    Attributes
    ----------
    blocks : tuple of str
        Names of the blocks.
    log_density : ndarray of float64, shape (n_models, n_blocks)
        Of every block given all others.
    left : ndarray of float64, shape (n_models, size)
        Whitened residuals of the predictions, NaN outside all blocks.
    """

    blocks: tuple[str, ...]
    log_density: FloatArray
    left: FloatArray


def linear_model(target: Target, fit: Fit, extra: FloatArray | None = None) -> Linear:
    """Return a fit as a linear model, nuisances and further whitened columns (p, size) beside its own."""
    slopes = target.white(fit.jacobian) * fit.deviation[:, None]
    # At the fit the coordinates are not those of the prior's mean.
    residual = fit.residual + slopes.T @ ((fit.x - fit.mean) / fit.deviation)
    parts = [target.null.nuisances, slopes] + ([] if extra is None else [extra])
    return Linear(residual, np.concatenate(parts))


def held_out(models: list[Linear], blocks: dict[str, BoolArray]) -> HeldOut:
    """Return how models predict blocks.

    Parameters
    ----------
    models : list of Linear
        To be compared.
    blocks : dict of str to ndarray of bool, shape (size,)
        Entries to be held out together.

    Returns
    -------
    HeldOut
        Densities without the constant that all models share.
    """
    size = len(models[0].residual)
    density = np.zeros((len(models), len(blocks)))
    left = np.full((len(models), size), np.nan)
    for m, model in enumerate(models):
        whole = model.columns @ model.columns.T
        along = model.columns @ model.residual
        for b, mask in enumerate(blocks.values()):
            mine = model.columns[:, mask]
            inner = np.eye(len(whole)) + whole - mine @ mine.T
            mean = np.linalg.solve(inner, along - mine @ model.residual[mask])
            rest = model.residual[mask] - mean @ mine
            left[m, mask] = rest
            # The block's covariance is I + A^T inner^-1 A; Woodbury keeps it small.
            full = inner + mine @ mine.T
            half = mine @ rest
            power = rest @ rest - half @ np.linalg.solve(full, half)
            logdet = np.linalg.slogdet(full)[1] - np.linalg.slogdet(inner)[1]
            density[m, b] = -0.5 * power - 0.5 * logdet
    return HeldOut(tuple(blocks), density, left)


def proof_blocks(layout: Layout, slopes: FloatArray) -> dict[str, BoolArray]:
    """Return the blocks on which a cause can be proved by the density that it gives them.

    Parameters
    ----------
    layout : Layout
        Order of the data.
    slopes : ndarray of float64, shape (k, size)
        The cause's whitened columns, over prior deviations.

    Returns
    -------
    dict of str to ndarray of bool, shape (size,)
        Load cases, where the others tell the cause; blocks of frames of the case that shows it, where one alone does.
    """

    def told(mask: BoolArray) -> bool:
        return bool(np.trace(_spread(slopes, mask)) / len(slopes) <= TOLD)

    return _blocks(layout, (slopes**2).sum(axis=0), told)


def figure_blocks(layout: Layout, slopes: FloatArray, change: FloatArray) -> dict[str, BoolArray]:
    """Return the blocks on which the best guess of a model with a cause can be better than that of one without.

    Parameters
    ----------
    layout : Layout
        Order of the data.
    slopes : ndarray of float64, shape (k, size)
        The cause's whitened columns, over prior deviations.
    change : ndarray of float64, shape (size,)
        What the cause changes, whitened.

    Returns
    -------
    dict of str to ndarray of bool, shape (size,)
        Load cases, where the others tell what the cause does there; blocks of frames of the case in which it does most,
        where there is none. Knobs that nothing tells do no harm where they move nothing.
    """

    def told(mask: BoolArray) -> bool:
        mine = slopes[:, mask]
        return bool(np.trace(_spread(slopes, mask) @ mine @ mine.T) <= LEFT_OPEN * (change[mask] ** 2).sum())

    return _blocks(layout, change**2, told)


def held_out_figures(layout: Layout, noise: Noise, proof: HeldOut, figures: HeldOut) -> dict[str, object]:
    """Return what a finding's proof says: residuals in mm, and over their noise with forces.

    Parameters
    ----------
    layout : Layout
        Order of the data.
    noise : Noise
        Of the measurement.
    proof, figures : HeldOut
        On what the density was proved, and on what can be guessed; rows as this module names them.

    Returns
    -------
    dict
        ``held_out`` of the answer.
    """
    markers = layout.of_markers() & layout.seen
    chi = [_rms(row[layout.seen & np.isfinite(row)]) for row in figures.left]
    typical = float(noise.marker_std.mean())
    rms = [typical * _rms(row[markers & np.isfinite(row)]) for row in figures.left]
    return {
        "rms_base_mm": rms[BELIEVED],
        "rms_named_mm": rms[NAMED],
        "rms_generic_mm": rms[GENERIC],
        "noise_mm": typical,
        "chi_base": chi[BELIEVED],
        "chi_named": chi[NAMED],
        "chi_generic": chi[GENERIC],
        "log_density_gain": float(proof.log_density[NAMED].sum() - proof.log_density[BEFORE].sum()),
        "cases": list(figures.blocks),
    }


def frame_blocks(layout: Layout, part: CasePart) -> dict[str, BoolArray]:
    """Return blocks of frames of one case; every block holds frames from all through it."""
    blocks = {}
    for number in range(min(TIME_BLOCKS, part.n_frames)):
        mask = np.zeros(layout.size, bool)
        part_mask = np.zeros(part.n_frames, bool)
        part_mask[number::TIME_BLOCKS] = True
        part.markers(mask)[part_mask] = True
        part.forces(mask)[part_mask] = True
        whole = part.n_frames == 1
        blocks[part.name if whole else f"{part.name}, every {TIME_BLOCKS}th frame from {number}"] = mask
    return blocks


def _blocks(layout: Layout, shown: FloatArray, told: Callable[[BoolArray], bool]) -> dict[str, BoolArray]:
    """Return the cases that show something and that the others tell; frames of the one that shows most if none does."""
    power = {part.name: float(shown[layout.of_case(part.name)].sum()) for part in layout.parts}
    masks = {name: layout.of_case(name) for name, size in power.items() if size > 1.0}
    cases = {name: mask for name, mask in masks.items() if told(mask)}
    return cases or frame_blocks(layout, layout[max(power, key=lambda name: power[name])])


def _spread(slopes: FloatArray, mask: BoolArray) -> FloatArray:
    """Return the covariance of knobs, over prior deviations, that data without a block leave."""
    others = slopes[:, ~mask]
    return np.asarray(np.linalg.inv(np.eye(len(slopes)) + others @ others.T))


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0
