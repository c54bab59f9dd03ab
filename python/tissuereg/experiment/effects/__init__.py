"""Effects: deviations of reality from a believed experiment, one class per ``id`` of an ``[[effect]]`` table.

An effect is plain data that can be made in Python (`Inclusion(centre_mm=..., semi_axes_mm=..., contrast=3.0)`) or read
from a table (`effect_from_table`). `extended` changes an experiment by its effects on body, supports and actuators;
`seen_markers` changes predicted marker places by the errors of the marker tracker.
"""

from tissuereg.experiment.effects.actuators import ActuatorDirection, ActuatorGain, ActuatorOffset
from tissuereg.experiment.effects.base import ChainEffect, Effect
from tissuereg.experiment.effects.catalogue import (
    EFFECTS,
    check_effects,
    effect_from_table,
    extended,
    seen_markers,
    true_markers,
)
from tissuereg.experiment.effects.chain import Frame, Latency, MarkerSlip, MarkerSwap, Scale
from tissuereg.experiment.effects.elastic import Asymmetry, Fibre, Mooney, Poisson, Stiffening, Stiffness
from tissuereg.experiment.effects.history import Drainage, Rate, Relaxation, Set, Softening, Swelling
from tissuereg.experiment.effects.regions import Inclusion, Layer
from tissuereg.experiment.effects.supports import Detachment, Gravity, Reference, Sliding

__all__ = [
    "EFFECTS",
    "ActuatorDirection",
    "ActuatorGain",
    "ActuatorOffset",
    "Asymmetry",
    "ChainEffect",
    "Detachment",
    "Drainage",
    "Effect",
    "Fibre",
    "Frame",
    "Gravity",
    "Inclusion",
    "Latency",
    "Layer",
    "MarkerSlip",
    "MarkerSwap",
    "Mooney",
    "Poisson",
    "Rate",
    "Reference",
    "Relaxation",
    "Scale",
    "Set",
    "Sliding",
    "Softening",
    "Stiffening",
    "Stiffness",
    "Swelling",
    "check_effects",
    "effect_from_table",
    "extended",
    "seen_markers",
    "true_markers",
]
