"""Nuisance parameters: modulus, tracker frame, drift, shape, remaining discretisation error; never findings.

Each is a sensitivity column times a prior standard deviation. Together with the noise they form the null covariance
``C0 = I + N N^T`` (`evidence`), so that they are integrated out of every comparison.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.evidence import rms
from tissuereg.diagnosis.settings import DEFAULT, NuisanceSettings
from tissuereg.diagnosis.shape import shape_nuisances
from tissuereg.diagnosis.signals import SignalLayout, force_columns, load_history, marker_columns, smooth_patterns
from tissuereg.experiment.effects.base import rotation_from_vector

#: Directions shorter than this share of the change are dropped.
_LEAST_FORM = 1e-6


#: Nuisances of the error of mesh and shape begin with these words.
OF_THE_MESH = (
    "mesh ", "bent ", "place of ", "rim of ", "size of ", "height of ", "tilt of ", "edge of ", "facets", "surface ",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Nuisance parameters, each with the change of all measured numbers that it makes.

    `names`: one for each of n parameters; `columns` (n, size): change by one prior standard deviation, mm and mN, on
    the fine mesh at the believed modulus.
    """

    names: tuple[str, ...]
    columns: FloatArray

    def but(self, name: str) -> BoolArray:
        """Return a boolean mask (n,), False for the nuisance parameters of this name."""
        return np.array([other != name for other in self.names], bool)


def make_nuisances(bench: Bench, mesh_errors: FloatArray, correction: Correction, *, keep: bool = False) -> Nuisances:
    """Return the nuisance parameters of an experiment, with the change that each makes.

    `mesh_errors` (n_meshes, size): predictions on further fine meshes minus those on the correcting one, mm and mN;
    `correction`: at the believed modulus; `keep`: whether changes by the shape are read from and written to the cache.
    The parameters are the modulus, six of the tracker's frame, three of its drift, the shape of the body and of its
    patches (`shape`); for the remaining discretisation error, which is proportional to the load, smooth patterns over
    the markers and the three components of every force in each case, of the size by which fine meshes differ; where
    ``trial_share`` is stated, the difference between trials of one case.
    """
    layout, base, numbers = bench.layout, bench.base, bench.settings.nuisances
    rows = [("stiffness", bench.young_spread * bench.by_young[0])]
    clock = layout.times()
    span = max(float(np.ptp(clock)), 1e-9)
    for axis, (shift, turn) in enumerate(frame_columns(layout, base, numbers)):
        drift = np.zeros(layout.size)
        for part in layout.parts:
            part.markers(drift)[..., axis] = numbers.drift * (part.times[:, None] - clock.min()) / span
        rows += [(f"frame shift {axis}", shift), (f"frame turn {axis}", turn), (f"drift {axis}", drift)]
    patterns = smooth_patterns(layout.reference, bench.extent, numbers)
    for part in layout.parts:
        load = load_history(part, base)
        if not load.any():
            continue
        top = load > 0.5
        for axis, smooth in enumerate(marker_columns(layout, part, load, patterns)):
            size = numbers.mesh_share * rms(part.markers(mesh_errors)[:, top][..., axis])
            rows += [(f"mesh {part.name} {axis} {number}", column) for number, column in enumerate(size * smooth)]
        for i, pad in enumerate(() if bench.is_exact else part.pads):
            strength = np.linalg.norm(part.forces(base)[:, i], axis=1)
            largest = max(float(strength.max()), 1e-9)
            # A pad on a curved body has a different tilt on every mesh, so that a difference in one component of its
            # force may as well occur in another.
            size = max(numbers.force_share * rms(part.forces(mesh_errors)[:, top, i] / largest), numbers.force_left)
            for word, history in (("mesh", size * strength), ("bent", numbers.force_bent * (strength**2 / largest))):
                own = force_columns(layout, part, i, history)
                rows += [(f"{word} {part.name} {pad} {axis}", column) for axis, column in enumerate(own)]
    rows += _bent_alike(bench)
    rows += _trials(bench, patterns)
    carried = correction.of_columns(np.array([column for _, column in rows]))
    rows = [(name, column) for (name, _), column in zip(rows, carried, strict=True)]
    if not bench.is_exact:
        rows += shape_nuisances(bench, correction.corrected(bench.base), keep=keep)
    kept = [row for row in rows if row[1].any() and (numbers.of_mesh or not row[0].startswith(OF_THE_MESH))]
    return Nuisances(tuple(name for name, _ in kept), np.array([column for _, column in kept]))


def frame_columns(
    layout: SignalLayout, base: FloatArray, settings: NuisanceSettings
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield for each axis the changes (size,) by a shift along it and by a rotation about it of the tracker's frame.

    The changes are in mm, by one prior standard deviation; those of forces are 0. `base` (size,): predicted
    displacements of the markers, mm.
    """
    middle = layout.reference.mean(axis=0)
    for axis in range(3):
        shift, turn = np.zeros(layout.size), np.zeros(layout.size)
        rotation = rotation_from_vector(tuple(settings.frame_turn * np.eye(3)[axis])) - np.eye(3)
        for part in layout.parts:
            part.markers(shift)[..., axis] = settings.frame_shift
            part.markers(turn)[:] = (layout.reference + part.markers(base) - middle) @ rotation.T
        yield shift, turn


def _bent_alike(bench: Bench) -> Iterator[tuple[str, FloatArray]]:
    """Yield name and column (size,), mN, of an error of all forces along themselves that grows with their squares."""
    column = np.zeros(bench.layout.size)
    for part in () if bench.is_exact else bench.layout.parts:
        forces = part.forces(bench.base)
        strength = np.linalg.norm(forces, axis=2, keepdims=True)
        largest = np.maximum(strength.max(axis=0, initial=0.0), 1e-9)
        part.forces(column)[:] = bench.settings.nuisances.force_bent_alike * strength / largest * forces
    yield "bent alike", column


def _trials(bench: Bench, patterns: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield names and columns (size,), mm, of the difference between trials, that is repetitions, of one case."""
    layout, share = bench.layout, bench.experiment.trial_share
    for part in layout.parts if share else ():
        moved = np.nan_to_num(np.linalg.norm(part.markers(layout.measured), axis=-1))
        for axis, smooth in enumerate(marker_columns(layout, part, share * moved, patterns)):
            for number, column in enumerate(smooth):
                yield f"trial {part.name} {axis} {number}", column


def effect_nuisances(bench: Bench, change: FloatArray) -> FloatArray:
    """Return nuisances for the model error of the causes found, whose laws are only approximately the body's own.

    `change` (size,): that the causes found so far make. Result: (n, size), changes by one prior standard deviation: in
    every case the change itself, smooth patterns over the markers and the components of every force. All in mm and mN.
    """
    layout, share = bench.layout, bench.settings.nuisances.effect_error
    patterns = smooth_patterns(layout.reference, bench.extent, bench.settings.nuisances)
    columns = []
    for part in layout.parts:
        mine = np.zeros(layout.size)
        part.markers(mine)[:] = share * part.markers(change)
        columns.append(mine)
        history = share * np.sqrt((part.markers(change) ** 2).mean(axis=(1, 2)))
        columns += list(marker_columns(layout, part, history, patterns).reshape(-1, layout.size))
        for i in range(len(part.pads)):
            strength = share * np.linalg.norm(part.forces(change)[:, i], axis=1)
            columns += list(force_columns(layout, part, i, strength))
    return np.array([column for column in columns if column.any()]).reshape(-1, layout.size)


def other_forms(
    hypotheses: FloatArray, change: FloatArray, settings: NuisanceSettings = DEFAULT.nuisances
) -> FloatArray:
    """Return nuisances for the form of a found cause: another place, onset, history or exponent than fitted.

    Without them the difference between the fitted and the true form would be taken for a further cause. `hypotheses`
    (n_variants, p, size), `change` (size,): columns of all hypotheses of the cause, and change that the fitted one
    makes, whitened by the noise. Result: (n, size), changes by one prior standard deviation, orthogonal to the fitted
    one: each hypothesis that reproduces the share `form_alike` of it is fitted to it and scaled to its norm, and its
    orthogonal part is kept; all together have the size `form_error`.
    """
    power, found = float(change @ change), []
    for columns in hypotheses:
        amplitudes = np.linalg.lstsq(columns.T, change, rcond=None)[0]
        alike = amplitudes @ columns
        if float(alike @ alike) >= settings.form_alike * power > 0.0:
            alike *= np.sqrt(power / float(alike @ alike))
            found.append(alike - (alike @ change) / power * change)
    if not found:
        return np.zeros((0, len(change)))
    _, sizes, rows = np.linalg.svd(np.array(found) * (settings.form_error / np.sqrt(len(found))), full_matrices=False)
    kept = sizes > _LEAST_FORM * np.sqrt(power)
    return np.asarray((sizes[:, None] * rows)[kept][: settings.most_forms])
