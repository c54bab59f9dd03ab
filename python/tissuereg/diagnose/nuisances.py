"""What is always fitted beside the causes: modulus, frame, drift, gains, error of the mesh; small, and not named."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tissuereg._arrays import BoolArray, FloatArray
from tissuereg.diagnose.bench import Bench
from tissuereg.diagnose.faceting import faceting
from tissuereg.diagnose.patterns import force_columns, load_history, marker_columns, smooth_patterns
from tissuereg.diagnose.signals import CasePart, Layout
from tissuereg.effects import ActuatorGain
from tissuereg.effects.base import rotation_from_vector
from tissuereg.experiment import Experiment
from tissuereg.simulate.fine.meshing import rim_of

#: Prior deviations of the tracker's frame: shifts in mm, turns in degrees.
FRAME_SHIFT, FRAME_TURN = 0.02, 0.02

#: Prior deviation of the drift of the camera over the whole session, mm.
DRIFT = 0.02

#: Share of the difference between two fine meshes that is taken for what is left of the mesh's error.
MESH_SHARE = 0.7

#: Error of the forces that is expected at least, as a share of them: what fine meshes were found off other solvers.
FORCE_LEFT = 0.005

#: Error of a marker at the rim of the pad at work, over the pad's motion, and how far from the patch it fades, over its
#: extent: stress is singular at a rim, and no mesh resolves it.
RIM_ERROR, RIM_REACH = 0.02, 0.4

#: Prior deviation of the gain of every actuator; and of what coarse meshes look like, over the share of the body that
#: their facets leave out: on six rigs of 600 nodes, 3 % left out, gains of 0.7 % (rms) were seen that were not there.
#: They look like pads of another size.
GAIN, FACETS = 0.003, 0.2

#: Error of a found cause's form and of its fine mesh, as a share of what it changes.
EFFECT_ERROR = 0.07


@dataclass(frozen=True, eq=False)
class Nuisances:
    """Columns of what is fitted beside the causes.

    Attributes
    ----------
    names : tuple of str
        One a column.
    columns : ndarray of float64, shape (n, size)
        Over one prior deviation, mm and mN.
    """

    names: tuple[str, ...]
    columns: FloatArray

    def but(self, name: str) -> BoolArray:
        """Return which columns have another name, shape (n,)."""
        return np.array([other != name for other in self.names], bool)


def make_nuisances(bench: Bench, mesh_errors: FloatArray) -> Nuisances:
    """Return the nuisances of an experiment.

    Parameters
    ----------
    bench : Bench
        The believed model.
    mesh_errors : ndarray of float64, shape (n_meshes, size)
        Other fine meshes less the one that corrects, mm and mN.

    Returns
    -------
    Nuisances
        Modulus, six of the frame, three of the drift, gains of the actuators. Of the mesh's error, which grows with the
        load, smooth patterns over the markers and the three components of every force, in each case, as large as meshes
        differ (a force in any component), and markers near the pad at work each on their own. Where stated, what trials
        of one case differ by.
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
        # Near a rim the error has its own columns, and says little of the rest.
        far = _rim_sizes(bench, part) == 0.0
        for axis, smooth in enumerate(marker_columns(layout, part, load, patterns)):
            size = _differ(part.markers(mesh_errors)[:, top][:, :, far, axis])
            names += [f"mesh {part.name} {axis} {number}" for number in range(len(patterns))]
            columns += list(size * smooth)
        for i, pad in enumerate(part.pads):
            strength = np.linalg.norm(part.forces(bench.base)[:, i], axis=1)
            errors = part.forces(mesh_errors)[:, top, i] / max(float(strength.max()), 1e-9)
            # A pad on a curved body is tilted otherwise on every mesh: what they differ by in one component of its
            # force they may be off in another.
            size = max(_differ(errors), FORCE_LEFT)
            for axis, column in enumerate(force_columns(layout, part, i, strength)):
                names.append(f"mesh {part.name} {pad} {axis}")
                columns.append(size * column)
    for name, column in (*_trials(bench, patterns), *_at_rims(bench, mesh_errors), *_gains(bench)):
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


def _differ(errors: FloatArray) -> float:
    """Return the size of the error that differences between meshes stand for; 0 where there are none."""
    return MESH_SHARE * float(np.sqrt((errors**2).mean())) if errors.size else 0.0


def _trials(bench: Bench, patterns: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield what trials of one case differ by: smooth over the markers, a share of how far each was seen to move."""
    layout, share = bench.layout, bench.experiment.trial_share
    for part in layout.parts if share else ():
        moved = np.nan_to_num(np.linalg.norm(part.markers(layout.measured), axis=-1))
        for axis, smooth in enumerate(marker_columns(layout, part, share * moved, patterns)):
            for number, column in enumerate(smooth):
                yield f"trial {part.name} {axis} {number}", column


def _rim_sizes(bench: Bench, part: CasePart) -> FloatArray:
    """Return how large the error of every marker is for a pad at work near it, in mm at full load; 0 for those far."""
    experiment = bench.experiment
    sizes = np.zeros(part.n_markers)
    for pad, motion in experiment.cases[part.name].displacements.items():
        away, extent = _away(experiment, pad, bench.layout.reference)
        reach = RIM_REACH * max(extent, 1e-9)
        stroke = float(np.linalg.norm(motion, axis=1).max())
        sizes += np.where(away < 2.0 * reach, RIM_ERROR * stroke * np.exp(-away / reach), 0.0)
    return sizes


def _away(experiment: Experiment, pad: str, places: FloatArray) -> tuple[FloatArray, float]:
    """Return how far places (n, 3) lie from a pad's patch, and the patch's extent, mm."""
    rim = rim_of(experiment.actuator(pad))
    if rim is not None:
        # A coarse mesh has few nodes in a ball, and none at its rim.
        beyond = -rim.depth(places)
        return np.maximum(beyond, 0.0), float(np.sqrt(8.0)) * rim.radius
    nodes = experiment.mesh.nodes[experiment.actuator(pad).nodes]
    away = np.linalg.norm(places[:, None] - nodes[None], axis=2).min(axis=1)
    return np.asarray(away), float(np.linalg.norm(np.ptp(nodes, axis=0)))


def _at_rims(bench: Bench, mesh_errors: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield the errors of markers near the rim of a pad at work, as large as meshes differ there at least."""
    layout = bench.layout
    for part in layout.parts:
        load, sizes = load_history(part, bench.base), _rim_sizes(bench, part)
        for marker in np.flatnonzero(sizes):
            size = max(float(sizes[marker]), _differ(part.markers(mesh_errors)[:, load > 0.5, marker]))
            alone = np.eye(part.n_markers)[[marker]]
            for axis, column in enumerate(marker_columns(layout, part, size * load, alone)[:, 0]):
                yield f"rim {part.name} {layout.marker_names[marker]} {axis}", column


def _gains(bench: Bench) -> Iterator[tuple[str, FloatArray]]:
    """Yield what small errors of the actuators' gains change, or of the pads' size, which look alike."""
    moved = {pad for case in bench.experiment.cases.values() for pad in case.displacements}
    size = float(np.hypot(GAIN, FACETS * faceting(bench.experiment.mesh)))
    for pad in sorted(moved):
        changed = bench.change(ActuatorGain(actuator=pad, gain=1.0 + size))
        if changed is not None:
            yield f"gain {pad}", changed


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
