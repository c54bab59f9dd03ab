"""The end of the registration of one moment of measurement, as the start of the next moment's."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts.columns import Columns
from tissuereg.registration.contacts.draws import Draws
from tissuereg.registration.contacts.fit import Samples
from tissuereg.registration.contacts.renewal import Renewal
from tissuereg.registration.contacts.settings import DISCRETISATION
from tissuereg.registration.contacts.state import BodyState
from tissuereg.registration.contacts.tangent import Tangent, Uncertain


@dataclass(frozen=True, eq=False)
class Carried:
    """The end of the registration of one moment of measurement, from which the registration of the next moment starts.

    `columns`: possible causes of motion, with the stiffness of doubtful supports that was found; `state`: the
    equilibrium under the posterior mean of the load; `samples`: samples of the posterior as three int64 arrays: patch
    and size of each contact, (n_samples, n_slots, 2), -1 for none; candidate size of each family of causes, (n_samples,
    n_families); whether each marker that is seen at the next moment is wrong, (n_samples, n_seen), 0 or 1; `tangent`:
    the linearised equilibrium near that state; `further`: further uncertain parameters of the model, each with its
    standard deviation in the parameter's unit; `residual`: root mean square residual that was left, in standard
    deviations; `moments`: number of moments through which the samples have been carried on; `renewal`: the tangent that
    a moment after the next one will use, or None.
    """

    columns: Columns
    state: BodyState
    samples: Samples
    tangent: Tangent
    further: list[tuple[Uncertain, float]]
    residual: float
    moments: int
    renewal: Renewal | None

    @classmethod
    def of(cls, draw: Draws, before: BoolArray, now: BoolArray) -> "Carried":
        """Return the end of a registration, made ready for the next moment of measurement.

        `draw`: holds the fit of the registration; `before`, `now` bool (n_markers,): markers that were seen at its
        moment, and those that are seen at the next one. In all samples a marker that was not seen before is taken as
        right.
        """
        fit = draw.fit
        slots, levels, wrong = fit.samples
        every = np.zeros((len(wrong), len(before)), wrong.dtype)
        every[:, before] = wrong
        samples = (slots, levels, np.ascontiguousarray(every[:, now]))
        left = min(fit.residual_rms)
        tangent, renewal = fit.tangent, draw.renewal
        if renewal is not None and draw.moments + 1 >= renewal.moment:
            tangent, renewal = renewal.tangent() or tangent, None
        further = list(draw.further)
        return cls(fit.columns, fit.state, samples, tangent.onwards(), further, left, draw.moments, renewal)

    def columns_for(self, columns: Columns) -> Columns | None:
        """Return the next moment's causes with the spring stiffness that was found here.

        `columns`: possible causes of motion at the next moment. Result: None if their body or their number is another
        one.
        """
        if columns.body is not self.columns.body or columns.n_columns != self.columns.n_columns:
            return None
        return columns.on(self.columns.springs)

    def begin(self, columns: Columns, solve: Callable[[FloatArray], FloatArray]) -> BodyState | None:
        """Return the equilibrium under the contacts found here and the next moment's believed load.

        `columns`: causes of the next moment; `solve`: takes coefficients of the causes (n_columns,) and returns the
        displacement (n_element_nodes, 3) in equilibrium, mm; it is not called if the load is the same as here. Result:
        None if the load has no equilibrium near the one found here.
        """
        coefficients = self.state.coefficients
        if _differ(columns, self.columns, coefficients) <= DISCRETISATION.same_load:
            return self.state
        try:
            return BodyState(coefficients, solve(coefficients), self.state.frame, self.state.beside)
        except ConvergenceError:
            return None


def _differ(here: Columns, there: Columns, coefficients: FloatArray) -> float:
    """Return the largest difference of the loads that two sets of causes make of equal coefficients (n_columns,).

    It is the largest absolute difference of any component, over the largest component of `there`'s load.
    """
    if all(part is None for columns in (here, there) for part in columns.believed.values()):
        return 0.0
    loads = [columns.load(coefficients) for columns in (here, there)]
    parts = [
        np.concatenate([np.ravel(load.forces), np.ravel(load.body_force), np.ravel(load.prescribed)]) for load in loads
    ]
    return float(np.abs(parts[0] - parts[1]).max() / max(float(np.abs(parts[1]).max()), 1e-300))
