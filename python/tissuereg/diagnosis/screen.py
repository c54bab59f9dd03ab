"""Screening: the bank of all hypotheses of all causes, and the exact linear-Gaussian evidence of each of them.

A bank holds the columns of the hypotheses. It depends on the believed model and on what the rig does, not on what was
measured, so that further experiments with the same mesh and rig reuse it: files in the cache folder of the package
(`tissuereg.io.cache`) are named by a hash of all that they depend on.

The log Bayes factor of a cause is averaged over its hypotheses: the penalty for having searched in many places. The
generic rival is a hypothesis of its own.
"""

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES, Variant, catalogue
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.evidence import Blocks, Null, fit_amplitudes, log_mean_exp
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.outside import outside_variants
from tissuereg.diagnosis.predictor import fingerprint
from tissuereg.diagnosis.settings import DiagnoseSettings
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.io.cache import keep_arrays, read_arrays
from tissuereg.io.json import dumps

#: To be increased when columns change their meaning, so that older files are not read.
SCHEMA = 11

#: Hypotheses by id of the cause; causes without a hypothesis in an experiment are left out.
Bank = dict[str, list[Variant]]

#: Id of the generic rival.
UNKNOWN = "unknown"

#: Columns that are reduced at a time, to bound memory.
_AT_A_TIME = 400


def make_bank(bench: Bench, *, keep: bool = True) -> Bank:
    """Return the bank: for every hypothesis of every cause, the change that it makes to the predicted data.

    `keep`: whether to read and write the cache, from which the believed model's prediction is taken too. The columns
    (p, size) of a hypothesis are changes by one prior standard deviation of each of its p amplitudes, in mm and mN,
    single precision. Hypotheses that change a number without bounds (`largest_change`) are left out. Raises
    `ConvergenceError` if the believed model itself has no equilibrium.
    """
    entry = f"bank_{fingerprint(bench.experiment, f'{bench.predictor.element} {SCHEMA} {numbers_of(bench.settings)}')}"
    base, bank = _read(entry) if keep else (None, {})
    if base is not None:
        bench.base = base
    wanted = {name: one for name, one in catalogue(bench.settings).items() if name not in bench.settings.left_out}
    # A law may grow without bounds under large strains: no amplitude of such a hypothesis would be seen.
    most = bench.settings.model.largest_change * max(float(np.abs(bench.base).max()), 1.0)
    new = [name for name in wanted if name not in bank]
    for name in new:
        bench.progress(name)
        bank[name] = _single(v for v in wanted[name].variants(bench) if np.abs(v.columns).max() < most)
    if keep and not all(wanted[name].closed_form for name in new):
        _write(entry, bench.base, bank)
    return {name: bank[name] for name in wanted if bank[name]}


def make_outside(bench: Bench, *, keep: bool = True) -> Bank:
    """Return the hypotheses of every kind of effect outside the catalogue (`outside_variants`), as `make_bank` does."""
    settings = replace(bench.settings.outside, variations=(), holds=(), strains=(), motions=()), bench.settings.model
    entry = f"outside_{fingerprint(bench.experiment, f'{bench.predictor.element} {SCHEMA} {settings}')}"
    bank = _read(entry)[1] if keep else {}
    if not bank and bench.is_elastic:
        bench.progress("effects outside the catalogue")
        bank = {kind: _single(several) for kind, several in outside_variants(bench).items()}
        if keep:
            _write(entry, bench.base, bank)
    return bank


def numbers_of(settings: DiagnoseSettings) -> str:
    """Return the numbers of all causes and of solutions as text, on which the columns of a bank depend."""
    return dumps([[repr(cause) for cause in catalogue(settings).values()], repr(settings.model)])


def _single(variants: Iterable[Variant]) -> list[Variant]:
    return [replace(one, columns=one.columns.astype(np.float32)) for one in variants]


def _write(entry: str, base: FloatArray, bank: Bank) -> None:
    lasting = {name: several for name, several in bank.items() if name not in CAUSES or not CAUSES[name].closed_form}
    keys = ("label", "settings", "positive", "fixed")
    card = {name: [{key: getattr(v, key) for key in keys} for v in several] for name, several in lasting.items()}
    columns = {
        f"columns_{name}": np.stack([v.columns for v in several]) for name, several in lasting.items() if several
    }
    keep_arrays(entry, {"base": base, **columns, "card": np.array(dumps(card))})


def _read(entry: str) -> tuple[FloatArray | None, Bank]:
    """Return the cached prediction (size,) of the believed model, mm and mN, and the bank; None and {} without any."""
    kept = read_arrays(entry)
    if kept is None:
        return None, {}
    bank: Bank = {}
    for name, rows in json.loads(str(kept["card"])).items():
        columns = kept[f"columns_{name}"] if rows else []
        bank[name] = [Variant(columns=column, **row) for row, column in zip(rows, columns, strict=True)]
    return kept["base"], bank


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
        self.generic_white: FloatArray = noise.whitened(replace(correction, modulus=1.0).of_columns(generic), layout)

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
            columns = blocks.columns[top].astype(np.float64)
            amplitudes = np.ones(1) if variants[top].fixed else fit_amplitudes(residual, columns)[1]
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
