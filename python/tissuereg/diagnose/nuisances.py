"""What is always fitted beside the causes: modulus, frame, drift, shape, error of the mesh; small, and not named."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import BoolArray, FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.correction import Correction
from tissuereg.diagnose.patterns import force_columns, load_history, marker_columns, smooth_patterns
from tissuereg.diagnose.shape_columns import shape_columns
from tissuereg.diagnose.signals import Layout
from tissuereg.effects.base import rotation_from_vector

#: Prior deviations of the tracker's frame: shifts in mm, turns in degrees.
FRAME_SHIFT, FRAME_TURN = 0.02, 0.02

#: Prior deviation of the drift of the camera over the whole session, mm.
DRIFT = 0.02

#: Share of the difference between two fine meshes that is taken for what is left of the mesh's error.
MESH_SHARE = 0.4

#: The same of forces: much of what two meshes differ by there is the shape of their pads.
FORCE_SHARE = 0.2

#: Error of the forces that is expected at least, as a share of them; and one that grows with the square of the force,
#: at the largest: strains at a pad's rim, where they are singular, grow faster than the load.
FORCE_LEFT, FORCE_BENT = 0.0015, 0.007

#: Error of a found cause's form and of its fine mesh, as a share of what it changes.
EFFECT_ERROR = 0.07

#: How much of what a found cause changes may be what its other hypotheses change, which do so much of the same, in
#: squares; and the number of directions that this is kept in.
FORM_ERROR, ALIKE, MOST_FORMS = 0.3, 0.5, 12

#: A direction shorter than this, over the change, is none.
_LEAST_FORM = 1e-6


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Columns of what is fitted beside the causes.

    Attributes
    ----------
    names : tuple of str
        One a column.
    columns : ndarray of float64, shape (n, size)
        Over one prior deviation, mm and mN, as a fine mesh gives them at the believed modulus.
    """

    names: tuple[str, ...]
    columns: FloatArray

    def but(self, name: str) -> BoolArray:
        """Return which columns have another name, shape (n,)."""
        return np.array([other != name for other in self.names], bool)


def make_nuisances(bench: Bench, mesh_errors: FloatArray, correction: Correction) -> Nuisances:
    """Return the nuisances of an experiment.

    Parameters
    ----------
    bench : Bench
        The believed model.
    mesh_errors : ndarray of float64, shape (n_meshes, size)
        Other fine meshes less the one that corrects, mm and mN.
    correction : Correction
        Of the mesh's error, at the believed modulus.

    Returns
    -------
    Nuisances
        Modulus, six of the frame, three of the drift, the shape of the body and of its patches (`shape`). Of the mesh's
        error, which grows with the load, smooth patterns over the markers and the three components of every force, in
        each case, as large as meshes differ (a force in any component). Where stated, how trials of one case differ.
    """
    layout = bench.layout
    names, columns = ["stiffness"], [bench.young_spread * bench.by_young[0]]
    clock = layout.times()
    span = max(float(np.ptp(clock)), 1e-9)
    for axis, (shift, turn) in enumerate(frame_columns(layout, bench.base)):
        drift = np.zeros(layout.size)
        for part in layout.parts:
            part.markers(drift)[..., axis] = DRIFT * (part.times[:, None] - clock.min()) / span
        names += [f"frame shift {axis}", f"frame turn {axis}", f"drift {axis}"]
        columns += [shift, turn, drift]
    patterns = smooth_patterns(layout.reference, bench.extent)
    for part in layout.parts:
        load = load_history(part, bench.base)
        if not load.any():
            continue
        top = load > 0.5
        for axis, smooth in enumerate(marker_columns(layout, part, load, patterns)):
            size = MESH_SHARE * _rms(part.markers(mesh_errors)[:, top][..., axis])
            names += [f"mesh {part.name} {axis} {number}" for number in range(len(patterns))]
            columns += list(size * smooth)
        for i, pad in enumerate(() if bench.is_exact else part.pads):
            strength = np.linalg.norm(part.forces(bench.base)[:, i], axis=1)
            errors = part.forces(mesh_errors)[:, top, i] / max(float(strength.max()), 1e-9)
            # A pad on a curved body is tilted otherwise on every mesh: what they differ by in one component of its
            # force they may be off in another.
            size = max(FORCE_SHARE * _rms(errors), FORCE_LEFT)
            largest = max(float(strength.max()), 1e-9)
            for word, history, share in (("mesh", strength, size), ("bent", strength**2 / largest, FORCE_BENT)):
                for axis, column in enumerate(force_columns(layout, part, i, history)):
                    names.append(f"{word} {part.name} {pad} {axis}")
                    columns.append(share * column)
    for name, column in _trials(bench, patterns):
        names.append(name)
        columns.append(column)
    columns = list(correction.of_columns(np.array(columns)))
    for name, column in _shapes(bench, correction):
        names.append(name)
        columns.append(column)
    kept = [i for i, column in enumerate(columns) if column.any()]
    return Nuisances(tuple(names[i] for i in kept), np.array([columns[i] for i in kept]))


def frame_columns(layout: Layout, base: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield, axis by axis, what a shift of the tracker's frame and a turn of it change, each (size,), in mm.

    Parameters
    ----------
    layout : Layout
        Order of the columns.
    base : ndarray of float64, shape (size,)
        Where the markers are: displacements, mm.
    """
    middle = layout.reference.mean(axis=0)
    for axis in range(3):
        shift, turn = np.zeros(layout.size), np.zeros(layout.size)
        rotation = rotation_from_vector(tuple(FRAME_TURN * np.eye(3)[axis])) - np.eye(3)
        for part in layout.parts:
            part.markers(shift)[..., axis] = FRAME_SHIFT
            part.markers(turn)[:] = (layout.reference + part.markers(base) - middle) @ rotation.T
        yield shift, turn


def _rms(errors: FloatArray) -> float:
    """Return the root mean square; 0 where there is nothing."""
    return float(np.sqrt((errors**2).mean())) if errors.size else 0.0


def _trials(bench: Bench, patterns: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield what trials of one case differ by: smooth over the markers, a share of how far each was seen to move."""
    layout, share = bench.layout, bench.experiment.trial_share
    for part in layout.parts if share else ():
        moved = np.nan_to_num(np.linalg.norm(part.markers(layout.measured), axis=-1))
        for axis, smooth in enumerate(marker_columns(layout, part, share * moved, patterns)):
            for number, column in enumerate(smooth):
                yield f"trial {part.name} {axis} {number}", column


def _shapes(bench: Bench, correction: Correction) -> Iterator[tuple[str, FloatArray]]:
    """Yield what another shape of the body and of its patches changes."""
    if not bench.is_exact:
        for direction, column in shape_columns(bench, correction.corrected(bench.base)):
            yield direction.name, direction.std_mm * column


def effect_nuisances(bench: Bench, change: FloatArray) -> FloatArray:
    """Return nuisances for the error of what a found cause changes: its law is hardly the body's own.

    Parameters
    ----------
    bench : Bench
        The believed model.
    change : ndarray of float64, shape (size,)
        What the causes found so far change, mm and mN.

    Returns
    -------
    ndarray of float64, shape (n, size)
        In every case, the change itself, smooth patterns over the markers and the components of every force, over one
        prior deviation.
    """
    layout = bench.layout
    patterns = smooth_patterns(layout.reference, bench.extent)
    columns = []
    for part in layout.parts:
        mine = np.zeros(layout.size)
        part.markers(mine)[:] = EFFECT_ERROR * part.markers(change)
        columns.append(mine)
        history = EFFECT_ERROR * np.sqrt((part.markers(change) ** 2).mean(axis=(1, 2)))
        columns += list(marker_columns(layout, part, history, patterns).reshape(-1, layout.size))
        for i in range(len(part.pads)):
            strength = EFFECT_ERROR * np.linalg.norm(part.forces(change)[:, i], axis=1)
            columns += list(force_columns(layout, part, i, strength))
    return np.array([column for column in columns if column.any()]).reshape(-1, layout.size)


def other_forms(hypotheses: FloatArray, change: FloatArray) -> FloatArray:
    """Return nuisances for a found cause that acts at another place, from another time on or by another exponent.

    What its own form leaves of it would else be taken for a further cause.

    Parameters
    ----------
    hypotheses : ndarray of float64, shape (n_variants, p, size)
        Whitened columns of all hypotheses of the cause.
    change : ndarray of float64, shape (size,)
        What it was found to change, whitened.

    Returns
    -------
    ndarray of float64, shape (n, size)
        Over one prior deviation: of what hypotheses do that do about the same, `FORM_ERROR` together, the part that is
        no multiple of the change itself.
    """
    power, found = float(change @ change), []
    for columns in hypotheses:
        amplitudes = np.linalg.lstsq(columns.T, change, rcond=None)[0]
        alike = amplitudes @ columns
        if float(alike @ alike) >= ALIKE * power > 0.0:
            alike *= np.sqrt(power / float(alike @ alike))
            found.append(alike - (alike @ change) / power * change)
    if not found:
        return np.zeros((0, len(change)))
    _, sizes, rows = np.linalg.svd(np.array(found) * (FORM_ERROR / np.sqrt(len(found))), full_matrices=False)
    kept = sizes > _LEAST_FORM * np.sqrt(power)
    return np.asarray((sizes[:, None] * rows)[kept][:MOST_FORMS])
