"""Adds the noise that an experiment states to its simulation."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from tissuereg.experiment.experiment import Experiment
from tissuereg.simulation.experiment import CaseSimulation


def with_noise(
    experiment: Experiment, answers: Mapping[str, CaseSimulation], *, seed: int = 0
) -> dict[str, CaseSimulation]:
    """Return simulated cases with measurement noise.

    `experiment`: with the standard deviations of markers and forces; `answers`: without noise; `seed`: seed of all
    random numbers. Result: white normal noise on the markers, and on the forces if their standard deviation is stated;
    targets and displacements unchanged.
    """
    generator = np.random.default_rng([seed, 6])
    std = experiment.force_std or 0.0
    noisy = {}
    for name, answer in answers.items():
        markers = answer.markers + experiment.marker_std * generator.standard_normal(answer.markers.shape)
        forces = {pad: force + std * generator.standard_normal(force.shape) for pad, force in answer.forces.items()}
        noisy[name] = replace(answer, markers=markers, forces=forces)
    return noisy
