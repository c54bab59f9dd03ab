"""Tracking: each frame (measured moment) is registered from the state of the last one, and filtered in time."""

from tissuereg.tracking.align import Alignment, rigid_alignment
from tissuereg.tracking.fitted import FittedPrior, fitted_prior
from tissuereg.tracking.frame import TrackedFrame
from tissuereg.tracking.physics import CalledPhysics, FemPhysics, HoldingPhysics, Physics
from tissuereg.tracking.stored import StoredTrack, read_track
from tissuereg.tracking.table import TablePhysics
from tissuereg.tracking.tracker import Tracker

__all__ = [
    "Alignment",
    "CalledPhysics",
    "FemPhysics",
    "FittedPrior",
    "HoldingPhysics",
    "Physics",
    "StoredTrack",
    "TablePhysics",
    "TrackedFrame",
    "Tracker",
    "fitted_prior",
    "read_track",
    "rigid_alignment",
]
