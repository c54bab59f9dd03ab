"""One body, its markers and its targets, registered moment after moment: what does not change is made once."""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cached_property
from typing import Any

from threadpoolctl import ThreadpoolController

from tissuereg._base.arguments import MOST_COUNTED, called, check_running, flag, maybe, whole
from tissuereg._base.arrays import FloatArray, float_array
from tissuereg._base.choice import check_choice
from tissuereg._base.clock import Clock
from tissuereg.body.load import Load
from tissuereg.body.markers import Markers
from tissuereg.body.material import Material
from tissuereg.body.mesh import Mesh
from tissuereg.body.surface import SurfacePoints
from tissuereg.errors import ArgumentError, MarkerError, SupportError
from tissuereg.registration.contacts.registration import ContactInput, fitting_element, register_by_contacts
from tissuereg.registration.fallback import LARGEST, ElasticFallback
from tissuereg.registration.inputs import Attachment, RegisterSettings, finite_field
from tissuereg.registration.learned.model import LatentModel
from tissuereg.registration.learned.points import PointModel
from tissuereg.registration.learned.registration import as_model, register_by_model
from tissuereg.registration.learned.variants import Variants
from tissuereg.registration.result import Fallback, Registration
from tissuereg.simulation.solve import ELEMENTS, Simulator

#: When a registrar with a model examines how markers are read.
READINGS = ("doubtful", "always")


class Registrar:
    """Registers one body to the same markers again and again; `register` is one such registration.

    Everything that depends on the body, the model and the places of markers and targets is made here: their attachment
    to the mesh, the model, its decoder cut down to these places, its errors there. `register` is the loop.

    Parameters
    ----------
    mesh : Mesh or (nodes, tets, fixed_nodes)
        Undeformed body in mm.
    reference_mm : array_like of float, shape (n_markers, 3), or Markers
        Places of the markers on or near the undeformed body; of `Markers` their noise and names are taken as well.
    model : path-like or LatentModel, optional
        Folder of a trained model for this mesh, or ``"phantom"`` for the one that is shipped. Without it the load is
        unknown and the answer an equilibrium.
    targets : mapping of str to array_like of float, shape (3,), optional
        Inner points of the undeformed body, mm.
    std : float or array_like of float, shape (n_markers,) or (n_markers, 3)
        Standard deviation of a measured coordinate in mm, as in `Markers`.
    names : sequence of str, optional
        Of the markers; by default ``M1``, ``M2``, ...
    load, material, element, held, held_nodes, frame, stiffness, seed, threads, settings, polish, ensemble
        As in `register`.
    readings : {"doubtful", "always"}
        With a model: when markers are examined for other units, axes, motions and orders
        (`tissuereg.registration.readings`), which
        takes as long as several registrations. "doubtful": until a first moment is free of suspicion, and where the
        answer cannot be trusted for another reason. Without a model, always; `register(after=)` then as "doubtful".

    Raises
    ------
    MarkerError
        If a marker or target lies far from the body.
    ModelError
        If the model was trained for another mesh, a file of it is corrupt, or its weights are not those of its decoder.
    ShapeError, ArgumentError, MeshError
        As in `register`.

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
        mesh: Mesh | tuple[Any, Any, Any],
        reference_mm: Any,
        model: "str | os.PathLike[str] | LatentModel | None" = None,
        targets: Mapping[str, Any] | None = None,
        *,
        std: Any = 0.1,
        names: Any = None,
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
        readings: str = "doubtful",
    ) -> None:
        check_running(seed=seed, threads=threads)
        self._load = maybe("load", load, Load)
        self._material = maybe("material", material, Material) or Material()
        check_choice("element", element, ("auto", *ELEMENTS), ArgumentError)
        check_choice("readings", readings, READINGS, ArgumentError)
        self._element: str = element
        self._examines = model is None or readings == "always"
        self._plausible = False
        self._polish = flag("polish", polish)
        self._ensemble = whole("ensemble", ensemble, most=MOST_COUNTED)
        self._held_nodes, self._frame, self._stiffness = held_nodes, frame, stiffness
        self._blas = ThreadpoolController().select(user_api="blas")
        if not isinstance(reference_mm, Markers):
            places = float_array("reference_mm", reference_mm, (None, 3))
            reference_mm = Markers(places, places * float("nan"), std, names)
        with self._blas.limit(limits=1):
            self._attached = Attachment.of(mesh, reference_mm, targets, settings, seed, threads, held)
            self._model = None if model is None else as_model(model, self._attached.mesh, threads)
            self._points = self._points_of(self._attached)

    @property
    def mesh(self) -> Mesh:
        """The undeformed body."""
        return self._attached.mesh

    @property
    def attached(self) -> Attachment:
        """Markers and targets on the body."""
        return self._attached

    @property
    def markers(self) -> Markers:
        """The markers: reference places, noise, names."""
        return self._attached.places

    @property
    def by_contacts(self) -> bool:
        """Whether there is no model, so that the load is unknown and contacts are searched."""
        return self._model is None

    @property
    def n_decoded(self) -> int:
        """Members decoded at markers and targets so far."""
        return 0 if self._points is None else self._points.n_decoded

    @property
    def multiply_adds(self) -> int:
        """Multiply-adds of the decoder at markers and targets, one member; 0 without one that could be cut."""
        return 0 if self._points is None else self._points.multiply_adds

    def register(
        self,
        measured_mm: Any,
        simulation: Any = None,
        *,
        variants: Any = None,
        after: Registration | None = None,
        progress: Callable[[int, int], None] | None = None,
        tell: Callable[[str, str], None] | None = None,
    ) -> Registration:
        """Register one moment.

        Parameters
        ----------
        measured_mm : array_like of float, shape (n_markers, 3), or Markers
            Measured places, in the order of the reference places; NaN = not seen. Of `Markers` the noise is taken as
            well; they must have the same names and reference places.
        simulation : array_like of float, shape (n_nodes, 3), optional
            Displacement of this moment by any simulator, mm.
        variants : array_like of float, shape (n_variants, n_nodes, 3), optional
            The same moment simulated with other values of what is uncertain, mm; see `register`.
        after : Registration, optional
            Of a moment shortly before, by this registrar. Without a model its contacts are where the search begins, and
            the stiffness of doubtful supports and of a graded body is kept: what was fitted once is not fitted again.
        progress, tell : callable, optional
            As in `register`.

        Returns
        -------
        Registration
            The one that `register` gives, if it is not `after` another; see `readings` for the reasons in its trust.

        Raises
        ------
        MarkerError
            If no marker was seen, or markers with other names or reference places are given.
        ShapeError
            If an array has another shape, or `simulation` or `variants` are not finite.
        ArgumentError
            If there are `variants`, and no model that was calibrated with pairs of simulation and truth.
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
        called("tell", tell)
        clock = Clock(tell)
        with clock.stage("total"):
            after = maybe("after", after, Registration)
            return self.moment(measured_mm, simulation, None, clock, progress, after, variants)

    def made_for(self, markers: Markers) -> "Registrar":
        """Return a registrar for other markers of the same body; this one if they are its own."""
        if self._attached.holds(markers):
            return self
        other = object.__new__(Registrar)
        other.__dict__.update(self.__dict__)
        own = self._attached
        targets = dict(zip(own.targets.names, own.targets.reference, strict=True))
        other._attached = Attachment.of(own.mesh, markers, targets, own.settings, own.seed, own.threads, own.held)
        other._points = self._points_of(other._attached)
        other.__dict__.pop("_elastic", None)
        return other

    def _points_of(self, attached: Attachment) -> PointModel | None:
        return None if self._model is None else PointModel(self._model, attached.observed, attached.targets)

    def moment(
        self,
        markers: Markers,
        simulation: Any,
        surface: SurfacePoints | None,
        clock: Clock,
        progress: Callable[[int, int], None] | None = None,
        after: Registration | None = None,
        variants: Any = None,
    ) -> Registration:
        """Register one moment whose markers are those of this registrar; see `register`.

        Parameters
        ----------
        markers : Markers
            Measured.
        simulation : array_like of float, shape (n_nodes, 3), or None
            Displacement of the moment, mm.
        surface : SurfacePoints or None
            Points of the surface; without a model only.
        clock : Clock
            Records the times of the stages.
        progress : callable of (int, int), optional
            Called with passes finished and passes at most.
        after : Registration, optional
            Of a moment shortly before.
        variants : array_like of float, shape (n_variants, n_nodes, 3), optional
            Of the simulation, mm.

        Returns
        -------
        Registration
            The result.
        """
        varied = None if variants is None else Variants.of(variants, self.mesh.n_nodes)
        field = None if simulation is None else finite_field(simulation, self.mesh)
        with self._blas.limit(limits=1):
            if field is None and varied is None and self._points is not None and self._load is not None:
                with clock.stage("simulate"):
                    solved = self._simulator.solve(self._load, self._material, threads=self._attached.threads)
                    field = solved.displacement
            found = self._registered(markers, field, varied, surface, clock, progress, after)
        if varied is not None:
            found = replace(found, model={**found.model, "variants": varied.count})
        start = field if field is not None or varied is None else varied.mean
        return replace(found, linear=lambda: self._linear(markers, found.markers.used, start))

    def _registered(
        self,
        markers: Markers,
        field: FloatArray | None,
        varied: Variants | None,
        surface: SurfacePoints | None,
        clock: Clock,
        progress: Callable[[int, int], None] | None,
        after: Registration | None,
    ) -> Registration:
        """Return the registration of a moment; see `moment`."""
        with clock.stage("attach"):
            always = self._examines and (after is None or self._points is not None)
            examined = always or not self._plausible
            given = self._attached.measured(markers, surface, examined)
            self._plausible = self._plausible or not given.suspicions
        if self._points is None:
            if varied is not None:
                message = "`variants` are of a registration with a trained model; there is none"
                raise ArgumentError(message, where="variants")
            found = register_by_contacts(given, self._contacts(self._load, field, progress), clock, after)
            return found if examined else self._judged(found, markers, clock)
        if not given.suspicions and self._attached.astray:
            given = replace(given, suspicions=self._attached.astray)
        result = register_by_model(given, self._points, field, clock, varied)
        if not examined:
            result = self._judged(result, markers, clock)
        if not self._polish:
            return result
        polished = register_by_contacts(given, self._contacts(None, result.displacement, progress), clock)
        return replace(polished, model={**result.model, "polished": True})

    def _judged(self, result: Registration, markers: Markers, clock: Clock) -> Registration:
        """Return a result whose markers were not examined, with the reasons that an examination gives if it fails."""
        if result.trust.ok:
            return result
        with clock.stage("judge"):
            reasons = [*self._attached.suspicions(markers), *result.trust.reasons]
            return replace(result, trust=replace(result.trust, reasons=reasons))

    def _contacts(
        self, load: Load | None, field: FloatArray | None, progress: Callable[[int, int], None] | None
    ) -> ContactInput:
        element, held = self._element, self._attached.held
        return ContactInput(
            load,
            field,
            self._material,
            fitting_element(self.mesh, self._material) if element == "auto" else element,
            held,
            self._held_nodes,
            self._frame,
            self._stiffness,
            progress,
            self._ensemble,
        )

    def _linear(self, markers: Markers, used: tuple[str, ...], start: FloatArray | None) -> Fallback | None:
        """Return where linear elasticity alone has the body; None where it can move freely or is too large."""
        with self._blas.limit(limits=1):
            return None if self._elastic is None else self._elastic.about(markers, used, start)

    @cached_property
    def _elastic(self) -> ElasticFallback | None:
        own = self._attached
        if not len(own.mesh.node_sets.get("fixed", ())) or own.mesh.n_nodes > LARGEST:
            return None
        try:
            return ElasticFallback.of(own.mesh, self._material, own.places, own.targets, own.threads)
        except SupportError:
            return None

    @cached_property
    def _simulator(self) -> Simulator:
        element = "tet4" if self._element == "auto" else self._element
        return Simulator(self.mesh, element=element, held_nodes=self._held_nodes)
