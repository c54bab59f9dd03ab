"""The bank: all hypotheses of all causes with their columns, kept between calls by content.

What a bank depends on is what is believed and what the rig does, not what was measured: the next experiment on the same
mesh and rig finds it made. Banks lie in the cache folder of the package (`tissuereg.io.cache`).
"""

import hashlib
import json
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg._version import __version__
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes import CAUSES, Variant
from tissuereg.effects import EFFECTS, ChainEffect
from tissuereg.experiment import Experiment
from tissuereg.io.cache import cache_folder, keep_in_cache
from tissuereg.io.json import dumps

#: Raised when columns change their meaning: banks of other releases are not read.
SCHEMA = 10

#: Causes whose columns are closed forms: made anew each time, never kept.
CLOSED_FORM = tuple(name for name in CAUSES if issubclass(EFFECTS[name], ChainEffect))

#: Oldest banks go when there are more than this.
MOST_FILES = 24


#: Hypotheses by id of the cause; causes that an experiment has no place for are left out.
Bank = dict[str, list[Variant]]


def make_bank(bench: Bench, *, keep: bool = True, progress: Callable[[str], None] | None = None) -> Bank:
    """Return the bank of a believed model, from the cache where it was made before.

    Parameters
    ----------
    bench : Bench
        The believed model; what it says is taken from the cache too.
    keep : bool
        Whether to read and write the cache.
    progress : callable of str, optional
        Called with the id of the cause that is at work.

    Returns
    -------
    Bank
        Columns in mm and mN, single precision.

    Raises
    ------
    ConvergenceError
        If the believed model itself finds no equilibrium.
    """
    path = cache_folder() / f"bank_{fingerprint(bench.experiment, f'{bench.predictor.element} {SCHEMA}')}.npz"
    base, bank = _read(path) if keep else (None, {})
    if base is not None:
        bench.base = base
    new = False
    for name, cause in CAUSES.items():
        if name not in bank:
            if progress is not None:
                progress(name)
            bank[name] = [_single(variant) for variant in cause.variants(bench)]
            new = new or name not in CLOSED_FORM
    if keep and new:
        _write(path, bench.base, bank)
    return {name: bank[name] for name in CAUSES if bank[name]}


def fingerprint(experiment: Experiment, of: str) -> str:
    """Return a hash of all that a believed model says depends on, and of what it is taken of, hexadecimal."""
    digest = hashlib.sha256(f"{__version__} {of}".encode())
    mesh = experiment.mesh
    parts = [mesh.nodes, mesh.tets, experiment.marker_reference]
    parts += [boundary.nodes for boundary in experiment.boundaries]
    parts += [pad.nodes for pad in experiment.actuators]
    for case in experiment.cases.values():
        digest.update(f"{case.name} {sorted(case.forces)}".encode())
        parts.append(case.times)
        for given in (case.displacements, case.applied_forces):
            for name in sorted(given):
                digest.update(name.encode())
                parts.append(given[name])
    for part in parts:
        array = np.ascontiguousarray(part)
        digest.update(f"{array.shape} {array.dtype}".encode() + array.tobytes())
    weight = experiment.gravity
    said = "none" if weight is None else f"{list(weight.direction)} {weight.g_mm_per_s2} {weight.in_reference}"
    patches = [f"{pad.name} {pad.kind} {pad.rule}" for pad in experiment.actuators]
    patches += [boundary.name for boundary in experiment.boundaries]
    effects = [dumps(effect.table()) for effect in experiment.effects]
    digest.update(
        "\n".join([experiment.material.digest(), f"{experiment.material.density}", said, *patches, *effects]).encode()
    )
    return digest.hexdigest()[:32]


def _single(variant: Variant) -> Variant:
    return Variant(
        variant.label,
        variant.columns.astype(np.float32),
        variant.settings,
        variant.positive,
        variant.fixed,
    )


def _write(path: Path, base: FloatArray, bank: Bank) -> None:
    arrays: dict[str, Any] = {"base": base}
    card: dict[str, list[dict[str, object]]] = {}
    for name, several in bank.items():
        if name in CLOSED_FORM:
            continue
        card[name] = [
            {"label": v.label, "settings": dict(v.settings), "positive": v.positive, "fixed": v.fixed} for v in several
        ]
        if several:
            arrays[f"columns_{name}"] = np.stack([v.columns for v in several])
    arrays["card"] = np.array(dumps(card))
    keep_in_cache(path, lambda stream: np.savez(stream, allow_pickle=False, **arrays), MOST_FILES)


def _read(path: Path) -> tuple[FloatArray | None, Bank]:
    """Return what the believed model says and the hypotheses that are kept; none where the file is damaged."""
    try:
        with np.load(path, allow_pickle=False) as kept:
            card = json.loads(str(kept["card"]))
            bank: Bank = {}
            for name, rows in card.items():
                columns = kept[f"columns_{name}"] if rows else []
                bank[name] = [
                    Variant(row["label"], column, row["settings"], row["positive"], row["fixed"])
                    for row, column in zip(rows, columns, strict=True)
                ]
            return kept["base"], bank
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return None, {}
