"""Effects of time and load history: relaxation, viscosity, softening, permanent set."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.diagnosis.material.causes.base import Form, MaterialCause, exponential, form, sigmoid
from tissuereg.diagnosis.material.scene import Scene
from tissuereg.experiment.effects.history import Rate, Relaxation, Set, Softening


def _relaxation_forms(scene: Scene) -> list[Form]:
    if not (scene.timed and scene.paced and scene.longest_s > scene.shortest_s):
        return []
    low, high = math.log(scene.shortest_s), math.log(scene.longest_s)
    forms = []
    for n in range(1, scene.settings.most_terms + 1):
        # Prior means of the time constants are spread evenly over the decades that the test resolves.
        times = low + (high - low) * (np.arange(n) + 0.5) / n
        spread = (high - low) / (2.0 * n) + 0.3
        prior = [(-0.7, 1.5)] * n + [(float(t), spread) for t in times]
        forms.append(form(f"prony-{n}", prior, [], _relaxation))
    return forms


def _relaxation(x: FloatArray) -> Relaxation:
    n = len(x) // 2
    shares = np.exp(np.clip(x[:n], -30.0, 30.0))
    shares = np.maximum(shares / (1.0 + shares.sum()), 1e-12)
    times = np.exp(np.clip(x[n:], -30.0, 30.0))
    order = np.argsort(times)
    return Relaxation(g=tuple(shares[order].tolist()), tau_s=tuple(times[order].tolist()))


def _relaxation_sentence(table: Mapping[str, Any]) -> str:
    terms = ", ".join(f"{g:.0%} within {tau:.3g} s" for g, tau in zip(table["g"], table["tau_s"], strict=True))
    return f"The stress relaxes: of the instantaneous stress {terms}."


def _rate_forms(scene: Scene) -> list[Form]:
    if not (scene.timed and scene.paced and scene.fastest > 0):
        return []
    likely = math.log(0.1 * scene.peak / (3.0 * scene.fastest))
    return [form("viscosity", [(likely, 2.0)], [], lambda x: Rate(viscosity_kpa_s=exponential(float(x[0]))))]


def _softening_forms(scene: Scene) -> list[Form]:
    if not scene.unloaded:
        return []
    likely = math.log(0.3 * scene.peak_energy)

    def effect(x: FloatArray) -> Softening:
        return Softening(r=1.0 + exponential(float(x[0])), m_kpa=exponential(float(x[1])))

    return [form("ogden-roxburgh", [(0.0, 1.5), (likely, 1.5)], [], effect)]


def _set_forms(scene: Scene) -> list[Form]:
    if not scene.unloaded:
        return []
    return [form("set", [(-2.5, 1.2)], [], lambda x: Set(fraction=sigmoid(float(x[0]))))]


RELAXATION = MaterialCause("relaxation", "relaxation", _relaxation_forms, _relaxation_sentence)
RATE = MaterialCause(
    "rate",
    "rate",
    _rate_forms,
    lambda table: f"The stress grows with the rate of strain: a viscosity of {table['viscosity_kpa_s']:.3g} kPa s.",
)
SOFTENING = MaterialCause(
    "softening",
    "softening",
    _softening_forms,
    lambda table: f"Below the largest load so far the material is softer (Mullins effect, r = {table['r']:.3g}).",
)
SET = MaterialCause(
    "set",
    "set",
    _set_forms,
    lambda table: f"A share of {table['fraction']:.2g} of the largest strain so far remains after unloading.",
)
