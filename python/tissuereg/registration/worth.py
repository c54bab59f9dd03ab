"""What a trained model is worth on its body: the same events registered with it and by contacts."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from tissuereg._base.arrays import FloatArray
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh, random_simplices
from tissuereg.errors import TissueRegError
from tissuereg.registration.learned.model import LatentModel
from tissuereg.registration.register import register
from tissuereg.registration.settings import RegisterSettings

#: Markers on the free surface, inner targets, and the noise of a coordinate, mm.
_MARKERS, _TARGETS, _STD = 15, 20, 0.1


@dataclass(frozen=True)
class Worth:
    """Mean errors at inner targets over some events, in mm.

    `events`: number of events; `before`: of the simulation, or of the body at rest; `model`: registered with the model;
    `contacts`: registered without it, by the contacts that explain the markers.
    """

    events: int
    before: float
    model: float
    contacts: float

    @property
    def pays(self) -> bool:
        """Whether the model's error is the smallest."""
        return self.model < min(self.contacts, self.before)


def worth(
    model: LatentModel,
    mesh: Mesh,
    truths: FloatArray,
    simulations: Sequence[FloatArray | None],
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> Worth | None:
    """Return what a model is worth on events that it was not trained on.

    Parameters
    ----------
    model : LatentModel
        Calibrated model of the mesh.
    mesh : Mesh
        Undeformed body.
    truths : ndarray of float, shape (n_events, n_nodes, 3)
        True displacements, mm.
    simulations : sequence of (ndarray of float, shape (n_nodes, 3), or None)
        What is simulated of each event, mm; without one it is registered from rest.
    seed : int
        Of places and noise.
    progress : callable of int, optional
        Called with the number of events done.

    Returns
    -------
    Worth or None
        None if no event could be registered in both ways. Cost: two registrations an event; by contacts some tenths of
        a second for 4,000 nodes.
    """
    rows = []
    for number, (truth, simulation) in enumerate(zip(truths, simulations, strict=True)):
        rng = np.random.default_rng([seed, 61, number])
        on, inside = random_simplices(mesh, _MARKERS, _TARGETS, rng)
        reference, places = mesh.nodes[on].mean(axis=1), mesh.nodes[inside].mean(axis=1)
        measured = reference + truth[on].mean(axis=1) + _STD * rng.standard_normal(reference.shape)
        targets = {str(i): place for i, place in enumerate(places)}
        true = places + truth[inside].mean(axis=1)
        start = places if simulation is None else places + simulation[inside].mean(axis=1)
        row = [float(np.linalg.norm(start - true, axis=1).mean())]
        try:
            for way in (model, None):
                markers, settings = Markers(reference, measured, _STD), RegisterSettings(threads=1)
                found = register(mesh, markers, targets=targets, simulation=simulation, model=way, settings=settings)
                ends = np.array([found.target(name).mean for name in targets])
                row.append(float(np.linalg.norm(ends - true, axis=1).mean()))
        except TissueRegError:
            row = []
        rows += [row] if row else []
        if progress is not None:
            progress(number + 1)
    return Worth(len(rows), *(float(one) for one in np.mean(rows, axis=0))) if rows else None


def worth_text(alone: Worth | None, simulated: Worth | None) -> str:
    """Return a table of errors with and without the model, and a sentence that says when the model pays."""
    rows = {"without a simulation": alone, "with a simulation": simulated}
    known = {name: one for name, one in rows.items() if one is not None}
    lines = [
        "| mean error at inner targets, mm | events | before | with this model | by contacts |",
        "| --- | --- | --- | --- | --- |",
        *(
            f"| {name} | {one.events} | {one.before:.2f} | {one.model:.2f} | {one.contacts:.2f} |"
            for name, one in known.items()
        ),
        "",
    ]
    pays = [name for name, one in known.items() if one.pays]
    if not known:
        return "No event could be registered with this model and by contacts.\n"
    verdict = f"It pays {' and '.join(pays)}." if pays else "It does not pay on these events: register without it."
    return "\n".join([*lines, f"{_MARKERS} random markers, {_STD:g} mm of noise. {verdict}", ""])
