"""Registration with an unknown load: the contacts that explain the markers, and the equilibrium under them."""

import math
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg._base.choices import TrackerKind
from tissuereg._base.clock import Clock
from tissuereg.body.load import Load
from tissuereg.body.material import Material
from tissuereg.errors import ConvergenceError, MaterialError
from tissuereg.registration.body import Body, fitting_element
from tissuereg.registration.contacts.answer import Answer, known_of, surface_fit
from tissuereg.registration.contacts.body import ContactBody
from tissuereg.registration.contacts.carried import Carried
from tissuereg.registration.contacts.columns import Columns, spring_stiffness
from tissuereg.registration.contacts.draws import DeviationsOfContacts, Draws
from tissuereg.registration.contacts.evidence import support_stiffness
from tissuereg.registration.contacts.fit import ContactFit, Passes, start_of
from tissuereg.registration.contacts.measured import MarkerData, ObservedData
from tissuereg.registration.contacts.renewal import Renewal
from tissuereg.registration.contacts.result import ContactRegistration
from tissuereg.registration.contacts.settings import DISCRETISATION, ContactSettings
from tissuereg.registration.contacts.size import announce
from tissuereg.registration.contacts.spread import Spread
from tissuereg.registration.contacts.state import BodyState, RigidMotion
from tissuereg.registration.contacts.supports import Supports
from tissuereg.registration.contacts.surface_points import PointData, closest_frame
from tissuereg.registration.contacts.tangent import Uncertain
from tissuereg.registration.contacts.unexplained import Unexplained
from tissuereg.registration.inputs import RegisterInput
from tissuereg.registration.result import Registration
from tissuereg.simulation.sensitivity import ModulusField, Parameter
from tissuereg.simulation.solve import LoadParts


@dataclass(frozen=True, eq=False)
class ContactInput:
    """The user's belief about the load on the body.

    `load`: believed load; `simulation` (n_nodes, 3): a displacement, mm, instead; the forces that hold it in
    equilibrium are then the believed load. If both are None, no load is believed.
    """

    load: Load | None = None
    simulation: FloatArray | None = None

    @property
    def any_load(self) -> bool:
        """Whether a load is believed."""
        return self.load is not None or self.simulation is not None


def register_by_contacts(
    given: RegisterInput, believed: ContactInput, clock: Clock, after: Registration | None = None
) -> ContactRegistration:
    """Register a body without a trained model: find the contacts that explain the data, and the equilibrium under them.

    `given`: checked input; `believed`: believed load; `clock`: records the times of the stages; `after`: registration
    of a moment shortly before, with the same markers: its contacts are the start, and its estimate of supports is kept;
    or None. Result: the equilibrium under the posterior mean of the load, with its uncertainty. Raises
    `ConvergenceError` if no equilibrium is found; `SupportError`, `LoadError` or `MaterialError` if a believed quantity
    does not fit the body.
    """
    settings = given.settings.contacts
    if given.suspicions:
        # Misread input is not worth many passes: the answer will not be trusted.
        settings = replace(settings, max_passes=1)
    with clock.stage("body"):
        body = ContactBody.of(given.mesh, given.body.supports, given.body.fitting_element)
    points = None if given.surface is None else PointData.of(given.mesh, given.surface, settings.model_error)
    observed = ObservedData.of(MarkerData(given.observed, given.markers, settings.model_error), points)
    if after is None:
        announce(body, observed, given, clock)
    carried = _carried(after, given)
    # A tangent that is being renewed has a thread of its own; no answer depends on their number.
    threads = (
        given.threads if carried is None or carried.renewal is None else carried.renewal.threads_beside(given.threads)
    )
    found, note = _ContactSearch(given, body, observed, settings, clock, threads, carried).least_left(believed)
    if note:
        given = replace(given, suspicions=(*given.suspicions, note))
    with clock.stage("spread"):
        spread = Spread(found.fit, settings, threads, found.further)
        known = known_of(given, found.fit, spread)
    renewal, tangent = found.renewal, found.fit.tangent
    if found.moments > 1:
        tangent.spent += max(0, found.fit.counters["iterations"] - settings.steps.renewed_needs)
    if renewal is None and found.moments > 1 and tangent.spent >= settings.steps.renew_at:
        sizes = math.ceil(body.simulator.body.n_unknowns / max(settings.steps.renewed_unknowns, 1))
        use = found.moments + sizes * settings.steps.renewed_after
        renewal = Renewal(found.fit, observed, given.targets.rows(), given.body.material, use)
    draw = Draws(
        found.fit, spread, given.body.material, given.seed, given.threads, found.further, found.moments, renewal
    )
    fields = None
    if given.settings.ensemble:
        with clock.stage("ensemble"):
            fields = draw(given.settings.ensemble)
    deviations = DeviationsOfContacts(spread, given.seed, fields)
    fared = surface_fit(given, points, found.start, found.fit.state)
    # Evidence is weighed now and then, and not beside a renewal, which takes a core.
    later = (found.moments - 1) % settings.evidence.every or found.renewal is not None
    kept = tuple(after.trust.reasons) if after is not None and later else None
    answer = Answer(given, found.fit, found.start, believed.any_load, known, deviations, draw, fared, kept)
    return answer.registration(clock)


@dataclass(frozen=True, eq=False)
class _Found:
    """A fit, the body from which its search began, and the estimates that were made before it.

    `fit`: contacts and equilibrium; `start`: the body under the believed load alone; `further`: further uncertain
    parameters, each with its standard deviation in the parameter's unit; `moments`: number of moments through which the
    samples have been carried on; `renewal`: the tangent that a later moment will use, or None.
    """

    fit: ContactFit
    start: BodyState
    further: list[tuple[Uncertain, float]]
    moments: int = 1
    renewal: Renewal | None = None


@dataclass(frozen=True, eq=False)
class _ContactSearch:
    """The search for the contacts that explain the measurements, for any believed load.

    `given`: checked input; `body`: prepared mesh; `observed`: data; `settings`: prior and Markov chains; `clock`:
    records the times of the stages; `carried`: end of the registration of the moment before, from which the search
    continues, or None.
    """

    given: RegisterInput
    body: ContactBody
    observed: ObservedData
    settings: ContactSettings
    clock: Clock
    threads: int
    carried: Carried | None = None

    def least_left(self, believed: ContactInput) -> tuple[_Found, str]:
        """Return the fit with the believed load; or, if that leaves large residuals, one without it, and the reason.

        `believed`: believed load. The reason is a sentence, empty if the believed load was kept. Raises
        `ConvergenceError` if neither finds an equilibrium.
        """
        if not believed.any_load:
            return self.found(believed), ""
        found = None
        with suppress(ConvergenceError):
            found = self.found(believed)
        if found is not None and min(found.fit.residual_rms) < self.settings.steps.unmet:
            return found, ""
        try:
            without = self.found(replace(believed, load=None, simulation=None))
        except ConvergenceError:
            if found is None:
                raise
            return found, ""
        if found is None:
            return without, "the believed load was left out: no equilibrium is found under it"
        if min(without.fit.residual_rms) < self.settings.steps.much_less * min(found.fit.residual_rms):
            return without, "the believed load was left out: no contacts added to it explain the markers"
        return found, ""

    def found(self, believed: ContactInput) -> _Found:
        """Return the fit under a believed load; it continues from the end of the moment before if that works.

        Otherwise doubtful supports are estimated first, and the search begins under the load alone.
        """
        given, body, settings, clock, material = (
            self.given,
            self.body,
            self.settings,
            self.clock,
            self.given.body.material,
        )
        frame = _first_frame(given, body.supports)
        with clock.stage("simulate"):
            parts, field = _believed(body, material, believed, settings)
            columns = Columns.of(
                body,
                material,
                parts,
                settings,
                drifts=_drifts(given.settings.tracker, body.supports),
                stiffness=_stiffness(given, field),
                unexplained=self._unexplained(frame),
            )
        rng = np.random.default_rng([given.seed, 7])
        passes = Passes(columns, self.observed, material, settings, rng, self.threads, clock)
        if self.carried is not None:
            gone_on = self._gone_on(self.carried, passes, field, frame)
            if gone_on is not None:
                return gone_on
        further: list[tuple[Uncertain, float]] = []
        if body.base is not None and field is None:
            passes, further = _supported(passes, frame)
        further += _regions(given.body)
        with clock.stage("simulate"):
            start = start_of(passes.columns, passes.material, field, frame, self.threads)
        return _Found(passes.run(start), start, further)

    def _unexplained(self, frame: RigidMotion) -> Unexplained | None:
        """Return the displacement that no load explains; none where points without labels are matched to the surface.

        There it could follow wrong matches, which loads cannot. `frame`: initial rigid motion.
        """
        data = self.observed.markers
        if data is None or self.observed.rematches:
            return None
        motion = float(np.sqrt(np.mean(data.motion(frame) ** 2)))
        before = None if self.carried is None else self.carried.columns.unexplained
        if before is not None and self.carried is not None and self.carried.columns.body is self.body:
            return before.with_motion(motion)
        return Unexplained.of(self.given.mesh, self.body.supports.sure, data.markers.reference, motion)

    def _gone_on(self, carried: Carried, passes: Passes, field: FloatArray | None, frame: RigidMotion) -> _Found | None:
        """Return the fit that continues from the end of the moment before; None if it leaves much larger residuals.

        `carried`: that end; `passes`: the loop of the fit with this moment's data; `field` (n_element_nodes, 3) or
        None: displacement under the believed load, mm, if known; `frame`: initial rigid motion. It is also None if the
        causes are others or there is no equilibrium.
        """
        columns = carried.columns_for(passes.columns)
        if columns is None:
            return None
        # Chains that go on do not repeat their random numbers: what they miss in one moment they find in a later one.
        rng = np.random.default_rng([self.given.seed, 7, carried.moments])
        passes = replace(passes, columns=columns, rng=rng, before=carried.samples, kept=carried.tangent)

        def solve(coefficients: FloatArray) -> FloatArray:
            near = carried.tangent.linearised
            return near.solve_near(
                columns.load(coefficients),
                springs=columns.springs,
                tolerance=DISCRETISATION.tolerance,
                threads=passes.threads,
            ).all_displacement

        with self.clock.stage("simulate"):
            start = start_of(columns, passes.material, field, frame, self.threads)
            begin = carried.begin(columns, solve)
        if begin is None:
            return None
        try:
            fit = passes.run(begin)
        except ConvergenceError:
            return None
        if min(fit.residual_rms) > max(self.settings.fit_limit, self.settings.steps.much_more * carried.residual):
            # The contacts of the moment before lead nowhere: look everywhere.
            return None
        return _Found(fit, start, carried.further, carried.moments + 1, carried.renewal)


def _carried(after: Registration | None, given: RegisterInput) -> Carried | None:
    """Return the end of an earlier registration of the same markers, to start from; None if it cannot be continued.

    `after`: the earlier registration, or None; `given`: this moment's input. A registration with points of the surface,
    with other markers, or of another material, whose tangent would solve for its own, cannot be continued.
    """
    if not isinstance(after, ContactRegistration) or not isinstance(after.draw, Draws):
        return None
    if given.surface is not None or after.surface is not None:
        return None
    theirs, ours = after.draw.material, given.body.material
    if theirs is not ours and theirs.digest() != ours.digest():
        return None
    names, observed = after.all_markers.names, np.isfinite(after.all_markers.measured).any(axis=1)
    now = np.isfinite(given.markers.measured).any(axis=1)
    if names != given.markers.names or after.draw.fit.samples[2].shape[1] != int(observed.sum()):
        return None
    return Carried.of(after.draw, np.asarray(observed), np.asarray(now))


def _supported(passes: Passes, frame: RigidMotion) -> tuple[Passes, list[tuple[Uncertain, float]]]:
    """Return the loop of the fit with the stiffness of doubtful supports of highest evidence, and its uncertainty.

    `passes`: loop of the fit; `frame`: initial rigid motion. Second result: normal and tangential stiffness of each set
    of springs, with standard deviations in kPa/mm.
    """
    found = support_stiffness(passes, frame)
    columns = passes.columns.on_springs(found.best)
    springs = np.zeros((0, 2)) if columns.springs is None else columns.springs
    causes: list[tuple[Uncertain, float]] = []
    for index, (stiffness, log_std) in enumerate(zip(springs, found.log_std, strict=True)):
        names = ("springs.normal_kpa_per_mm", "springs.tangential_kpa_per_mm")
        causes += [(Parameter(name, index), log_std * float(k)) for name, k in zip(names, stiffness, strict=True)]
    return replace(passes, columns=columns), causes


def _regions(body: Body) -> list[tuple[Uncertain, float]]:
    """Return the moduli of regions of the body that are uncertain, as causes, each with its standard deviation, kPa."""
    causes: list[tuple[Uncertain, float]] = []
    for region in body.regions.values():
        if region.std > 0.0 and len(region.tets):
            rates = np.zeros(body.mesh.n_tets)
            rates[region.tets] = 1.0
            causes.append((ModulusField("young", rates), region.std))
    return causes


def _drifts(tracker: TrackerKind | None, supports: Supports) -> bool:
    """Return whether the tracker may have drifted, by its setting or by default: where supports are sure and none not.

    On doubtful supports the body itself may move as a whole.
    """
    return tracker == "drifts" if tracker is not None else not len(supports.perhaps)


def _stiffness(given: RegisterInput, simulation: FloatArray | None) -> tuple[float, float] | None:
    """Return the size of changes of stiffness across the body: median and standard deviation of its logarithm.

    `simulation` (n_element_nodes, 3) or None: displacement under the believed load, mm. Its forces belong to the
    believed stiffness, which then does not change: None. Raises `MaterialError` if it is graded nevertheless.
    """
    graded, settings = given.body.stiffness == "graded", given.settings.contacts
    if simulation is None:
        return settings.graded if graded else settings.stiffness
    if graded:
        message = "a graded stiffness needs a load or none: it would change the forces that hold a `simulation`"
        raise MaterialError(message, where="stiffness")
    return None


def _believed(
    body: ContactBody, material: Material, believed: ContactInput, settings: ContactSettings
) -> tuple[LoadParts, FloatArray | None]:
    """Return the parts of the believed load, and the displacement (n_element_nodes, 3) under it, mm, if it is known.

    `body`: prepared mesh; `material`: its material; `believed`: believed load or simulated displacement; `settings`:
    stiffness of the supports. The displacement is None unless it was given as a simulation.
    """
    simulator = body.simulator
    if believed.simulation is None:
        return simulator.load_parts(believed.load or Load()), None
    field = np.zeros((simulator.body.n_nodes, 3))
    field[: body.mesh.n_nodes] = believed.simulation
    middles = simulator.body.mid_edges
    if len(middles):
        field[body.mesh.n_nodes :] = field[middles].mean(axis=1)
    springs = spring_stiffness(body, material, settings.support_stiffness)
    forces = simulator.internal_forces(field, material, springs=springs)
    forces[simulator.held_nodes] = 0.0
    parts: LoadParts = {"forces": forces, "body_force": None, "prescribed": field[simulator.held_nodes]}
    return parts, field


def _first_frame(given: RegisterInput, supports: Supports) -> RigidMotion:
    """Return the initial rigid motion from the body's frame to the tracker's; the identity if any node is held.

    It is fitted to the markers, or to the surface points if fewer than three markers are seen.
    """
    if not supports.moves or supports.holds:
        return RigidMotion.still()
    whole = given.markers.seen
    if whole.sum() >= 3:
        return RigidMotion.between(given.markers.reference[whole], given.markers.measured[whole])
    return RigidMotion.still() if given.surface is None else closest_frame(given.mesh, given.surface.places)


__all__ = ["ContactInput", "fitting_element", "register_by_contacts"]
