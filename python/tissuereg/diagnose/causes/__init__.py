"""The catalogue of causes that a diagnosis can name: each has a module with its hypotheses, parameters and sentence."""

from tissuereg.diagnose.causes.actuators import DirectionCause, GainCause, OffsetCause
from tissuereg.diagnose.causes.asymmetry import AsymmetryCause
from tissuereg.diagnose.causes.base import Cause, Knobs, Values, Variant
from tissuereg.diagnose.causes.detachment import DetachmentCause
from tissuereg.diagnose.causes.drainage import DrainageCause
from tissuereg.diagnose.causes.fibre import FibreCause
from tissuereg.diagnose.causes.gravity import GravityCause
from tissuereg.diagnose.causes.inclusion import InclusionCause
from tissuereg.diagnose.causes.layer import LayerCause
from tissuereg.diagnose.causes.mooney import MooneyCause
from tissuereg.diagnose.causes.poisson import PoissonCause
from tissuereg.diagnose.causes.rate import RateCause
from tissuereg.diagnose.causes.reference import ReferenceCause
from tissuereg.diagnose.causes.relaxation import RelaxationCause
from tissuereg.diagnose.causes.set import SetCause
from tissuereg.diagnose.causes.sliding import SlidingCause
from tissuereg.diagnose.causes.softening import SofteningCause
from tissuereg.diagnose.causes.stiffening import StiffeningCause
from tissuereg.diagnose.causes.stiffness import StiffnessCause
from tissuereg.diagnose.causes.swelling import SwellingCause
from tissuereg.diagnose.causes.tracker import FrameCause, LatencyCause, ScaleCause, SlipCause, SwapCause

#: All causes by id.
CAUSES: dict[str, Cause] = {
    cause.id: cause
    for cause in (
        StiffnessCause(), PoissonCause(), StiffeningCause(), MooneyCause(), AsymmetryCause(), FibreCause(),
        InclusionCause(), LayerCause(),
        RelaxationCause(), RateCause(), SofteningCause(), SetCause(), SwellingCause(), DrainageCause(),
        GravityCause(), ReferenceCause(),
        SlidingCause(), DetachmentCause(),
        GainCause(), DirectionCause(), OffsetCause(),
        FrameCause(), ScaleCause(), LatencyCause(), SlipCause(), SwapCause(),
    )
}  # fmt: skip

__all__ = ["CAUSES", "Cause", "Knobs", "Values", "Variant"]
