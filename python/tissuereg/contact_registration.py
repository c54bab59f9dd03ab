"""Registration without a known load: contacts found by their traces at the markers."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tissuereg._arrays import FloatArray
from tissuereg._clock import Clock
from tissuereg.contacts.body import ContactBody
from tissuereg.contacts.columns import Columns, spring_stiffness
from tissuereg.contacts.evidence import support_stiffness
from tissuereg.contacts.fit import ContactFit, Passes, start_of
from tissuereg.contacts.found import FoundContact, find_contacts
from tissuereg.contacts.frame import Frame, drifts
from tissuereg.contacts.graded import grade, is_graded
from tissuereg.contacts.icp import closest_frame
from tissuereg.contacts.moment import Moment
from tissuereg.contacts.seen import Seen, SeenMarkers
from tissuereg.contacts.settings import ContactSettings
from tissuereg.contacts.spread import Points, Spread
from tissuereg.contacts.supports import Supports
from tissuereg.contacts.surface_fit import SurfaceFit
from tissuereg.contacts.surface_points import SeenPoints
from tissuereg.errors import ConvergenceError, MaterialError
from tissuereg.inputs import RegisterInput, rms_length
from tissuereg.load import Load
from tissuereg.material import Material
from tissuereg.mesh import Mesh, det_f
from tissuereg.result import MarkerFit, Registration, Target
from tissuereg.simulate.sensitivity import Cause, Field, Parameter
from tissuereg.simulate.solve import LoadParts
from tissuereg.trust import Trust, judge

#: A target is flagged where the markers take away less than this share of its variance under unseen contacts.
LEAST_CONSTRAINED = 0.5

#: Meshes of at most so many nodes get averaged elements, and so do Poisson's ratios above this.
COARSE_NODES, STIFF_POISSON = 3000, 0.475

#: What a flagged target is told.
NO_MARKER = "no marker tells"

#: A marker that is wrong with at least this probability is named and does not count.
_WRONG = 0.5


@dataclass(frozen=True, eq=False)
class ContactInput:
    """What is believed of the moment.

    Attributes
    ----------
    load : Load or None
        What acts.
    simulation : ndarray of float64, shape (n_nodes, 3), or None
        A displacement whose holding forces act.
    material : Material
        What the body is made of.
    element : str
        Elements of the solver.
    held : str
        How the node set ``fixed`` is taken.
    held_nodes : array_like of int or None
        Nodes in its place.
    frame : str
        Whether the tracker drifts.
    stiffness : str
        Whether the stiffness changes across the body.
    progress : callable or None
        Called with passes finished and passes at most.
    ensemble : int
        Posterior loads solved for the covariance of nodes; 0: draws to first order.
    """

    load: Load | None
    simulation: FloatArray | None
    material: Material
    element: str
    held: str
    held_nodes: Any
    frame: str
    stiffness: str
    progress: Callable[[int, int], None] | None
    ensemble: int = 0


def register_by_contacts(given: RegisterInput, believed: ContactInput, clock: Clock) -> Registration:
    """Register without a model.

    Parameters
    ----------
    given : RegisterInput
        Checked input.
    believed : ContactInput
        What is believed of the moment.
    clock : Clock
        Gets the stages' times.

    Returns
    -------
    Registration
        The equilibrium under the mean of the loads that the markers suggest.

    Raises
    ------
    ConvergenceError
        If no equilibrium is found.
    SupportError, LoadError, MaterialError
        If what is believed does not fit the body.
    """
    settings, material = given.settings.contacts, believed.material
    if given.suspicions:
        # Input that is misread is not worth many passes: the answer will not be trusted.
        settings = replace(settings, max_passes=1)
    with clock.stage("body"):
        supports = Supports.of(given.mesh, believed.held, believed.held_nodes)
        body = ContactBody.of(given.mesh, supports, believed.element)
    seen = _seen(given)
    with clock.stage("simulate"):
        parts, field = _believed(body, believed, settings)
        columns = Columns.of(body, material, parts, settings, drifts=drifts(believed.frame))
    frame = _first_frame(given, supports)
    rng = np.random.default_rng([given.seed, 7])
    passes = Passes(columns, seen, material, settings, rng, given.threads, clock, believed.progress)
    further: list[tuple[Cause, float]] = []
    if body.base is not None and field is None:
        passes, further = _supported(passes, frame)
    if is_graded(believed.stiffness):
        passes, slopes = _graded(passes, frame, field)
        further += slopes
    columns, material = passes.columns, passes.material
    with clock.stage("simulate"):
        start = start_of(columns, material, field, frame, given.threads)
    fit = passes.run(start)
    with clock.stage("spread"):
        spread = Spread(fit, seen, material, settings, given.threads, further)
        points = _points(given, fit, spread)
        draw = _Draws(fit, spread, material, given)
        if believed.ensemble:
            with clock.stage("ensemble"):
                fields = draw(believed.ensemble)
            covariance = spread.nodes(rng, fields)
        else:
            covariance = spread.nodes(rng)
    return _result(given, fit, start, points, covariance, draw, clock, believed)


def fitting_element(mesh: Mesh, material: Material) -> str:
    """Return the elements that suit a mesh: averaged ones where plain four-node tets would be much too stiff."""
    coarse = mesh.n_nodes <= COARSE_NODES
    return "tet4-averaged" if coarse or float(np.max(material.poisson_array)) > STIFF_POISSON else "tet4"


def _supported(passes: Passes, frame: Frame) -> tuple[Passes, list[tuple[Cause, float]]]:
    """Return the passes on supports as stiff as the markers suggest, and what is left uncertain of that."""
    found = support_stiffness(passes, frame)
    columns = passes.columns.on_springs(found.best)
    springs = np.zeros((0, 2)) if columns.springs is None else columns.springs
    causes: list[tuple[Cause, float]] = []
    for index, (stiffness, log_std) in enumerate(zip(springs, found.log_std, strict=True)):
        names = ("springs.normal_kpa_per_mm", "springs.tangential_kpa_per_mm")
        causes += [(Parameter(name, index), log_std * float(k)) for name, k in zip(names, stiffness, strict=True)]
    return replace(passes, columns=columns), causes


def _graded(passes: Passes, frame: Frame, simulation: FloatArray | None) -> tuple[Passes, list[tuple[Cause, float]]]:
    """Return the passes with the stiffness that the markers suggest, and what is left uncertain of it."""
    if simulation is not None:
        message = "a graded stiffness needs a load or none: it would change the forces that hold a `simulation`"
        raise MaterialError(message, where="stiffness")
    found = grade(passes, frame)
    young = passes.columns.body.simulator.moduli(found.material)[0]
    by_tet = young if young.ndim == 1 else young.mean(axis=1)
    slopes: list[tuple[Cause, float]] = [
        (Field("young", profile * by_tet), float(std)) for std, profile in zip(found.std, found.profiles, strict=True)
    ]
    return replace(passes, material=found.material, columns=passes.columns.made_of(found.material)), slopes


def _believed(
    body: ContactBody, believed: ContactInput, settings: ContactSettings
) -> tuple[LoadParts, FloatArray | None]:
    """Return the parts of the believed load and, where it is known, the displacement that it holds."""
    simulator = body.simulator
    if believed.simulation is None:
        return simulator.load_parts(believed.load or Load()), None
    field = np.zeros((simulator.body.n_nodes, 3))
    field[: body.mesh.n_nodes] = believed.simulation
    middles = simulator.body.mid_edges
    if len(middles):
        field[body.mesh.n_nodes :] = field[middles].mean(axis=1)
    springs = spring_stiffness(body, believed.material, settings.support_stiffness)
    forces = simulator.internal_forces(field, believed.material, springs=springs)
    forces[simulator.held_nodes] = 0.0
    parts: LoadParts = {"forces": forces, "body_force": None, "prescribed": field[simulator.held_nodes]}
    return parts, field


def _seen(given: RegisterInput) -> Seen:
    """Return the data: markers, points of the surface, or both."""
    model_error = given.settings.contacts.model_error
    return Seen.of(SeenMarkers(given.observed, given.markers, model_error), _seen_points(given))


def _seen_points(given: RegisterInput) -> SeenPoints | None:
    if given.surface is None:
        return None
    return SeenPoints.of(given.mesh, given.surface, given.settings.contacts.model_error)


def _first_frame(given: RegisterInput, supports: Supports) -> Frame:
    """Return the rigid motion of the markers, or else of the points, where nothing is held for sure."""
    if not supports.moves or supports.holds:
        return Frame.still()
    whole = given.markers.seen
    if whole.sum() >= 3:
        return Frame.between(given.markers.reference[whole], given.markers.measured[whole])
    return Frame.still() if given.surface is None else closest_frame(given.mesh, given.surface.places)


def _surface_fit(given: RegisterInput, start: Moment, end: Moment) -> SurfaceFit | None:
    points = _seen_points(given)
    if given.surface is None or points is None:
        return None
    return SurfaceFit.of(points, given.surface, start, end)


@dataclass(frozen=True, eq=False)
class _Known:
    """Targets, then markers: displacements in the tracker's frame and what is known of them."""

    displacement: FloatArray
    points: Points


def _points(given: RegisterInput, fit: ContactFit, spread: Spread) -> _Known:
    moment, observed, inner = fit.moment, given.observed, given.targets
    moved = np.concatenate(
        [
            inner.predict(moment.displacement[inner.nodes]),
            observed.predict(moment.displacement[observed.nodes]),
        ]
    )
    reference = np.concatenate([inner.reference.reshape(-1, 3), given.markers.reference])
    rows = [*inner.rows(), *observed.rows(moment.displacement[observed.nodes])]
    known = spread.points(rows, reference + moved)
    return _Known(moment.frame.apply(reference + moved) - reference, known)


@dataclass(frozen=True, eq=False)
class _Draws:
    """Posterior displacement fields in equilibrium."""

    fit: ContactFit
    spread: Spread
    material: Material
    given: RegisterInput

    def __call__(self, count: int) -> FloatArray:
        """Return fields (count, n_nodes, 3) in mm."""
        fit = self.fit
        rng = np.random.default_rng([self.given.seed, 8])
        coefficients = self.spread.coefficients(rng, count)
        simulator, mesh = fit.columns.body.simulator, fit.columns.body.mesh
        found = simulator.solve_many(
            [fit.columns.load(one) for one in coefficients],
            [self.material] * count,
            start=fit.moment.displacement,
            springs=fit.columns.springs,
            threads=self.given.threads,
            tolerance=1e-6,
        )
        if found.failed:
            index, reason = found.failed[0]
            message = (
                f"every draw must find equilibrium; {len(found.failed)} of {count} do not, the first of them: {reason}"
            )
            raise ConvergenceError(message, where=f"draw {index}")
        frames = [self._frame(one) for one in coefficients]
        moved = mesh.nodes + found.displacement
        return np.stack([frame.apply(places) for frame, places in zip(frames, moved, strict=True)]) - mesh.nodes

    def _frame(self, coefficients: FloatArray) -> Frame:
        columns = self.fit.columns
        first = self.fit.moment.frame if columns.body.supports.moves else Frame.still()
        return first.followed_by(columns.frame(coefficients), columns.rigid)


def _result(
    given: RegisterInput,
    fit: ContactFit,
    start: Moment,
    known: _Known,
    covariance: FloatArray,
    draw: _Draws,
    clock: Clock,
    believed: ContactInput,
) -> Registration:
    """Put everything that was found in its place."""
    mesh, markers, n_targets = given.mesh, given.markers, len(given.targets.names)
    moment = fit.moment
    displacement = moment.frame.apply(mesh.nodes + moment.displacement[: mesh.n_nodes]) - mesh.nodes
    fitted = known.displacement[n_targets:]
    begun = given.observed.predict(start.displacement[given.observed.nodes])
    begun = start.frame.apply(markers.reference + begun) - markers.reference
    some = np.asarray(np.isfinite(markers.measured).any(axis=1))
    wrong = np.asarray(fit.wrong >= _WRONG)
    used, lost = np.flatnonzero(some & ~wrong), np.flatnonzero(~some | wrong)
    ratios = det_f(mesh, moment.displacement[: mesh.n_nodes])
    surface = _surface_fit(given, start, moment)
    knows = believed.load is not None or believed.simulation is not None
    return Registration(
        mesh=mesh,
        displacement=displacement,
        std=np.sqrt(np.trace(covariance, axis1=1, axis2=2)),
        node_covariance=covariance,
        targets=_targets(given, known, start if knows else None),
        unseen=_unseen(given, known, begun if knows else None, lost),
        markers=MarkerFit(
            used=tuple(markers.names[i] for i in used),
            dropped=tuple((markers.names[i], "wrong" if some[i] else "not seen") for i in lost),
            before_rms_mm=rms_length(markers.displacement[used] - begun[used]),
            after_rms_mm=rms_length(markers.displacement[used] - fitted[used]),
            residual_mm={markers.names[i]: markers.displacement[i] - fitted[i] for i in used},
        ),
        all_markers=markers,
        start_markers=markers.reference + begun,
        min_det_f=float(ratios.min()),
        inverted_tets=int((ratios <= 0).sum()),
        trust=_trust(given, fit, known, (used, surface), float(ratios.min())),
        surface=surface,
        model={"kind": "contacts", "source": "fitted here", "patches": fit.columns.n_patches},
        seconds=clock.seconds,
        seed=given.seed,
        dropped_members=[],
        contacts=find_contacts(fit),
        work=dict(fit.counters),
        forces=_forces(fit),
        draw=draw,
    )


def _forces(fit: ContactFit) -> FloatArray:
    """Return the nodal forces (n_nodes, 3) of the mean load in the tracker's frame, mN."""
    forces = np.asarray(fit.columns.load(fit.moment.coefficients).forces)
    return np.asarray(forces[: fit.columns.body.mesh.n_nodes] @ fit.moment.frame.rotation.T)


def _targets(given: RegisterInput, known: _Known, start: Moment | None) -> dict[str, Target]:
    inner, points = given.targets, known.points
    said = None
    if start is not None:
        said = start.frame.apply(inner.reference + inner.predict(start.displacement[inner.nodes]))
    return {
        name: Target(
            inner.reference[i],
            inner.reference[i] + known.displacement[i],
            points.covariance[i],
            None if said is None else said[i],
            float(points.constrained[i]),
            NO_MARKER if points.constrained[i] < LEAST_CONSTRAINED else None,
        )
        for i, name in enumerate(inner.names)
    }


def _unseen(given: RegisterInput, known: _Known, begun: FloatArray | None, lost: Any) -> dict[str, Target]:
    """Return where a tracker would see the markers that do not count."""
    markers, first = given.markers, len(given.targets.names)
    return {
        markers.names[i]: Target(
            markers.reference[i],
            markers.reference[i] + known.displacement[first + i],
            known.points.covariance[first + i] + np.diag(markers.axis_std[i] ** 2),
            None if begun is None else markers.reference[i] + begun[i],
            float(known.points.constrained[first + i]),
            NO_MARKER if known.points.constrained[first + i] < LEAST_CONSTRAINED else None,
        )
        for i in lost
    }


def _trust(
    given: RegisterInput, fit: ContactFit, known: _Known, data: tuple[Any, SurfaceFit | None], min_det_f: float
) -> Trust:
    used, surface = data
    markers, first = given.markers, len(given.targets.names)
    model_error = given.settings.contacts.model_error
    notes = list(given.suspicions)
    notes += [
        f"wrong marker: {markers.names[i]} does not fit the others (probability {fit.wrong[i]:.2f})"
        for i in np.flatnonzero(fit.wrong >= _WRONG)
    ]
    notes += [] if surface is None else surface.reasons()
    points = (0.0, 0) if surface is None else (surface.misfit, surface.used)
    left = markers.displacement[used] - known.displacement[first + used]
    size = SeenMarkers(given.observed, markers, model_error).moved(fit.moment.frame)[used]
    variance = (markers.axis_std[used] ** 2 + (model_error * size[:, None]) ** 2).ravel()
    # A component that was not seen says nothing.
    variance[~np.isfinite(left.ravel())] = 1e12
    # Whether a marker is wrong has been asked with the contacts; here its residual is held against its noise alone.
    spread = np.zeros((3 * len(used), 3 * len(used)))
    names = tuple(markers.names[i] for i in used)
    residual = np.nan_to_num(left)
    # The innovation's misfit counts the data term once more: what it has beyond that is the prior's.
    prior_term = max(0.0, fit.misfit - float(np.sum(residual.ravel() ** 2 / variance)))
    return judge(names, residual, np.diag(variance), spread, prior_term, min_det_f, notes, points)


__all__ = ["ContactInput", "FoundContact", "register_by_contacts"]
