"""The methods that registration is compared with, one file each, all with the one call of `Rival`."""

from tissuereg_paper.rivals.about import MeanAbout, RigidAbout, SplineAbout
from tissuereg_paper.rivals.copy import MeanOfMarkers, copied_displacement
from tissuereg_paper.rivals.elastic import LinearElastic
from tissuereg_paper.rivals.kf_admm import KfAdmm
from tissuereg_paper.rivals.latent_step import LatentFilter, OneStepSmoother
from tissuereg_paper.rivals.libr import Libr
from tissuereg_paper.rivals.ours import Network, PhysicsPrior
from tissuereg_paper.rivals.parameters import ParameterInference
from tissuereg_paper.rivals.pbd import PositionBasedDynamics
from tissuereg_paper.rivals.pca import PcaEsMda
from tissuereg_paper.rivals.residual import LinearResidual
from tissuereg_paper.rivals.rigid import Rigid, rigid_displacement
from tissuereg_paper.rivals.rival import Estimate, Moment, Rival, Setting
from tissuereg_paper.rivals.spline import Spline, spline_displacement
from tissuereg_paper.rivals.varied import EnsembleOfSimulations, Varied, VariedNetwork

#: Every method by the name that tables print.
RIVALS: dict[str, type[Rival]] = {
    rival.name: rival
    for rival in (
        MeanOfMarkers,
        Rigid,
        Spline,
        MeanAbout,
        RigidAbout,
        SplineAbout,
        LinearElastic,
        Libr,
        LinearResidual,
        PositionBasedDynamics,
        KfAdmm,
        ParameterInference,
        PcaEsMda,
        OneStepSmoother,
        LatentFilter,
        PhysicsPrior,
        Network,
        EnsembleOfSimulations,
        VariedNetwork,
    )
}

__all__ = [
    "RIVALS",
    "EnsembleOfSimulations",
    "Estimate",
    "KfAdmm",
    "LatentFilter",
    "Libr",
    "LinearElastic",
    "LinearResidual",
    "MeanAbout",
    "MeanOfMarkers",
    "Moment",
    "Network",
    "OneStepSmoother",
    "ParameterInference",
    "PcaEsMda",
    "PhysicsPrior",
    "PositionBasedDynamics",
    "Rigid",
    "RigidAbout",
    "Rival",
    "Setting",
    "Spline",
    "SplineAbout",
    "Varied",
    "VariedNetwork",
    "copied_displacement",
    "rigid_displacement",
    "spline_displacement",
]
