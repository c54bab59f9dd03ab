"""Held-out proof: the predictive density that a model, fitted without a block of the data, gives to that block.

A block is a set of entries of the data, such as a load case. Models are linearised at their fit (`Fit.jacobian`).
Holding a block out is then exact linear algebra: the posterior of parameters and nuisances given all other data, and
the Gaussian predictive density of the block. A cause must predict better than the model without it and than the generic
rival: an empirical discrepancy term interpolates well but extrapolates badly, a physical cause does both
(Brynjarsdottir and O'Hagan, Inverse Problems 30, 2014).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.stats import norm

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.evidence import fit_amplitudes, rms
from tissuereg.diagnosis.fit import Fit, FitTarget
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.screen import Screen
from tissuereg.diagnosis.settings import DEFAULT, SearchSettings
from tissuereg.diagnosis.signals import CasePart, SignalLayout

#: Rows of a proof: model before the cause, model with it, the former plus the generic rival, the believed model.
BEFORE, NAMED, GENERIC, BELIEVED = range(4)


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A model linear in its parameters x: residual = columns^T x + white noise, x ~ N(0, I).

    `residual` (size,): measured minus predicted at x = 0, whitened by the noise; `columns` (p, size): whitened
    likewise.
    """

    residual: FloatArray
    columns: FloatArray


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Predictions of blocks of data by several models, each fitted to all data but the block.

    `blocks`: their names; `log_density` (n_models, n_blocks): of every block given all others, nats; `residuals`
    (n_models, size): whitened, NaN outside all blocks; `expected_gain`: gain in log density over the model before,
    nats, if the cause is as it was fitted and nothing else is wrong, without noise.
    """

    blocks: tuple[str, ...]
    log_density: FloatArray
    residuals: FloatArray
    expected_gain: float = np.inf

    def proves(self, rules: SearchSettings) -> bool:
        """Return whether the cause predicts held-out data better than the rival and than the model without it."""
        if not rules.judged:
            return True
        density = self.log_density.sum(axis=1)
        # Where a nuisance describes the same change, held-out data hardly differ between the models. The log density
        # ratio of two Gaussians has a variance of twice its mean.
        root = np.sqrt(max(self.expected_gain, 0.0))
        reached = float(root * (root + np.sqrt(2.0) * norm.ppf(rules.refused)))
        least_gain = max(0.0, min(rules.proved, reached))
        return bool(density[NAMED] > density[BEFORE] + least_gain and density[NAMED] > density[GENERIC])


def linear_model(target: FitTarget, fit: Fit, extra: FloatArray | None = None) -> LinearModel:
    """Return a fit as a model linear in its nuisances, its parameters and the amplitudes of further columns.

    `extra` (p, size): further columns, whitened by the noise, times prior standard deviations; None for none.
    """
    slopes = target.slopes(fit)
    # The model is linear about the fit; x = 0 is the prior mean.
    residual = fit.residual + slopes.T @ ((fit.x - fit.mean) / fit.deviation)
    parts = [target.null.nuisances, slopes, *([] if extra is None else [extra])]
    return LinearModel(residual, np.concatenate(parts))


def prove(
    target: FitTarget,
    references: list[LinearModel],
    current: Fit,
    found: Fit,
    part: int | None = -1,
    *,
    stated: bool = False,
) -> HeldOut:
    """Return the predictions of the compared models on held-out blocks: of a proof, or those whose errors are stated.

    `references`: as `references_of`; `current`, `found`: fits without and with the cause; `part`: its number in the
    latter; None for the modulus; `stated`: whether the blocks are those whose errors are stated (`figure_blocks`).
    """
    # Whitened changes: by one prior deviation of each parameter, and by the whole cause.
    slopes = target.slopes(found)[slice(1) if part is None else found.slices()[part]]
    change = target.white(found.prediction - current.prediction)
    slopes = slopes if len(slopes) else change[None]
    layout, rules = target.bench.layout, target.bench.settings.search
    blocks = figure_blocks(layout, slopes, change, rules) if stated else proof_blocks(layout, slopes, rules)
    before, *others = references
    named = linear_model(target, found)
    made = held_out([before, named, *others], blocks)
    if stated:
        return made
    # Data that the fit predicts exactly, as each model sees them.
    would = replace(before, residual=before.residual - current.residual + change)
    exact = replace(named, residual=named.residual - found.residual)
    return replace(made, expected_gain=-float(np.subtract(*held_out([would, exact], blocks).log_density.sum(axis=1))))


def references_of(target: FitTarget, screen: Screen, base: Fit, current: Fit) -> list[LinearModel]:
    """Return three models to compare a cause with: one without it, that plus the generic rival, the believed one.

    `base`, `current`: fits of the believed model and without the cause. The rival has the size of most evidence.
    """
    reduced = target.null.reduced(current.residual)
    gains = [fit_amplitudes(reduced, target.null.reduced(columns))[0] for columns in screen.generic_white]
    rival = linear_model(target, current, np.asarray(screen.generic_white[int(np.argmax(gains))]))
    return [linear_model(target, current), rival, linear_model(target, base)]


def held_out(models: list[LinearModel], blocks: dict[str, BoolArray]) -> HeldOut:
    """Return the predictions of blocks of the data by several models, each block predicted from all other data.

    `blocks`: by name, a boolean mask (size,) of the entries that are held out together. Log densities lack the constant
    that all models have in common.
    """
    size = len(models[0].residual)
    density = np.zeros((len(models), len(blocks)))
    residuals = np.full((len(models), size), np.nan)
    for m, model in enumerate(models):
        whole = model.columns @ model.columns.T
        along = model.columns @ model.residual
        for b, mask in enumerate(blocks.values()):
            mine = model.columns[:, mask]
            inner = np.eye(len(whole)) + whole - mine @ mine.T
            mean = np.linalg.solve(inner, along - mine @ model.residual[mask])
            rest = model.residual[mask] - mean @ mine
            residuals[m, mask] = rest
            # The block's predictive covariance is I + A^T inner^-1 A; by Woodbury only (p, p) matrices are needed.
            full = inner + mine @ mine.T
            half = mine @ rest
            power = rest @ rest - half @ np.linalg.solve(full, half)
            logdet = np.linalg.slogdet(full)[1] - np.linalg.slogdet(inner)[1]
            density[m, b] = -0.5 * power - 0.5 * logdet
    return HeldOut(tuple(blocks), density, residuals)


def proof_blocks(
    layout: SignalLayout, slopes: FloatArray, settings: SearchSettings = DEFAULT.search
) -> dict[str, BoolArray]:
    """Return the blocks that are held out to prove a cause by its predictive density, as masks (size,) by name.

    `slopes` (k, size): whitened changes of the prediction by one prior standard deviation of each of the cause's
    parameters. The blocks are the load cases in which the cause shows and without which its parameters are still
    determined (`determined`); if there is none, blocks of frames of the case that shows it most.
    """

    def determined(mask: BoolArray) -> bool:
        return bool(np.trace(_spread(slopes, mask)) / len(slopes) <= settings.determined)

    return _blocks(layout, (slopes**2).sum(axis=0), determined, settings.time_blocks)


def figure_blocks(
    layout: SignalLayout, slopes: FloatArray, change: FloatArray, settings: SearchSettings = DEFAULT.search
) -> dict[str, BoolArray]:
    """Return the blocks for which prediction errors with and without a cause are stated, as masks (size,) by name.

    `slopes` (k, size): as for `proof_blocks`; `change` (size,): whitened change that the fitted cause makes. The blocks
    are the load cases whose change the other data determine (`undetermined`); if there is none, blocks of frames of the
    case with the largest change. Undetermined parameters do no harm where their columns vanish.
    """

    def determined(mask: BoolArray) -> bool:
        mine, most = slopes[:, mask], settings.undetermined * (change[mask] ** 2).sum()
        return bool(np.trace(_spread(slopes, mask) @ mine @ mine.T) <= most)

    return _blocks(layout, change**2, determined, settings.time_blocks)


def held_out_figures(layout: SignalLayout, noise: Noise, proof: HeldOut, figures: HeldOut) -> dict[str, object]:
    """Return the held-out errors of a finding: of markers in mm, and of markers and forces in noise deviations.

    `proof`, `figures`: predictions of the blocks of `proof_blocks` and of `figure_blocks`, with the rows of `prove`.
    The entries are ``rms_..._mm`` and ``chi_...`` of three models, ``noise_mm``, ``log_density_gain`` in nats, and
    ``cases``, the names of the blocks.
    """
    typical = float(noise.marker_std.mean())
    rows = {"base": BELIEVED, "named": NAMED, "generic": GENERIC}

    def of(row: int, entries: BoolArray) -> float:
        left = figures.residuals[row]
        return rms(left[entries & layout.seen & np.isfinite(left)])

    return {
        **{f"rms_{key}_mm": typical * of(row, layout.of_markers()) for key, row in rows.items()},
        "noise_mm": typical,
        **{f"chi_{key}": of(row, layout.seen) for key, row in rows.items()},
        "log_density_gain": float(proof.log_density[NAMED].sum() - proof.log_density[BEFORE].sum()),
        "cases": list(figures.blocks),
    }


def frame_blocks(
    layout: SignalLayout, part: CasePart, n_blocks: int = DEFAULT.search.time_blocks
) -> dict[str, BoolArray]:
    """Return masks (size,) by name that divide a case into `n_blocks` blocks, each of every `n_blocks`-th frame."""
    blocks = {}
    for number in range(min(n_blocks, part.n_frames)):
        mask = np.zeros(layout.size, bool)
        part.put(mask, np.arange(part.n_frames) % n_blocks == number)
        whole = part.n_frames == 1
        blocks[part.name if whole else f"{part.name}, every {n_blocks}th frame from {number}"] = mask
    return blocks


def _blocks(
    layout: SignalLayout, shown: FloatArray, determined: Callable[[BoolArray], bool], n_blocks: int
) -> dict[str, BoolArray]:
    """Return the cases that a cause changes and that the other data determine, as masks (size,) by name."""
    power = {part.name: float(shown[layout.of_case(part.name)].sum()) for part in layout.parts}
    masks = {name: layout.of_case(name) for name, size in power.items() if size > 1.0}
    cases = {name: mask for name, mask in masks.items() if determined(mask)}
    # Without such a case, blocks of frames of the one that changes most.
    return cases or frame_blocks(layout, layout[max(power, key=lambda name: power[name])], n_blocks)


def _spread(slopes: FloatArray, mask: BoolArray) -> FloatArray:
    """Return the posterior covariance (k, k) of parameters, in prior deviations, given all data but a block."""
    others = slopes[:, ~mask]
    return np.asarray(np.linalg.inv(np.eye(len(slopes)) + others @ others.T))
