"""The catalogue of causes that a diagnosis can name, each with hypotheses, parameters, forms in curves, a sentence."""

from tissuereg.diagnosis.causes.actuators import DirectionCause, GainCause, OffsetCause
from tissuereg.diagnosis.causes.base import Cause, FreeParameters, Values, Variant
from tissuereg.diagnosis.causes.drainage import DrainageCause
from tissuereg.diagnosis.causes.fibre import FibreCause
from tissuereg.diagnosis.causes.gravity import GravityCause, ReferenceCause
from tissuereg.diagnosis.causes.laws import AsymmetryCause, MooneyCause, StiffeningCause
from tissuereg.diagnosis.causes.rate import RateCause
from tissuereg.diagnosis.causes.regions import InclusionCause, LayerCause
from tissuereg.diagnosis.causes.relaxation import RelaxationCause
from tissuereg.diagnosis.causes.set import SetCause
from tissuereg.diagnosis.causes.softening import SofteningCause
from tissuereg.diagnosis.causes.stiffness import PoissonCause, StiffnessCause
from tissuereg.diagnosis.causes.supports import DetachmentCause, SlidingCause
from tissuereg.diagnosis.causes.swelling import SwellingCause
from tissuereg.diagnosis.causes.tracker import FrameCause, LatencyCause, ScaleCause, SlipCause, SwapCause
from tissuereg.diagnosis.settings import DiagnoseSettings

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


def catalogue(settings: DiagnoseSettings) -> dict[str, Cause]:
    """Return all causes by id, with the numbers of the settings."""
    return CAUSES | {cause.id: cause for cause in settings.causes}


__all__ = ["CAUSES", "Cause", "FreeParameters", "Values", "Variant", "catalogue"]
