"""Parameters given observations: by an ensemble, ES-MDA, or by the most probable ones and the Gaussian about them.

`tissuereg-esmda` computes; the model is a Python function of many columns of parameters.
"""

from tissuereg.registration.learned.assimilate.ensemble import (
    ABSURD_MM,
    Assimilation,
    FirstEnsemble,
    StepOptions,
    assimilate,
    balanced_draws,
)
from tissuereg.registration.learned.assimilate.laplace import Laplace, gauss_newton
from tissuereg.registration.learned.assimilate.shortcut import Between

__all__ = [
    "ABSURD_MM",
    "Assimilation",
    "Between",
    "FirstEnsemble",
    "Laplace",
    "StepOptions",
    "assimilate",
    "balanced_draws",
    "gauss_newton",
]
