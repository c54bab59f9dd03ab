"""All measured numbers of an experiment as one flat vector: markers and forces of all cases in a fixed order."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from tissuereg._base.arrays import BoolArray, FloatArray
from tissuereg.errors import ExperimentError
from tissuereg.experiment.experiment import Experiment

_T = TypeVar("_T", bound=np.generic)


@dataclass(frozen=True, eq=False)
class CasePart:
    """Where the numbers of one case lie in the flat vector of all measured numbers.

    `name`: name of the case; `times` (n_frames,): s; `pads`: actuators whose force was measured in it; `begin`: index
    of its first entry; coordinates of markers come first, (n_frames, n_markers, 3), then forces, (n_frames, n_pads, 3);
    `n_markers`: number of markers.
    """

    name: str
    times: FloatArray
    pads: tuple[str, ...]
    begin: int
    n_markers: int

    @property
    def n_frames(self) -> int:
        """Number of frames of the case."""
        return len(self.times)

    @property
    def middle(self) -> int:
        """Index of the case's first force in the flat vector; its markers lie before it."""
        return self.begin + 3 * self.n_frames * self.n_markers

    @property
    def end(self) -> int:
        """Index in the flat vector one past the case's last entry."""
        return self.middle + 3 * self.n_frames * len(self.pads)

    def markers(self, flat: NDArray[_T]) -> NDArray[_T]:
        """Return the case's markers in flat vectors (..., size): a view of shape (..., n_frames, n_markers, 3)."""
        return flat[..., self.begin : self.middle].reshape(*flat.shape[:-1], self.n_frames, self.n_markers, 3)

    def forces(self, flat: NDArray[_T]) -> NDArray[_T]:
        """Return the case's forces in flat vectors (..., size): a view of shape (..., n_frames, n_pads, 3)."""
        return flat[..., self.middle : self.end].reshape(*flat.shape[:-1], self.n_frames, len(self.pads), 3)

    def put(self, flat: NDArray[_T], history: NDArray[_T]) -> None:
        """Write the values of all frames, (n_frames,), into the case's numbers of a flat vector (size,)."""
        self.markers(flat)[:] = history[:, None, None]
        self.forces(flat)[:] = history[:, None, None]


class SignalLayout:
    """The order of all measured numbers of an experiment in one flat vector.

    Raises `ExperimentError` if nothing was measured. Attributes: `parts`: for each case, in the experiment's order,
    where its numbers lie; `size`: length of the vector; `measured` (size,): displacements of markers from their
    reference places in mm, and forces in mN; NaN = not measured.
    """

    def __init__(self, experiment: Experiment) -> None:
        self.marker_names = experiment.marker_names
        self.reference = experiment.marker_reference
        parts, at = [], 0
        for name, case in experiment.cases.items():
            # In the order of the actuators, not of the file of forces: cached banks depend on it.
            known = case.forces.keys() & case.displacements.keys()
            pads = tuple(pad.name for pad in experiment.actuators if pad.name in known)
            part = CasePart(name, case.times, pads, at, len(self.marker_names))
            parts.append(part)
            at = part.end
        self.parts = tuple(parts)
        self.size = at
        cases = experiment.cases.items()
        self.measured = self.flatten(
            {name: case.markers for name, case in cases}, {name: case.forces for name, case in cases}
        )
        if not np.isfinite(self.measured).any():
            message = (
                f"experiment '{experiment.name}' must have measured markers or forces to be diagnosed; it has none"
            )
            raise ExperimentError(message, where=experiment.name)

    def __getitem__(self, name: str) -> CasePart:
        """Return where the numbers of a case lie, by its name."""
        return next(part for part in self.parts if part.name == name)

    @property
    def seen(self) -> BoolArray:
        """Mask (size,) of the entries that were measured."""
        return np.isfinite(self.measured)

    def of_markers(self) -> BoolArray:
        """Return a mask (size,) of the entries that are coordinates of markers."""
        chosen = np.zeros(self.size, bool)
        for part in self.parts:
            chosen[part.begin : part.middle] = True
        return chosen

    def of_case(self, name: str) -> BoolArray:
        """Return a mask (size,) of the entries that belong to a case."""
        chosen = np.zeros(self.size, bool)
        chosen[self[name].begin : self[name].end] = True
        return chosen

    def times(self) -> FloatArray:
        """Return the time of every entry in s, shape (size,)."""
        moments = np.zeros(self.size)
        for part in self.parts:
            part.put(moments, part.times)
        return moments

    def flatten(self, places: Mapping[str, FloatArray], forces: Mapping[str, Mapping[str, FloatArray]]) -> FloatArray:
        """Return predictions as a flat vector (size,): displacements of markers in mm, and forces in mN.

        `places`: by case, (n_frames, n_markers, 3), places of markers, mm; `forces`: by case and pad, (n_frames, 3),
        force on the body, mN.
        """
        flat = np.zeros(self.size)
        for part in self.parts:
            part.markers(flat)[:] = places[part.name] - self.reference
            for i, pad in enumerate(part.pads):
                part.forces(flat)[:, i] = forces[part.name][pad]
        return flat
