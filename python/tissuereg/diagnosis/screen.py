"""Screening: the exact linear-Gaussian evidence of every hypothesis in the bank, and of the generic rival.

The log Bayes factor of a cause is averaged over its hypotheses: the penalty for having searched in many places.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bank import Bank
from tissuereg.diagnosis.causes import Variant
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.evidence import Blocks, Null, fit_amplitudes, log_mean_exp
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.signals import SignalLayout

#: Id of the generic rival.
UNKNOWN = "unknown"

#: Columns that are reduced at a time, to bound memory.
_AT_A_TIME = 400


@dataclass(frozen=True, eq=False)
class Screened:
    """Linear evidence of one cause.

    `log_bayes_factor`: of the cause against no cause, nats: logarithm of the mean Bayes factor of its hypotheses;
    `best`: the likeliest one; `amplitudes` (p,): posterior mean of its amplitudes, in prior standard deviations. The
    generic rival has neither.
    """

    log_bayes_factor: float
    best: Variant | None
    amplitudes: FloatArray


class Screen:
    """All hypotheses, corrected and whitened by noise and nuisances once for any number of residuals.

    `bank`: hypotheses of each cause, with columns in mm and mN; `generic` (n_sizes, p, size): columns of the generic
    rival, mm and mN; `null`: covariance of noise and nuisances. `generic_white` (n_sizes, p, size): the rival's
    columns, whitened by the noise alone.
    """

    def __init__(
        self, bank: Bank, generic: FloatArray, noise: Noise, layout: SignalLayout, correction: Correction, null: Null
    ) -> None:
        self.bank = bank
        self.null = null
        self.white: Callable[[FloatArray], FloatArray] = lambda columns: noise.whitened(
            correction.of_columns(columns), layout
        )
        believed = replace(correction, modulus=1.0)
        self.generic_white: FloatArray = np.stack(
            [noise.whitened(believed.of_columns(block), layout) for block in generic]
        )

        def reduced(columns: FloatArray) -> FloatArray:
            flat = columns.reshape(-1, columns.shape[-1])
            pieces = (flat[i : i + _AT_A_TIME].astype(np.float64) for i in range(0, len(flat), _AT_A_TIME))
            parts = [null.reduced(self.white(piece)) for piece in pieces]
            return np.concatenate(parts).astype(np.float32).reshape(columns.shape)  # type: ignore[return-value]

        self.blocks = {
            name: Blocks(reduced(np.stack([v.columns for v in variants])), positive=variants[0].positive)
            for name, variants in bank.items()
        }
        self.generic = [Blocks(null.reduced(columns)[None].astype(np.float32)) for columns in self.generic_white]

    def of(self, residual: FloatArray) -> dict[str, Screened]:
        """Return the evidence of every cause, by id, for one residual (size,) whitened by noise and nuisances."""
        found: dict[str, Screened] = {}
        for name, blocks in self.blocks.items():
            variants = self.bank[name]
            each = self._each(name, residual[None])[0]
            top = int(np.argmax(each))
            if variants[top].fixed:
                amplitudes = np.ones(1)
            else:
                amplitudes = fit_amplitudes(residual, blocks.columns[top].astype(np.float64))[1]
            found[name] = Screened(float(log_mean_exp(each)), variants[top], amplitudes)
        each = np.array([block.log_bayes_factors(residual[None])[0, 0] for block in self.generic])
        found[UNKNOWN] = Screened(float(log_mean_exp(each)), None, np.empty(0))
        return found

    def white_columns(self, name: str) -> FloatArray:
        """Return the columns of all hypotheses of a cause, (n_variants, p, size), whitened by the noise alone."""
        return np.stack([self.white(variant.columns.astype(np.float64)) for variant in self.bank[name]])

    def detectability(self, name: str, variant: Variant, amplitudes: FloatArray) -> float:
        """Return the norm, whitened by noise and nuisances, of the change by a hypothesis of amplitudes (p,)."""
        number = next(i for i, other in enumerate(self.bank[name]) if other is variant)
        return float(np.linalg.norm(amplitudes @ self.blocks[name].columns[number].astype(np.float64)))

    def many(self, residuals: FloatArray) -> dict[str, FloatArray]:
        """Return the log Bayes factors (n,), nats, of all causes and the generic rival for residuals (n, size)."""
        found = {name: log_mean_exp(self._each(name, residuals)) for name in self.blocks}
        each = [block.log_bayes_factors(residuals)[:, 0] for block in self.generic]
        found[UNKNOWN] = log_mean_exp(np.stack(each, axis=-1))
        return found

    def _each(self, name: str, residuals: FloatArray) -> FloatArray:
        """Return the log Bayes factors (n, n_variants) of a cause's hypotheses, for whitened residuals (n, size)."""
        blocks = self.blocks[name]
        if self.bank[name][0].fixed:
            shift = blocks.columns[:, 0]
            power = np.einsum("vs,vs->v", shift, shift, dtype=np.float64)
            return np.asarray(residuals.astype(np.float32) @ shift.T - 0.5 * power, np.float64)
        return blocks.log_bayes_factors(residuals)
