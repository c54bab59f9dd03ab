"""The main function `register`: from a mesh and a few measured markers to the deformed body with its uncertainty.

Without a trained model the load is unknown: the prior is a few contacts on the free surface, and the result is an
equilibrium under the contacts that explain the markers (`tissuereg.registration.contacts.registration`). With a model
it is the posterior ensemble of ES-MDA in the model's latents (`tissuereg.registration.learned.registration`). Either is
one registration of a `Registrar`.
"""

import os
from collections.abc import Mapping
from typing import Any

from tissuereg._base.arguments import called
from tissuereg._base.clock import Clock, Listener
from tissuereg.body.load import Load
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.body.surface import SurfacePoints
from tissuereg.errors import MarkerError, ModelError
from tissuereg.registration.body import Body
from tissuereg.registration.inputs import MomentInput, as_markers
from tissuereg.registration.learned.model import LatentModel
from tissuereg.registration.registrar import Registrar
from tissuereg.registration.result import Registration
from tissuereg.registration.settings import RegisterSettings

__all__ = ["register"]


def register(
    mesh: Mesh | Body | tuple[Any, Any, Any],
    markers: Markers | tuple[Any, Any] | None = None,
    *,
    surface: Any = None,
    targets: Mapping[str, Any] | None = None,
    load: Load | None = None,
    simulation: Any = None,
    model: "str | os.PathLike[str] | LatentModel | None" = None,
    seed: int = 0,
    settings: RegisterSettings | None = None,
    progress: Listener | None = None,
) -> Registration:
    """Register a deformed body to a few measured markers, to points of its surface, or to both.

    Without a trained model the load need not be known: the contacts on the free surface that explain the markers are
    estimated, the body is brought to equilibrium under them, and every point gets a posterior covariance over loads and
    errors of the model. The method is described in ``docs/registration.md`` in the repository.

    Parameters
    ----------
    mesh : Mesh, Body or (nodes, tets, fixed_nodes)
        Undeformed body in mm. The nodes of its set ``fixed`` are held in place; those of its set ``perhaps_fixed`` may
        or may not be held. A mesh without either set, or with empty ones, can move freely: a rigid motion is then
        unknown as well. A `Body` is a mesh with all further assumptions about it: material, elements, how surely it is
        held.
    markers : Markers or (reference, measured), optional
        Reference and measured places of the markers, mm. NaN = not seen, also in single components.
    surface : SurfacePoints or array_like of float, shape (n, 3), optional
        Unlabelled points on all or part of the deformed surface, mm; without a model only. Only their distance from the
        surface along the normal is used; each is matched to the surface anew in every iteration. More than 500 points
        are thinned evenly.
    targets : mapping of str to array_like of float, shape (3,), optional
        Inner points of the undeformed body by name, mm, whose deformed places are wanted.
    load : Load, optional
        The assumed load; its direction, size and place stay uncertain. With a model the body is simulated under it.
    simulation : array_like of float, shape (n_nodes, 3), or SimulationVariants, optional
        Displacement of each node at this moment by any simulator, mm. It includes the effect of the loads, so that
        `load` is not used. Without a model, the nodal forces that hold it in equilibrium are the assumed load. With
        one, it may also be variants: simulations of the moment with other values of uncertain parameters.
    model : path-like or LatentModel, optional
        Folder of a trained model for this mesh, or ``"phantom"`` or ``"phantom-graph"``: shipped ones. Without it the
        answer is an equilibrium under unknown contacts.
    seed : int
        Seed of all random numbers: the same seed gives the same result at any thread count.
    settings : RegisterSettings, optional
        All other settings: threads, whether the tracker drifts, the prior of contacts; ensemble size and steps with a
        model.
    progress : callable of Progress, optional
        Called when a stage begins, with its name in `Registration.seconds`, and when an iteration (a pass) is finished;
        on large bodies also with the part of a stage that is done. Without a model also with lines of size, time,
        memory and work as soon as the mesh is analysed, and with a warning where it takes longer than a minute.

    Returns
    -------
    Registration
        Displacement and standard deviation of each node in mm, targets with confidence regions, fit of the markers,
        trust, times. Without a model it is a `ContactRegistration`, which has contacts, forces and posterior draws as
        well; otherwise it is a `LearnedRegistration`.

    Raises
    ------
    MarkerError
        If no marker was seen, or one lies far from the body.
    SurfaceError
        If points of the surface are in other units or lie far from the body.
    ModelError
        If the model was trained for another mesh, or a file of it is corrupt, or something is given that has no meaning
        with a model: points of a surface, assumptions about the body, or settings for contacts alone.
    ShapeError
        If an array does not fit the mesh.
    ArgumentError
        If something is given that has no meaning without a model, or another argument has the wrong type or is out of
        its range; the message names it.
    LargeBodyError
        If the body would not fit into memory (``docs/large-bodies.md``); nothing has been factored then.
    MaterialError
        If the stiffness is graded and there is a `simulation`.
    ConvergenceError, EnsembleError
        If no equilibrium is found, or too few ensemble members survive.

    Notes
    -----
    A result is returned even if it cannot be trusted: read ``result.trust`` and the targets' ``flag`` first. Cost
    without a model: two or three iterations (passes), each with one factorisation, one right-hand side per marker
    component and a few solves; about six iterations with points of the surface. Regions cost three right-hand sides a
    target; those of more than 400 come from draws, which costs no more and leaves some per cent of error. Everything
    that depends on the mesh alone is cached for the next call in the same process.

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
    if markers is None and surface is None:
        message = "markers or points of the surface must be given; there are neither"
        raise MarkerError(message, where="markers")
    clock = Clock(progress)
    with clock.stage("total"):
        with clock.stage("attach"):
            if surface is not None and model is not None:
                message = "points of a surface are registered without a trained model; leave out `model` or `surface`"
                raise ModelError(message, where="surface")
            points = surface if surface is None or isinstance(surface, SurfacePoints) else SurfacePoints(surface)
            body, measured = Body.of(mesh), as_markers(markers)
            registrar = Registrar(body, measured, model, targets, load=load, seed=seed, settings=settings)
        return registrar.registered(MomentInput(measured, points, simulation), clock)
