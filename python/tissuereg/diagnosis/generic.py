"""The generic rival: a hypothesis for any smooth change over markers, load and time, without a physical cause.

It is a Gaussian process in a few hundred columns. Over the markers it is smooth (`patterns`). Over the frames of each
case it is a sum of histories: the load, its square, its fading memory, the clock and a constant. Single frames may be
displaced as if the actuator had jammed, and forces have columns of their own. Its size is unknown: the evidence is the
mean over several sizes.
"""

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.patterns import force_columns, load_history, marker_columns, smooth_patterns
from tissuereg.diagnosis.settings import DEFAULT
from tissuereg.diagnosis.signals import CasePart


def generic_columns(bench: Bench, marker_std: float) -> FloatArray:
    """Return the changes that the generic rival, smooth and without a physical cause, makes, for several sizes of it.

    `bench`: the believed model; `marker_std`: typical noise of a coordinate, mm. Result: (n_sizes, p, size), changes of
    all measured numbers by one prior standard deviation of each of the rival's p amplitudes, mm and mN.
    """
    layout = bench.layout
    patterns = smooth_patterns(layout.reference, bench.extent, bench.settings.nuisances)
    base = bench.base
    markers: list[FloatArray] = []
    forces: list[FloatArray] = []
    jams: list[FloatArray] = []
    for part in layout.parts:
        for history in histories(part, base, bench.settings.evidence.fading):
            markers += list(marker_columns(layout, part, history, patterns).reshape(-1, layout.size))
            for i in range(len(part.pads)):
                largest = np.abs(part.forces(base)[:, i]).max()
                forces += list(force_columns(layout, part, i, history * largest))
        change = np.diff(part.markers(base), axis=0)
        for frame in range(1, part.n_frames):
            if np.abs(change[frame - 1]).max() > bench.settings.evidence.jam_above * marker_std:
                column = np.zeros(layout.size)
                part.markers(column)[frame] = bench.settings.evidence.jam * change[frame - 1]
                if part.pads:
                    part.forces(column)[frame] = (
                        bench.settings.evidence.jam * np.diff(part.forces(base), axis=0)[frame - 1]
                    )
                jams.append(column)
    smooth = np.array(markers).reshape(-1, layout.size)
    strong = np.array(forces).reshape(-1, layout.size)
    steps = np.array(jams).reshape(-1, layout.size)
    return np.array(
        [
            np.concatenate([size * marker_std * smooth, share * strong, steps])
            for size, share in bench.settings.evidence.generic_sizes
        ],
        np.float32,
    ).astype(np.float64)


def histories(part: CasePart, base: FloatArray, fading: float = DEFAULT.evidence.fading) -> list[FloatArray]:
    """Return the time histories, each (n_frames,), that a generic change may have in a case.

    They are load, load squared (minus load), fading memory of the load, clock and constant; without load only a
    constant and the clock. `part`: the case; `base` (size,): prediction of the believed model, mm and mN; `fading`:
    time in which the memory fades, over the duration of the case. The histories are dimensionless and of about unit
    size.
    """
    load = load_history(part, base)
    span = float(part.times[-1] - part.times[0]) if part.n_frames > 1 else 1.0
    clock = (part.times - part.times[0]) / max(span, 1e-9)
    if not load.any():
        return [np.ones(part.n_frames), clock - 0.5]
    memory = np.zeros(part.n_frames)
    for frame in range(1, part.n_frames):
        fade = np.exp(-(part.times[frame] - part.times[frame - 1]) / max(fading * span, 1e-9))
        memory[frame] = fade * memory[frame - 1] + (1.0 - fade) * load[frame]
    return [load, load**2 - load, memory, clock, np.ones(part.n_frames)]
