"""Where the passes of one moment ended, as the start of the next moment's."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.body.material import Material
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.draws import Draws
from tissuereg.registration.contacts.fit import Samples
from tissuereg.registration.contacts.settings import DISCRETISATION
from tissuereg.registration.contacts.state import BodyState
from tissuereg.registration.contacts.tangent import Tangent
from tissuereg.simulation.sensitivity import Cause


@dataclass(frozen=True, eq=False)
class Carried:
    """The state in which the registration of one frame ended, from which the registration of the next frame starts.

    Attributes
    ----------
    columns : Columns
        Possible causes of motion, with the stiffness of doubtful supports that was found.
    state : BodyState
        The equilibrium under the mean load.
    samples : tuple of ndarray
        Of every sample of the posterior: the contacts, the sizes of the families of causes, and the markers that are
        wrong; the last has a column for each marker of the next frame.
    tangent : Tangent
        The linearised equilibrium near that state.
    material : Material
        Material, with the graded stiffness that was found.
    further : list of (Cause, float)
        Other uncertain parameters, each with its standard deviation.
    residual : float
        Root mean square residual that was left, in standard deviations.
    moments : int
        Number of frames through which the samples have been carried on.
    """

    columns: Columns
    state: BodyState
    samples: Samples
    tangent: Tangent
    material: Material
    further: list[tuple[Cause, float]]
    residual: float
    moments: int

    @classmethod
    def of(cls, draw: Draws, before: BoolArray, now: BoolArray) -> "Carried":
        """Return the end of a registration, made ready for the next frame.

        `draw`: holds the fit of the registration; `before`, `now` bool (n_markers,): markers that were seen in that
        frame, and those that are seen in the next one. Markers that were not seen before are taken for right.
        """
        fit = draw.fit
        slots, levels, wrong = fit.samples
        every = np.zeros((len(wrong), len(before)), wrong.dtype)
        every[:, before] = wrong
        samples = (slots, levels, np.ascontiguousarray(every[:, now]))
        left = min(fit.residual_rms)
        return cls(fit.columns, fit.state, samples, fit.tangent, draw.material, list(draw.further), left, draw.moments)

    def columns_for(self, columns: Columns) -> Columns | None:
        """Return the causes of the next frame on supports of the stiffness found; None if body or causes differ."""
        if columns.body is not self.columns.body or columns.n_columns != self.columns.n_columns:
            return None
        return columns.made_of(self.material).on(self.columns.springs)

    def begin(self, columns: Columns, solve: Callable[[FloatArray], FloatArray]) -> BodyState | None:
        """Return the body under the contacts found in the frame before and the next frame's believed load.

        `columns`: causes of the next frame; `solve`: takes the displacement (n_element_nodes, 3) to start from, mm, and
        returns the equilibrium. Result: None if the load has no equilibrium near that state.
        """
        coefficients = self.state.coefficients
        if _differ(columns, self.columns, coefficients) <= DISCRETISATION.same_load:
            return self.state
        try:
            return BodyState(coefficients, solve(coefficients), self.state.frame)
        except ConvergenceError:
            return None


def _differ(here: Columns, there: Columns, coefficients: FloatArray) -> float:
    """Return the relative difference of the loads that two sets of causes make of coefficients (n_columns,)."""
    loads = [columns.load(coefficients) for columns in (here, there)]
    parts = [
        np.concatenate([np.ravel(load.forces), np.ravel(load.body_force), np.ravel(load.prescribed)]) for load in loads
    ]
    return float(np.abs(parts[0] - parts[1]).max() / max(float(np.abs(parts[1]).max()), 1e-300))
