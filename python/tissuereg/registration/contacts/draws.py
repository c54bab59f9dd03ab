"""Displacement fields drawn from the posterior, each in equilibrium, and the uncertainty of whole fields."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.material import Material
from tissuereg.errors import ConvergenceError
from tissuereg.registration.contacts.fit import ContactFit
from tissuereg.registration.contacts.renewal import Renewal
from tissuereg.registration.contacts.spread import Spread
from tissuereg.registration.contacts.state import RigidMotion
from tissuereg.registration.contacts.tangent import Uncertain
from tissuereg.registration.deviations import Deviations


@dataclass(frozen=True, eq=False)
class Draws:
    """A function that draws displacement fields from the posterior, each in equilibrium under its drawn load.

    `fit`: the contacts that were found, with the posterior samples and the linearised equilibrium; `spread`:
    uncertainty of the fit, which draws the coefficients of the causes; `material`: material of the body; `seed`: seed
    of the random numbers; `threads`: threads to use, 0 takes all cores; `further`: uncertain parameters of the model
    beside the moduli, each with its standard deviation in the parameter's unit; `moments`: number of moments of
    measurement over which the samples were carried on, the last one included; `renewal`: the tangent that a later
    moment will use, or None.
    """

    fit: ContactFit
    spread: Spread
    material: Material
    seed: int
    threads: int
    further: Sequence[tuple[Uncertain, float]] = ()
    moments: int = 1
    renewal: Renewal | None = None

    def __call__(self, count: int) -> FloatArray:
        """Return `count` displacement fields (count, n_nodes, 3) from the posterior, in the tracker's frame, in mm.

        Raises `ConvergenceError` if a drawn load finds no equilibrium.
        """
        fit = self.fit
        coefficients, beside = self.drawn(count)
        simulator, mesh = fit.columns.body.simulator, fit.columns.body.mesh
        found = simulator.solve_many(
            [fit.columns.load(one) for one in coefficients],
            [self.material] * count,
            start=fit.state.displacement,
            springs=fit.columns.springs,
            threads=self.threads,
            tolerance=1e-6,
        )
        if found.failed:
            index, reason = found.failed[0]
            message = (
                f"every draw must find equilibrium; {len(found.failed)} of {count} do not, the first of them: {reason}"
            )
            raise ConvergenceError(message, where=f"draw {index}")
        frames = [self._frame(one) for one in coefficients]
        moved = mesh.nodes + found.displacement + beside
        return np.stack([frame.apply(places) for frame, places in zip(frames, moved, strict=True)]) - mesh.nodes

    def drawn(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Return `count` drawn coefficients of the causes, (count, n_columns), and what moves beside the equilibrium.

        The latter is a displacement in the body's frame, (count, n_nodes, 3), in mm.
        """
        rng = np.random.default_rng([self.seed, 8])
        coefficients = self.spread.coefficients(rng, count)
        parts = self.fit.columns.beside(coefficients, self.fit.tangent.by_stiffness)
        return coefficients, np.asarray(sum(parts.values(), self.spread.rest_draws(rng, count)))

    def _frame(self, coefficients: FloatArray) -> RigidMotion:
        columns = self.fit.columns
        first = self.fit.state.frame if columns.body.supports.moves else RigidMotion.still()
        return first.followed_by(columns.frame(coefficients), columns.rigid)


@dataclass(frozen=True, eq=False)
class DeviationsOfContacts:
    """A function without arguments that computes the uncertainty of the displacement of every node.

    `spread`: uncertainty of the fit; `seed`: seed of the registration's random numbers; `fields` (n_draws, n_nodes, 3)
    or None: posterior displacement fields in equilibrium, mm, if they have been solved; otherwise fields are drawn from
    the linear model.
    """

    spread: Spread
    seed: int
    fields: FloatArray | None = field(default=None, repr=False)

    def __call__(self) -> Deviations:
        """Return the uncertainty in the tracker's frame; the same at every call."""
        return self.spread.deviations(self.seed, self.fields)


__all__ = ["DeviationsOfContacts", "Draws"]
