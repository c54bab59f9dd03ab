"""The main path: from a mesh and a few measured markers to the registered body with its uncertainty.

Without a trained model the load is unknown: the prior is a few contacts on the free surface, and the answer is an
equilibrium under the contacts that explain the markers (`tissuereg.registration.contacts.registration`). With a
model it is the
paper's Algorithm 1 (`tissuereg.registration.learned.registration`). Either is one registration of a `Registrar`.
"""

import os
from collections.abc import Callable, Mapping
from typing import Any

from tissuereg._base.arguments import called
from tissuereg._base.clock import Clock
from tissuereg.body.load import Load
from tissuereg.body.markers import Markers
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.body.surface import SurfacePoints
from tissuereg.errors import MarkerError, ModelError
from tissuereg.registration.inputs import RegisterSettings, as_markers, as_mesh
from tissuereg.registration.learned.model import LatentModel
from tissuereg.registration.registrar import Registrar
from tissuereg.registration.result import Registration

__all__ = ["RegisterSettings", "register"]


def register(
    mesh: Mesh | tuple[Any, Any, Any],
    markers: Markers | tuple[Any, Any] | None = None,
    *,
    surface: Any = None,
    surface_std: float = 0.1,
    model: "str | os.PathLike[str] | LatentModel | None" = None,
    simulation: Any = None,
    variants: Any = None,
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
    tell: Callable[[str, str], None] | None = None,
) -> Registration:
    """Register a deformed body to a few measured markers, to points of its surface, or to both.

    Without a trained model the load need not be known: the contacts on the free surface that explain the markers are
    estimated, the body is brought to equilibrium under them, and every point gets a posterior covariance over loads and
    errors of the model. The method is described in ``docs/registration.md`` in the repository.

    Parameters
    ----------
    mesh : Mesh or (nodes, tets, fixed_nodes)
        Undeformed body in mm; its node set ``fixed`` is held, its node set ``perhaps_fixed`` may or may not be. A mesh
        without either, or one whose sets are empty, is free: a rigid motion is then unknown as well.
    markers : Markers or (reference, measured), optional
        Reference and measured positions of the markers, mm; NaN = not seen, also in single components.
    surface : array_like of float, shape (n, 3), optional
        Unlabelled points on all or part of the deformed surface, mm. Only their distance from the surface along the
        normal is used; matches are made anew in every pass. More than 500 are thinned evenly.
    surface_std : float
        Standard deviation of such a point along the normal, mm. Some may belong to something else.
    model : path-like or LatentModel, optional
        Folder of a trained model for this mesh, or ``"phantom"`` for the one that is shipped. Without it the answer is
        an equilibrium under unknown contacts.
    simulation : array_like of float, shape (n_nodes, 3), optional
        Displacement of this moment by any simulator, mm. Without a model, the nodal forces that hold it in equilibrium
        are the believed load.
    variants : array_like of float, shape (n_variants, n_nodes, 3), optional
        With a model: this moment simulated with other values of what is uncertain, mm: moduli, supports, loads, poses
        of tools. Two dozen or more say how this body may differ from its simulation, where a model knows how bodies in
        general do. Registration starts from their mean; `simulation` is then what the answer is compared with.
    targets : mapping of str to array_like of float, shape (3,), optional
        Inner points of the undeformed body, mm.
    load : Load, optional
        The believed load; its direction, size and place stay uncertain.
    material : Material, optional
        The believed material. Without a load its stiffness affects the forces alone.
    element : {"auto", "tet4", "tet4-averaged", "tet10"}
        Elements of the package's own solves. ``"auto"`` without a model: averaged ones on coarse meshes and near
        incompressibility, where plain four-node tets are too stiff; otherwise ``"tet4"``.
    held : {"sure", "perhaps", "free"}
        Whether the node set ``fixed`` is surely held, may be held, or is free.
    held_nodes : array_like of int, optional
        Nodes that the load prescribes, if they differ from the set ``fixed``.
    frame : {"known", "drifts"}
        Whether the tracker stayed fixed relative to the body's supports, or may have drifted by a small rigid motion.
        The answer is in the tracker's frame at the measurement.
    stiffness : {"believed", "graded"}
        Whether the stiffness is distributed as in `material`, or its logarithm has in addition an unknown slope along
        each principal axis of the body, which is estimated from the markers.
    seed : int
        Seed of all random numbers: the same seed gives the same result at any thread count.
    threads : int
        Threads to use; 0 takes all cores.
    settings : RegisterSettings, optional
        Prior of contacts; ensemble size and steps with a model.
    polish : bool
        With a model: use its answer as the simulation of a registration by contacts, so that the body is in equilibrium
        and meets the markers.
    ensemble : int
        Without a model: the number of posterior loads to solve for the covariance of every node, instead of linear
        draws; for large motions, where the posterior is not Gaussian.
    progress : callable of (int, int), optional
        Called with passes finished and passes at most.
    tell : callable of (str, str), optional
        Called with a kind and words: ``"stage"`` with the name of each stage that begins, as in `Registration.seconds`,
        on large bodies also with how much of it is done. Without a model ``"size"`` with one line of size, time and
        memory as soon as the mesh is analysed, and ``"warning"`` where it takes longer than a minute.

    Returns
    -------
    Registration
        Displacement, spread, targets with regions, contacts, markers, trust, times.

    Raises
    ------
    MarkerError
        If no marker was seen, or one lies far from the body.
    SurfaceError
        If points of the surface are in other units or lie far from the body.
    ModelError
        If the model was trained for another mesh, or a file of it is corrupt, or points of a surface are given with it.
    ShapeError, SupportError
        If an array does not fit the mesh, or `held` or `frame` is none of these.
    ArgumentError
        If another argument has the wrong type or is out of its range; the message names it.
    LargeBodyError
        If the body would not fit into memory (``docs/large-bodies.md``); nothing has been factored then.
    MaterialError
        If `stiffness` is none of these, or graded together with a `simulation`.
    ConvergenceError, EnsembleError
        If no equilibrium is found, or too few ensemble members survive.

    Notes
    -----
    A result is returned even if it cannot be trusted: read ``result.trust`` and the targets' ``flag`` first.
    Cost without a model: two or three passes, each with one factorisation, one right-hand side per marker component and
    a few solves; about six passes with points of the surface. Everything that depends on the mesh alone is cached for
    the next call in the same process.

    Examples
    --------
    The shipped phantom, pressed by two pads that are unknown to `register`:

    >>> from tissuereg.phantom.event import LESION_MM, make_event
    >>> event = make_event(seed=0)
    >>> result = register(event.mesh, event.markers, targets={"lesion": LESION_MM})
    >>> result.trust.ok, result.target("lesion").flag
    (True, None)
    >>> error = result.target("lesion").mean - event.true_lesion
    >>> float(error @ error) < 1.0
    True
    >>> len(result.contacts)
    2
    """
    called("progress", progress)
    called("tell", tell)
    if markers is None and surface is None:
        message = "markers or points of the surface must be given; there are neither"
        raise MarkerError(message, where="markers")
    clock = Clock(tell)
    with clock.stage("total"):
        with clock.stage("attach"):
            if surface is not None and model is not None:
                message = "points of a surface are registered without a trained model; leave out `model` or `surface`"
                raise ModelError(message, where="surface")
            points = None if surface is None else SurfacePoints(surface, surface_std)
            body, measured = as_mesh(mesh), as_markers(markers)
            registrar = Registrar(
                body,
                measured,
                model,
                targets,
                load=load,
                material=material,
                element=element,
                held=held,
                held_nodes=held_nodes,
                frame=frame,
                stiffness=stiffness,
                seed=seed,
                threads=threads,
                settings=settings,
                polish=polish,
                ensemble=ensemble,
            )
        return registrar.moment(measured, simulation, points, clock, progress, None, variants)
