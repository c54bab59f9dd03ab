"""Constancy test of findings: whether the change that a cause makes is the same in all parts of the data.

A wrong cause is fitted to the effect of the true one: right on the whole and wrong in parts, such as a load case, or
ramps and holds. Partitions of the data (`partitions`) divide it. In each the change that the cause makes, weighted part
by part, spans a subspace: a cause whose size differs from part to part would change the data in it. So do its columns,
if it has several parameters. Nuisances, the modulus and the cause's own parameters are projected out. With m
orthonormal rows B and the residual z, the evidence for changes of the size t is

    a2 t^2 / (2 (1 + t^2)) - m/2 log(1 + t^2),    a2 = |B z|^2;

the means of its exponential over sizes, and then over all subspaces, are taken. The p-value is that among residuals of
data in which nothing but noise and nuisances is left.

A true cause that the catalogue lacks is best imitated by a cause of its family (`Cause.family`). What that leaves of
the data lies along changes that further members of the family make, or along parts in which the cause is inconstant.
Where the evidence for either is too large, among such residuals, the family alone is stated, with its best member.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.evidence import Null, log_mean_exp, tail_probability
from tissuereg.diagnosis.fit import Fit, FitTarget, predicted
from tissuereg.diagnosis.nuisances import effect_nuisances
from tissuereg.diagnosis.screen import Screen
from tissuereg.diagnosis.settings import DEFAULT, ConstancySettings
from tissuereg.diagnosis.signals import CasePart, SignalLayout, load_history, spanning
from tissuereg.experiment.experiment import Case, Experiment

#: Families by id, in words.
FAMILIES = {
    "law": "elastic laws",
    "region": "regions of other stiffness",
    "memory": "effects of time and load history",
    "rest": "errors of weight and unloaded shape",
    "support": "errors of supports",
    "actuator": "errors of actuators",
    "tracker": "errors of the tracker",
}


@dataclass(frozen=True)
class Constancy:
    """Result of the constancy test of one finding.

    `p`: probability that data which the cause explains are as inconstant; `differs_by`: the partition of the data over
    which its change is least constant; `level`: p-value below which it is not stated.
    """

    id: str
    p: float
    differs_by: str
    level: float

    @property
    def holds(self) -> bool:
        """Whether the cause may be stated."""
        return self.p >= self.level

    def to_json(self) -> dict[str, Any]:
        """Return the test as plain data for JSON."""
        return {"id": self.id, "p": self.p, "differs_by": self.differs_by, "holds": self.holds}


@dataclass(frozen=True, eq=False)
class AfterFit:
    """What a fitted model leaves of the data, without all that its own parameters and the modulus can change.

    `residual` (size,), `draws` (n, size): of the data, and of data in which nothing but noise and nuisances is left,
    both whitened by noise and nuisances; `own` (k, size): orthonormal rows that span the changes by the parameters.
    """

    residual: FloatArray
    draws: FloatArray
    own: FloatArray

    @classmethod
    def of(cls, residual: FloatArray, draws: FloatArray, slopes: FloatArray) -> "AfterFit":
        """Return what is left of a residual and of draws, given the changes (k, size) by the parameters."""
        own = spanning(slopes)
        return cls(_beside(residual, own), _beside(draws, own), own)

    def inconstancies(
        self,
        change: FloatArray,
        columns: FloatArray,
        parts: Mapping[str, FloatArray],
        reduced: Callable[[FloatArray], FloatArray],
        settings: ConstancySettings,
    ) -> list[tuple[str, FloatArray]]:
        """Return partitions with the log evidence (1 + n,), nats, that a cause's change differs between their parts.

        `change` (size,), `columns` (k, size): changes by the whole cause and by each of its parameters, whitened by the
        noise; `parts`: partitions, weights (m, size) by name; `reduced`: whitens further, by the nuisances. A partition
        may stand twice, for the whole cause and for its parameters, or not, where nothing changes but by the latter.
        """
        least = settings.least_change * float(np.linalg.norm(change))
        found = []
        for name, weights in parts.items():
            # One parameter changes the data nearly as the whole cause does.
            by_each = [column * weights for column in columns] if len(columns) > 1 else []
            for rows in (change * weights, *([np.concatenate(by_each)] if by_each else [])):
                evidence = self.evidence(reduced(rows), least, settings)
                if evidence is not None:
                    found.append((name, evidence))
        return found

    def evidence(self, rows: FloatArray, least: float, settings: ConstancySettings) -> FloatArray | None:
        """Return the log evidence (1 + n,), nats, that the residual and each draw have a change in the span of rows.

        `rows` (k, size): whitened as the residual is; those count whose part beside the cause's own changes is longer
        than `least`, noise deviations. None where none is.
        """
        kept = _beside(rows, self.own)
        lengths = np.linalg.norm(kept, axis=1, keepdims=True)
        if not (lengths > least).any():
            return None
        basis = spanning((kept / np.maximum(lengths, 1e-300))[lengths[:, 0] > least], settings.least_direction)
        power, sizes = ((self._scaled @ basis.T) ** 2).sum(axis=1)[:, None], np.square(settings.sizes)
        return log_mean_exp(0.5 * power * sizes / (1.0 + sizes) - 0.5 * len(basis) * np.log1p(sizes), axis=1)

    @cached_property
    def _scaled(self) -> FloatArray:
        """The residual and the draws (1 + n, size), scaled down to the size of noise where they are larger."""
        rows = np.concatenate([self.residual[None], self.draws])
        # The size of the noise is uncertain. A residual below it is none the more inconstant for that.
        rms = np.sqrt((rows**2).mean(axis=1, keepdims=True))
        return np.asarray(rows / np.maximum(rms / np.median(rms[1:]), 1.0))


def p_value(evidence: FloatArray) -> float:
    """Return the p-value of the residual's mean evidence among the draws'; `evidence` (k, 1 + n): log, nats."""
    whole = log_mean_exp(evidence, axis=0)
    return tail_probability(float(whole[0]), whole[1:])


@dataclass(frozen=True, eq=False)
class FittedPart:
    """One cause of a fit with what the fit leaves of the data, given the errors of all causes.

    `beside`: ids of the others; `left`: the residual without all that the parameters change; `errors`: covariance of
    the causes' errors, beside that of the nuisances; `inconstancies`: as `AfterFit.inconstancies`; none where the
    change has not one size; `number`: of the cause in the fit.
    """

    id: str
    beside: tuple[str, ...]
    left: AfterFit
    errors: Null
    inconstancies: list[tuple[str, FloatArray]]
    number: int = 0

    def constancy(self, level: float) -> Constancy | None:
        """Return the constancy test; None where nothing can be inconstant. `level`: that of the test."""
        if not self.inconstancies:
            return None
        evidence = np.array([one for _, one in self.inconstancies])
        return Constancy(self.id, p_value(evidence), self.inconstancies[int(evidence[:, 0].argmax())][0], level)


def fitted_parts(
    target: FitTarget, found: Fit, null: Null, draws: FloatArray, seed: int, settings: ConstancySettings
) -> list[FittedPart]:
    """Return every cause of a fit that has parameters, in their order, ready for tests of what the fit leaves.

    `null`: covariance of noise and nuisances, the modulus included; `draws` (n, size): residuals of data without any
    effect, whitened by it (`draw_nulls`); `seed`: seed of further draws. Each cause may be off in its form by a share
    of its change in any part of the data, and the others as when a further cause is looked for.
    """
    bench = target.bench
    parts = partitions(bench.experiment, bench.layout, bench.base, settings)
    slopes = target.slopes(found)
    changes = [found.prediction - predicted(target, found, without=number) for number in range(len(found.parts))]
    ready = []
    for number, (name, mine) in enumerate(zip(found.ids, found.slices(), strict=True)):
        if mine.start == mine.stop:
            continue
        others = [target.white(effect_nuisances(bench, other)) for i, other in enumerate(changes) if i != number]
        change = target.white(changes[number])
        form = settings.form_error * np.concatenate([change * weights for weights in parts.values()])
        errors = null.reduced(np.concatenate([form, *others]))
        beside = Null(errors)
        generator = np.random.default_rng([seed, 11, number])

        def reduced(white: FloatArray, beside: Null = beside) -> FloatArray:
            """Whiten by all nuisances what the noise has whitened."""
            return beside.reduced(null.reduced(white))

        drawn = beside.reduced(draws + generator.standard_normal((len(draws), len(errors))) @ errors)
        left = AfterFit.of(reduced(found.residual), drawn, reduced(slopes))
        unlike = left.inconstancies(change, slopes[mine], parts, reduced, settings) if CAUSES[name].constant else []
        ready.append(FittedPart(name, (*found.ids[:number], *found.ids[number + 1 :]), left, beside, unlike, number))
    return ready


@dataclass(frozen=True)
class Membership:
    """Whether the data hold a cause, or its family alone.

    `p`: probability that data which the cause explains speak as much for something else of its family; `level`: p-value
    below which the family alone is stated; `beaten`: whether an effect of the family that is outside the catalogue
    explains the data better (`outside`).
    """

    id: str
    p: float
    level: float
    beaten: bool = False

    @property
    def family(self) -> str:
        """Id of the family."""
        return CAUSES[self.id].family

    @property
    def words(self) -> str:
        """Name of the family."""
        return FAMILIES[self.family]

    @property
    def holds(self) -> bool:
        """Whether the cause itself may be stated."""
        return self.p >= self.level and not self.beaten

    @property
    def reason(self) -> str:
        """Why the family alone is stated, in words."""
        if self.p < self.level:
            return f"what it leaves looks like another one of them (p = {self.p:.1g})"
        return "one of them that the catalogue lacks explains the data as well"

    def to_json(self) -> dict[str, Any]:
        """Return the test as plain data for JSON."""
        said = {} if self.holds else {"reason": self.reason}
        return {"id": self.family, "words": self.words, "p": self.p, "alone": not self.holds, **said}


def memberships(parts: Sequence[FittedPart], screen: Screen, settings: ConstancySettings) -> dict[int, Membership]:
    """Return for causes of a fit, by number, whether the data hold them or their families alone.

    Not in the result are causes without relatives that could change what is left, and without inconstancies; and those
    that begin to act somewhere (`Cause.constant`): what they leave is another effect beside them.
    """
    found = {}
    for part in (one for one in parts if CAUSES[one.id].constant):
        relatives = _of_relatives(part, screen, settings)
        evidence = [] if relatives is None else [relatives]
        if part.inconstancies:
            evidence.append(log_mean_exp(np.array([one for _, one in part.inconstancies]), axis=0))
        if evidence:
            found[part.number] = Membership(part.id, p_value(np.array(evidence)), settings.member_level)
    return found


def _of_relatives(part: FittedPart, screen: Screen, settings: ConstancySettings) -> FloatArray | None:
    """Return the log evidence (1 + n,), nats, of the other members of a cause's family in what its fit leaves."""
    members = []
    for name, blocks in screen.blocks.items():
        if name in (part.id, *part.beside) or CAUSES[name].family != CAUSES[part.id].family:
            continue
        each = []
        for columns in blocks.columns:
            rows = part.errors.reduced(columns.astype(np.float64))
            least = settings.least_change * float(np.linalg.norm(columns, axis=1).max())
            evidence = part.left.evidence(rows, least, settings)
            if evidence is not None:
                each.append(evidence)
        if each:
            members.append(log_mean_exp(np.array(each), axis=0))
    return log_mean_exp(np.array(members), axis=0) if members else None


def partitions(
    experiment: Experiment, layout: SignalLayout, base: FloatArray, settings: ConstancySettings = DEFAULT.constancy
) -> dict[str, FloatArray]:
    """Return the partitions of the data, by name, each as weights (k, size) of all measured numbers.

    `base` (size,): prediction of the believed model, mm and mN. The weights are 0 and 1 for cases, phases of the load,
    axes and forces; numbers of unit size for time, place and the size of the load.
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
        for name, frames in phases(experiment.cases[part.name], part, settings.least_load).items():
            part.put(by_phase.setdefault(name, np.zeros(size)), frames)
        own = (part.times - part.times[0]) / max(float(part.times[-1] - part.times[0]), 1e-9)
        part.put(time[0], (part.times - begin) / span - 0.5)
        part.put(time[1], own - 0.5)
        history = load_history(part, base)
        part.put(load[0], history)
        part.put(load[1], history**2)
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


def phases(case: Case, part: CasePart, least: float) -> dict[str, FloatArray]:
    """Return the frames of each phase of a case, 0 or 1 (n_frames,), by name.

    They are those before the load, in which it grows, the first and second half of every hold, in which it falls, and
    after it. `least`: share of the largest command below which there is no load.
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


def _beside(rows: FloatArray, own: FloatArray) -> FloatArray:
    """Return rows (..., size) without their part in the span of orthonormal rows (k, size)."""
    return np.asarray(rows - (rows @ own.T) @ own)
