"""A reading (one interpretation of the input), with the prior cost of the mistake it assumes, and the input itself."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from tissuereg._base.arrays import BoolArray, FloatArray, IntArray
from tissuereg.body.markers import Markers
from tissuereg.body.mesh import Mesh
from tissuereg.registration.readings.settings import MOTION
from tissuereg.registration.readings.skin import Skin, skin_of


@dataclass(frozen=True, eq=False)
class Given:
    """The markers as they were given, with derived data that readings (interpretations of the input) need.

    `skin`: surface of the undeformed body, for distances of points from it; `held_nodes` (n_held, 3): places of the
    held nodes, mm; `names`: names of the markers; `reference`, `measured` (n_markers, 3): reference and measured places
    as given, mm; NaN = not seen; `motion` (n_markers, 3): measured minus reference, mm; `noise`: median standard
    deviation of a measured coordinate, mm.
    """

    skin: Skin
    held_nodes: FloatArray
    names: tuple[str, ...]
    reference: FloatArray
    measured: FloatArray
    motion: FloatArray
    noise: float

    @classmethod
    def of(cls, mesh: Mesh, markers: Markers, rows: IntArray) -> "Given":
        """Return the input of the markers with numbers `rows`, int64 (n,), with the data that readings need."""
        skin = skin_of(mesh)
        return cls(
            skin,
            mesh.nodes[skin.held],
            tuple(markers.names[i] for i in rows),
            markers.reference[rows],
            markers.measured[rows],
            markers.displacement[rows],
            min(float(np.median(markers.std[rows])), MOTION.largest_noise_mm),
        )

    @property
    def complete(self) -> BoolArray:
        """Mask (n_markers,) of the markers that were seen with all three coordinates."""
        return np.asarray(np.isfinite(self.measured).all(axis=1))


@dataclass(frozen=True, eq=False)
class Reading:
    """One way to interpret the input: a mistake that may have been made, and the places and motion without it.

    `kind`: kind of mistake, the first word of the sentence that reports it; `words`: the change of the input that this
    reading makes, in words; `cost`: minus the logarithm of the prior odds of such a mistake; `places` (n_markers, 3):
    reference places under this reading, mm; `motion` (n_markers, 3): displacements under this reading, mm, possibly in
    a rotated frame; NaN = not seen; `arms` (n_markers, 3): the reference places in the frame of the displacements, mm;
    `log_scale`: logarithm of the factor by which this reading multiplies measured coordinates; 0 unless it changes
    units; `rigid`: whether the body may move rigidly as a whole; `rows`: numbers of the markers that this reading
    changes; empty = all.
    """

    kind: str
    words: str
    cost: float
    places: FloatArray
    motion: FloatArray
    arms: FloatArray
    log_scale: float = 0.0
    rigid: bool = False
    rows: Sequence[int] = field(default_factory=tuple)


def as_given(given: Given) -> Reading:
    """Return the reading (interpretation) that takes the input as it was given: places and displacements unchanged."""
    return Reading("", "", 0.0, given.reference, given.motion, given.reference)
