"""Methods that are given variants of the simulation: each moment simulated with other values of what is uncertain."""

from abc import abstractmethod
from typing import Any, ClassVar

import numpy as np

from tissuereg._base.arguments import real
from tissuereg._base.arrays import FloatArray
from tissuereg.body.observe import MarkerObservation
from tissuereg.errors import ArgumentError
from tissuereg.registration.learned.variants import Variants
from tissuereg_paper.rivals.ours import Network
from tissuereg_paper.rivals.rival import Estimate, Rival, Setting


class Varied(Rival):
    """A method whose moments come with variants of the simulation."""

    needs: ClassVar[frozenset[str]] = frozenset({"variants"})

    @abstractmethod
    def register(self, measured_mm: Any, simulation_mm: Any = None, variants_mm: Any = None) -> Estimate:
        """Return what the method says of one moment; see `Rival.register`.

        Parameters
        ----------
        measured_mm, simulation_mm
            As there.
        variants_mm : array_like of float, shape (n_variants, n_nodes, 3)
            The moment simulated with other values of what is uncertain, mm.

        Raises
        ------
        ArgumentError
            If there are no variants.
        ShapeError
            If there are too few, or they have another shape or are not finite.
        """

    def given(self, variants_mm: Any) -> Any:
        """Return variants, if there are some."""
        if variants_mm is None:
            message = f"`variants_mm` must be given for the method '{self.name}', got None"
            raise ArgumentError(message, where="variants_mm")
        return variants_mm


class VariedNetwork(Network, Varied):
    """``tissuereg.Registrar`` with the model of the setting and variants of each moment's simulation."""

    name: ClassVar[str] = "tissuereg, network with variants"
    needs: ClassVar[frozenset[str]] = frozenset({"model", "variants"})

    def register(self, measured_mm: Any, simulation_mm: Any = None, variants_mm: Any = None) -> Estimate:
        """Return the registered body; see `Varied.register`. What is kept: as for `Network`."""
        return self.registered(self.moment(measured_mm, simulation_mm), self.given(variants_mm))


class EnsembleOfSimulations(Varied):
    r"""The variants as an ensemble that one Kalman update draws to the markers, without a network.

    With the mean ``m`` of the variants, their anomalies ``A`` over the root of one less than their number, and H what
    the markers see, ``x = m + A (H A)' (H A (H A)' + R)^-1 (d - H m)``: the ensemble smoother (G. Evensen and P. J. van
    Leeuwen, Monthly Weather Review 128, 1852-1867, 2000) on displacements, by its moments.

    Parameters
    ----------
    setting : Setting
        Body, markers, beliefs.
    error_mm : float
        Standard deviation of a marker's component by what no combination of variants moves; R is its square and that of
        the tracker.
    """

    name: ClassVar[str] = "ensemble of simulations"

    def __init__(self, setting: Setting, *, error_mm: float = 0.1) -> None:
        super().__init__(setting)
        self._error = real("error_mm", error_mm, least=0.0, unit="mm")
        names = tuple(str(k) for k in range(setting.n_markers))
        self._observation = MarkerObservation(setting.mesh, setting.reference_mm, names)

    def register(self, measured_mm: Any, simulation_mm: Any = None, variants_mm: Any = None) -> Estimate:
        """Return the updated mean and the spread of the updated ensemble; see `Varied.register`."""
        moment = self.moment(measured_mm, simulation_mm)
        given = Variants.of(self.given(variants_mm), self.setting.mesh.n_nodes)
        patterns, mean = given.spread.basis, given.mean
        seen = np.array([self._at_markers(one)[moment.seen].ravel() for one in patterns])
        weights = 1.0 / (np.repeat(self.setting.std_mm[moment.seen], 3) ** 2 + self._error**2)
        innovation = moment.displacement_mm - self._at_markers(mean)[moment.seen]
        # In the coefficients of the patterns, which are independent and of unit variance.
        precision = np.eye(len(seen)) + (seen * weights) @ seen.T
        root = np.linalg.cholesky(precision)
        coefficients = np.linalg.solve(precision, seen @ (weights * innovation.ravel()))
        flat = patterns.reshape(len(patterns), -1)
        spread = np.linalg.norm(np.linalg.solve(root, flat), axis=0)
        return Estimate(mean + (coefficients @ flat).reshape(mean.shape), spread.reshape(mean.shape))

    def _at_markers(self, field: FloatArray) -> FloatArray:
        return self._observation.predict(field[self._observation.nodes])
