"""Repeated registration of one body with the same markers and targets; what does not change is computed once."""

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

from tissuereg._base.arguments import called, check_running, found, maybe, named
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg._base.blas import BlasThreads
from tissuereg._base.clock import Clock, Listener
from tissuereg._base.provenance import call_text, note_origins, note_record, provenance_now, recorded, warn
from tissuereg.body.load import Load
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.errors import ArgumentError, LostMarkerWarning, MarkerError, ModelError, SupportError
from tissuereg.registration.body import Body
from tissuereg.registration.contacts.registration import ContactInput, register_by_contacts
from tissuereg.registration.fallback import LARGEST, ElasticFallback
from tissuereg.registration.inputs import Attachment, MomentInput, RegisterInput, SimulationVariants, finite_field
from tissuereg.registration.learned.model import LatentModel
from tissuereg.registration.learned.points import PointModel
from tissuereg.registration.learned.registration import as_model, register_by_model
from tissuereg.registration.learned.variants import Variants
from tissuereg.registration.result import Fallback, Registration
from tissuereg.registration.settings import RegisterSettings
from tissuereg.simulation.solve import Simulator

#: Settings that mean nothing without a trained model, and those that mean nothing with one.
_OF_MODELS, _OF_CONTACTS = ("smoother", "readings"), ("tracker", "contacts", "ensemble")

#: Where something means something with a trained model after all.
_WHERE = dict.fromkeys(("element", "held_nodes"), " without a `load` to simulate")


class Registrar:
    """Registers one body to the same markers again and again; `tissuereg.register` makes one and calls it once.

    Everything that depends on the body, the model and the places of markers and targets is made here: the map from
    nodes to these places, the model, its decoder restricted to them, its reconstruction errors there. The method
    `register` then takes the measured places of one moment (n_markers, 3), mm, and returns a `Registration`.

    Parameters
    ----------
    mesh : Mesh, Body or (nodes, tets, fixed_nodes)
        Undeformed body in mm; a `Body` also states the assumed material, elements and how surely it is held.
    reference_mm : array_like of float, shape (n_markers, 3), or Markers
        Places of the markers on, near or inside the undeformed body, mm; of `Markers` their noise and names are taken
        as well.
    model : path-like or LatentModel, optional
        Folder of a trained model for this mesh, or ``"phantom"`` or ``"phantom-graph"``: shipped ones. Without it the
        load is unknown, and the answer is the equilibrium under the load that fits the markers.
    targets : mapping of str to array_like of float, shape (3,), optional
        Inner points of the undeformed body by name, mm, whose deformed places are wanted.
    load : Load, optional
        The assumed load, the same for every call of `register`.
    seed : int
        Seed of all random numbers.
    settings : RegisterSettings, optional
        All other settings, by default ``RegisterSettings()``.

    Raises
    ------
    MarkerError
        If a marker or target lies far from the body.
    ModelError
        If the model was trained for another mesh, a file of it is corrupt, or its weights are not those of its decoder;
        or if `body` or `settings` state something that has no meaning with a model; the message names it.
    ArgumentError
        If `settings` state something that has no meaning without a model, or an argument has the wrong type.
    ShapeError, MeshError
        If an array has another shape, or the mesh is not valid, as in `register`.

    Notes
    -----
    Cost: less than two seconds with a model; without one the body is analysed by the first registration.

    Examples
    --------
    >>> import tissuereg as tr
    >>> from tissuereg.phantom.event import LESION_MM, make_event
    >>> event = make_event(seed=0)
    >>> registrar = tr.Registrar(event.mesh, event.markers.reference, "phantom", {"lesion": LESION_MM})
    >>> simulation = tr.simulate(event.mesh, event.load, event.material).displacement
    >>> moments = [event.markers.measured, event.markers.measured + 0.05]
    >>> [registrar.register(moment, simulation).trust.ok for moment in moments]
    [True, True]
    """

    def __init__(
        self,
        mesh: Mesh | Body | tuple[Any, Any, Any],
        reference_mm: Any,
        model: "str | os.PathLike[str] | LatentModel | None" = None,
        targets: Mapping[str, Any] | None = None,
        *,
        load: Load | None = None,
        seed: int = 0,
        settings: RegisterSettings | None = None,
    ) -> None:
        check_running(seed=seed)
        how = maybe("settings", settings, RegisterSettings) or RegisterSettings()
        self._load, self._named = maybe("load", load, Load), model
        body = Body.of(mesh)
        if model is None:
            _refuse_of_models(how)
            body.warn_of_supports()
        else:
            _refuse_with_model(body, self._load, how)
        self._examines = model is None or how.readings == "always"
        self._plausible = False
        self._blas = BlasThreads()
        if not isinstance(reference_mm, Markers):
            reference_mm = Markers(float_array("reference_mm", reference_mm, (None, 3)))
        with recorded() as self._record, self._blas.one():
            note_origins(body.mesh, body.material, reference_mm, targets)
            self._attached = Attachment.of(body, reference_mm, targets, how, seed)
            self._model = None if model is None else as_model(model, body.mesh, how.threads)
            note_origins(self._model)
            self._points = None if self._model is None else self._points_of(self._model)
        self._solver = _LoadSolver(body)

    @property
    def mesh(self) -> Mesh:
        """Mesh of the undeformed body."""
        return self._attached.mesh

    @property
    def attached(self) -> Attachment:
        """Input that is the same for every registration: body, settings, markers and targets located in the mesh."""
        return self._attached

    @property
    def markers(self) -> Markers:
        """The markers: reference places (n_markers, 3) in mm, noise in mm, names."""
        return self._attached.places

    def __repr__(self) -> str:
        markers, targets = len(self.markers), len(self._attached.targets.names)
        how = "unknown contacts" if self.by_contacts else "a trained model"
        return f"Registrar({self.mesh.n_nodes} nodes, {markers} markers, {targets} targets, {how})"

    @property
    def by_contacts(self) -> bool:
        """Whether there is no trained model, so that the load is unknown and contacts on the surface are estimated."""
        return self._model is None

    @property
    def n_decoded(self) -> int:
        """Number of latent vectors that the model has decoded at markers and targets so far; 0 without a model."""
        return 0 if self._points is None else self._points.n_decoded

    @property
    def multiply_adds(self) -> int:
        """Multiply-adds of the decoder for one latent vector, at markers and targets; 0 without such a decoder."""
        return 0 if self._points is None else self._points.multiply_adds

    def register(
        self,
        measured_mm: Any,
        simulation: Any = None,
        *,
        after: Registration | None = None,
        lost: Mapping[str, str] | None = None,
        progress: Listener | None = None,
    ) -> Registration:
        """Register the body at one moment to the measured places of its markers.

        Parameters
        ----------
        measured_mm : array_like of float, shape (n_markers, 3), or Markers
            Measured places in mm, in the order of the reference places; NaN = not seen. Of `Markers` the noise is taken
            as well; they must have the same names and reference places.
        simulation : array_like of float, shape (n_nodes, 3), or SimulationVariants, optional
            Displacement of each node at this moment by any simulator, mm; with a model also variants, simulations with
            other values of uncertain parameters. It takes the place of the assumed load.
        after : Registration, optional
            Registration of a moment shortly before, by this registrar; without a model only. The search for contacts
            begins with its contacts, and the fitted stiffness of doubtful supports is kept and not fitted again.
        lost : mapping of str to str, optional
            Names of markers whose measured places are no measurements, each with the reason, which is that of the
            result's `markers.dropped`. Those that can be told from this moment alone are found without it.
        progress : callable of Progress, optional
            Called when a stage begins and when an iteration is finished, as in `register`.

        Returns
        -------
        Registration
            The displaced body with its uncertainty, the same as that of `register` unless `after` is given.
            `RegisterSettings.readings` says when the markers are examined for misreadings, which may add reasons to its
            trust.

        Raises
        ------
        MarkerError
            If no marker was seen, or markers with other names or reference places are given.
        ShapeError
            If an array has another shape, or a simulation is not finite.
        ModelError
            If `after` is given with a model.
        ArgumentError
            If there are variants, and no model that was calibrated with pairs of simulation and truth.
        ConvergenceError, EnsembleError
            If no equilibrium is found, or too few ensemble members survive.
        """
        places = self.markers
        if not isinstance(measured_mm, Markers):
            measured = float_array("measured_mm", measured_mm, (len(places), 3))
            measured_mm = Markers(places.reference, measured, places.axis_std, places.names)
        elif not self._attached.holds(measured_mm):
            message = "`measured_mm` must be of the markers that the registrar was made for, got other names or places"
            raise MarkerError(message, where="measured_mm")
        called("progress", progress)
        clock = Clock(progress)
        with clock.stage("total"):
            before = maybe("after", after, Registration)
            gone = _lost(lost, places)
            return self.registered(MomentInput(measured_mm, None, simulation, before, gone), clock)

    def begin_anew(self) -> None:
        """Take the next moment for a first one, whose markers are examined (`RegisterSettings.readings`)."""
        self._plausible = False

    def made_for(self, markers: Markers) -> "Registrar":
        """Return a registrar for `markers` on the same body; itself if names and reference places are its own."""
        own = self._attached
        if own.holds(markers):
            return self
        targets = dict(zip(own.targets.names, own.targets.reference, strict=True))
        load, how = self._load, own.settings
        other = Registrar(own.body, markers, self._model, targets, load=load, seed=own.seed, settings=how)
        other._solver = self._solver  # analysed once for the body
        other._named = self._named
        other._record.add(self._record)
        return other

    def _points_of(self, model: LatentModel) -> PointModel:
        return PointModel(model, self._attached.observed, self._attached.targets)

    def registered(self, moment: MomentInput, clock: Clock) -> Registration:
        """Return the registration of one moment whose markers are those of this registrar.

        Parameters
        ----------
        moment : MomentInput
            Measured markers and surface points, simulated displacement, and an earlier registration to start from.
        clock : Clock
            Records the times of the stages; its listener is told how far the registration is.

        Returns
        -------
        Registration
            The displaced body with its uncertainty, as `register` returns it.
        """
        with recorded(self._call(moment)):
            note_record(self._record)
            note_origins(moment.markers, moment.surface, moment.simulation)
            result, start = self._answer(moment, clock)
            made = provenance_now()
        # Not the moment itself: it holds the one before, and so on to the first.
        markers, used = result.all_markers, result.markers.used
        return replace(result, linear=lambda: self._linear(markers, used, start), provenance=made)

    def _call(self, moment: MomentInput) -> str:
        """Return the call of `tissuereg.register` that gives the answer of a moment, as text."""
        own = self._attached
        return call_text(
            "tissuereg.register",
            mesh=own.mesh,
            markers=moment.markers if len(moment.markers) else None,
            surface=moment.surface,
            targets=own.targets.names or None,
            load=self._load,
            simulation=moment.simulation,
            model=self._named,
            seed=own.seed,
        )

    def _answer(self, moment: MomentInput, clock: Clock) -> tuple[Registration, FloatArray | None]:
        """Return the registration of one moment, and the displacement (n_nodes, 3), mm, from which it starts."""
        field, varied = self._simulated(moment)
        with self._blas.one():
            if field is None and varied is None and self._points is not None and self._load is not None:
                with clock.stage("simulate"):
                    solver, own = self._solver.simulator, self._attached
                    field = solver.solve(self._load, own.body.material, threads=own.settings.threads).displacement
            result = self._registered(moment, field, varied, clock)
        if varied is not None:
            result = replace(result, model={**result.model, "variants": varied.count})
        return result, field if field is not None or varied is None else varied.mean

    def _simulated(self, moment: MomentInput) -> tuple[FloatArray | None, Variants | None]:
        """Return the simulated displacement (n_nodes, 3) of a moment, mm, and its variants, checked; each may be None.

        Variants are simulations with other values of uncertain parameters. Raises `ModelError` if an earlier
        registration is given with a trained model, and `ArgumentError` if variants are given without one.
        """
        if self._points is not None and moment.after is not None:
            message = "`after` must be left out with a trained model, which registers every moment on its own"
            raise ModelError(message, where="after")
        own, varied = moment.simulation, None
        if isinstance(own, SimulationVariants):
            if self._points is None:
                message = "`variants` are of a registration with a trained model; there is none"
                raise ArgumentError(message, where="variants")
            varied, own = Variants.of(own.fields, self.mesh.n_nodes), own.simulation
        return (None if own is None else finite_field(own, self.mesh)), varied

    def _registered(
        self, moment: MomentInput, field: FloatArray | None, varied: Variants | None, clock: Clock
    ) -> Registration:
        """Return the registration of one moment, by contacts or by the trained model.

        `moment`: measurements; `field` (n_nodes, 3) or None: simulated displacement, mm; `varied`: variants of the
        simulation, or None; `clock`: records the times of stages.
        """
        with clock.stage("attach"):
            always = self._examines and (moment.after is None or self._points is not None)
            examined = always or not self._plausible
            given = self._attached.measured(moment, suspects=examined)
            self._plausible = self._plausible or not given.suspicions
        for name, why in given.lost.items():
            warn(f"marker {name} counts as not seen: {why}", LostMarkerWarning)

        def fitted(given: RegisterInput) -> Registration:
            if self._points is None:
                return register_by_contacts(given, ContactInput(self._load, field), clock, moment.after)
            if not given.suspicions and self._attached.astray:
                given = replace(given, suspicions=self._attached.astray)
            return register_by_model(given, self._points, field, clock, varied)

        result = None if given.swap else fitted(given)
        if result is not None and (examined or result.trust.ok):
            return result
        if not examined:
            with clock.stage("judge"):
                given = self._attached.measured(moment)
        if given.swap is not None:
            # The exchange is certain if mechanics agree: the markers fit where they were put back.
            again = fitted(given.in_order())
            if set(given.swap.markers) <= set(again.markers.used):
                return again
        if result is None:
            return fitted(given)
        new = [one for one in given.suspicions if one not in result.trust.reasons]
        return replace(result, trust=replace(result.trust, reasons=[*new, *result.trust.reasons]))

    def _linear(self, markers: Markers, used: tuple[str, ...], start: FloatArray | None) -> Fallback | None:
        """Return the linear elastic estimate of displacement and target places, in mm, at one moment.

        `markers`: reference and measured places, mm; `used`: names of the markers to use; `start` (n_nodes, 3) or None:
        simulated displacement to which the estimate is added, mm. Result: None if the body can move freely or is too
        large, or no marker is left.
        """
        with self._blas.one():
            return None if self._elastic is None else self._elastic.about(markers, used, start)

    @cached_property
    def _elastic(self) -> ElasticFallback | None:
        own = self._attached
        if not len(own.body.held_mesh.node_sets.get("fixed", ())) or own.mesh.n_nodes > LARGEST:
            return None
        try:
            return ElasticFallback.of(own.mesh, own.body.material, own.places, own.targets, own.settings.threads)
        except SupportError:
            return None


def _lost(lost: Any, places: Markers) -> Mapping[str, str]:
    """Return reasons by marker after checking that all are of `places`; raise `MarkerError` if one is not."""
    given = named("lost", lost, error=MarkerError)
    for name in given:
        if name not in places.names:
            message = f"`lost` must name markers that the registrar was made for, got {found(name)}"
            raise MarkerError(message, where="lost")
    return given


@dataclass(frozen=True, eq=False)
class _LoadSolver:
    """Solver of the equilibrium of `body` under an assumed load, beside a trained model; made when it is first used."""

    body: Body

    @cached_property
    def simulator(self) -> Simulator:
        element = "tet4" if self.body.element == "auto" else self.body.element
        return Simulator(self.body.mesh, element=element, held_nodes=self.body.held_nodes)


def _refuse_of_models(how: RegisterSettings) -> None:
    """Raise `ArgumentError` if a setting that has no meaning without a trained model is not at its default."""
    for name, value in how.changed(*_OF_MODELS).items():
        message = f"`{name}` must be left out without a trained model, for which alone it means something; got "
        raise ArgumentError(message + _in_short(value), where=name)


def _refuse_with_model(body: Body, load: Load | None, how: RegisterSettings) -> None:
    """Raise `ModelError` if an assumption or setting that has no meaning with a trained model is not at its default."""
    given: dict[str, Any] = {} if body.stiffness == "believed" else {"stiffness": body.stiffness}
    given |= how.changed(*_OF_CONTACTS)
    given |= {} if body.held == "sure" else {"held": body.held}
    given |= {"regions": body.regions} if body.regions else {}
    if load is None:
        given |= {} if body.element == "auto" else {"element": body.element}
        given |= {} if body.held_nodes is None else {"held_nodes": body.held_nodes}
    for name, value in given.items():
        message = f"`{name}` must be left out with a trained model, where it means nothing{_WHERE.get(name, '')}; got "
        raise ModelError(message + _in_short(value), where=name)


def _in_short(value: Any) -> str:
    return found(value) if isinstance(value, str | int) else f"another {type(value).__name__} than the usual one"
