"""Frame after frame: the registered state restarts the simulation, and the last frames tell about this one."""

from tissuereg.tracking.fitted import FittedPrior, fitted_prior
from tissuereg.tracking.frame import TrackedFrame
from tissuereg.tracking.physics import CalledPhysics, FemPhysics, HoldingPhysics, Physics
from tissuereg.tracking.table import TablePhysics
from tissuereg.tracking.tracker import Tracker

__all__ = [
    "CalledPhysics",
    "FemPhysics",
    "FittedPrior",
    "HoldingPhysics",
    "Physics",
    "TablePhysics",
    "TrackedFrame",
    "Tracker",
    "fitted_prior",
]
