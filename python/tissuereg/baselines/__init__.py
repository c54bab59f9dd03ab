"""The methods that registration is compared with, one file each, all with the one call of `Rival`."""

from tissuereg.baselines.about import MeanAbout, RigidAbout, SplineAbout
from tissuereg.baselines.copy import MeanOfMarkers, copied_displacement
from tissuereg.baselines.elastic import LinearElastic
from tissuereg.baselines.kf_admm import KfAdmm
from tissuereg.baselines.latent_step import LatentFilter, OneStepSmoother
from tissuereg.baselines.libr import Libr
from tissuereg.baselines.ours import Network, PhysicsPrior
from tissuereg.baselines.parameters import ParameterInference
from tissuereg.baselines.pbd import PositionBasedDynamics
from tissuereg.baselines.pca import PcaEsMda
from tissuereg.baselines.residual import LinearResidual
from tissuereg.baselines.rigid import Rigid, rigid_displacement
from tissuereg.baselines.rival import Estimate, Moment, Rival, Setting
from tissuereg.baselines.spline import Spline, spline_displacement
from tissuereg.baselines.varied import EnsembleOfSimulations, Varied, VariedNetwork

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
