"""The bank: all hypotheses of all causes with their columns, kept between calls by content.

What a bank depends on is what is believed and what the rig does, not what was measured: the next experiment on the same
mesh and rig finds it made. Banks lie in the cache folder of the package (`tissuereg.latent.cache`).
"""

import hashlib
import json
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg._version import __version__
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.causes import CAUSES, Variant
from tissuereg.experiment import Experiment
from tissuereg.io.atomic import atomic_file
from tissuereg.io.json import dumps
from tissuereg.latent.cache import cache_folder

#: Raised when columns change their meaning: banks of other releases are not read.
SCHEMA = 1

#: Causes whose columns are closed forms: made anew each time, never kept.
CLOSED_FORM = ("frame", "scale", "latency", "marker_slip", "marker_swap")

#: Oldest banks go when there are more than this.
MOST_FILES = 24


@dataclass(frozen=True, eq=False)
class Bank:
    """Hypotheses by cause.

    Attributes
    ----------
    base : ndarray of float64, shape (size,)
        What the believed model says.
    variants : dict of str to list of Variant
        By id of the cause; those that an experiment has no place for are left out.
    """

    base: FloatArray
    variants: dict[str, list[Variant]]


def make_bank(
    bench: Bench,
    *,
    causes: Sequence[str] | None = None,
    keep: bool = True,
    progress: Callable[[str], None] | None = None,
) -> Bank:
    """Return the bank of a believed model, from the cache where it was made before.

    Parameters
    ----------
    bench : Bench
        The believed model.
    causes : sequence of str, optional
        Ids; all where absent.
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
    wanted = [name for name in CAUSES if causes is None or name in causes]
    path = cache_folder() / f"bank_{fingerprint(bench.experiment, bench.predictor.element)}.npz"
    kept = _read(path) if keep else {}
    if "" in kept:
        bench.__dict__["base"] = kept.pop("")[0].columns[0].astype(np.float64)
    made, new = {}, False
    for name in wanted:
        if name not in kept:
            if progress is not None:
                progress(name)
            kept[name] = [_single(variant) for variant in CAUSES[name].variants(bench)]
            new = new or name not in CLOSED_FORM
        if kept[name]:
            made[name] = kept[name]
    if keep and new:
        _write(path, bench.base, kept)
    return Bank(bench.base, made)


def fingerprint(experiment: Experiment, element: str) -> str:
    """Return a hash of everything that a bank depends on, hexadecimal."""
    digest = hashlib.sha256(f"{__version__} {SCHEMA} {element}".encode())
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


def _write(path: Path, base: FloatArray, variants: dict[str, list[Variant]]) -> None:
    arrays: dict[str, FloatArray] = {"base": base}
    card: dict[str, list[dict[str, object]]] = {}
    for name, several in variants.items():
        if name in CLOSED_FORM:
            continue
        card[name] = [
            {"label": v.label, "settings": dict(v.settings), "positive": v.positive, "fixed": v.fixed} for v in several
        ]
        if several:
            arrays[f"columns_{name}"] = np.stack([v.columns for v in several])
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as handle:
            np.savez(handle, allow_pickle=False, card=np.array(dumps(card)), **arrays)
        old = sorted(path.parent.glob("bank_*.npz"), key=lambda p: p.stat().st_mtime)
        for spare in old[:-MOST_FILES]:
            spare.unlink(missing_ok=True)
    except OSError:  # a cache that cannot be written is no error
        return


def _read(path: Path) -> dict[str, list[Variant]]:
    """Return what is kept, the base under an empty name; nothing where the file is absent or damaged."""
    try:
        with np.load(path, allow_pickle=False) as kept:
            card = json.loads(str(kept["card"]))
            found = {"": [Variant("base", kept["base"][None])]}
            for name, rows in card.items():
                columns = kept[f"columns_{name}"] if rows else []
                found[name] = [
                    Variant(row["label"], column, row["settings"], row["positive"], row["fixed"])
                    for row, column in zip(rows, columns, strict=True)
                ]
            return found
    except (OSError, ValueError, KeyError, zipfile.BadZipFile):
        return {}
