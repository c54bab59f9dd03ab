"""What an answer says of a misfit, where, when and under which load, and what to measure or to check next.

Where causes are tied, the proposed load case is the one whose predicted outcomes separate them best. The separability
of a pair is the norm of the difference between the fitted models' predictions under it, whitened by noise, tracker
frame, modulus and force error.

Where no cause explains the data, a component is to be checked. Every marker, pad, support and case, and the body as a
whole, is a hypothesis with one parameter ``a``: the reduced residual has the variance ``1 + a w`` instead of 1, where
the weight ``w``, 0 to 1, is the proximity of a measured number to the component. The one to check has the largest gain
in log likelihood, maximised over ``a``, minus the logarithm of the number of components of its kind.
"""

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.diagnosis.answer import Finding, to_check
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.candidates import Candidate
from tissuereg.diagnosis.evidence import Null, rms
from tissuereg.diagnosis.fit import Fit, FitTarget
from tissuereg.diagnosis.nuisances import frame_columns
from tissuereg.diagnosis.nulls import Misfit
from tissuereg.diagnosis.predictor import Predictor
from tissuereg.diagnosis.screen import UNKNOWN, Screen
from tissuereg.diagnosis.search import Search, Step
from tissuereg.diagnosis.settings import DEFAULT, AdviceSettings
from tissuereg.diagnosis.signals import SignalLayout, force_columns
from tissuereg.errors import TissueRegError
from tissuereg.experiment.experiment import Actuator, Case, Experiment


def describe(layout: SignalLayout, base: Fit, final: Fit, settings: AdviceSettings) -> dict[str, Any]:
    """Return where, when and by how much the believed model with fitted modulus differs from the data.

    The result has the entries ``rms_mm`` and ``in_sigma``, root mean square residual of a marker's coordinate in mm and
    in noise deviations; ``where``, names of the worst markers; ``when``, a text; ``under``, name of the worst case;
    ``chi_by_case``, ``chi_forces_by_case`` and ``chi_by_marker``, root mean square residuals in noise deviations by
    name; and ``after``, with ``rms_mm`` and ``in_sigma`` of the model with all causes found, `final`.
    """
    seen, white = layout.seen, base.residual
    markers = layout.of_markers() & seen
    cases = {part.name: rms(part.markers(white)[part.markers(seen)]) for part in layout.parts}
    forces = {part.name: rms(part.forces(white)[part.forces(seen)]) for part in layout.parts if part.pads}
    per_marker = _sizes(layout, white, pads=False)
    worst_case = max(cases, key=lambda name: max(cases[name], forces.get(name, 0.0)))
    part = layout[worst_case]
    top = int(np.argmax((part.markers(white) ** 2).mean(axis=(1, 2))))

    def size(of: Fit) -> dict[str, float]:
        return {"rms_mm": rms((layout.measured - of.prediction)[markers]), "in_sigma": rms(of.residual[markers])}

    return {
        **size(base),
        "where": _largest(per_marker, settings.above)[: settings.most_markers],
        "when": f"most at {part.times[top]:.4g} s ({part.times[top] - part.times[0]:.3g} s into the case)",
        "under": worst_case,
        "chi_by_case": cases,
        "chi_forces_by_case": forces,
        "chi_by_marker": per_marker,
        "after": size(final),
    }


def _sizes(layout: SignalLayout, white: FloatArray, *, pads: bool) -> dict[str, float]:
    """Return the root mean square of a whitened residual (size,) at each marker, and at each pad if `pads`, by name."""
    found: dict[str, list[FloatArray]] = {name: [] for name in layout.marker_names}
    for part in layout.parts:
        for names, of in ((layout.marker_names, part.markers), (part.pads if pads else (), part.forces)):
            values, seen = of(white), of(layout.seen)
            for i, name in enumerate(names):
                found.setdefault(name, []).append(values[:, i][seen[:, i]])
    return {name: rms(np.concatenate(parts)) for name, parts in found.items()}


def _largest(sizes: dict[str, float], above: float) -> list[str]:
    """Return the names of the sizes above a bound, the largest first."""
    return sorted((name for name in sizes if sizes[name] > above), key=lambda name: -sizes[name])


def residual_summary(
    layout: SignalLayout, screen: Screen, found: Search, misfit: Misfit, settings: AdviceSettings = DEFAULT.report
) -> dict[str, Any]:
    """Return a description of the residual that remains after the findings, where it is too large to be noise.

    The result has the p-value ``p`` of the misfit test, ``where`` (names of markers and pads), the text ``when``,
    ``looks_like`` (an id, or ``"unknown"``), and the text ``sentence``.
    """
    where = _largest(_sizes(layout, found.reduced, pads=True), settings.above)[: settings.most_places]
    case, time = _worst_frame(layout, found.reduced)
    alike = nearest_cause(screen, found, settings.looks_like)[0]
    when = f"most at {time:.4g} s, under case {case}"
    places = f"at {', '.join(where)}" if where else "spread over all markers and pads"
    like = "no cause of the catalogue" if alike == UNKNOWN else f"'{alike}' more than any other cause"
    sentence = f"A misfit remains after the findings (p = {misfit.p:.2g}) {places}, {when}; it resembles {like}."
    return {"p": misfit.p, "where": where, "when": when, "looks_like": alike, "sentence": sentence}


def _worst_frame(layout: SignalLayout, reduced: FloatArray) -> tuple[str, float]:
    """Return case and time, s, of the frame with the largest sum of squares in a whitened residual (size,)."""
    found = []
    for part in layout.parts:
        power = (part.markers(reduced) ** 2).sum(axis=(1, 2)) + (part.forces(reduced) ** 2).sum(axis=(1, 2))
        top = int(np.argmax(power))
        found.append((float(power[top]), part.name, float(part.times[top])))
    return max(found, key=lambda one: one[0])[1:]


def nearest_cause(screen: Screen, found: Search, least: float) -> tuple[str, float]:
    """Return the id of the further cause most like the residual, `UNKNOWN` below `least`, and its evidence, nats."""
    known = (*found.final.ids, UNKNOWN)
    others = {name: one.log_bayes_factor for name, one in screen.of(found.reduced).items() if name not in known}
    best = max(others, key=lambda name: others[name], default=UNKNOWN)
    gain = others.get(best, -np.inf)
    return (best if gain >= least else UNKNOWN), gain


@dataclass(frozen=True, eq=False)
class RigComponent:
    """A component that can be checked: its kind and name, and how near (size,) every number is to it, 0 to 1."""

    kind: str
    name: str
    proximity: FloatArray


#: The advised action for a component of each kind.
_ACTIONS = {
    "marker": "check marker {name}: that it is firmly attached, fully visible and not mistaken for another; "
    "leave it out and diagnose again",
    "pad": "check pad {name}: its position, whether it slips or lifts off, and that its motion and force are as "
    "recorded; add a marker next to it",
    "support": "check support {name}: whether the body slips or lifts off there, and where its edge is; "
    "add a marker next to it",
    "case": "measure case {name} again: a deviation that does not repeat is no property of the body",
    "body": "check the model of the whole body: {elements}measure its shape and its material separately",
}


def next_check(bench: Bench, residual: FloatArray, like: str = "") -> dict[str, Any]:
    """Return the component of the rig or model to check next, where no cause explains the data.

    `residual` (size,): unexplained, whitened by noise and nuisances; `like`: what it resembles most, in words; empty
    for nothing. The result is that of `to_check`: the component's ``kind`` and ``name``, the ``share`` of the misfit
    near it, ``where`` (markers and pads, the worst first), and ``case`` and ``time_s`` of the worst frame.
    """
    layout, settings = bench.layout, bench.settings.report
    components = list(components_of(bench))
    count = Counter(one.kind for one in components)
    chosen = max(components, key=lambda one: _gain(residual, one.proximity, layout, settings) - np.log(count[one.kind]))
    share = _share(residual, chosen.proximity, layout, settings)
    case, time = _worst_frame(layout, residual * np.sqrt(chosen.proximity))
    where = _largest(_sizes(layout, residual, pads=True), settings.above)[: settings.most_places]
    elements = "" if chosen.name == "tet10" else "diagnose again with the elements tet10; if the misfit remains, "
    action = _ACTIONS[chosen.kind].format(name=chosen.name, elements=elements)
    worst = f", worst at {', '.join(where)}" if where and chosen.kind not in ("marker", "case") else ""
    like = f"; {like}" if like else ""
    whole = "the misfit is spread over the body, in proportion to its motion"
    place = whole if chosen.kind == "body" else f"{share:.0%} of the misfit is there"
    action = f"{action} ({place}{worst}, most at {time:.4g} s under case {case}{like})"
    return to_check(action, chosen.kind, chosen.name, share=share, where=where, case=case, time_s=time)


def components_of(bench: Bench) -> Iterator[RigComponent]:
    """Yield every marker, pad, support and case, and the body, as components that can be checked.

    Proximities (size,) weigh every measured number from 0 (far) to 1 (at it); the body's is that of its motion.
    """
    layout, experiment = bench.layout, bench.experiment
    for i, name in enumerate(layout.marker_names):
        yield RigComponent("marker", name, _near_markers(layout, np.eye(len(layout.marker_names))[i]))
    for pad in experiment.actuators:
        near = _near_markers(layout, _closeness(bench, pad.nodes))
        for part in layout.parts:
            case = experiment.cases[part.name]
            if pad.name not in case.displacements and pad.name not in case.applied_forces:
                part.markers(near)[:] = 0.0
            if pad.name in part.pads:
                part.forces(near)[:, part.pads.index(pad.name)] = 1.0
        yield RigComponent("pad", pad.name, near)
    for boundary in experiment.boundaries:
        yield RigComponent("support", boundary.name, _near_markers(layout, _closeness(bench, boundary.nodes)))
    if len(layout.parts) > 1:
        for part in layout.parts:
            yield RigComponent("case", part.name, layout.of_case(part.name).astype(np.float64))
    yield RigComponent("body", bench.predictor.element, _squared_motion(layout, bench.base))


def _gain(residual: FloatArray, proximity: FloatArray, layout: SignalLayout, settings: AdviceSettings) -> float:
    """Return the largest gain in log likelihood, nats, of additional variances near a component over unit variance."""
    seen, variances = layout.seen, np.geomspace(*settings.variances)
    squares, variance = residual[seen] ** 2, 1.0 + variances[:, None] * proximity[seen]
    nats = 0.5 * (squares * (1.0 - 1.0 / variance) - np.log(variance)).sum(axis=1)
    return float(max(nats.max(), 0.0))


def _share(residual: FloatArray, proximity: FloatArray, layout: SignalLayout, settings: AdviceSettings) -> float:
    """Return the share of a whitened residual (size,), squared and beyond noise, that lies near a component."""
    seen = layout.seen
    beyond = residual[seen] ** 2 - 1.0
    whole, there = float(beyond.sum()), float(beyond[proximity[seen] > settings.near].sum())
    return float(np.clip(there / whole, 0.0, 1.0)) if whole > 0.0 else 0.0


def _near_markers(layout: SignalLayout, closeness: FloatArray) -> FloatArray:
    near = np.zeros(layout.size)
    for part in layout.parts:
        part.markers(near)[:] = closeness[:, None]
    return near


def _closeness(bench: Bench, nodes: IntArray) -> FloatArray:
    """Return how close each marker at rest lies to a patch, (n_markers,): a Gaussian of the distance, 1 on it."""
    places = bench.experiment.mesh.nodes[nodes]
    apart = np.linalg.norm(bench.layout.reference[:, None] - places, axis=2).min(axis=1)
    return np.asarray(np.exp(-0.5 * (apart / (bench.settings.report.reach * bench.extent)) ** 2))


def _squared_motion(layout: SignalLayout, believed: FloatArray) -> FloatArray:
    """Return the squares of a prediction (size,) over the largest of them, 0 to 1, for markers and forces each."""
    near = np.zeros(layout.size)
    markers = layout.of_markers()
    for rows in (markers, ~markers):
        largest = np.abs(believed[rows]).max(initial=0.0)
        if largest > 0.0:
            near[rows] = (believed[rows] / largest) ** 2
    return near


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
    known, up, rest = experiment.force_std is not None, settings.ramp_s, experiment.marker_reference
    begin = max(float(case.times[-1]) for case in experiment.cases.values()) + 10.0
    shares = np.array([0.0, 0.5, 1.0, 1.0, 1.0, 1.0, 1.0, 0.5, 0.0])

    def add(words: str, pad: Actuator, motion: FloatArray, hold: float, *, force: bool) -> None:
        held = up + hold * np.array([0.25, 0.5, 0.75, 1.0])
        times = begin + np.array([0.0, up / 2, up, *held, up + hold + up / 2, 2 * up + hold])
        markers, forces = np.broadcast_to(rest, (len(times), *rest.shape)), {pad.name: np.zeros((len(times), 3))}
        case = Case("next", times, markers, {pad.name: shares[:, None] * motion}, forces=forces if force else {})
        actions.append((f"{words}, hold {hold:.0f} s", replace(experiment, cases={"next": case}, rest_case=None)))

    for pad in experiment.actuators:
        given = [case.displacements[pad.name] for case in experiment.cases.values() if pad.name in case.displacements]
        if pad.kind != "displacement" or not given:
            continue
        stroke = float(np.linalg.norm(np.concatenate(given), axis=1).max())
        own = max(given, key=lambda motion: float(np.linalg.norm(motion, axis=1).max()))
        along = own[int(np.argmax(np.linalg.norm(own, axis=1)))]
        for axis, name in zip(np.eye(3), "xyz", strict=True):
            for far in (-stroke, stroke):
                add(f"move {pad.name} by {far:+.3g} mm along {name}", pad, far * axis, settings.hold_s, force=known)
        add(f"move {pad.name} as before", pad, along, settings.long_hold_s, force=known)
        if not known:
            words = f"measure the force at {pad.name} to {settings.measured_to:g} mN"
            add(words, pad, along, settings.hold_s, force=True)
    return actions


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
