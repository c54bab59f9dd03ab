"""The main path: a mesh and a few measured markers in, the registered body with its spread out.

Without a trained model the load is unknown: sparse contacts on the free surface are the prior, and the answer is an
equilibrium under those that the markers suggest (`tissuereg.contact_registration`). With one it is the paper's
Algorithm 1 (`tissuereg.latent_registration`).
"""

import os
from collections.abc import Callable, Mapping
from typing import Any

from threadpoolctl import threadpool_limits

from tissuereg._clock import Clock
from tissuereg.contact_registration import ContactInput, register_by_contacts
from tissuereg.inputs import RegisterInput, RegisterSettings, finite_field
from tissuereg.latent.model import LatentModel
from tissuereg.latent_registration import register_by_model
from tissuereg.load import Load
from tissuereg.markers import Markers
from tissuereg.material import Material
from tissuereg.mesh import Mesh
from tissuereg.result import Registration
from tissuereg.simulate.solve import Simulator

__all__ = ["RegisterSettings", "register"]


def register(
    mesh: Mesh | tuple[Any, Any, Any],
    markers: Markers | tuple[Any, Any],
    *,
    model: "str | os.PathLike[str] | LatentModel | None" = None,
    simulation: Any = None,
    targets: Mapping[str, Any] | None = None,
    load: Load | None = None,
    material: Material | None = None,
    element: str = "tet4",
    held: str = "sure",
    held_nodes: Any = None,
    frame: str = "known",
    stiffness: str = "believed",
    seed: int = 0,
    threads: int = 0,
    settings: RegisterSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Registration:
    """Register a deformed body to a few measured markers.

    Parameters
    ----------
    mesh : Mesh or (nodes, tets, fixed_nodes)
        Undeformed body in mm; its node set ``fixed`` is held, its node set ``perhaps_fixed`` perhaps. A mesh without
        either, or one whose sets are empty, is free: a rigid motion is then unknown as well.
    markers : Markers or (reference, measured)
        Where markers sit and where they were seen, mm; NaN = not seen, also in single components.
    model : path-like or LatentModel, optional
        Folder of a trained model for this mesh, or ``"phantom"`` for the one that is shipped. Without it the answer is
        an equilibrium under unknown contacts.
    simulation : array_like of float, shape (n_nodes, 3), optional
        What a simulation says of this moment, from any simulator, mm. Without a model the nodal forces that hold it are
        the believed load.
    targets : mapping of str to array_like of float, shape (3,), optional
        Inner points of the undeformed body, mm.
    load : Load, optional
        What is believed to act; direction, size and place stay uncertain.
    material : Material, optional
        What is believed of the material. Without a load its stiffness scales forces alone.
    element : {"tet4", "tet4-averaged", "tet10"}
        Elements of our own simulations.
    held : {"sure", "perhaps", "free"}
        How the node set ``fixed`` is taken.
    held_nodes : array_like of int, optional
        Nodes that the load prescribes, where they differ from the set ``fixed``.
    frame : {"known", "drifts"}
        Whether the tracker kept its place beside the body's supports, or may have moved rigidly a little in between.
        The answer is in the tracker's frame at the measurement.
    stiffness : {"believed", "graded"}
        Whether the stiffness is distributed as `material` says, or softer towards one side by an unknown amount, which
        the markers tell: its logarithm then has an unknown slope along each principal axis of the body.
    seed : int
        Of all chance: the same seed gives the same result at any thread count.
    threads : int
        Threads to use; 0 takes all cores.
    settings : RegisterSettings, optional
        Prior of contacts; ensemble size and steps with a model.
    progress : callable of (int, int), optional
        Called with passes finished and passes at most.

    Returns
    -------
    Registration
        Displacement, spread, targets with regions, contacts, markers, trust, times.

    Raises
    ------
    MarkerError
        If no marker was seen, or one lies far off the body.
    ModelError
        If the model was trained for another mesh, or a file of it is spoilt.
    ShapeError, SupportError
        If an array does not fit the mesh, or `held` or `frame` is none of these.
    MaterialError
        If `stiffness` is none of these, or graded beside a `simulation`.
    ConvergenceError, EnsembleError
        If no equilibrium is found, or too few ensemble members survive.

    Notes
    -----
    Cost without a model: two or three passes, each with one factorisation, one right-hand side a marker component and a
    few solves. What depends on the mesh alone is kept for the next call in the same process.
    """
    clock = Clock()
    with threadpool_limits(limits=1, user_api="blas"), clock.stage("total"):
        with clock.stage("attach"):
            given = RegisterInput.of(mesh, markers, targets, settings, seed, threads, held)
        said = None if simulation is None else finite_field(simulation, given.mesh)
        if model is None:
            believed = ContactInput(
                load, said, material or Material(), element, held, held_nodes, frame, stiffness, progress
            )
            return register_by_contacts(given, believed, clock)
        if said is None and load is not None:
            with clock.stage("simulate"):
                simulator = Simulator(given.mesh, element=element, held_nodes=held_nodes)
                said = simulator.solve(load, material or Material(), threads=threads).displacement
        return register_by_model(given, model, said, clock)
