"""Parameters given observations: an ensemble of them by ES-MDA.

`tissuereg-esmda` computes; the model is a Python function of many columns of parameters.
"""

from tissuereg.registration.learned.assimilate.ensemble import (
    ABSURD_MM,
    Assimilation,
    AssimilationSettings,
    FirstEnsemble,
    StepOptions,
    assimilate,
    balanced_draws,
    spread_factor,
)

__all__ = [
    "ABSURD_MM",
    "Assimilation",
    "AssimilationSettings",
    "FirstEnsemble",
    "StepOptions",
    "assimilate",
    "balanced_draws",
    "spread_factor",
]
