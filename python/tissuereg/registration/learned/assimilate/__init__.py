"""Parameters given observations: an ensemble of them by ES-MDA, or the most probable ones and a Gaussian about them.

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
)
from tissuereg.registration.learned.assimilate.laplace import Laplace, SearchSettings, gauss_newton

__all__ = [
    "ABSURD_MM",
    "Assimilation",
    "AssimilationSettings",
    "FirstEnsemble",
    "Laplace",
    "SearchSettings",
    "StepOptions",
    "assimilate",
    "balanced_draws",
    "gauss_newton",
]
