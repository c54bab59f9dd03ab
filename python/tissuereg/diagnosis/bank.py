"""The bank: all hypotheses of all causes with their sensitivity columns, cached between calls.

A bank depends on the believed model and on what the rig does, not on what was measured, so that further experiments
with the same mesh and rig reuse it. Files lie in the cache folder of the package (`tissuereg.io.cache`), named by a
hash of all that they depend on.
"""

import json
from dataclasses import replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES, Variant, catalogue
from tissuereg.diagnosis.outside import outside_variants
from tissuereg.diagnosis.predictor import fingerprint
from tissuereg.diagnosis.settings import DiagnoseSettings
from tissuereg.io.cache import keep_arrays, read_arrays
from tissuereg.io.json import dumps

#: To be increased when columns change their meaning, so that older files are not read.
SCHEMA = 11

#: Hypotheses by id of the cause; causes without a hypothesis in an experiment are left out.
Bank = dict[str, list[Variant]]


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
    new = False
    wanted = {name: one for name, one in catalogue(bench.settings).items() if name not in bench.settings.left_out}
    # A law may grow without bounds under large strains: no amplitude of such a hypothesis would be seen.
    most = bench.settings.model.largest_change * max(float(np.abs(bench.base).max()), 1.0)
    for name, cause in wanted.items():
        if name not in bank:
            bench.progress(name)
            finite = (v for v in cause.variants(bench) if np.abs(v.columns).max() < most)
            bank[name] = [replace(v, columns=v.columns.astype(np.float32)) for v in finite]
            new = new or not cause.closed_form
    if keep and new:
        _write(entry, bench.base, bank)
    return {name: bank[name] for name in wanted if bank[name]}


def make_outside(bench: Bench, *, keep: bool = True) -> Bank:
    """Return the hypotheses of every kind of effect outside the catalogue (`outside_variants`), as `make_bank` does."""
    settings = replace(bench.settings.outside, variations=(), holds=(), strains=(), motions=()), bench.settings.model
    entry = f"outside_{fingerprint(bench.experiment, f'{bench.predictor.element} {SCHEMA} {settings}')}"
    bank = _read(entry)[1] if keep else {}
    if not bank and bench.is_elastic:
        bench.progress("effects outside the catalogue")
        for kind, several in outside_variants(bench).items():
            bank[kind] = [replace(v, columns=v.columns.astype(np.float32)) for v in several]
        if keep:
            _write(entry, bench.base, bank)
    return bank


def numbers_of(settings: DiagnoseSettings) -> str:
    """Return the numbers of all causes and of solutions as text, on which the columns of a bank depend."""
    of_causes = [repr(cause) for cause in catalogue(settings).values()]
    return dumps([of_causes, repr(settings.model)])


def _write(entry: str, base: FloatArray, bank: Bank) -> None:
    arrays: dict[str, Any] = {"base": base}
    card: dict[str, list[dict[str, object]]] = {}
    for name, several in bank.items():
        if name in CAUSES and CAUSES[name].closed_form:
            continue
        card[name] = [
            {"label": v.label, "settings": dict(v.settings), "positive": v.positive, "fixed": v.fixed} for v in several
        ]
        if several:
            arrays[f"columns_{name}"] = np.stack([v.columns for v in several])
    arrays["card"] = np.array(dumps(card))
    keep_arrays(entry, arrays)


def _read(entry: str) -> tuple[FloatArray | None, Bank]:
    """Return the cached prediction (size,) of the believed model, mm and mN, and the bank; None and {} without any."""
    kept = read_arrays(entry)
    if kept is None:
        return None, {}
    card = json.loads(str(kept["card"]))
    bank: Bank = {}
    for name, rows in card.items():
        columns = kept[f"columns_{name}"] if rows else []
        bank[name] = [
            Variant(row["label"], column, row["settings"], row["positive"], row["fixed"])
            for row, column in zip(rows, columns, strict=True)
        ]
    return kept["base"], bank
