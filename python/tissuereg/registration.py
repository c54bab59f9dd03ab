"""The main path: a mesh and a few measured markers in, the registered body with its spread out.

Without a trained model the load is unknown: sparse contacts on the free surface are the prior, and the answer is an
equilibrium under those that the markers suggest (`tissuereg.contact_registration`). With one it is the paper's
Algorithm 1 (`tissuereg.latent_registration`).
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from threadpoolctl import threadpool_limits

from tissuereg._arguments import MOST_COUNTED, called, check_running, flag, maybe, whole
from tissuereg._choice import check_choice
from tissuereg._clock import Clock
from tissuereg.contact_registration import ContactInput, fitting_element, register_by_contacts
from tissuereg.errors import ArgumentError, ModelError
from tissuereg.inputs import RegisterInput, RegisterSettings, finite_field
from tissuereg.latent.model import LatentModel
from tissuereg.latent_registration import register_by_model
from tissuereg.load import Load
from tissuereg.markers import Markers
from tissuereg.material import Material
from tissuereg.mesh import Mesh
from tissuereg.result import Registration
from tissuereg.simulate.solve import ELEMENTS, Simulator
from tissuereg.surface import SurfacePoints

__all__ = ["RegisterSettings", "register"]


def register(
    mesh: Mesh | tuple[Any, Any, Any],
    markers: Markers | tuple[Any, Any] | None = None,
    *,
    surface: Any = None,
    surface_std: float = 0.1,
    model: "str | os.PathLike[str] | LatentModel | None" = None,
    simulation: Any = None,
    targets: Mapping[str, Any] | None = None,
    load: Load | None = None,
    material: Material | None = None,
    element: str = "auto",
    held: str = "sure",
    held_nodes: Any = None,
    frame: str = "known",
    stiffness: str = "believed",
    seed: int = 0,
    threads: int = 0,
    settings: RegisterSettings | None = None,
    polish: bool = False,
    ensemble: int = 0,
    progress: Callable[[int, int], None] | None = None,
) -> Registration:
    """Register a deformed body to a few measured markers, to points of its surface, or to both.

    Where is every point of the body now? Without a trained model nothing need be known of what pushed or pulled: the
    contacts on the free surface that explain the markers are found, the body is brought to equilibrium under them,
    and every point gets the covariance that is left over loads and errors of the model. ``docs/registration.md`` in the
    repository tells how.

    Parameters
    ----------
    mesh : Mesh or (nodes, tets, fixed_nodes)
        Undeformed body in mm; its node set ``fixed`` is held, its node set ``perhaps_fixed`` perhaps. A mesh without
        either, or one whose sets are empty, is free: a rigid motion is then unknown as well.
    markers : Markers or (reference, measured), optional
        Where markers sit and where they were seen, mm; NaN = not seen, also in single components.
    surface : array_like of float, shape (n, 3), optional
        Points on the deformed surface, or on a part of it, without labels, mm: each counts by its distance from the
        surface along the normal, and is matched anew in every pass. More than 500 are thinned evenly.
    surface_std : float
        Standard deviation of such a point along the normal, mm. Some may belong to something else.
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
    element : {"auto", "tet4", "tet4-averaged", "tet10"}
        Elements of our own simulations. ``"auto"`` without a model: averaged ones on coarse meshes and near
        incompressibility, where plain four-node tets are too stiff; ``"tet4"`` else.
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
    polish : bool
        With a model: take its answer for the simulation of a registration by contacts, so that the body becomes an
        equilibrium and meets the markers.
    ensemble : int
        Without a model: that many posterior loads are solved, and the covariance of every node comes from them in place
        of draws to first order; for motions so large that regions bend.
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
    SurfaceError
        If points of the surface are in other units or lie far off the body.
    ModelError
        If the model was trained for another mesh, or a file of it is spoilt, or points of a surface are given with it.
    ShapeError, SupportError
        If an array does not fit the mesh, or `held` or `frame` is none of these.
    ArgumentError
        If another argument is of another kind than said, or out of its range; the message names it.
    MaterialError
        If `stiffness` is none of these, or graded beside a `simulation`.
    ConvergenceError, EnsembleError
        If no equilibrium is found, or too few ensemble members survive.

    Notes
    -----
    A result is always returned, also where it cannot be trusted: read ``result.trust`` and the targets' ``flag`` first.
    Cost without a model: two or three passes, each with one factorisation, one right-hand side a marker component and a
    few solves; with points of the surface six passes or so. What depends on the mesh alone is kept for the next call in
    the same process.

    Examples
    --------
    The shipped phantom, pressed by two pads of which nothing is told:

    >>> from tissuereg.phantom.event import LESION_MM, make_event
    >>> event = make_event(seed=0)
    >>> result = register(event.mesh, event.markers, targets={"lesion": LESION_MM})
    >>> result.trust.ok, result.target("lesion").flag
    (True, None)
    >>> off = result.target("lesion").mean - event.true_lesion
    >>> float(off @ off) < 1.0
    True
    >>> len(result.contacts)
    2
    """
    check_running(seed=seed, threads=threads)
    maybe("load", load, Load)
    maybe("material", material, Material)
    check_choice("element", element, ("auto", *ELEMENTS), ArgumentError)
    flag("polish", polish)
    whole("ensemble", ensemble, most=MOST_COUNTED)
    called("progress", progress)
    clock = Clock()
    with threadpool_limits(limits=1, user_api="blas"), clock.stage("total"):
        with clock.stage("attach"):
            if surface is not None and model is not None:
                message = "points of a surface are registered without a trained model; leave out `model` or `surface`"
                raise ModelError(message, where="surface")
            points = None if surface is None else SurfacePoints(surface, surface_std)
            given = RegisterInput.of(mesh, markers, targets, settings, seed, threads, held, points)
        said = None if simulation is None else finite_field(simulation, given.mesh)
        stuff = Material() if material is None else material
        own = fitting_element(given.mesh, stuff) if element == "auto" else element
        if model is None:
            believed = ContactInput(load, said, stuff, own, held, held_nodes, frame, stiffness, progress, ensemble)
            return register_by_contacts(given, believed, clock)
        if said is None and load is not None:
            with clock.stage("simulate"):
                plain = "tet4" if element == "auto" else element
                simulator = Simulator(given.mesh, element=plain, held_nodes=held_nodes)
                said = simulator.solve(load, stuff, threads=threads).displacement
        result = register_by_model(given, model, said, clock)
        if not polish:
            return result
        believed = ContactInput(
            None, result.displacement, stuff, own, held, held_nodes, frame, stiffness, progress, ensemble
        )
        polished = register_by_contacts(given, believed, clock)
        return replace(polished, model={**result.model, "polished": True})
