"""The package's own registrations among the methods: with the physics prior, and with a network."""

from dataclasses import replace
from typing import Any, ClassVar

import numpy as np

from tissuereg import Body, ContactRegistration, RegisterSettings, Registrar, Registration, SimulationVariants
from tissuereg._base.arguments import flag, maybe
from tissuereg._base.arrays import FloatArray
from tissuereg.registration.learned.model import LatentModel
from tissuereg_paper.rivals.rival import Estimate, Moment, Rival, Setting


def spread_of(found: Registration) -> FloatArray:
    """Return the standard deviation (n_nodes, 3) of each component of a registered body, mm.

    Of a trained model only the length of a node's error is known, which is shared out evenly among the axes.
    """
    if isinstance(found, ContactRegistration):
        return np.asarray(np.sqrt(np.einsum("nii->ni", found.node_covariance)))
    return np.repeat(found.std[:, None] / np.sqrt(3.0), 3, axis=1)


class _Registered(Rival):
    """A registration of each moment by itself.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    spread : bool
        Whether the spread of all nodes is computed, which the answer does not need and takes as long again or longer.
    settings : RegisterSettings, optional
        Of the registration.

    Raises
    ------
    ArgumentError
        If the setting lacks what the method needs, or an argument is of the wrong kind.
    """

    def __init__(self, setting: Setting, *, spread: bool = False, settings: RegisterSettings | None = None) -> None:
        super().__init__(setting)
        self._spread = flag("spread", spread)
        how = maybe("settings", settings, RegisterSettings) or RegisterSettings()
        self._registrar = Registrar(
            Body(setting.mesh, setting.material),
            setting.markers(np.full_like(setting.reference_mm, np.nan)),
            self._model,
            load=setting.load,
            seed=setting.seed,
            settings=replace(how, threads=setting.threads),
        )

    @property
    def _model(self) -> LatentModel | None:
        return None

    def register(self, measured_mm: Any, simulation_mm: Any = None) -> Estimate:
        """Return the registered body; see `Rival.register`. What is kept: ``trusted``, ``reasons``, ``seconds``."""
        return self.registered(self.moment(measured_mm, simulation_mm))

    def registered(self, moment: Moment, variants_mm: Any = None) -> Estimate:
        """Return the registered body of a checked moment, with variants of its simulation (n, n_nodes, 3) in mm."""
        given = moment.simulation_mm if variants_mm is None else SimulationVariants(variants_mm, moment.simulation_mm)
        found = self._registrar.register(moment.measured_mm, given)
        kept = {"trusted": found.trust.ok, "reasons": found.trust.reasons, "seconds": dict(found.seconds)}
        return Estimate(found.displacement, spread_of(found) if self._spread else None, kept)


class PhysicsPrior(_Registered):
    """``tissuereg.Registrar`` without a model: few unknown contacts beside the forces that hold the simulation.

    The answer is an equilibrium of the believed body. Without a simulation the load of the setting, if it has one, is
    believed, at each moment. See `Registrar.register`.
    """

    name: ClassVar[str] = "tissuereg, physics prior"


class Network(_Registered):
    """``tissuereg.Registrar`` with the model of the setting: the paper's method with an honest prior."""

    name: ClassVar[str] = "tissuereg, network"
    needs: ClassVar[frozenset[str]] = frozenset({"model"})

    @property
    def _model(self) -> LatentModel | None:
        return self.setting.model
