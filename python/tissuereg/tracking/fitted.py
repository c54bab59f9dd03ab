"""A prior of displacement fields that is fitted to a body on the spot: principal components of random deformations.

Without a trained network, the changes that a body may undergo beside what is simulated are drawn here: pushes and pulls
at random places of its surface, with random body forces. The coefficients of their principal components are the
latents. They are changes from a simulation, whichever it is, so that they need not be found again when markers or
actuators move.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tissuereg._base.arguments import check_running, of_kind, real, whole
from tissuereg._base.arrays import FloatArray, IntArray
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.registration.learned.model import Gaussian
from tissuereg.registration.learned.pca import PcaModel
from tissuereg.simulation.sampling import random_changes


@dataclass(frozen=True)
class FittingRules:
    """Settings of the fit of a prior; `held_out`: share of the random deformations that measures its error."""

    held_out: float = 0.2  # share of the events that measures the reconstruction error


FITTING = FittingRules()


@dataclass(frozen=True, eq=False)
class _Changes:
    """The part of a latent model of displacement fields that does not depend on the simulation.

    `changes`: principal components of the changes of displacement from any simulation.
    """

    changes: PcaModel

    @property
    def n_latent(self) -> int:
        """Number of latents."""
        return self.changes.n_latent

    @property
    def n_nodes(self) -> int:
        """Number of mesh nodes."""
        return self.changes.n_nodes

    @property
    def card(self) -> dict[str, Any]:
        """Description of the model for the entry ``model`` of a result: its kind, source and number of fields."""
        return self.changes.card

    def errors(self) -> FloatArray:
        """Return the expected reconstruction errors (n_fields, n_nodes, 3), mm, of changes."""
        return self.changes.errors()

    def prior(self) -> Gaussian:
        """Return the prior of the latents, the unit Gaussian."""
        return self.changes.prior()


@dataclass(frozen=True, eq=False)
class FittedPrior(_Changes):
    """Latent model of changes of displacement from a simulation, whichever it is; `fitted_prior` makes it.

    Attributes
    ----------
    changes : PcaModel
        Principal components of the changes; their coefficients are the latents.
    """

    def around(self, simulation: FloatArray) -> "ChangedSimulation":
        """Return the latent model of displacement fields about a simulated displacement (n_nodes, 3), mm."""
        return ChangedSimulation(self.changes, simulation)

    def decode(self, latents: FloatArray, nodes: IntArray | None = None) -> FloatArray:
        """Return displacement changes (n_members, k, 3), mm, of latents (n_latent, n_members), at nodes (k,) or all."""
        return self.changes.decode(latents, nodes)


@dataclass(frozen=True, eq=False)
class ChangedSimulation(_Changes):
    """Latent model of displacement fields, ``field = simulation + change(z)`` with latents z.

    `changes`: principal components of the changes; `simulation` (n_nodes, 3): simulated displacement, mm.
    """

    simulation: FloatArray

    @property
    def code(self) -> FloatArray:
        """Latents (n_latent,) of no change: zero."""
        return np.zeros(self.n_latent)

    def decode(self, latents: FloatArray, nodes: IntArray | None = None) -> FloatArray:
        """Return displacement fields (n_members, k, 3), mm, of latents (n_latent, n_members), at nodes (k,) or all."""
        simulation = self.simulation if nodes is None else self.simulation[nodes]
        return np.asarray(simulation + self.changes.decode(latents, nodes))


def fitted_prior(
    mesh: Mesh,
    material: Material | None = None,
    *,
    largest_mm: float,
    n_events: int = 200,
    n_latent: int = 26,
    held_nodes: Any = None,
    seed: int = 0,
    threads: int = 0,
) -> FittedPrior:
    """Fit a prior of changes from a simulation to a body, for `Registrar` and `Tracker` in place of a trained model.

    Parameters
    ----------
    mesh : Mesh
        Undeformed body.
    material : Material, optional
        Assumed material, by default ``Material()``.
    largest_mm : float
        Largest node displacement of a usual change, mm: how far a simulation may be off.
    n_events : int
        Number of random deformations that are drawn; a fifth of them measures the reconstruction error.
    n_latent : int
        Number of latents, the coefficients of principal components.
    held_nodes : array_like of int, optional
        Numbers of the nodes that are held; by default the node set ``fixed``.
    seed : int
        Seed of the random deformations.
    threads : int
        Threads to use; 0 takes all cores.

    Returns
    -------
    FittedPrior
        The prior. Cost: one nearly linear solve for each random deformation, a few back-substitutions each.

    Raises
    ------
    ArgumentError, MeshError, SupportError
        If an argument is out of its range, nothing of the surface is free, or the body can move freely.
    EnsembleError
        If too few random loads find an equilibrium.

    Notes
    -----
    Random deformations are linear about the undeformed body; their size is log-normal about `largest_mm`.

    Examples
    --------
    >>> import tissuereg as tr
    >>> prior = tr.tracking.fitted_prior(tr.phantom.phantom_mesh("small"), largest_mm=3.0, n_events=40, n_latent=8)
    >>> prior.n_latent
    8
    """
    of_kind("mesh", mesh, Mesh)
    believed = Material() if material is None else of_kind("material", material, Material)
    real("largest_mm", largest_mm, above=0.0, below=1e6, unit="mm")
    whole("n_events", n_events, least=4)
    whole("n_latent", n_latent, least=1)
    check_running(seed=seed, threads=threads)
    fields = random_changes(
        mesh,
        believed,
        largest_mm=largest_mm,
        n_events=n_events,
        rng=np.random.default_rng([seed, 15]),
        held_nodes=held_nodes,
        threads=threads,
    )
    n_held_out = max(1, int(FITTING.held_out * len(fields)))
    card = {"kind": "pca", "source": "fitted here", "members": len(fields) - n_held_out}
    none = np.zeros((mesh.n_nodes, 3))
    return FittedPrior(
        PcaModel.fit(fields[n_held_out:], fields[:n_held_out], centre=none, n_latent=n_latent, card=card)
    )
