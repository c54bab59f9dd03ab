"""The methods that are compared: registration with an unknown load, simpler methods, and the true load.

A method is a function from a `Case` to an `Answer`; `METHODS` holds them by name.
"""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

import tissuereg as tr
from loadfree import wrong
from loadfree.events import Body, Event, true_load
from loadfree.gaussian import gaussian_answer
from loadfree.layouts import NOISE_MM, chosen, markers


@dataclass(frozen=True, eq=False)
class Case:
    """One registration: a body, an event, and markers of a layout."""

    body: Body
    event: Event
    layout: str

    @property
    def markers(self) -> tr.Markers:
        """What is measured."""
        return markers(self.body, self.event, self.layout)


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer of a method.

    Attributes
    ----------
    nodes : ndarray, shape (n_nodes, 3)
        Displacement in mm.
    targets : ndarray, shape (n_targets, 3)
        Displacement of the targets, mm.
    covariances : ndarray, shape (n_targets, 3, 3), or None
        mm^2; None: the method gives no region.
    constrained : list of float, or None
        Share of each target's prior variance that the markers remove, if the method states it.
    flagged : list of bool, or None
        Targets with the flag "no marker tells", if the method has it.
    trusted : bool or None
        The method's own trust.
    counters : dict
        Work, where the method counts it.
    """

    nodes: np.ndarray
    targets: np.ndarray
    covariances: np.ndarray | None = None
    constrained: list | None = None
    flagged: list | None = None
    trusted: bool | None = None
    counters: dict = field(default_factory=dict)


def registered(case: Case, **options) -> Answer:
    """Return the package's answer; `options` are further arguments of ``tissuereg.Body``, and the believed load."""
    names = [f"t{i}" for i in range(len(case.body.targets))]
    targets = dict(zip(names, case.body.targets, strict=True))
    load, settings = options.pop("load", None), tr.RegisterSettings(threads=1)
    body = tr.Body(case.body.mesh, **options)
    result = tr.register(body, case.markers, targets=targets, load=load, seed=0, settings=settings)
    found = [result.target(name) for name in names]
    shares = [getattr(target, "constrained", None) for target in found]
    return Answer(
        np.asarray(result.displacement),
        np.array([target.mean for target in found]) - case.body.targets,
        np.array([target.covariance for target in found]),
        None if None in shares else [float(share) for share in shares],
        [target.flag is not None for target in found] if hasattr(found[0], "flag") else None,
        bool(result.trust.ok),
        dict(result.work),
    )


def contacts(case: Case) -> Answer:
    """Register with nothing known of the load: the package's first call."""
    return registered(case)


def oracle(case: Case) -> Answer:
    """Register about the true load: contacts as smooth tractions of their true force and place, and the weight."""
    return registered(case, load=true_load(case.body, case.event))


def wrong_load(case: Case) -> Answer:
    """Register about a wrong load: half as large, turned by 30 degrees, 12 mm from where it truly acts."""
    return registered(case, load=wrong.wrong_load(case.body, case.event))


def gaussian(case: Case) -> Answer:
    """Tractions of a Gaussian field, to first order."""
    seen = case.markers
    places = chosen(case.body, case.event, case.layout)
    return Answer(*gaussian_answer(case.body, places, np.asarray(seen.displacement), NOISE_MM))


def rigid(case: Case) -> Answer:
    """Return the markers' best rigid motion."""
    from tissuereg_paper.rivals import rigid_displacement  # the other methods run without the paper's package

    return _interpolated(case, rigid_displacement)


def spline(case: Case) -> Answer:
    """Return a thin-plate spline through the markers."""
    from tissuereg_paper.rivals import spline_displacement

    return _interpolated(case, spline_displacement)


def none(case: Case) -> Answer:
    """Nothing moves."""
    return Answer(np.zeros_like(case.event.nodes), np.zeros_like(case.event.targets))


def _interpolated(case: Case, rule: Callable) -> Answer:
    seen = case.markers
    mesh, targets = case.body.mesh, case.body.targets
    moved = rule(seen.reference, seen.measured, np.concatenate([mesh.nodes, targets]))
    return Answer(moved[: mesh.n_nodes], moved[mesh.n_nodes :])


METHODS: dict[str, Callable[[Case], Answer]] = {
    "contacts": contacts,
    "rigid": rigid,
    "spline": spline,
    "gaussian": gaussian,
    "oracle": oracle,
    "wrong_load": wrong_load,
    "none": none,
}
