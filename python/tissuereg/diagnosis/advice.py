"""Advice on what to measure next: the proposed load case whose predicted outcomes best separate tied causes.

The separability of a pair is the norm of the difference between the fitted models' predictions under it, whitened by
noise, tracker frame, modulus and force error.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.answer import Finding
from tissuereg.diagnosis.candidates import Candidate
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import Fit, FitTarget
from tissuereg.diagnosis.nuisances import frame_columns
from tissuereg.diagnosis.patterns import force_columns
from tissuereg.diagnosis.predictor import Predictor
from tissuereg.diagnosis.search import Step
from tissuereg.diagnosis.settings import DEFAULT, AdviceSettings
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.errors import TissueRegError
from tissuereg.experiment.experiment import Actuator, Case, Experiment


def advise(target: FitTarget, steps: Sequence[Step], findings: Sequence[Finding]) -> dict[str, Any] | None:
    """Return the proposed load case that best separates causes between which the data cannot decide.

    `steps`: rounds of the search; `findings`: each with its group, the ids of the causes that explain the data about as
    well. The result has ``action``, the instruction in words, ``separates``, the pairs of ids, and ``separability``,
    the least over these pairs of the norm of the difference between the two fitted models' predictions under the
    action, in noise deviations, given the uncertainty of the tracker's frame, of the modulus as fitted, and of forces.
    It is None where no causes are tied, and where no pad is moved.

    The separability is an upper bound: the models' parameters are not fitted again to the outcome, and the
    discretisation error of the markers under the action is not known.
    """
    pairs: list[tuple[Candidate, Candidate]] = []
    for finding in findings:
        step = next((s for s in steps if s.found is not None and s.found.id == finding.id), None)
        if step is not None:
            each = {candidate.id: candidate for candidate in step.candidates}
            pairs += [(each[finding.id], each[other]) for other in finding.group[1:] if finding.id in each]
    if not pairs:
        return None
    tied = dict.fromkeys(candidate for pair in pairs for candidate in pair)
    best: dict[str, Any] | None = None
    for words, rig in _actions(target.bench.experiment, target.bench.settings.report):
        try:
            outcomes = {candidate: _prediction(target, candidate.fit, rig) for candidate in tied}
            least = min(_separability(target, rig, one.fit, outcomes[one], outcomes[other]) for one, other in pairs)
        except TissueRegError:  # an action without equilibrium is no advice
            continue
        if best is None or least > best["separability"]:
            named = [[one.id, other.id] for one, other in pairs]
            best = {"action": words, "separates": named, "separability": least}
    return best


def _actions(experiment: Experiment, settings: AdviceSettings = DEFAULT.report) -> list[tuple[str, Experiment]]:
    """Return the load cases that could be measured next, each in words and as an experiment without data."""
    # Pushes and pulls as far as each pad has moved, its own motion with a long hold, and with its force if not known.
    actions: list[tuple[str, Experiment]] = []
    known = experiment.force_std is not None

    def add(words: str, pad: Actuator, motion: FloatArray, hold: float, *, force: bool) -> None:
        case = _case(experiment, pad, motion, hold, settings.ramp_s, force=force)
        actions.append((f"{words}, hold {hold:.0f} s", replace(experiment, cases={"next": case}, rest_case=None)))

    for pad in experiment.actuators:
        given = [case.displacements[pad.name] for case in experiment.cases.values() if pad.name in case.displacements]
        if pad.kind != "displacement" or not given:
            continue
        stroke = float(np.linalg.norm(np.concatenate(given), axis=1).max())
        own = max((motion for motion in given), key=lambda motion: float(np.linalg.norm(motion, axis=1).max()))
        along = own[int(np.argmax(np.linalg.norm(own, axis=1)))]
        for axis, name in zip(np.eye(3), "xyz", strict=True):
            for far in (-stroke, stroke):
                add(f"move {pad.name} by {far:+.3g} mm along {name}", pad, far * axis, settings.hold_s, force=known)
        add(f"move {pad.name} as before", pad, along, settings.long_hold_s, force=known)
        if not known:
            words = f"measure the force at {pad.name} to {settings.measured_to:g} mN"
            add(words, pad, along, settings.hold_s, force=True)
    return actions


def _case(experiment: Experiment, pad: Actuator, motion: FloatArray, hold: float, up: float, *, force: bool) -> Case:
    begin = max(float(case.times[-1]) for case in experiment.cases.values()) + 10.0
    shares = np.array([0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0])
    held = up + hold * np.array([0.25, 0.5, 0.75, 1.0])
    times = begin + np.array([0.0, up / 2, up, *held, up + hold + up / 2, 2 * up + hold])
    markers = np.broadcast_to(experiment.marker_reference, (len(times), *experiment.marker_reference.shape))
    given = {pad.name: shares[:, None] * motion}
    return Case("next", times, markers, given, forces={pad.name: np.zeros((len(times), 3))} if force else {})


def _prediction(target: FitTarget, fit: Fit, rig: Experiment) -> FloatArray:
    """Return a fitted model's prediction in a rig, flat: marker displacements in mm, then pad forces in mN."""
    own, settings = target.bench.predictor, target.bench.settings.model
    predictor = Predictor(rig, SignalLayout(rig), element=own.element, threads=own.threads, settings=settings)
    return predictor.predict(fit.effects(target.bench.young), young=float(np.exp(fit.x[0])))


def _separability(target: FitTarget, rig: Experiment, fit: Fit, one: FloatArray, other: FloatArray) -> float:
    """Return the norm of the difference (n,), mm and mN, of two predictions in a rig, in standard deviations."""
    layout, settings = SignalLayout(rig), target.bench.settings
    markers = layout.of_markers()
    force_std = settings.report.measured_to if rig.force_std is None else target.noise.force_std
    std = np.where(markers, float(target.noise.marker_std.mean()), force_std)
    columns = [column for pair in frame_columns(layout, one, settings.nuisances) for column in pair]
    deviation = float(np.sqrt(fit.covariance[0, 0]))
    if target.scales_forces(fit.ids):
        columns.append(np.where(markers, 0.0, deviation * one))
    else:
        stiffer = replace(fit, x=fit.x + deviation * np.eye(len(fit.x))[0])
        columns.append(_prediction(target, stiffer, rig) - one)
    for part in layout.parts:
        for pad in range(len(part.pads)):
            strength = np.linalg.norm(part.forces(one)[:, pad], axis=1)
            columns += list(force_columns(layout, part, pad, settings.nuisances.force_left * strength))
    return float(np.linalg.norm(Null(np.array(columns) / std).reduced((one - other) / std)))
