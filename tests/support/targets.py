"""Small experiments with hidden effects, and the target of a fit on one."""

from dataclasses import replace

import numpy as np

from support.rigs import rig
from tissuereg.diagnosis.answer import Finding
from tissuereg.diagnosis.bench import Bench
from tissuereg.diagnosis.causes import CAUSES
from tissuereg.diagnosis.correction import Correction
from tissuereg.diagnosis.evidence import Null
from tissuereg.diagnosis.fit import FitTarget, FittedCause
from tissuereg.diagnosis.noise import Noise
from tissuereg.diagnosis.screen import Screen
from tissuereg.diagnosis.signals import SignalLayout
from tissuereg.experiment.experiment import Experiment
from tissuereg.simulation.experiment import with_noise
from tissuereg.simulation.fine import FineModel

MARKER_STD, FORCE_STD, YOUNG = 0.01, 2.0, 1.1


def hidden(believed, *effects) -> Experiment:
    """Return an experiment with what would be measured under effects that it does not state, noise included."""
    seen = with_noise(believed, FineModel(believed).simulate(effects))
    cases = {
        name: replace(
            case,
            markers=seen[name].markers,
            forces={pad: seen[name].forces[pad] for pad in case.forces},
            targets=seen[name].targets,
        )
        for name, case in believed.cases.items()
    }
    return replace(believed, cases=cases)


def target_of(*effects, believed=None, marker_std=MARKER_STD, force_std=FORCE_STD, young=YOUNG) -> FitTarget:
    """Return the target of a fit to data with effects, a stiffer body and noise; of the small rig if none is given."""
    believed = believed or rig()
    truth = Bench(believed, SignalLayout(believed)).predictor.predict(effects, young=young)
    layout = SignalLayout(believed)
    rng = np.random.default_rng(1)
    std = np.where(layout.of_markers(), marker_std, force_std)
    layout.measured[:] = truth + std * rng.standard_normal(layout.size)
    bench = Bench(believed, layout)
    noise = Noise(np.full(len(layout.marker_names), marker_std), 0.0, 0.0, 0.0, 1.0, force_std, True)
    same = Correction(layout)
    return FitTarget(bench, noise, same, Null(np.zeros((0, layout.size))))


def part(target, name, amplitude=0.1, **settings):
    """Return a cause with its parameters at the start of a fit."""
    variants = [v for v in CAUSES[name].variants(target.bench) if settings.items() <= v.settings.items()]
    amplitudes = np.full(len(variants[0].columns), amplitude)
    return FittedCause(name, CAUSES[name].free_parameters(target.bench, variants[0], amplitudes))


def screen_of(target, names, null=None):
    """Return a screen of some causes and a generic rival that does nothing."""
    bank = {name: list(CAUSES[name].variants(target.bench)) for name in names}
    layout = target.bench.layout
    return Screen(bank, np.zeros((1, 1, layout.size)), target.noise, layout, target.correction, null or target.null)


def finding_of(group, **changes):
    """Return a finding of some ids that the data cannot distinguish, the first of them the likeliest."""
    figures = {"probability": 0.9, "log_bayes_factor": 30.0, "threshold": 6.0, "group_probability": 0.9}
    rest = {"parameters": {}, "deviations": {}, "held_out": {}, "sentence": ""}
    return Finding(id=group[0], group=group, **{**figures, **rest, **changes})
