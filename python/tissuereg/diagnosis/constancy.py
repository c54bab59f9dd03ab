"""Constancy test of findings: is the change that a cause makes the same in all parts of the data?

A wrong cause is fitted to the effect of the true one. It is right on the whole and wrong in parts: too large in one
load case and too small in another, or during ramps and during holds. Partitions of the data (`partitions`) divide it by
case, phase of the load, time, place, axis, channel and size of the load. In each partition the change c that the cause
makes, weighted part by part, spans a subspace: a cause whose size differs from part to part would change the data in
it. So do its columns J, if it has several parameters. Nuisances, the modulus and the cause's own parameters are
projected out. With m orthonormal rows B and the residual z of unit root mean square, the evidence for changes of the
size t is

    a2 t^2 / (2 (1 + t^2)) - m/2 log(1 + t^2),    a2 = |B z|^2,

of which the mean over sizes is taken, and then over all subspaces. The p-value is that among residuals of data in which
nothing but noise and nuisances is left.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import gumbel_r

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.evidence import Null, log_mean_exp
from tissuereg.diagnosis.fit import Fit, FitTarget, predicted
from tissuereg.diagnosis.patterns import load_history
from tissuereg.diagnosis.settings import DEFAULT, ConstancySettings
from tissuereg.diagnosis.signals import CasePart, SignalLayout
from tissuereg.experiment.experiment import Case, Experiment

#: Singular values below this share of the largest are taken for zero.
_LEAST = 1e-6


@dataclass(frozen=True)
class Constancy:
    """Result of the constancy test of one finding.

    `id`: the cause; `p`: probability that data which it explains are as inconstant; `differs_by`: the partition of the
    data over which its change is least constant.
    """

    id: str
    p: float
    differs_by: str


def constancies(
    target: FitTarget, found: Fit, null: Null, draws: FloatArray, settings: ConstancySettings = DEFAULT.constancy
) -> list[Constancy]:
    """Return the constancy test of every cause of a fit that has one, in their order.

    `target`: data and model of the fit; `found`: fit with causes; `null`: covariance of noise and nuisances, the
    modulus included; `draws` (n, size): residuals of data without any effect, whitened by it (`draw_nulls`). Causes
    whose change is not proportional to anything (`Cause.constant`) or that have no parameters are not tested.
    """
    bench = target.bench
    parts = partitions(bench.experiment, bench.layout, bench.base)
    slopes = target.white(found.jacobian) * found.deviation[:, None]
    own = _orthonormal(null.reduced(slopes), _LEAST)

    def reduced(white: FloatArray) -> FloatArray:
        """Whiten by nuisances and project out what the model's own parameters can change."""
        rest = null.reduced(np.where(bench.layout.seen, white, 0.0))
        return np.asarray(rest - (rest @ own.T) @ own)

    residual = reduced(found.residual)
    drawn = draws - (draws @ own.T) @ own
    tested = []
    for number, (name, mine) in enumerate(zip(found.ids, found.slices(), strict=True)):
        if not CAUSES[name].constant or mine.start == mine.stop:
            continue
        change = target.white(found.prediction - predicted(target, found, without=number))
        size = float(np.linalg.norm(change))
        spaces: list[tuple[str, FloatArray]] = []
        for partition, weights in parts.items():
            of_change = reduced(change * weights)
            columns = slopes[mine]
            of_columns = [reduced(column * weights) for column in columns] if len(columns) > 1 else []
            for rows in (of_change, *([np.concatenate(of_columns)] if of_columns else [])):
                kept = rows[np.linalg.norm(rows, axis=1) > settings.least_change * size]
                if len(kept):
                    kept = kept / np.linalg.norm(kept, axis=1, keepdims=True)
                    spaces.append((partition, _orthonormal(kept, settings.least_direction)))
        if spaces:
            tested.append(_judged(name, spaces, residual, drawn, settings))
    return tested


def partitions(experiment: Experiment, layout: SignalLayout, base: FloatArray) -> dict[str, FloatArray]:
    """Return the partitions of the data, by name, each as weights (k, size) of all measured numbers.

    `experiment`: with the commands of its cases; `layout`: order of the data; `base` (size,): prediction of the
    believed model, mm and mN. The weights are 0 and 1 for cases, phases of the load, axes and forces; numbers of unit
    size for time, place and the size of the load.
    """
    size, parts = layout.size, layout.parts
    begin = min(float(part.times[0]) for part in parts)
    span = max(max(float(part.times[-1]) for part in parts) - begin, 1e-9)
    places = layout.reference - layout.reference.mean(axis=0)
    places = places / np.maximum(places.std(axis=0), 1e-9)
    cases, by_phase = np.zeros((len(parts), size)), dict[str, FloatArray]()
    time, place, axis = np.zeros((2, size)), np.zeros((3, size)), np.zeros((3, size))
    force, load = np.zeros((1, size)), np.zeros((2, size))
    for number, part in enumerate(parts):
        cases[number, part.begin : part.end] = 1.0
        for name, frames in phases(experiment.cases[part.name], part).items():
            _put(by_phase.setdefault(name, np.zeros(size)), part, frames)
        own = (part.times - part.times[0]) / max(float(part.times[-1] - part.times[0]), 1e-9)
        _put(time[0], part, (part.times - begin) / span - 0.5)
        _put(time[1], part, own - 0.5)
        history = load_history(part, base)
        _put(load[0], part, history)
        _put(load[1], part, history**2)
        part.forces(force)[:] = 1.0
        for i in range(3):
            part.markers(place[i])[:] = places[:, i, None]
            part.markers(axis[i])[..., i] = 1.0
            part.forces(axis[i])[..., i] = 1.0
    return {
        "load case": cases,
        "phase of the load": np.array(list(by_phase.values())),
        "time": time,
        "place": place,
        "markers and forces": force,
        "axis": axis,
        "size of the load": load,
    }


def phases(case: Case, part: CasePart, least: float = 0.02) -> dict[str, FloatArray]:
    """Return the frames of each phase of a case, 0 or 1 (n_frames,), by name.

    They are those before the load, in which it grows, the first and second half of every hold, in which it falls, and
    after it. `case`: with its commands; `part`: its place in the data; `least`: share of the largest command below
    which there is no load.
    """
    acts = [*case.displacements.values(), *case.applied_forces.values()]
    size = np.linalg.norm(np.concatenate(acts, axis=1), axis=1) if acts else np.zeros(part.n_frames)
    size = size / size.max() if size.max() > 0.0 else size
    on = np.flatnonzero(size > least)
    change = np.sign(np.round(np.diff(size, prepend=0.0), 6))
    frame = np.arange(part.n_frames)
    inside = (frame >= on[0]) & (frame <= on[-1]) if len(on) else np.zeros(part.n_frames, bool)
    later = np.zeros(part.n_frames, bool)
    holds = np.flatnonzero(inside & (change == 0.0))
    for run in np.split(holds, np.flatnonzero(np.diff(holds) > 1) + 1):
        later[run[(len(run) + 1) // 2 :]] = True
    found = {
        "before": ~inside & (frame < on[0] if len(on) else True),
        "growing": inside & (change > 0.0),
        "held": inside & (change == 0.0) & ~later,
        "held long": later,
        "falling": inside & (change < 0.0),
        "after": ~inside & (frame > on[-1] if len(on) else False),
    }
    return {name: np.asarray(frames, np.float64) for name, frames in found.items() if frames.any()}


def tail_probability(value: float, drawn: FloatArray) -> float:
    """Return the probability of a value at least as large, by n draws (n,) of it and, beyond them, a Gumbel tail."""
    share = float((drawn >= value).mean())
    # Maxima follow a Gumbel distribution; its tail extends the p-value beyond the number of draws.
    width = float(drawn.std()) * np.sqrt(6.0) / np.pi
    tail = float(gumbel_r.sf(value, drawn.mean() - np.euler_gamma * width, width))
    return max(share, tail) if share > 0.0 else min(tail, 1.0 / len(drawn))


def _judged(
    name: str,
    spaces: Sequence[tuple[str, FloatArray]],
    residual: FloatArray,
    drawn: FloatArray,
    settings: ConstancySettings,
) -> Constancy:
    """Return the test of one cause, by the subspaces in which it would change the data if it were not constant."""
    rows = np.concatenate([residual[None], drawn])
    # The size of the noise is uncertain.
    rows = rows / np.sqrt((rows**2).mean(axis=1, keepdims=True))
    sizes = np.square(settings.sizes)
    evidence = []
    for _, basis in spaces:
        power = ((rows @ basis.T) ** 2).sum(axis=1)[:, None]
        evidence.append(log_mean_exp(0.5 * power * sizes / (1.0 + sizes) - 0.5 * len(basis) * np.log1p(sizes), axis=1))
    whole = log_mean_exp(np.array(evidence), axis=0)
    worst = int(np.argmax([one[0] for one in evidence]))
    return Constancy(name, tail_probability(float(whole[0]), whole[1:]), spaces[worst][0])


def _put(weights: FloatArray, part: CasePart, history: FloatArray) -> None:
    """Write a history (n_frames,) into the weights (size,) of all numbers of a case."""
    part.markers(weights)[:] = history[:, None, None]
    part.forces(weights)[:] = history[:, None, None]


def _orthonormal(rows: FloatArray, least: float) -> FloatArray:
    """Return orthonormal rows (m, size) that span rows (k, size), without singular values below a share `least`."""
    _, sizes, basis = np.linalg.svd(rows, full_matrices=False)
    return np.asarray(basis[sizes > least * sizes[0]])


def mapping_of(tested: Sequence[Constancy]) -> Mapping[str, dict[str, float | str]]:
    """Return tests by the id of the cause, as plain data for the answer."""
    return {one.id: {"p": one.p, "differs_by": one.differs_by} for one in tested}


__all__ = ["Constancy", "constancies", "mapping_of", "partitions", "phases", "tail_probability"]
